"""Coordinates in which the fit is regular.

The two time constants of a channel are interchangeable, and where they meet their columns coincide: a search in them
crawls along that ridge or stops on it. In the sum s and the spread v = ((tau_1 - tau_2) / s)^2 the response is smooth
through the double pole, and each response has one description.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from vpp_fmu.kernel.types import Model

CHANNELS = ("omega", "beta")
SHORTEST = 0.05
"""Share of the longer lag that the shorter one has at least where a search starts."""

CLOSEST, WIDEST = 1e-6, 0.9999
"""Range of the spread. At the lower end the constants differ by 0.2 %: a double pole to any measurement."""


def slowest(values: Mapping[str, float], known: Iterable[str]) -> float:
    """s: the sum of the lags of the channel that takes longest, of those whose lags are `known`; of both where none is."""
    sums = {u: values[f"tau_{u}_1"] + values[f"tau_{u}_2"] for u in CHANNELS}
    told = [total for u, total in sums.items() if f"tau_{u}_1" in set(known)]
    return max(told or sums.values())


def regular_start(model: Model, values: Mapping[str, float], names: Iterable[str]) -> dict[str, float]:
    """`values` of a `model`, the free ones (`names`) as a search may start from: within bounds, and no lag of a channel's two
    shorter than SHORTEST of the other. At its least a lag has no tangent, and would stay there whatever the records tell."""
    names, bounds = set(names), {p.name: (p.minimum, p.maximum) for p in model.parameters}
    found = {n: min(max(v, bounds[n][0]), bounds[n][1]) if n in names else v for n, v in values.items()}
    for pair in ((f"tau_{u}_1", f"tau_{u}_2") for u in CHANNELS):
        if names.issuperset(pair):
            least = SHORTEST * max(found[n] for n in pair)
            found |= {n: max(found[n], least) for n in pair}
    return found


class Coordinates:
    """Free parameters `names` of `model` as a vector: log of the sum and spread for a channel's pair, the rest as it is.

    A channel counts as a pair when both its time constants are free. `slow_first`: which of the pair is the slower,
    `tau_<channel>_1` or the other; it only matters to effects that stand between the lags. `lower`, `upper` bound the
    coordinates, `floor`, `ceiling` the values.
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
        """Coordinates of parameter values, by name."""
        x = np.array([values[n] for n in self.names], float)
        for i, j in self.pairs:
            total, apart = x[i] + x[j], x[i] - x[j]
            x[i], x[j] = np.log(total), (apart / total) ** 2
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
            if total * (1 - spread) / 2 < self.floor[j]:  # a lag too short to matter stays at its least
                d[j] = 0.0
            if total * (1 + spread) / 2 > self.ceiling[i]:  # and one too long to end at its greatest
                d[i] = 0.0
        return d
