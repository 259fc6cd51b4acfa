"""Options that verbs share. A number declares its range; any other input gives one line and exit code 2."""

import argparse
import math
from dataclasses import dataclass

from vpp_fmu.files import InFolder
from vpp_fmu.parameters import gains_file, knowledge_file, parameters_file


@dataclass(frozen=True)
class Number:
    """The `type` of an argument: a number from `low` to `high`.

    `above`: `low` is excluded. `whole`: whole numbers only. NaN and infinities are never in a range. argparse puts the option
    before the message.
    """

    low: float
    high: float
    unit: str = ""
    whole: bool = False
    above: bool = False

    def __call__(self, text: str) -> int | float:
        try:
            value = int(text) if self.whole else float(text)
        except ValueError:
            value = math.nan
        inside = self.low < value <= self.high if self.above else self.low <= value <= self.high
        if not inside:
            raise argparse.ArgumentTypeError(f"found {shortened(text)}, expected {self.allowed}")
        return value

    @property
    def allowed(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        span = f"above {self.low:g} and up to {self.high:g}" if self.above else f"from {self.low:.12g} to {self.high:.12g}"
        return f"{kind} {span} {self.unit}".rstrip()


def whole(low: int, high: int) -> Number:
    """A whole number within a range."""
    return Number(low, high, whole=True)


def shortened(text: str) -> str:
    """User input for a message: on one line, shortened."""
    short = text if len(text) <= 40 else f"{text[:37]}..."
    return short if short.strip() and short.isprintable() else repr(short)


SEED = whole(0, 2**32 - 1)
"""Seed of a random generator, 32 bits in numpy and C."""

WORKERS = whole(1, 256)
"""Number of parallel processes or threads. More than the machine's cores only cost memory, some 100 MB each."""

GAINS = "the controller's parameters (default: the published gains, within the limits and at the pace of the parameters' rig)"

ADAPT = "the plant's parameters that the twin adapts (default: thrust gain, pitch and reading offset, the slower lags)"
"""Help of --gains and of --adapt."""


FMU = "VppPlant", "VppController", "VppTwin"
plant_file, controller_file, twin_file = (InFolder((f"{name}.fmu", f"{name}.native.fmu")) for name in FMU)
profile_file = InFolder(("profile.csv",))
run_file = InFolder(("run.csv", "prediction.csv"))
commands_file = InFolder(("plan.csv", "next_experiment.csv", "validation.csv", "validation.csv.gz"))
"""Files of folders that verbs wrote, for arguments that name one of them."""


def add_gains(parser, text: str) -> None:
    parser.add_argument("--gains", type=gains_file, metavar="G", help=f"{text}; G: a file or its folder")


def add_knowledge(parser, text: str) -> None:
    parser.add_argument("--knowledge", type=knowledge_file, metavar="F", help=text)


def add_plant(parser, more: str = "", required: bool = False) -> None:
    """The options --parameters and --effects-from; `more`: end of the help."""
    text = f"the plant's parameters, a file or its folder{more}"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", required=required, help=text)
    add_effects_from(parser)


def add_output(parser) -> None:
    parser.add_argument("-o", "--output", default="out", metavar="DIR", help="folder to write to (default: out)")


def add_accept(parser) -> None:
    """The option that overrides the quality gate."""
    text = "go on in spite of a finding of the quality gate, by its code, and keep its rows; may be repeated (vpp check --help)"
    parser.add_argument("--accept", action="append", default=[], metavar="CODE", help=text)


def add_records(parser) -> None:
    """The option that adds records to fit."""
    text = "fit this record too; may be repeated"
    parser.add_argument("--record", dest="records", action="append", default=[], metavar="FILE", help=text)


def add_effects_from(parser) -> None:
    """The option that adds user-defined effects to the library."""
    text = "a Python file with an effect of one's own, such as learned_effect.py, added to the library; "
    text += "it runs its author's code; may be repeated"
    parser.add_argument("--effects-from", action="append", default=[], metavar="FILE.py", help=text)
