"""A model whose smooth parameters may move along their sensitivities from where they are: the cheap stand-in for a refit."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.fit.least_squares import Solution
from identification.fit.problem import Problem
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.tracer import LANES


class Linearised:
    """`problem` about coordinates `x`; `residual` (rows,) is what the parameters can't follow, scaled, data rows only."""

    def __init__(self, problem: Problem, x: np.ndarray, residual: np.ndarray, jacobian: np.ndarray):
        self._problem, self._x, self._values = problem, x, problem.values | problem.coordinates.values(x)
        size = problem.size
        self._columns = jacobian[:size]
        # pinv: at a double pole, or at a bound, columns may coincide or vanish.
        self._inverse = np.linalg.pinv(self._columns.T @ self._columns, rcond=1e-12, hermitian=True)
        self.residual = self.orthogonal_part(residual[:size])

    @property
    def records(self) -> list[Record]:
        """Whose commands its experiments ran."""
        return [e.record for e in self._problem.experiments]

    @classmethod
    def of(cls, problem: Problem, solution: Solution) -> "Linearised":
        """About a fit's solution."""
        return cls(problem, solution.value, solution.residual, solution.jacobian)

    def orthogonal_part(self, rows: np.ndarray) -> np.ndarray:
        """What of `rows` the fitted parameters can't follow."""
        return rows - self._columns @ (self._inverse @ (self._columns.T @ rows))

    def products(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of what of each column of `rows` (rows, k) the parameters can't follow: its products (k,) with the residual, and with
        itself."""
        followed = self._columns.T @ rows
        own = np.einsum("ij,ij->j", rows, rows) - np.einsum("ij,ij->j", followed, self._inverse @ followed)
        return self.residual @ rows, np.maximum(own, 0.0)

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray:
        """As `apart`, of many rows (k, n) that are nothing outside one channel's place `at` in the residual, in place; returns
        the products (k, k) of all that is left.

        What the parameters follow moves the other channel, too: of its rows the products will do.
        """
        own = self._columns[at]
        other = self._columns.T @ self._columns - own.T @ own
        shares = self._inverse @ (own.T @ rows.T)
        for row, share in zip(rows, shares.T, strict=True):
            np.subtract(row, own @ share, out=row)
        return rows @ rows.T + shares.T @ other @ shares

    def directions(self, at: slice) -> np.ndarray:
        """(parameters, n): rows whose squares sum to the share of noise in the rows `at` that the fit has taken up."""
        power, turned = np.linalg.eigh(self._inverse)
        return (self._columns[at] @ (turned * np.sqrt(np.maximum(power, 0.0)))).T

    def followed(self, rows: np.ndarray) -> dict[str, float]:
        """Values of the fitted parameters once they have followed residual `rows` as far as they can."""
        coordinates = self._problem.coordinates
        x = self._x - self._inverse @ (self._columns.T @ rows)
        return coordinates.values(np.clip(x, coordinates.lower, coordinates.upper))

    def outputs(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """Outputs (rows, 3, points) of a simulator's model for each experiment, each point a change to the fitted values."""
        values = [{**self._values, **point} for point in points]
        return [simulator.simulate_all(values, *e.record.run) for e in self._problem.experiments]

    def rerun(
        self, simulator: Simulator, change: Mapping[str, float], columns: Sequence[Mapping[str, np.ndarray]]
    ) -> list[np.ndarray]:
        """Outputs (rows, 3) of a simulator's model for each experiment under `columns` in the place of its record's own, with a
        change to the fitted values."""
        values, experiments = {**self._values, **change}, self._problem.experiments
        return [simulator.simulate(values, c, e.record.steps) for c, e in zip(columns, experiments, strict=True)]

    def rows(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Scaled residual (rows, points) of a simulator's model with changes to the fitted values."""
        problem = self._problem
        residuals = problem.residuals(self.outputs(simulator, points))
        return np.concatenate([r / problem.scale[c] for c, r in residuals.items()])

    def change(self, outputs: Sequence[np.ndarray]) -> np.ndarray:
        """Scaled change of the residual (rows, ...) for a change of the outputs, (rows, 3, ...) for each experiment."""
        problem = self._problem
        return np.concatenate([c / problem.scale[k] for k, c in problem.columns(outputs).items()])

    def columns(self, simulator: Simulator, changes: Mapping[str, float]) -> np.ndarray:
        """Sensitivities (rows, wrt) of the scaled residual in the parameters that a simulator has tangents for."""
        values, problem = {**self._values, **changes}, self._problem
        runs = [simulator.sensitivities(values, *e.record.run) for e in problem.experiments]
        columns = problem.columns([tangents for _, tangents in runs], [outputs for outputs, _ in runs])
        return np.vstack([c / problem.scale[k] for k, c in columns.items()])

    def left(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> np.ndarray:
        """(rows, points) residual with changes, the fitted parameters following as far as they can."""
        return self.orthogonal_part(self.rows(simulator, points))

    def costs(self, simulator: Simulator, points: Sequence[Mapping[str, float]]) -> list[float]:
        """Half the sum of its squares, for each point."""
        found = []
        for first in range(0, len(points), LANES):  # so that no more than these are held
            left = self.left(simulator, points[first : first + LANES])
            found += (0.5 * np.einsum("ij,ij->j", left, left)).tolist()
        return found
