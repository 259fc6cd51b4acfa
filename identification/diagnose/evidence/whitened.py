"""A model with candidate effects against the records, as whitened residuals: what every judgement rests on.

Records of the same commands are one experiment: they are simulated once, and their thrust is averaged, which divides the
noise's power by their number. Speed is compared as the tachometer shows it, in each record by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identification.diagnose.evidence.converter import Converter
from identification.diagnose.evidence.noise import Noise, blocks
from identification.diagnose.roles import Fitted
from identification.fit.coordinates import Coordinates
from identification.fit.least_squares import Solution, solve
from identification.fit.problem import Prior
from identification.fit.tachometer import Tachometer
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator

WEIGHED, ENOUGH = 0.5, 1e-3
"""Log-likelihood at which a fit ends: to weigh the channels by what it leaves, and for good (a deviation of 0.045 standard
deviations of the estimate)."""


PIECE = 16384
"""Rows of a record that are run at a time."""


@dataclass(frozen=True)
class Score:
    """Sum of squares and number of whitened residuals in each channel."""

    squares: Mapping[str, float]
    counts: Mapping[str, int]

    @property
    def deviance(self) -> float:
        """-2 log-likelihood, noise variances unknown, up to a constant."""
        return float(sum(n * np.log(max(self.squares[c], 1e-300)) for c, n in self.counts.items()))


class Experiment:
    """Fitted records of the same commands, and what of them counts. TypeError for a record of another role.

    `skip` [s]: the run-in at the start that has no weight, where a record did not start settled.
    """

    def __init__(self, records: Sequence[Fitted], noise: Noise, skip: float = 0.0):
        if not all(isinstance(r, Fitted) for r in records):
            raise TypeError("only records that are there to be fitted may be fitted")
        own = [r.record for r in records]
        self.records, self.record, self.noise, self.skip = tuple(records), own[0], noise, skip
        thrust = np.stack([r["thrust"] for r in own])
        self._there = np.isfinite(thrust).all(axis=0)
        self.thrust_rows = np.where(self._there, thrust.mean(axis=0), np.nan)
        self.converter = Converter.of(np.concatenate([r["thrust"] for r in own]), noise.floor)
        self._blocks = blocks(self.record, noise.block)
        self.thrust = self._blocks.mean(self.thrust_rows)
        self.tachometers = [Tachometer(r) for r in own if "omega" in r]
        order = noise.colour.order
        self._seen = np.isfinite(noise.colour.whiten(self.thrust)) & (self._blocks.time[order:] >= skip)
        self._share = 1.0 / np.sqrt(len(own))  # the mean's noise
        self._late = [t.rows_time(skip, noise.speed.order) for t in self.tachometers]
        self.thrust_time = self._blocks.time[order:][self._seen]
        self.omega_time = np.concatenate([time for _, time in self._late]) if self._late else np.zeros(0)
        self.sizes = {"thrust": int(self._seen.sum())}
        if len(self.omega_time):
            self.sizes["omega"] = len(self.omega_time)

    @property
    def compared(self) -> list[int]:
        """Columns of the model's outputs (rows, 3) that these records measure: thrust, and speed where it is there."""
        return [0, 1] if len(self.omega_time) else [0]

    def thrust_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened predicted less measured thrust (n,), from thrust (rows,) N."""
        return self._white(self._blocks.mean(self._where_measured(self.converter.reads(predicted))) - self.thrust)

    def thrust_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the thrust (rows, ...) N."""
        if not tangents.any():  # what runs into nothing changes nothing
            return np.zeros((self.sizes["thrust"], *tangents.shape[1:]))
        return self._white(self._blocks.mean(self._where_measured(tangents)))

    def sensitivities(self, simulator: Simulator, values: Mapping[str, float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(outputs (rows, 3), whitened sensitivities (n, k) by channel) of a simulator's model.

        The record is run in pieces: of a long one, sensitivities are by far the largest thing in memory, and only block means
        of those of thrust are kept.
        """
        length, k = int(self._blocks.edges[1]), len(simulator.wrt)
        means, speed = np.empty((len(self._blocks.time), k)), np.empty((len(self.record) * bool(self.tachometers), k))
        outputs, first = np.empty((len(self.record), len(simulator.outputs))), 0
        rows = max(1, PIECE // length) * length
        for at, shown, tangents in simulator.pieces(values, self.record.columns, self.record.steps, rows):
            outputs[at] = shown
            own = self._blocks.part(at)
            if len(own.time):
                thrust = (tangents[:, 0].T * self.converter.slope(shown[:, 0])).T
                means[first : first + len(own.time)] = own.mean(self._where_measured(thrust, at))
                first += len(own.time)
            if len(speed):
                speed[at] = tangents[:, 1]
        found = {"thrust": self._white(means)}
        return outputs, found | ({"omega": self.omega_columns(speed)} if len(self.omega_time) else {})

    def omega_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened predicted less measured speed (n,), from speed (rows,) rpm."""
        return self._heard([(t.shows(predicted) - t.measured) / t.std for t in self.tachometers])

    def omega_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the speed (rows, ...) rpm."""
        if not tangents.any():
            return np.zeros((len(self.omega_time), *tangents.shape[1:]))
        return self._heard([(t.shows(tangents).T / t.std).T for t in self.tachometers])

    def white_thrust(self, means: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change of the thrust's block means (blocks, ...) N."""
        return self._white(means)

    def white_speed(self, shown: Sequence[np.ndarray]) -> np.ndarray:
        """Whitened change of the residual (n, ...) for one of what each tachometer shows (readings, ...) rpm."""
        return self._heard([(part.T / t.std).T for t, part in zip(self.tachometers, shown, strict=True)])

    def slow_thrust(self, rows: np.ndarray) -> np.ndarray:
        """Means of a thrust (rows,) [N] over 50 ms, what is below 10 Hz of it; blocks without a reading left out."""
        means = blocks(self.record, 0.05).mean(self._where_measured(rows))
        return means[np.isfinite(means)]

    def _where_measured(self, predicted, at=slice(None)):
        """NaN where no thrust was read, so that block means of both are over the same rows."""
        there = self._there[at]
        return predicted if there.all() else np.where(there.reshape(-1, *[1] * (predicted.ndim - 1)), predicted, np.nan)

    def _white(self, means):
        return self.noise.colour.whiten(means)[self._seen] / self._share

    def _heard(self, parts):
        white = [self.noise.speed.whiten(part)[kept] for part, (kept, _) in zip(parts, self._late, strict=True)]
        return np.concatenate(white)


class Evidence:
    """Residuals of a model over experiments; `names` are free, `values` holds the rest.

    `scale` divides each channel's residual: what the fit leaves there, so that neither channel dictates.
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
        self.scale = dict.fromkeys(("thrust", "omega"), 1.0)

    @cached_property
    def simulator(self) -> Simulator:
        """The model's, with sensitivities in what is free."""
        return Simulator(self.model, self.coordinates.names)

    @property
    def size(self) -> int:
        """Rows of the residual without the prior's."""
        return sum(sum(e.sizes.values()) for e in self.experiments)

    @property
    def times(self) -> list[tuple[np.ndarray, float]]:
        """(time [s] of each row, length [s] of its record), in the residual's order: thrust by experiment, then speed."""
        ends = [float(e.record.time[-1]) for e in self.experiments]
        thrust = [(e.thrust_time, end) for e, end in zip(self.experiments, ends, strict=True)]
        return thrust + [(e.omega_time, end) for e, end in zip(self.experiments, ends, strict=True) if len(e.omega_time)]

    def residuals(self, outputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Each channel's residual (n,), unscaled, from the outputs (rows, 3) of each experiment."""
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
        """Scaled residual, the prior's rows last, and Jacobian in coordinates."""
        found, inner = self.values | self.coordinates.values(x), self.coordinates.jacobian(x)
        runs = [e.sensitivities(self.simulator, found) for e in self.experiments]
        residuals = self.residuals([outputs for outputs, _ in runs])
        residual = np.concatenate([r / self.scale[c] for c, r in residuals.items()])
        jacobian = np.vstack([own[c] @ (inner / self.scale[c]) for c in residuals for _, own in runs if c in own])
        if self.prior is None:
            return residual, jacobian
        error, known = self.prior.rows(found, self.coordinates.names)
        return np.append(residual, error), np.vstack([jacobian, known @ inner])

    def residual_at(self, values: Mapping[str, float]) -> np.ndarray:
        """The scaled residual at parameter values, the prior's rows last."""
        found = self.values | dict(values)
        outputs = [self.simulator.simulate(found, e.record.columns, e.record.steps) for e in self.experiments]
        residual = np.concatenate([r / self.scale[c] for c, r in self.residuals(outputs).items()])
        return residual if self.prior is None else np.append(residual, self.prior.rows(found, self.coordinates.names)[0])

    def fit(self, start: Mapping[str, float]) -> Solution:
        """Fit from `start`, then once more with the channels weighed by what the first fit left."""
        found = self._solve(self.coordinates.vector(start), WEIGHED, 40)
        self.weigh(found.residual)
        return self.refit(found.value)

    def refit(self, x: np.ndarray, limit: int = 12) -> Solution:
        """Fit from coordinates `x` under the present weights."""
        return self._solve(x, ENOUGH, limit)

    def _solve(self, x, enough, limit):
        c, tolerance = self.coordinates, 2.0 * enough / self.size
        return solve(
            self.evaluate, x, c.lower, c.upper, tolerance, limit, lambda x: self.residual_at(c.values(x)), tangent=False
        )

    def weigh(self, residual: np.ndarray) -> None:
        """Set the channels' scales from a residual under the present ones."""
        score = self.score_of(residual)
        self.scale |= {c: float(np.sqrt(s / score.counts[c])) or 1.0 for c, s in score.squares.items()}

    def score_of(self, residual: np.ndarray) -> Score:
        """The score that a scaled residual, as `evaluate` gives it under the present scales, stands for."""
        counts = {c: sum(e.sizes.get(c, 0) for e in self.experiments) for c in self.scale}
        counts = {c: n for c, n in counts.items() if n}
        parts = np.split(residual, np.cumsum(list(counts.values())))
        return Score({c: self.scale[c] ** 2 * float(p @ p) for c, p in zip(counts, parts, strict=False)}, counts)
