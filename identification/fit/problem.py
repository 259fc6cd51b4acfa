"""The least-squares problem of a fit: records, what was measured in them, what is known beforehand.

Residuals are in units of their standard deviation. Thrust is white as far as the fit is concerned; what colour it has is
accounted for in the uncertainty. A channel's weight follows from what the fit leaves in it (maximum likelihood with unknown
variances): a sensor that is far better than the model is would otherwise dictate all parameters. Records of the same commands
share what the model lacks; they weigh as their mean does, not as so many independent ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.fit.coordinates import Coordinates
from identification.fit.least_squares import Solution, solve
from identification.fit.tachometer import Tachometer
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

CHANNELS = ("thrust", "omega")
REWEIGHTS = 3
"""Rounds of fit and weight; the third changes the weights by less than a per cent."""

WEIGHED = 0.5
"""Log-likelihood at which a fit may end that only weighs the channels."""

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
        return np.linalg.cholesky(np.linalg.inv(self.covariance)).T

    def rows(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """(residual (k,) of unit variance at parameter values, its derivatives (k, len(names)) in the free ones)."""
        root = self.root()
        chosen = np.zeros((len(self.names), len(names)))
        for k, name in enumerate(self.names):
            if name in names:
                chosen[k, names.index(name)] = 1.0
        return root @ (np.array([values[n] for n in self.names]) - self.mean), root @ chosen

    def loosened(self, factor: float) -> "Prior":
        """The same knowledge with standard deviations `factor` times as large."""
        return Prior(self.names, self.mean, self.covariance * factor**2)


@dataclass(frozen=True)
class Block:
    """The rows of the residual that one channel of one record has, and the record's rows they belong to."""

    record: int
    channel: str
    rows: np.ndarray
    at: slice


def summed(group: Sequence[Block], residual: np.ndarray) -> np.ndarray:
    """(m,) the residuals (rows,) of one channel in records of the same commands, added at the rows of the first."""
    first = group[0]
    total = residual[first.at].copy()
    for other in group[1:]:
        total += np.interp(first.rows, other.rows, residual[other.at]) * (len(other.rows) / len(first.rows))
    return total


