"""All steps on the campaign that ships with the project: identify, diagnose, augment, export, simulate, close the loop."""

import time

from tqdm import tqdm

from identification.demo import Demo, demo, example_folder, step_profile
from identification.identify import Identification
from vpp_fmu.app.cli.cosim import STEP_COLUMNS, row, sentence
from vpp_fmu.app.cli.diagnose import write_diagnosis
from vpp_fmu.app.cli.export import exported
from vpp_fmu.app.cli.options import WORKERS
from vpp_fmu.app.cli.output import add_output, dated, say_written
from vpp_fmu.app.report.canvas import thinning
from vpp_fmu.app.report.figures.time import closed_loop, measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.diagnosis import add_diagnosis
from vpp_fmu.app.report.pages.diagnosis import key_figures as diagnosed
from vpp_fmu.app.report.pages.identification import add_found, add_static
from vpp_fmu.campaign import read_campaign
from vpp_fmu.digits import number
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
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        done = demo(
            read_campaign(example_folder()),
            folder,
            lambda parts, flavour: exported(parts, [flavour]),
            options.workers,
            bar.set_description,
        )
        bar.set_description("report")
        _write(folder, done)
    lines = [f"{label}: {value} ({note})" for label, value, note in key_figures(done)]
    lines += [f"{name}: {sentence(step)}" for name, loop in done.loops.items() for step in steps(loop)]
    lines.append(f"{time.perf_counter() - began:.1f} s")
    say_written(folder, done.diagnosis.parameters(done.diagnosis.final), lines)


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


def key_figures(done: Demo) -> list[tuple[str, str, str]]:
    """(label, value, note): those of the diagnosis, and the errors of the FMUs."""
    before, after = done.rmse["before"], done.rmse["after"]
    note = f"unseen record, noise of one reading {number(done.diagnosis.noise.floor)} N"
    through = ("thrust error, FMU in fmpy", f"{number(before)} → {number(after)} N", note)
    return [through if label.startswith("thrust error") else (label, *rest) for label, *rest in diagnosed(done.diagnosis)]


def demo_page(done: Demo) -> Page:
    """The report of all steps."""
    found, validation = done.diagnosis, done.validation
    described = {e.name: e.description for e in found.final.problem.model.effects}
    effects = " and ".join(f"{name} ({described[name]})" for name in found.final.effects) or "nothing"
    before, after = done.rmse["before"], done.rmse["after"]
    page = Page(
        "From rig data to FMUs",
        f"A measured campaign becomes a plant model; its residual shows what the model lacks: {effects}. The model before and "
        f"after is exported as FMUs, and fmpy runs them on a record that no fit has seen: {number(before)} N before, "
        f"{number(after)} N after; the noise alone is {number(found.noise.floor)} N.",
        found.campaign.label,
    )
    page.tiles(key_figures(done))
    page.section("The plant FMUs against measurement")
    title = (
        f"On an unseen record the FMU errs by {number(before)} N before and {number(after)} N after; "
        f"noise is {number(found.noise.floor)} N"
    )
    lines = {f"FMU {name}": thrust for name, thrust in done.thrust.items()}
    figure = measured_against_predicted(
        validation.time,
        validation["thrust"],
        lines,
        title,
        commands={n: validation[n] for n in ("omega_ref", "beta_ref")},
        noise=found.noise.floor,
    )
    page.figure(figure, f"validation.csv. {thinning(len(validation))}")
    _add_loops(page, done)
    add_diagnosis(page, found)
    _add_identification(page, found.identification)
    return page


def _add_identification(page: Page, found: Identification) -> None:
    """Parameters, their uncertainty and the static map; the prediction is shown above."""
    text = "The plain model, without the effects, fitted to the campaign: the start of the diagnosis."
    page.section("Where this started: the identification", text)
    add_found(page, found)
    if found.static is not None:
        add_static(page, found)


def _add_loops(page: Page, done: Demo) -> None:
    page.section("The closed loop of both FMUs")
    found = {name: steps(loop) for name, loop in done.loops.items()}
    settling = {name: each[-1].settling for name, each in found.items()}
    words = {name: "not in time" if s is None else f"in {number(s, 3)} s" for name, s in settling.items()}
    title = f"Step down: both actuators settle {words['dual']}, speed alone {words['speed only']}"
    caption = "The paper's gains on the augmented plant."
    page.figure(closed_loop({name: loop.columns for name, loop in done.loops.items()}, title), caption)
    rows = [(name, *row(step)) for name, each in found.items() for step in each]
    page.table(("loop", *STEP_COLUMNS), rows, "Settled: within 2 % of the step from then on.")
