"""Find for each thrust the pair of speed and pitch of least power, from parameters with torque or power.

gains.json is a controller that comes to rest on these pairs (mode 2), for vpp export --gains and vpp cosim."""

from vpp_fmu.app.api.control import allocate
from vpp_fmu.app.cli.options import SEED, Number, add_output, add_plant, whole
from vpp_fmu.app.cli.output import answer

EXAMPLE = "vpp allocate --parameters out/parameters.json -o pairs"


def configure(parser):
    add_plant(parser, ", identified from a campaign with torque, power, or voltage and current", required=True)
    text = "0: least power; 1: largest reserve of thrust that pitch alone, the fast actuator, can add and remove; between: both"
    parser.add_argument("--weight", type=Number(0.0, 1.0, "1"), default=0.0, metavar="W", help=f"{text} (default: 0)")
    parser.add_argument(
        "--points", type=whole(2, 1000), default=41, metavar="N", help="number of thrusts (default: %(default)s)"
    )
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the draws for the bands (default: %(default)s)")
    add_output(parser)


def run(options):
    return answer(options, allocate)
