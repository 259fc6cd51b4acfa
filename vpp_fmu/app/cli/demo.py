"""All steps on the campaign that ships with the project: identify, diagnose, augment, export, simulate, close the loop."""

import time

from identification.demo import demo, example_folder
from vpp_fmu.app.api.export import exported
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import WORKERS, add_output
from vpp_fmu.app.cli.output import answered, output, stages
from vpp_fmu.app.report.pages.demo import DemoResult
from vpp_fmu.campaign import read_campaign

EXAMPLE = "vpp demo -o demo"


def configure(parser):
    parser.add_argument(
        "--workers", type=WORKERS, default=2, metavar="N", help="number of parallel fits (default: %(default)s)"
    )
    add_output(parser)
    parser.set_defaults(output="demo")


def run(options) -> Answer:
    began = time.perf_counter()
    with output(options) as folder, stages("vpp demo", options.quiet) as stage:
        whole = read_campaign(example_folder())
        done = demo(whole, folder, lambda parts, flavour: exported(parts, [flavour]), options.workers, stage)
        stage("report")
        return answered(options, folder, DemoResult(done, time.perf_counter() - began))
