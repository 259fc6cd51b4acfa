"""The least-squares problem of every fit: the residuals of a model over experiments, and a prior.

Residuals are whitened, in units of their standard deviation, which is estimated for each channel from the residual (maximum
likelihood with unknown variances). Otherwise a sensor more accurate than the model would determine all parameters. The assumed
noise depends on the purpose. Published estimates assume independent readings: with model error these predict best, and their
uncertainty accounts for the colour of the residual. Tests whiten by the colour of the noise, because evidence counts
independent readings.
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
"""Iterations of fit and weights; the third changes the weights by less than 1 %."""

WEIGHED, ENOUGH = 0.5, 1e-3
"""Tolerance of the log-likelihood: of a fit that only sets the channels' weights, and of one that is compared with others
(0.045 standard deviations of the estimate)."""

EXACT = 1e-12
"""Relative tolerance of the cost: full numerical precision."""


@dataclass(frozen=True)
class Prior:
    """Prior distribution of some parameters: `names`, `mean` (k,) and `covariance` (k, k)."""

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    def root(self) -> np.ndarray:
        """L (k, k) with L.T @ L the inverse covariance: L (p - mean) has unit variance."""
        std = np.sqrt(np.diag(self.covariance))
        # Eigenvalues of nearly collinear terms differ by ten decades: a Cholesky factorisation would fail.
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
        """The marginal prior of the parameters in `names`; None if it has none of them."""
        kept = [k for k, n in enumerate(self.names) if n in names]
        chosen = tuple(self.names[k] for k in kept)
        return Prior(chosen, self.mean[kept], self.covariance[np.ix_(kept, kept)]) if kept else None

    def loosened(self, factor: float) -> "Prior":
        """The same prior with standard deviations `factor` times as large."""
        return Prior(self.names, self.mean, self.covariance * factor**2)

    def wider_than(self, other: "Prior") -> float:
        """Ratio of its standard deviations to those of `other`, from which it was loosened."""
        own, its = (prior.covariance[0, 0] for prior in (self, other.of(self.names)))
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

    def gain_over(self, other: "Score") -> dict[str, float]:
        """Log-likelihood gain over `other`, by channel."""
        ratio = {c: max(other.squares[c], 1e-300) / max(self.squares[c], 1e-300) for c in self.counts}
        return {c: 0.5 * n * float(np.log(ratio[c])) for c, n in self.counts.items()}


@dataclass(frozen=True)
class Block:
    """Rows `at` of the residual for one channel of one experiment, at `time` [s]; of speed, one block for each record."""

    experiment: int
    channel: str
    time: np.ndarray
    at: slice


def summed(group: Sequence[Block], residual: np.ndarray) -> np.ndarray:
    """(m,): sum of the residuals (rows,) of one channel over records of the same commands, at the times of the first."""
    first = group[0]
    total = residual[first.at].copy()
    for other in group[1:]:
        total += np.interp(first.time, other.time, residual[other.at]) * (len(other.time) / len(first.time))
    return total


class Problem:
    """The residual of a model over experiments. Parameters `names` are free; `values` has the others.

    Rows: thrust by experiment, then speed by experiment, then the prior. `scale`: standard deviation of each channel's
    residual, by which it is divided.
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
        """The model's simulator, with sensitivities in the free parameters."""
        return Simulator(self.model, self.coordinates.names)

    @property
    def size(self) -> int:
        """Rows of the residual without the prior's."""
        return sum(sum(e.sizes.values()) for e in self.experiments)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Rows of each channel of each experiment in the residual."""
        times = [(i, "thrust", e.thrust_time) for i, e in enumerate(self.experiments)]
        times += [(i, "omega", time) for i, e in enumerate(self.experiments) for time in e.omega_times]
        ends = np.cumsum([len(time) for _, _, time in times]).tolist()
        return tuple(Block(i, c, t, slice(end - len(t), end)) for (i, c, t), end in zip(times, ends, strict=True) if len(t))

    @property
    def groups(self) -> tuple[tuple[Block, ...], ...]:
        """The blocks grouped by channel and experiment: records of the same commands share the model error."""
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

        `outputs`: the point of linearisation of a coarse converter; None: a fine converter.
        """
        pairs = list(zip(self.experiments, tangents, strict=True))
        thrust = [d[:, 0] for d in tangents]
        if outputs is not None:
            shown = zip(pairs, outputs, strict=True)
            thrust = [e.converter.reading_tangents(d[:, 0], y[:, 0]) for (e, d), y in shown]
        found = {"thrust": np.concatenate([e.thrust_columns(d) for e, d in zip(self.experiments, thrust, strict=True)])}
        omega = [e.omega_columns(d[:, 1]) for e, d in pairs if len(e.omega_time)]
        if omega:
            found["omega"] = np.concatenate(omega)
        return found

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residual, the prior's rows last, and Jacobian (rows, coordinates) at coordinates `x`."""
        return self.rows(self.coordinates.values(x), self.coordinates.jacobian(x))

    def rows(self, values: Mapping[str, float], inner: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian (rows, k) at the free parameters' `values` by name. The Jacobian is in coordinates with
        `inner` (names, k), the derivatives of the parameters; None: in the parameters."""
        found, names = self.values | dict(values), self.coordinates.names
        known = 0 if self.prior is None else len(self.prior.names)
        jacobian, outputs = np.empty((self.size + known, len(names))), []
        place = {"thrust": 0, "omega": sum(e.sizes["thrust"] for e in self.experiments)}
        for e in self.experiments:
            at = {c: slice(first, first + e.sizes.get(c, 0)) for c, first in place.items()}
            shown, own = e.sensitivities(self.simulator, found, jacobian[at["thrust"]])
            outputs.append(shown)
            for c, columns in own.items():
                np.multiply(columns, 1.0 / self.scale[c], out=jacobian[at[c]])
                place[c] = at[c].stop
        residual = self._with_prior(found, outputs)
        if self.prior is not None:
            jacobian[self.size :] = self.prior.rows(found, names)[1]
        return residual, jacobian if inner is None else jacobian @ inner

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
        """Predicted minus measured thrust [N] of every record, (rows with thrust,), not averaged or whitened."""
        runs = zip(self.outputs(values), self.experiments, strict=True)
        pairs = [(shown[:, 0], one.record["thrust"]) for shown, e in runs for one in e.records]
        return [(predicted - measured)[np.isfinite(measured)] for predicted, measured in pairs]

    def fit(self, start: Mapping[str, float]) -> Solution:
        """Fit from `start`, weight the channels by the residual, and fit again: for comparison with other fits."""
        found = self._solve(self.coordinates.vector(start), WEIGHED, 40)
        self.weigh(found.residual)
        return self.refit(found.value)

    def refit(self, x: np.ndarray, limit: int = 12) -> Solution:
        """The same from coordinates `x` under the present weights."""
        return self._solve(x, ENOUGH, limit)

    def solve(self, start: Mapping[str, float], enough: float = 0.0, known: list[tuple] | None = None) -> Solution:
        """Fit from `start` under the present weights. `enough`: minimum gain of log-likelihood (noise of unknown size) to
        continue the search; the Jacobian may then be of an earlier step. 0: full numerical precision. `known`: the rows at
        `start`, if they are known. They are removed from the list: memory may suffice for one Jacobian only."""
        return self._solve(self.coordinates.vector(start), enough, 100, known)

    def _solve(self, x, enough, limit, known=None):
        c, tolerance = self.coordinates, 2.0 * enough / self.size if enough else EXACT
        residual_at = (lambda x: self.residual_at(c.values(x))) if enough else None

        def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return known.pop() if known else self.rows(c.values(x))

        return solve(evaluate, x, c.lower, c.upper, tolerance, limit, residual_at, c.jacobian)

    def solve_and_weigh(self, start: Mapping[str, float], known: list[tuple] | None = None) -> list[Solution]:
        """Alternately fit from `start` and weight the channels by their residuals, until both converge.

        Returns all fits. The last is the result; the others are slim. Each has its own weights, so their costs do not compare.
        """
        rounds = REWEIGHTS if len({b.channel for b in self.blocks}) > 1 or self.prior is not None else 0
        found = [self.solve(start, WEIGHED if rounds else 0.0, known)]
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
                # The mean of n records has 1 / n of the variance of independent noise, but all of that of shared errors.
                variances = [np.mean(summed(g, residual) ** 2) / len(g) for g in groups]
                self.scale[channel] *= float(np.sqrt(np.average(variances, weights=rows))) or 1.0

    def score_of(self, residual: np.ndarray) -> Score:
        """The score of a scaled residual that `evaluate` gives under the present scales."""
        counts = {c: sum(e.sizes.get(c, 0) for e in self.experiments) for c in self.scale}
        counts = {c: n for c, n in counts.items() if n}
        parts = np.split(residual, np.cumsum(list(counts.values())))
        return Score({c: self.scale[c] ** 2 * float(p @ p) for c, p in zip(counts, parts, strict=False)}, counts)