class Problem:
    """The residual of `names` over `records`, as a function of coordinates.

    `values`: all parameter values of the model, of which those in `names` are free. `channels`: what of "thrust", "omega"
    counts where a record has it. `twin`: for each record the number of the first one with the same inputs; such records are
    simulated once, and what the model lacks is the same in all of them.
    """

    def __init__(
        self,
        model: Model,
        records: Sequence[Record],
        values: Mapping[str, float],
        names: Sequence[str],
        prior: Prior | None = None,
        channels: Sequence[str] = CHANNELS,
        slow_first: Mapping[str, bool] | None = None,
    ):
        self.model, self.records, self.values = model, tuple(records), dict(values)
        self.coordinates = Coordinates(model, names, slow_first)
        self.prior = prior
        self._simulator = Simulator(model, names)
        self._thrust, self._omega = (self._simulator.outputs.index(n) for n in CHANNELS)
        inputs = [u.name for u in model.inputs]
        self.twin = tuple(next(k for k, r in enumerate(self.records) if _same_run(r, own, inputs)) for own in self.records)
        self._blocks: list[Block] = []
        self._tachometers: dict[int, Tachometer] = {}
        self.std: dict[str, float] = {}
        size = 0
        for i, record in enumerate(self.records):
            for channel in channels:
                rows = self._rows(i, record, channel)
                if len(rows):
                    self._blocks.append(Block(i, channel, rows, slice(size, size + len(rows))))
                    self.std[channel] = 1.0 if channel == "omega" else values["thrust_scale"]
                    size += len(rows)
        self.size = size

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Where each channel of each record stands in the residual; a prior's rows come last."""
        return tuple(self._blocks)

    @property
    def groups(self) -> tuple[tuple[Block, ...], ...]:
        """The same, those of one channel in records with the same inputs together."""
        together: dict[tuple[int, str], list[Block]] = {}
        for block in self._blocks:
            together.setdefault((self.twin[block.record], block.channel), []).append(block)
        return tuple(map(tuple, together.values()))

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian (rows, coordinates) at `x`."""
        residual, jacobian = self.rows(self.coordinates.values(x))
        return residual, jacobian @ self.coordinates.jacobian(x)

    def rows(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Residual and Jacobian (rows, names) in the free parameters themselves, at their `values` by name."""
        found, names = self.values | dict(values), self.coordinates.names
        known = 0 if self.prior is None else len(self.prior.names)
        residual, jacobian = np.empty(self.size + known), np.empty((self.size + known, len(names)))
        for first in dict.fromkeys(self.twin):
            record = self.records[first]
            # Kept until the next evaluation: memory that went back to the system costs more to get again than the arithmetic.
            outputs, tangents = self._work = self._simulator.sensitivities(found, record.columns, record.steps)
            for block in self._blocks:
                if self.twin[block.record] == first:
                    measured = self.records[block.record]
                    residual[block.at], jacobian[block.at] = self._compared(block, measured, outputs, tangents)
        if self.prior is not None:
            residual[self.size :], jacobian[self.size :] = self.prior.rows(found, names)
        return residual, jacobian

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """The same residual alone, from a simulation without sensitivities."""
        found = self.values | dict(values)
        residual = np.empty(self.size + (0 if self.prior is None else len(self.prior.names)))
        for first in dict.fromkeys(self.twin):
            record = self.records[first]
            outputs = self._simulator.simulate(found, record.columns, record.steps)
            for block in self._blocks:
                if self.twin[block.record] == first:
                    residual[block.at] = self._error(block, self.records[block.record], outputs)[0]
        if self.prior is not None:
            residual[self.size :], _ = self.prior.rows(found, self.coordinates.names)
        return residual

    def release(self) -> None:
        """Give back what `rows` keeps of the last evaluation: as much as all records' sensitivities."""
        self._work = None

    def solve(self, start: Mapping[str, float], enough: float = 0.0) -> Solution:
        """Fit from `start` under the present weights. `enough`: log-likelihood (of noise of unknown size) that a step must
        bring for the search to go on, and then the Jacobian need not be the solution's own; 0: as far as numbers go."""
        c = self.coordinates

        def residual_at(x: np.ndarray) -> np.ndarray:
            return self.residual(c.values(x))

        tolerance = 2.0 * enough / self.size if enough else EXACT
        return solve(self.evaluate, c.vector(start), c.lower, c.upper, tolerance, residual_at=residual_at, tangent=not enough)

    def solve_and_weigh(self, start: Mapping[str, float]) -> list[Solution]:
        """Fit from `start`, and weigh the channels by what the fit leaves in them, until the two agree.

        All fits, the last is the result, the others are slim; each has its own weights, so their costs do not compare.
        """
        rounds = REWEIGHTS if len(self.std) > 1 or self.prior is not None else 0
        found = [self.solve(start, WEIGHED if rounds else 0.0)]
        for k in range(rounds):
            self.weigh(found[-1].residual)
            found[-1] = found[-1].slim()
            found.append(self.solve(self.coordinates.values(found[-1].value), WEIGHED if k < rounds - 1 else 0.0))
        return found

    def thrust_error(self, record: int, values: Mapping[str, float]) -> np.ndarray:
        """Predicted less measured thrust (rows with thrust,) N of one record."""
        columns, steps = self.records[record].columns, self.records[record].steps
        predicted = self._simulator.simulate(values, columns, steps)[:, self._thrust]
        measured = columns["thrust"]
        return (predicted - measured)[np.isfinite(measured)]

    def weigh(self, residual: np.ndarray) -> None:
        """Set each channel's standard deviation from a residual under the present ones."""
        for channel in self.std:
            groups = [g for g in self.groups if g[0].channel == channel]
            rows = [len(g) * len(g[0].rows) for g in groups]
            # The mean of n independent records has a variance of 1 / n, that of what they share has none the less.
            variances = [np.mean(summed(g, residual) ** 2) / len(g) for g in groups]
            self.std[channel] *= float(np.sqrt(np.average(variances, weights=rows))) or 1.0

    def _rows(self, i, record, channel):
        if channel not in record:
            return np.zeros(0, int)
        if channel == "omega":
            self._tachometers[i] = Tachometer(record)
            return self._tachometers[i].rows
        return np.flatnonzero(np.isfinite(record[channel]))

    def _compared(self, block, record, outputs, tangents):
        """(error, its sensitivities), both in standard deviations."""
        error, std = self._error(block, record, outputs)
        if block.channel == "omega":
            return error, self._tachometers[block.record].shows(tangents[:, self._omega]) / std[:, None]
        return error, tangents[block.rows, self._thrust] / std

    def _error(self, block, record, outputs):
        """(predicted less measured, in standard deviations; these)."""
        if block.channel == "omega":
            tachometer = self._tachometers[block.record]
            std = tachometer.std * self.std["omega"]
            return (tachometer.shows(outputs[:, self._omega]) - tachometer.measured) / std, std
        std = self.std["thrust"]
        return (outputs[block.rows, self._thrust] - record["thrust"][block.rows]) / std, std


def _same_run(a: Record, b: Record, inputs: Sequence[str]) -> bool:
    """Whether the model's response to both records is the same."""
    if len(a) != len(b) or not np.array_equal(a.steps, b.steps):
        return False
    return all((name in a) == (name in b) and (name not in a or np.array_equal(a[name], b[name])) for name in inputs)
