"""Coordinates in which the fit is regular.

The two time constants of a channel are interchangeable. If they are equal, their sensitivities coincide, and a search in them
is slow or stops there. In the sum s and the spread v = ((tau_1 - tau_2) / s)^2 the response is smooth through the double pole,
and each response has one description.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from vpp_fmu.kernel.types import Model

CHANNELS = ("omega", "beta")
SHORTEST = 0.05
"""Minimum ratio of the shorter lag to the longer at the start of a search."""

CLOSEST, WIDEST = 1e-6, 0.9999
"""Range of the spread. At the lower end the constants differ by 0.2 %: no measurement distinguishes that from a double pole."""


def slowest(values: Mapping[str, float], known: Iterable[str]) -> float:
    """s: the larger sum of lags among the channels whose first lag is in `known`; among both if none is."""
    sums = {u: values[f"tau_{u}_1"] + values[f"tau_{u}_2"] for u in CHANNELS}
    sums_known = [total for u, total in sums.items() if f"tau_{u}_1" in set(known)]
    return max(sums_known or sums.values())


def regular_start(model: Model, values: Mapping[str, float], names: Iterable[str]) -> dict[str, float]:
    """`values` of a `model` with the free ones (`names`) moved to a regular start: within bounds, each lag at least SHORTEST of
    the channel's other lag. At its minimum a lag has no sensitivity and would stay there."""
    names, bounds = set(names), {p.name: (p.minimum, p.maximum) for p in model.parameters}
    found = {n: min(max(v, bounds[n][0]), bounds[n][1]) if n in names else v for n, v in values.items()}
    for pair in ((f"tau_{u}_1", f"tau_{u}_2") for u in CHANNELS):
        if names.issuperset(pair):
            least = SHORTEST * max(found[n] for n in pair)
            found |= {n: max(found[n], least) for n in pair}
    return found


class Coordinates:
    """Free parameters `names` of `model` as a vector: log of the sum, and spread, for a channel's pair; other parameters
    unchanged.

    A channel is a pair if both its time constants are free. `slow_first`: whether `tau_<channel>_1` is the slower lag, which
    matters only to effects between the lags. `lower`, `upper` bound the coordinates; `floor`, `ceiling` bound the values.
    """

    def __init__(self, model: Model, names: Sequence[str], slow_first: Mapping[str, bool] | None = None):
        self.names, self.slow_first = tuple(names), dict(slow_first or {})
        bounds = {p.name: (p.minimum, p.maximum) for p in model.parameters}
        lower, upper = np.array([bounds[n] for n in self.names]).reshape(-1, 2).T.copy()
        self.floor, self.ceiling = lower.copy(), upper.copy()
        self.pairs = []
        for channel in CHANNELS:
            pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
            if set(pair) <= set(self.names):
                i, j = (self.names.index(n) for n in (pair if self.slow_first.get(channel, True) else pair[::-1]))
                self.pairs.append((i, j))
                lower[[i, j]], upper[[i, j]] = (np.log(2 * lower[i]), CLOSEST), (np.log(2 * upper[i]), WIDEST)
        self.lower, self.upper = lower, upper

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Coordinates of parameter values by name."""
        x = np.array([values[n] for n in self.names], float)
        for i, j in self.pairs:
            total, difference = x[i] + x[j], x[i] - x[j]
            x[i], x[j] = np.log(total), (difference / total) ** 2
        return np.clip(x, self.lower, self.upper)

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Parameter values at coordinates `x`."""
        p = np.array(x, float)
        for i, j in self.pairs:
            total, spread = np.exp(x[i]), np.sqrt(x[j])
            p[i], p[j] = min(total * (1 + spread) / 2, self.ceiling[i]), max(total * (1 - spread) / 2, self.floor[j])
        return dict(zip(self.names, p.tolist(), strict=True))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """d values / d coordinates (n, n)."""
        d = np.eye(len(x))
        for i, j in self.pairs:
            total, spread = np.exp(x[i]), np.sqrt(x[j])
            d[i, i], d[j, i] = total * (1 + spread) / 2, total * (1 - spread) / 2
            d[i, j], d[j, j] = total / (4 * spread), -total / (4 * spread)
            if total * (1 - spread) / 2 < self.floor[j]:  # a lag clipped at its minimum does not move
                d[j] = 0.0
            if total * (1 + spread) / 2 > self.ceiling[i]:  # nor does one clipped at its maximum
                d[i] = 0.0
        return d
