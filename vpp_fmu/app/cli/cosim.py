"""Run the closed loop of a plant FMU and a controller FMU over a profile of set-points (CSV with time, thrust_set).

An FMU runs its author's code, with your rights."""

from tqdm import tqdm

from vpp_fmu.app.api.loop import run_loop
from vpp_fmu.app.cli.options import Number, add_output, controller_file, plant_file, profile_file, twin_file
from vpp_fmu.app.cli.output import answer
from vpp_fmu.plants import USUAL_STEP

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
    parser.add_argument("--step", dest="dt", type=Number(1e-6, 1.0, "s"), metavar="S", help=text)
    add_output(parser)


def run(options):
    with tqdm(total=100, unit="%", disable=None, leave=False) as bar:
        return answer(options, run_loop, progress=lambda share: bar.update(round(100 * share) - bar.n))
