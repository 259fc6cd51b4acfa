"""A model with candidate effects against the records, as whitened residuals: what every judgement rests on.

Records of the same commands are one experiment: they are simulated once, and their thrust is averaged, which halves the
noise's power. Speed is compared as the tachometer shows it, in each record by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnose.evidence.noise import Noise, blocks
from identification.fit.coordinates import Coordinates
from identification.fit.least_squares import Solution, solve
from identification.fit.problem import Prior
from identification.fit.tachometer import Tachometer
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


@dataclass(frozen=True)
class Score:
    """Sum of squares and number of residuals in each channel; rmse of thrust [N] and speed [rpm] on the rows as they are."""

    squares: Mapping[str, float]
    counts: Mapping[str, int]

    def gain(self, other: "Score") -> dict[str, float]:
        """Log-likelihood that this has over `other` in each channel, noise variances unknown: n / 2 log(SSE ratio)."""
        return {c: 0.5 * n * float(np.log(other.squares[c] / self.squares[c])) for c, n in self.counts.items()}


class Experiment:
    """Records of the same commands, and what of them counts."""

    def __init__(self, records: Sequence[Record], noise: Noise):
        self.record, self.noise = records[0], noise
        thrust = np.mean([r["thrust"] for r in records], axis=0)
        self._blocks = blocks(self.record)
        self._there = np.isfinite(thrust)
        self.thrust = self._blocks.mean(thrust)
        self.tachometers = [Tachometer(r) for r in records if "omega" in r]
        self._seen = np.isfinite(noise.whiten(self.thrust))
        self._share = 1.0 / np.sqrt(len(records))  # the mean's noise
        self.sizes = {"thrust": int(self._seen.sum())}
        if count := sum(len(t) for t in self.tachometers):
            self.sizes["omega"] = count

    def thrust_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened predicted less measured thrust (n,), from thrust (rows,) N."""
        return self._white(self._blocks.mean(self._where_measured(predicted)) - self.thrust)

    def thrust_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened sensitivities (n, k) from those of thrust (rows, k)."""
        return self._white(self._blocks.mean(self._where_measured(tangents)))

    def omega_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Predicted less measured speed over its uncertainty (n,), from speed (rows,) rpm."""
        return np.concatenate([(t.shows(predicted) - t.measured) / t.std for t in self.tachometers])

    def omega_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Sensitivities (n, k) over the uncertainty, from those of speed (rows, k)."""
        return np.concatenate([t.shows(tangents) / t.std[:, None] for t in self.tachometers])

    def _where_measured(self, predicted):
        """NaN where no thrust was read, so that block means of both are over the same rows."""
        if self._there.all():
            return predicted
        return np.where(self._there.reshape(-1, *[1] * (predicted.ndim - 1)), predicted, np.nan)

    def _white(self, means):
        return self.noise.whiten(means)[self._seen] / self._share


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
        self._simulator: Simulator | None = None

    @property
    def size(self) -> int:
        """Rows of the residual without the prior's."""
        return sum(sum(e.sizes.values()) for e in self.experiments)

    def residuals(self, outputs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Each channel's residual (n,), unscaled, from the outputs (rows, 3) of each experiment."""
        thrust = [e.thrust_residual(y[:, 0]) for e, y in zip(self.experiments, outputs, strict=True)]
        found = {"thrust": np.concatenate(thrust)}
        omega = [e.omega_residual(y[:, 1]) for e, y in zip(self.experiments, outputs, strict=True) if e.tachometers]
        if omega:
            found["omega"] = np.concatenate(omega)
        return found

    def columns(self, tangents: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Each channel's sensitivities (n, k), unscaled, from those of the outputs (rows, 3, k) of each experiment."""
        found = {"thrust": np.vstack([e.thrust_columns(d[:, 0]) for e, d in zip(self.experiments, tangents, strict=True)])}
        omega = [e.omega_columns(d[:, 1]) for e, d in zip(self.experiments, tangents, strict=True) if e.tachometers]
        if omega:
            found["omega"] = np.vstack(omega)
        return found

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residual, the prior's rows last, and Jacobian in coordinates."""
        if self._simulator is None:
            self._simulator = Simulator(self.model, self.coordinates.names)
        found, inner = self.values | self.coordinates.values(x), self.coordinates.jacobian(x)
        runs = [self._simulator.sensitivities(found, e.record.columns, e.record.steps) for e in self.experiments]
        residuals = self.residuals([outputs for outputs, _ in runs])
        columns = self.columns([tangents for _, tangents in runs])
        residual = np.concatenate([r / self.scale[c] for c, r in residuals.items()])
        jacobian = np.vstack([j @ inner / self.scale[c] for c, j in columns.items()])
        if self.prior is None:
            return residual, jacobian
        error, known = self.prior.rows(found, self.coordinates.names)
        return np.append(residual, error), np.vstack([jacobian, known @ inner])

    def score(self, values: Mapping[str, float], simulator: Simulator) -> Score:
        """The score of parameter values, by a simulator of the model."""
        found = self.values | dict(values)
        outputs = [simulator.simulate(found, e.record.columns, e.record.steps) for e in self.experiments]
        residuals = self.residuals(outputs)
        return Score({c: float(r @ r) for c, r in residuals.items()}, {c: len(r) for c, r in residuals.items()})

    def fit(self, start: Mapping[str, float], limit: int = 40) -> Solution:
        """Fit from `start`, then once more with the channels weighed by what the first fit left."""
        coordinates = self.coordinates
        found = solve(self.evaluate, coordinates.vector(start), coordinates.lower, coordinates.upper, 1e-8, limit)
        self.weigh(found.residual)
        return self.refit(found.value)

    def refit(self, x: np.ndarray, limit: int = 12) -> Solution:
        """Fit from coordinates `x` under the present weights."""
        return solve(self.evaluate, x, self.coordinates.lower, self.coordinates.upper, 1e-8, limit)

    def weigh(self, residual: np.ndarray) -> None:
        """Set the channels' scales from a residual under the present ones."""
        score = self.score_of(residual)
        self.scale |= {c: float(np.sqrt(s / score.counts[c])) for c, s in score.squares.items()}

    def score_of(self, residual: np.ndarray) -> Score:
        """The score that a scaled residual, as `evaluate` gives it under the present scales, stands for."""
        counts = {c: sum(e.sizes.get(c, 0) for e in self.experiments) for c in self.scale}
        counts = {c: n for c, n in counts.items() if n}
        parts = np.split(residual, np.cumsum(list(counts.values())))
        return Score({c: self.scale[c] ** 2 * float(p @ p) for c, p in zip(counts, parts, strict=False)}, counts)
