"""Run the closed loop of a plant FMU and a controller FMU over a profile of wanted thrust (CSV with time, thrust_set).

An FMU runs its author's code, with your rights."""

from collections.abc import Mapping
from contextlib import closing, nullcontext

import numpy as np
from tqdm import tqdm

from vpp_fmu.app.cli.options import real
from vpp_fmu.app.cli.output import add_output, say_written
from vpp_fmu.app.report.canvas import thinning
from vpp_fmu.app.report.figures.loop import ADAPTED, adapted_parameters, residual_in_band
from vpp_fmu.app.report.figures.time import closed_loop
from vpp_fmu.app.report.page import Page
from vpp_fmu.digits import number
from vpp_fmu.loop import STANDSTILL
from vpp_fmu.loop import run as run_loop
from vpp_fmu.outputs import OutputSet
from vpp_fmu.plants import USUAL_STEP, FmuController, FmuPlant, FmuTwin
from vpp_fmu.record import Record, read_profile, write_record
from vpp_fmu.response import Step, steps

EXAMPLE = "vpp cosim fmus/VppPlant.fmu fmus/VppController.fmu --profile step.csv -o out"


def configure(parser):
    parser.add_argument("plant", metavar="PLANT", help="plant FMU: omega_ref, beta_ref to thrust, omega, beta")
    parser.add_argument("controller", metavar="CONTROLLER", help="controller FMU: thrust_set, thrust to omega_ref, beta_ref")
    parser.add_argument("--profile", metavar="P", required=True, help="CSV with time [s], thrust_set [N]")
    text = "twin FMU that monitors the loop (vpp export --twin): its outputs in the CSV and on the page"
    parser.add_argument("--twin", metavar="TWIN", help=text)
    text = f"communication step in s (default: the controller's sample_time, else {USUAL_STEP:g})"
    parser.add_argument("--step", type=real(1e-6, 1.0, "s"), metavar="S", help=text)
    add_output(parser)


def run(options):
    profile = read_profile(options.profile)
    folder = OutputSet(options.output, "cosim")
    with (
        closing(FmuPlant(options.plant)) as plant,
        closing(FmuController(options.controller, dt=options.step)) as controller,
        closing(FmuTwin(options.twin, controller.dt)) if options.twin else nullcontext() as twin,
        tqdm(total=100, unit="%", disable=None, leave=False) as bar,
    ):
        plant.dt = controller.dt
        done = run_loop(plant, controller, profile, progress=lambda share: bar.update(round(100 * share) - bar.n))
        watched = twin.beside(done, STANDSTILL) if twin else {}
    page = loop_page(done, f"{options.plant} under {options.controller} over {options.profile}.", controller.limits)
    if twin:
        add_twin(page, done.time, watched, twin.units)
        done = Record({**done.columns, **watched}, done.source)
    write_record(folder, "run.csv", done)
    folder.write("report.html", page.html())
    say_written(folder, lines=map(sentence, steps(done, limits=controller.limits)))


def add_twin(page: Page, time: np.ndarray, outputs: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Add the outputs (rows,) of an adaptive twin by name, with the units of its variables."""
    page.figure(residual_in_band(time, outputs), f"Measured thrust less the twin's. {thinning(len(time))}")
    own = {name.removeprefix(ADAPTED): unit for name, unit in units.items() if name.startswith(ADAPTED)}
    page.figure(adapted_parameters(time, outputs, own), "The twin's adapted parameters.")


def loop_page(done: Record, summary: str, limits: Mapping[str, tuple[float, float]] | None = None) -> Page:
    """The report of a closed loop's run; `limits` as of `vpp_fmu.response.steps`."""
    found = steps(done, limits=limits)
    page = Page("Closed loop", summary)
    title = sentence(found[0]) if found else "Thrust under a constant set-point"
    drawn = closed_loop({"loop": done.columns}, title, limits)
    page.figure(drawn, "Thrust with its set-point, speed and pitch with their commands.")
    page.table(STEP_COLUMNS, [row(step) for step in found], "Every change of the set-point.")
    return page


STEP_COLUMNS = ("at [s]", "from [N]", "to [N]", "settled after [s]", "overshoot [%]")


def row(step: Step) -> tuple:
    """A step as cells of a table."""
    never = "out of reach" if step.stuck else "not by the end" if step.last else "not before the next"
    settled = never if step.settling is None else step.settling
    return step.time, step.before, step.after, settled, f"{step.overshoot:.1f}"


def sentence(step: Step) -> str:
    """A step in words."""
    change = f"The step from {number(step.before)} to {number(step.after)} N at {number(step.time)} s"
    if step.stuck:
        thrust, omega, beta = step.stuck
        at = f"{number(thrust)} N at {number(omega)} rpm, {number(beta)} deg"
        return f"{change}: the set-point of {number(step.after)} N is out of reach: {at}"
    never = "has not settled " + ("by the end of the run" if step.last else "before the next")
    when = never if step.settling is None else f"has settled after {number(step.settling, 3)} s"
    return f"{change} {when}, overshoot {step.overshoot:.1f} %"
