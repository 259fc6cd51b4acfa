"""Tune the controller for a model: the paper's cost, within limits on overshoot and sensitivity; both actuators, speed alone.

The controller samples, saturates and reads thrust through a converter as on the rig, whose ranges are its limits. New gains
are accepted only if no step settles later, overshoots or rings more than with the initial gains, which are kept otherwise. The
result is simulated again with both FMUs. With --robust, gains are optimised for the worst case, or the mean, over plants drawn
from the parameters' uncertainty."""

import argparse

from identification.tune.objective import ALPHA
from vpp_fmu.app.api.control import tune
from vpp_fmu.app.api.objects import PAPERS
from vpp_fmu.app.cli.options import SEED, WORKERS, Number, add_gains, add_knowledge, add_output, add_plant, profile_file, whole
from vpp_fmu.app.cli.output import answer
from vpp_fmu.kernel.measurement import CONVERSIONS

EXAMPLE = "vpp tune --parameters out/parameters.json --assume tau_beta_2=0.05 -o out"

RANGES = {
    "alpha": Number(0.0, 1.0),
    "overshoot": Number(0.01, 100.0, "%"),
    "sensitivity": Number(1.1, 100.0),
    "noise": Number(0.0, 100.0, "N"),
    "delay": Number(0.0, 10.0, "s"),
    "lag": Number(0.0, 1.0, "s"),
    "resolution": Number(0.0, 10.0, "N"),
    "sample-time": Number(1e-5, 1.0, "s"),
    "draws": whole(1, 10000),
    "spread": Number(0.0, 1.0),
    "seed": SEED,
    "workers": WORKERS,
}
"""Ranges of the options."""

WEIGHTS = {"power": 0.0, "agility": 1.0}


class Weight(Number):
    """A weight of the allocation, as a number or a word."""

    def __call__(self, text: str) -> float:
        if text in WEIGHTS:
            return WEIGHTS[text]
        try:
            return super().__call__(text)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{error}, {' or '.join(WEIGHTS)}") from error


def configure(parser):
    def number(name, default, text, metavar="X"):
        shown = "" if default is None else " (default: %(default).4g)"
        parser.add_argument(f"--{name}", type=RANGES[name], default=default, metavar=metavar, help=text + shown)

    add_plant(parser, f" (default: {PAPERS})")
    text = "a parameter that the design assumes instead, as the paper does with tau_beta_2=0.05; may be repeated"
    parser.add_argument("--assume", action="append", default=[], metavar="NAME=VALUE", help=text)
    text = "limits, filter, sample time and first gains of the controller (default: the rig's limits, the paper's gains)"
    add_gains(parser, text)
    text = "tune the law that rests on the best pairs of speed and pitch instead (vpp allocate): those of least power, of the "
    text += "largest reserve of thrust by pitch, or a weight between 0 (power) and 1 (agility); for parameters with power"
    parser.add_argument("--objective", type=Weight(0.0, 1.0), metavar="power|agility|W", help=text)
    text = "CSV with time, thrust_set (default: 0.1 to 0.8 of the thrust scale and back, as far as the rig reaches)"
    parser.add_argument("--profile", type=profile_file, metavar="P", help=text)
    text = (
        "period of the controller in s (default: the campaign's, else 0.004; other where the plant's faster channel needs it)"
    )
    number("sample-time", None, text, "S")
    number("alpha", ALPHA, "weight of the squared norm of the gains")
    number("overshoot", 1.0, "largest overshoot in %% of a step")
    number("sensitivity", 2.0, "largest amplification of a disturbance around the operating points")
    number("noise", None, "standard deviation of a thrust reading in N (default: that of --knowledge, else 0)")
    number("delay", None, f"delay of a thrust reading in s (default: {1.0 / CONVERSIONS:.4g})", "S")
    number("lag", 0.0, "time constant of the thrust reading in s", "S")
    number("resolution", None, "step of the converter in N (default: 2e-4 of the thrust scale, the paper's)")
    parser.add_argument("--robust", choices=("worst", "mean"), help="tune over many plants as well")
    number("draws", 200, "plants to tune over", "N")
    number("spread", 0.1, "standard deviation, as a share, of assumed parameters and of those whose file has none")
    text = "identification.json: correlation of the parameters, noise of thrust (default: the one beside --parameters)"
    add_knowledge(parser, text)
    number("seed", 0, "of plants and noise", "N")
    number("workers", 1, "number of parallel searches", "N")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler to run the searches on instead")
    add_output(parser)


def _assumed(text: str) -> tuple[str, float | str]:
    """The name and the value of NAME=VALUE; a value that is no number, or an unknown name, is refused by the verb."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        return name, value


def run(options):
    return answer(options, tune, assume=map(_assumed, options.assume))
