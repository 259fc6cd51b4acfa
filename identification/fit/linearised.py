"""A model linearised in its fitted parameters: a cheap approximation of a refit."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.fit.least_squares import Solution
from identification.fit.problem import Problem
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.tracer import LANES


class Linearised:
    """`problem` linearised at coordinates `x`. `residual` (rows,): scaled data rows, orthogonal to the sensitivities."""

    def __init__(self, problem: Problem, x: np.ndarray, residual: np.ndarray, jacobian: np.ndarray):
        self._problem, self._x, self._values = problem, x, problem.values | problem.coordinates.values(x)
        size = problem.size
        self._columns = jacobian[:size]
        # pinv: columns may coincide or vanish at a double pole or at a bound.
        self._inverse = np.linalg.pinv(self._columns.T @ self._columns, rcond=1e-12, hermitian=True)
        self.residual = self.orthogonal_part(residual[:size])

    @property
    def names(self) -> tuple[str, ...]:
        """The fitted parameters."""
        return self._problem.coordinates.names

    @property
    def records(self) -> list[Record]:
        """One record of each experiment."""
        return [e.record for e in self._problem.experiments]

    @classmethod
    def of(cls, problem: Problem, solution: Solution) -> "Linearised":
        """Linearised at the solution of a fit."""
        return cls(problem, solution.value, solution.residual, solution.jacobian)

    def orthogonal_part(self, rows: np.ndarray) -> np.ndarray:
        """Part of `rows` that is orthogonal to the sensitivities of the fitted parameters."""
        return rows - self._columns @ (self._inverse @ (self._columns.T @ rows))

    def products(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products (k,) of the orthogonal part of each column of `rows` (rows, k): with the residual, and with itself."""
        absorbed = self._columns.T @ rows
        own = np.einsum("ij,ij->j", rows, rows) - np.einsum("ij,ij->j", absorbed, self._inverse @ absorbed)
        return self.residual @ rows, np.maximum(own, 0.0)

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray:
        """`orthogonal_part`, in place, of many rows (k, n) that are zero outside one channel `at`. Returns the products (k, k)
        of their orthogonal parts in all channels.

        A change of the parameters affects the other channel, too. Of its rows only the products are computed.
        """
        own = self._columns[at]
        other = self._columns.T @ self._columns - own.T @ own
        shares = self._inverse @ (own.T @ rows.T)
        for row, share in zip(rows, shares.T, strict=True):
            np.subtract(row, own @ share, out=row)
        return rows @ rows.T + shares.T @ other @ shares

    def directions(self, at: slice) -> np.ndarray:
        """(parameters, n): rows whose squares sum to the share of the noise power in rows `at` that the fit absorbs."""
        power, turned = np.linalg.eigh(self._inverse)
        return (self._columns[at] @ (turned * np.sqrt(np.maximum(power, 0.0)))).T

    def followed(self, rows: np.ndarray) -> dict[str, float]:
        """Values of the fitted parameters after one least-squares step for the residual `rows`, within bounds."""
        coordinates = self._problem.coordinates
        x = self._x - self._inverse @ (self._columns.T @ rows)
        return coordinates.values(np.clip(x, coordinates.lower, coordinates.upper))

    def outputs(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """Outputs (rows, 3, points) of a simulator's model for each experiment; each point is a change of the fitted values."""
        values = [{**self._values, **point} for point in points]
        return [simulator.simulate_all(values, *e.record.run) for e in self._problem.experiments]

    def rerun(
        self, simulator: Simulator, change: Mapping[str, float], columns: Sequence[Mapping[str, np.ndarray]]
    ) -> list[np.ndarray]:
        """Outputs (rows, 3) of a simulator's model for each experiment with inputs `columns` in place of its record's, after a
        change of the fitted values."""
        values, experiments = {**self._values, **change}, self._problem.experiments
        return [simulator.simulate(values, c, e.record.steps) for c, e in zip(columns, experiments, strict=True)]

    def rows(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Scaled residual (rows, points) of a simulator's model after changes of the fitted values."""
        problem = self._problem
        residuals = problem.residuals(self.outputs(simulator, points))
        return np.concatenate([r / problem.scale[c] for c, r in residuals.items()])

    def change(self, outputs: Sequence[np.ndarray]) -> np.ndarray:
        """Scaled change of the residual (rows, ...) for a change of the outputs, (rows, 3, ...) for each experiment."""
        problem = self._problem
        return np.concatenate([c / problem.scale[k] for k, c in problem.columns(outputs).items()])

    def columns(self, simulator: Simulator, changes: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Sensitivities (rows, k) of the scaled residual in k of the parameters of a simulator."""
        values, problem, at = {**self._values, **changes}, self._problem, [simulator.wrt.index(n) for n in names]
        runs = [simulator.sensitivities(values, *e.record.run) for e in problem.experiments]
        columns = problem.columns([tangents[:, :, at] for _, tangents in runs], [outputs for outputs, _ in runs])
        return np.vstack([c / problem.scale[k] for k, c in columns.items()])

    def left(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Residual (rows, points) after changes of values and a linearised refit of the fitted parameters."""
        return self.orthogonal_part(self.rows(simulator, points))

    def costs(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> list[float]:
        """Half the sum of squares of that residual, for each point."""
        found = []
        for first in range(0, len(points), LANES):  # in parts, to limit the memory
            residuals = self.left(simulator, points[first : first + LANES])
            found += (0.5 * np.einsum("ij,ij->j", residuals, residuals)).tolist()
        return found
