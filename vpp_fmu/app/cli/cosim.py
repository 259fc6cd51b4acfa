"""Run the closed loop of a plant FMU and a controller FMU over a profile of set-points (CSV with time, thrust_set).

An FMU runs its author's code, with your rights."""

from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict

from tqdm import tqdm

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import controller_file, plant_file, profile_file, twin_file
from vpp_fmu.app.cli.options import real
from vpp_fmu.app.cli.output import add_output, written
from vpp_fmu.app.report.pages.loop import add_adaptive, headline, loop_page, sentence
from vpp_fmu.loop import STANDSTILL
from vpp_fmu.loop import run as run_loop
from vpp_fmu.outputs import OutputSet
from vpp_fmu.plants import USUAL_STEP, FmuController, FmuPlant, FmuTwin
from vpp_fmu.reach import warn_beyond_reach
from vpp_fmu.record import Record, read_profile, write_record
from vpp_fmu.response import UNITS, Step, steps

EXAMPLE = "vpp cosim fmus/VppPlant.fmu fmus/VppController.fmu --profile step.csv -o out"


def configure(parser):
    parser.add_argument("plant", type=plant_file, metavar="PLANT", help="plant FMU: omega_ref, beta_ref to thrust, omega, beta")
    text = "controller FMU: thrust_set, thrust to omega_ref, beta_ref; each FMU is a file, or its folder of vpp export"
    parser.add_argument("controller", type=controller_file, metavar="CONTROLLER", help=text)
    text = "CSV with time [s], thrust_set [N], or the folder of its profile.csv"
    parser.add_argument("--profile", type=profile_file, metavar="P", required=True, help=text)
    text = "twin FMU that monitors the loop (vpp export --twin): its outputs in the CSV and on the page"
    parser.add_argument("--twin", type=twin_file, metavar="TWIN", help=text)
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
        warn_beyond_reach(profile, plant, controller.limits)
        done = run_loop(plant, controller, profile, progress=lambda share: bar.update(round(100 * share) - bar.n))
        watched = twin.beside(done, STANDSTILL) if twin else {}
    page = loop_page(done, f"{options.plant} under {options.controller} over {options.profile}.", controller.limits)
    if twin:
        add_adaptive(page, done.time, watched, twin.units, "the twin's", "The twin's adapted parameters.")
        done = Record({**done.columns, **watched}, done.source)
    write_record(folder, "run.csv", done)
    folder.write("report.html", page.html())
    found = steps(done, limits=controller.limits)
    lines = [sentence(step) for step in found] if len(found) > 1 else []
    return Answer(headline(found), summary(found), lines, written=written(options, folder))


def summary(found: Sequence[Step]) -> dict:
    """The object of --json: the steps of the set-point."""
    return {"format": "vpp-loop/1", "units": UNITS, "steps": [asdict(step) for step in found]}
