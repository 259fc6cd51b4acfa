"""Numbers on the command line: each option declares its range; any other input gives one line and exit code 2."""

import argparse
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Number:
    """The `type` of an argument: a number from `low` to `high`, or one of `also`.

    `above`: `low` is excluded. `whole`: whole numbers only. NaN and infinities are never in a range. argparse puts the option
    before the message.
    """

    low: float
    high: float
    unit: str = ""
    whole: bool = False
    above: bool = False
    also: tuple[float, ...] = ()

    def __call__(self, text: str) -> int | float:
        try:
            value = int(text) if self.whole else float(text)
        except ValueError:
            value = math.nan
        inside = self.low < value <= self.high if self.above else self.low <= value <= self.high
        if not inside and value not in self.also:
            raise argparse.ArgumentTypeError(f"found {shortened(text)}, expected {self.allowed}")
        return value

    @property
    def allowed(self) -> str:
        """In words."""
        kind = "a whole number" if self.whole else "a number"
        span = f"above {self.low:g} and up to {self.high:g}" if self.above else f"from {self.low:.12g} to {self.high:.12g}"
        others = "".join(f", or {value:g}" for value in self.also)
        return f"{kind} {span} {self.unit}".rstrip() + others


def real(low: float, high: float, unit: str = "", above: bool = False) -> Number:
    """A real number within a range."""
    return Number(low, high, unit, above=above)


def whole(low: int, high: int, unit: str = "", also: tuple[int, ...] = ()) -> Number:
    """A whole number within a range."""
    return Number(low, high, unit, whole=True, also=also)


def shortened(text: str) -> str:
    """User input for a message: on one line, shortened."""
    short = text if len(text) <= 40 else f"{text[:37]}..."
    return short if short.strip() and short.isprintable() else repr(short)


SEED = whole(0, 2**32 - 1)
"""Seed of a random generator, 32 bits in numpy and C."""

WORKERS = whole(1, 256)
"""Number of parallel processes or threads. More than the machine's cores only cost memory, some 100 MB each."""
