"""All steps on the campaign that ships with the project: identify, diagnose, augment, export, simulate, close the loop."""

import time

from identification.demo import Demo, demo, example_folder
from identification.thrust_steps import step_profile
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.cosim import summary
from vpp_fmu.app.cli.diagnose import write_diagnosis
from vpp_fmu.app.cli.export import exported
from vpp_fmu.app.cli.options import WORKERS
from vpp_fmu.app.cli.output import add_output, dated, stages, written
from vpp_fmu.app.report.pages.demo import demo_page, headline, key_figures
from vpp_fmu.app.report.pages.loop import sentence
from vpp_fmu.app.report.summary import summary as diagnosed
from vpp_fmu.campaign import read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet, to_json
from vpp_fmu.record import Record, write_record
from vpp_fmu.response import steps

EXAMPLE = "vpp demo -o demo"


def configure(parser):
    parser.add_argument(
        "--workers", type=WORKERS, default=2, metavar="N", help="number of parallel fits (default: %(default)s)"
    )
    add_output(parser)
    parser.set_defaults(output="demo")


def run(options):
    began = time.perf_counter()
    folder = OutputSet(options.output, "demo")
    with stages("vpp demo", options.quiet) as stage:
        done = demo(
            read_campaign(example_folder()),
            folder,
            lambda parts, flavour: exported(parts, [flavour]),
            options.workers,
            stage,
        )
        stage("report")
        _write(folder, done)
    loops = {name: steps(loop) for name, loop in done.loops.items()}
    lines = [f"{name}: {sentence(step)}" for name, found in loops.items() for step in found]
    seconds = time.perf_counter() - began
    content = {"format": "vpp-demo/1", "diagnosis": diagnosed(done.diagnosis), "rmse_thrust_fmu": {**done.rmse, "unit": "N"}}
    content |= {"loops": {name: summary(found) for name, found in loops.items()}, "seconds": seconds}
    place = written(options, folder, done.diagnosis.parameters(done.diagnosis.final))
    return Answer(headline(done), content, lines, key_figures(done), written=[f"{seconds:.1f} s", *place])


def _write(folder: OutputFolder, done: Demo) -> None:
    """Write the files of the other verbs, and the report."""
    found = done.diagnosis
    write_diagnosis(folder, found)
    for name, gains in (("gains.json", DUAL), ("gains_speed_only.json", SPEED_ONLY)):
        folder.write(name, to_json(dated(ParameterSet(CONTROLLER, source={"made_by": "the paper's gains"}).replaced(gains))))
    write_record(folder, "profile.csv", step_profile(found.rig))
    commands = {name: done.validation[name] for name in ("time", "omega_ref", "beta_ref")}
    for name, file in (("before", "prediction_base.csv"), ("after", "prediction.csv")):
        write_record(folder, file, Record({**commands, "thrust": done.thrust[name]}, "vpp demo"))
    for name, loop in done.loops.items():
        write_record(folder, f"run_{name.replace(' ', '_')}.csv", loop)
    folder.write("report.html", demo_page(done).html())
