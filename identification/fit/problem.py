"""The least-squares problem of every fit: a model against experiments, and what is known beforehand.

Residuals are whitened, and in units of their standard deviation. How large they are follows in each channel from what the fit
leaves there (maximum likelihood with unknown variances): a sensor that is far better than the model is would otherwise dictate
all parameters. What noise is supposed differs with the purpose. Estimates that ship suppose independent readings: they then
predict best where the model lacks something, and what colour the residual has is accounted for in their uncertainty. Judgements
whiten by the noise's own colour: evidence counts independent readings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identification.fit.coordinates import Coordinates
from identification.fit.experiment import CHANNELS, Experiment
from identification.fit.least_squares import Solution, solve
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator

REWEIGHTS = 3
"""Rounds of fit and weight; the third changes the weights by less than a per cent."""

WEIGHED, ENOUGH = 0.5, 1e-3
"""Log-likelihood at which a fit may end that only weighs the channels, and one that is compared with others (a deviation of
0.045 standard deviations of the estimate)."""

EXACT = 1e-12
"""Share of the cost: as far as numbers go."""


@dataclass(frozen=True)
class Prior:
    """What is known of some parameters beforehand: `names`, `mean` (k,) and `covariance` (k, k)."""

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    def root(self) -> np.ndarray:
        """L (k, k) with L.T @ L the inverse covariance: L (p - mean) has unit variance."""
        std = np.sqrt(np.diag(self.covariance))
        # Terms that nearly make up each other are known together ten decades better than each: no Cholesky factor stands that.
        power, axes = np.linalg.eigh(self.covariance / np.outer(std, std))
        least = len(std) * np.finfo(float).eps * max(power[-1], 0.0) if len(std) else 0.0
        return axes.T / np.sqrt(np.maximum(power, least))[:, None] / std

    def rows(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """(residual (k,) of unit variance at parameter values, its derivatives (k, len(names)) in the free ones)."""
        root = self.root()
        chosen = np.zeros((len(self.names), len(names)))
        for k, name in enumerate(self.names):
            if name in names:
                chosen[k, names.index(name)] = 1.0
        return root @ (np.array([values[n] for n in self.names]) - self.mean), root @ chosen

    def of(self, names: Sequence[str]) -> "Prior | None":
        """What it tells of those in `names`; None where that is nothing."""
        kept = [k for k, n in enumerate(self.names) if n in names]
        chosen = tuple(self.names[k] for k in kept)
        return Prior(chosen, self.mean[kept], self.covariance[np.ix_(kept, kept)]) if kept else None

    def loosened(self, factor: float) -> "Prior":
        """The same knowledge with standard deviations `factor` times as large."""
        return Prior(self.names, self.mean, self.covariance * factor**2)

    def wider_than(self, other: "Prior") -> float:
        """How many times the standard deviations of `other`, which it was loosened from, its own are."""
        own, its = (knowledge.covariance[0, 0] for knowledge in (self, other.of(self.names)))
        return float(np.sqrt(own / its))


@dataclass(frozen=True)
class Score:
    """Sum of squares and number of whitened residuals in each channel."""

    squares: Mapping[str, float]
    counts: Mapping[str, int]

    @property
    def deviance(self) -> float:
        """-2 log-likelihood, noise variances unknown, up to a constant."""
        return float(sum(n * np.log(max(self.squares[c], 1e-300)) for c, n in self.counts.items()))

    def fall(self, other: "Score") -> dict[str, float]:
        """By how much half of it is below another's, by channel."""
        ratio = {c: max(other.squares[c], 1e-300) / max(self.squares[c], 1e-300) for c in self.counts}
        return {c: 0.5 * n * float(np.log(ratio[c])) for c, n in self.counts.items()}


@dataclass(frozen=True)
class Block:
    """The rows of the residual that one channel of one experiment has, at `time` [s]; of speed, each record has its own."""

    experiment: int
    channel: str
    time: np.ndarray
    at: slice


def summed(group: Sequence[Block], residual: np.ndarray) -> np.ndarray:
    """(m,) the residuals (rows,) of one channel in records of the same commands, added at the times of the first."""
    first = group[0]
    total = residual[first.at].copy()
    for other in group[1:]:
        total += np.interp(first.time, other.time, residual[other.at]) * (len(other.time) / len(first.time))
    return total


