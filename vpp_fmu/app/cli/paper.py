"""Repeat the paper's study on the emulated rig: campaign, model, fine-tuning, controllers, and every number beside the paper's.
In virtual time; on a real rig the campaign would take an hour."""

import sys
import time

from identification.demo import local_flavour
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.export import exported
from vpp_fmu.app.cli.options import whole
from vpp_fmu.app.cli.output import add_output, dated, stages, written
from vpp_fmu.app.paper.control import RIG
from vpp_fmu.app.paper.study import FEWER, FULL, QUICK, REPEATS, Stages, Study, study
from vpp_fmu.app.report.pages.paper import paper_page, summary, tiles, verdict
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet, to_json, to_ssv
from vpp_fmu.structured import as_json

EXAMPLE = "vpp paper -o paper"


def configure(parser):
    if sys.platform != "linux":
        parser.error(f"platform: found {sys.platform}, expected Linux: the rig needs its clock, PWM files, I2C, terminals")
    parser.add_argument("--quick", action="store_true", help="a smaller campaign, to see what the study does")
    parser.add_argument(
        "--seed", type=whole(0, 999_999), default=0, metavar="N", help="of everything random (default: %(default)s)"
    )
    add_output(parser)


def run(options):
    folder, began = OutputSet(options.output, "paper"), time.perf_counter()
    plan, repeats = (QUICK, FEWER) if options.quick else (FULL, REPEATS)
    with stages("vpp paper", options.quiet) as stage:
        timed = Stages(stage)
        done = study(OutputFolder(folder.path / "campaign"), plan, repeats, options.seed, timed)
        stage("export")
        _write(folder, done)
        timed.done("FMUs")
        total = time.perf_counter() - began
        stage("report")
        folder.write("paper.json", as_json(summary(done, total)))
        folder.write("report.html", paper_page(done, total).html())
    more = [f"{name}: {seconds:.1f} s" for name, seconds in done.seconds.items()]
    place = [f"the whole study: {time.perf_counter() - began:.1f} s", *written(options, folder, done.found.parameters)]
    return Answer(verdict(done), summary(done, total), figures=tiles(done, total), more=more, written=place)


def _write(folder: OutputFolder, done: Study) -> None:
    """Write the files of `vpp identify`, `vpp tune` and `vpp export` for the campaign."""
    parameters, gains = done.found.parameters, {}
    folder.write("parameters.json", to_json(dated(parameters)))
    folder.write("parameters.ssv", to_ssv(parameters, "parameters"))
    folder.write("identification.json", as_json(done.found.summary()))
    for name, file in (("dual", "gains.json"), ("speed_only", "gains_speed_only.json")):
        tuned = done.tuned[RIG].tuned[name]
        source = {"made_by": "vpp paper", "cost": tuned.cost("tuned")}
        gains[name] = ParameterSet(CONTROLLER, source=source).replaced(tuned.objective.with_gains(tuned.final))
        folder.write(file, to_json(dated(gains[name], parameters=("parameters.json", parameters))))
    for name, content in exported([parameters, gains["dual"]], [local_flavour()]).items():
        folder.write(name, content)
