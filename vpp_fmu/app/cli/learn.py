"""Learn a control law, a small network, on plants drawn from the parameters' uncertainty; compare it with the tuned PID.

An evolution strategy (cma) searches the weights on the compiled loop. The comparison uses plants, set-points and noise that
are not part of the search. `vpp export --policy` makes an FMU of the law, which falls back on the PID while an observation is
outside the range of the training."""

from tqdm import tqdm

from vpp_fmu.app.api.control import learn
from vpp_fmu.app.cli.options import SEED, Number, add_effects_from, add_gains, add_knowledge, add_output, whole
from vpp_fmu.app.cli.output import answer
from vpp_fmu.parameters import parameters_file

EXAMPLE = "vpp learn out/parameters.json --generations 500 -o policy"


def configure(parser):
    text = "the plant's parameters, a file or its folder"
    parser.add_argument("parameters", type=parameters_file, metavar="PARAMETERS", help=text)
    add_effects_from(parser)
    text = "the PID to compare with and to fall back on (default: tuned here on set-points of the same kind)"
    add_gains(parser, text)
    text = "identification.json: correlation of the parameters, noise of thrust (default: the one beside PARAMETERS)"
    add_knowledge(parser, text)
    text = "generations of the search (default: %(default)s, about five minutes on two cores)"
    parser.add_argument("--generations", type=whole(1, 10**6), default=1000, metavar="N", help=text)
    text = "units of the network's hidden layer (default: %(default)s)"
    parser.add_argument("--hidden", type=whole(1, 64), default=6, metavar="N", help=text)
    text = "held-out plants of the comparison (default: %(default)s)"
    parser.add_argument("--plants", type=whole(2, 10000), default=100, metavar="N", help=text)
    text = "overshoot in %% of a step that costs nothing (default: %(default)g)"
    parser.add_argument("--overshoot", type=Number(0.01, 100.0, "%"), default=5.0, metavar="X", help=text)
    text = "standard deviation, as a share, of parameters whose file has none (default: %(default)g)"
    parser.add_argument("--spread", type=Number(0.0, 1.0), default=0.1, metavar="X", help=text)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of plants, set-points, noise and search")
    add_output(parser)


def run(options):
    with tqdm(total=100, unit="%", disable=None, leave=False) as bar:
        return answer(options, learn, progress=lambda share: bar.update(round(100 * share) - bar.n))