class Problem:
    """The residual of a model over experiments; `names` are free, `values` holds the rest.

    Its rows: thrust by experiment, then speed by experiment, a prior's last. `scale` divides each channel's residual: what the
    fit leaves there, so that neither channel dictates.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        values: Mapping[str, float],
        names: Sequence[str],
        prior: Prior | None = None,
        slow_first: Mapping[str, bool] | None = None,
    ):
        self.model, self.experiments, self.values, self.prior = model, tuple(experiments), dict(values), prior
        self.coordinates = Coordinates(model, names, slow_first)
        self.scale = dict.fromkeys(CHANNELS, 1.0)

    @cached_property
    def simulator(self) -> Simulator:
        """The model's, with sensitivities in what is free."""
        return Simulator(self.model, self.coordinates.names)

    @property
    def size(self) -> int:
        """Rows of the residual without the prior's."""
        return sum(sum(e.sizes.values()) for e in self.experiments)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Where each channel of each experiment stands in the residual."""
        times = [(i, "thrust", e.thrust_time) for i, e in enumerate(self.experiments)]
        times += [(i, "omega", time) for i, e in enumerate(self.experiments) for time in e.omega_times]
        ends = np.cumsum([len(time) for _, _, time in times]).tolist()
        return tuple(Block(i, c, t, slice(end - len(t), end)) for (i, c, t), end in zip(times, ends, strict=True) if len(t))

    @property
    def groups(self) -> tuple[tuple[Block, ...], ...]:
        """The same, those of one channel in records of the same commands together: what the model lacks is shared there."""
        together: dict[tuple[int, str], list[Block]] = {}
        for block in self.blocks:
            together.setdefault((block.experiment, block.channel), []).append(block)
        return tuple(map(tuple, together.values()))

    @property
    def times(self) -> list[tuple[np.ndarray, float]]:
        """(time [s] of each row, length [s] of its record), in the residual's order."""
        return [(b.time, float(self.experiments[b.experiment].record.time[-1])) for b in self.blocks]

    def residuals(self, outputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Each channel's residual (n, ...), unscaled, from the outputs (rows, 3, ...) of each experiment."""
        thrust = [e.thrust_residual(y[:, 0]) for e, y in zip(self.experiments, outputs, strict=True)]
        found = {"thrust": np.concatenate(thrust)}
        omega = [e.omega_residual(y[:, 1]) for e, y in zip(self.experiments, outputs, strict=True) if len(e.omega_time)]
        if omega:
            found["omega"] = np.concatenate(omega)
        return found

    def columns(self, tangents: Sequence[np.ndarray], outputs: Sequence[np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Each channel's sensitivities (n, ...), unscaled, from those of the outputs (rows, 3, ...) of each experiment.

        `outputs`: where they are taken, for what a coarse converter makes of them; None: as if it were fine.
        """
        pairs = list(zip(self.experiments, tangents, strict=True))
        slopes = [e.converter.slope(y[:, 0]) for e, y in zip(self.experiments, outputs or (), strict=False)]
        thrust = [d[:, 0] for d in tangents]
        thrust = [(d.T * slope).T for d, slope in zip(thrust, slopes, strict=True)] if slopes else thrust
        found = {"thrust": np.concatenate([e.thrust_columns(d) for e, d in zip(self.experiments, thrust, strict=True)])}
        omega = [e.omega_columns(d[:, 1]) for e, d in pairs if len(e.omega_time)]
        if omega:
            found["omega"] = np.concatenate(omega)
        return found

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residual, the prior's rows last, and Jacobian (rows, coordinates) at coordinates `x`."""
        return self.rows(self.coordinates.values(x), self.coordinates.jacobian(x))

    def rows(self, values: Mapping[str, float], inner: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian (rows, k) at the free parameters' `values` by name, in what these have the derivatives `inner`
        (names, k) in; None: in the parameters themselves."""
        found, names = self.values | dict(values), self.coordinates.names
        inner = np.eye(len(names)) if inner is None else inner
        known = 0 if self.prior is None else len(self.prior.names)
        jacobian, outputs = np.empty((self.size + known, inner.shape[1])), []
        place = {"thrust": 0, "omega": sum(e.sizes["thrust"] for e in self.experiments)}
        for e in self.experiments:
            shown, own = e.sensitivities(self.simulator, found)
            outputs.append(shown)
            for c, columns in own.items():
                at = slice(place[c], place[c] + len(columns))
                np.matmul(columns, inner / self.scale[c], out=jacobian[at])
                place[c] = at.stop
        residual = self._with_prior(found, outputs)
        if self.prior is not None:
            jacobian[self.size :] = self.prior.rows(found, names)[1] @ inner
        return residual, jacobian

    def residual_at(self, values: Mapping[str, float]) -> np.ndarray:
        """The same residual alone, from a simulation without sensitivities."""
        found = self.values | dict(values)
        return self._with_prior(found, self.outputs(found))

    def outputs(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """Outputs (rows, 3) of the model in each experiment, at all its parameters' `values`."""
        return [self.simulator.simulate(values, *e.record.run) for e in self.experiments]

    def _with_prior(self, found, outputs):
        residual = np.concatenate([r / self.scale[c] for c, r in self.residuals(outputs).items()])
        return residual if self.prior is None else np.append(residual, self.prior.rows(found, self.coordinates.names)[0])

    def thrust_errors(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """Predicted less measured thrust [N] of every record, the rows (rows with thrust,) as they are."""
        runs = zip(self.outputs(values), self.experiments, strict=True)
        pairs = [(shown[:, 0], one.record["thrust"]) for shown, e in runs for one in e.records]
        return [(predicted - measured)[np.isfinite(measured)] for predicted, measured in pairs]

    def fit(self, start: Mapping[str, float]) -> Solution:
        """Fit from `start`, then once more with the channels weighed by what the first fit left: to compare with other fits."""
        found = self._solve(self.coordinates.vector(start), WEIGHED, 40)
        self.weigh(found.residual)
        return self.refit(found.value)

    def refit(self, x: np.ndarray, limit: int = 12) -> Solution:
        """The same from coordinates `x` under the present weights."""
        return self._solve(x, ENOUGH, limit)

    def solve(self, start: Mapping[str, float], enough: float = 0.0) -> Solution:
        """Fit from `start` under the present weights. `enough`: log-likelihood (of noise of unknown size) that a step must
        bring for the search to go on, and then the Jacobian need not be the solution's own; 0: as far as numbers go."""
        return self._solve(self.coordinates.vector(start), enough, 100)

    def _solve(self, x, enough, limit):
        c, tolerance = self.coordinates, 2.0 * enough / self.size if enough else EXACT
        return solve(
            self.evaluate, x, c.lower, c.upper, tolerance, limit, lambda x: self.residual_at(c.values(x)), tangent=not enough
        )

    def solve_and_weigh(self, start: Mapping[str, float]) -> list[Solution]:
        """Fit from `start`, and weigh the channels by what the fit leaves in them, until the two agree.

        All fits, the last is the result, the others are slim; each has its own weights, so their costs do not compare.
        """
        rounds = REWEIGHTS if len({b.channel for b in self.blocks}) > 1 or self.prior is not None else 0
        found = [self.solve(start, WEIGHED if rounds else 0.0)]
        for k in range(rounds):
            self.weigh(found[-1].residual)
            found[-1] = found[-1].slim()
            found.append(self.solve(self.coordinates.values(found[-1].value), WEIGHED if k < rounds - 1 else 0.0))
        return found

    def with_rows(self, found: Solution) -> Solution:
        """A slim solution under the present weights, with its residual and Jacobian again."""
        residual, jacobian = self.evaluate(found.value)
        return replace(found, residual=residual, jacobian=jacobian)

    def weigh(self, residual: np.ndarray) -> None:
        """Set the channels' scales from a residual under the present ones."""
        for channel in self.scale:
            groups = [g for g in self.groups if g[0].channel == channel]
            if groups:
                rows = [len(g) * len(g[0].time) for g in groups]
                # The mean of n independent records has a variance of 1 / n, that of what they share has none the less.
                variances = [np.mean(summed(g, residual) ** 2) / len(g) for g in groups]
                self.scale[channel] *= float(np.sqrt(np.average(variances, weights=rows))) or 1.0

    def score_of(self, residual: np.ndarray) -> Score:
        """The score that a scaled residual, as `evaluate` gives it under the present scales, stands for."""
        counts = {c: sum(e.sizes.get(c, 0) for e in self.experiments) for c in self.scale}
        counts = {c: n for c, n in counts.items() if n}
        parts = np.split(residual, np.cumsum(list(counts.values())))
        return Score({c: self.scale[c] ** 2 * float(p @ p) for c, p in zip(counts, parts, strict=False)}, counts)
