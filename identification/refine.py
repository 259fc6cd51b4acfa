"""Fine-tuning: the parameters that make the model's response to a record fit the measured one (paper, section 3.2).

The paper descends the gradient of the thrust error's mean square; here Levenberg-Marquardt works on the same exact forward
sensitivities, in coordinates that are regular where the two lags of a channel meet.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.coordinates import Coordinates
from identification.least_squares import Solution, solve
from vpp_fmu.kernel.plant import FINE_TUNED
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

BASE_PARAMETERS = tuple(FINE_TUNED)
"""The four time constants and the five map coefficients."""


@dataclass(frozen=True)
class Refinement:
    """What a fine-tuning found.

    `values`: every parameter of the model; `std`: of those that were fitted, for white residuals, scaled to what is left;
    `covariance` (fitted, fitted) in the order of `names`. Costs are the paper's: mean(e^2) / 2 of normalised thrust.
    `residual` (rows,) N: predicted less measured.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    std: Mapping[str, float]
    covariance: np.ndarray
    cost_start: float
    cost_final: float
    costs: tuple[float, ...]
    residual: np.ndarray
    evaluations: int
    converged: bool
    seconds: float


class ThrustFit:
    """The least-squares problem: normalised thrust of a record, in the coordinates of the free parameters."""

    def __init__(self, model: Model, record: Record, values: Mapping[str, float], names: Sequence[str] = BASE_PARAMETERS):
        self.coordinates = Coordinates(model, names)
        self.scale = values["thrust_scale"]
        self._simulator = Simulator(model, names)
        self._fixed, self._record, self._steps = dict(values), record, record.steps
        self._column = self._simulator.outputs.index("thrust")
        self._seen = np.isfinite(record["thrust"])

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (rows with thrust,) and Jacobian (rows, parameters) at coordinates `x`."""
        values = self._fixed | self.coordinates.values(x)
        outputs, tangents = self._simulator.sensitivities(values, self._record.columns, self._steps)
        residual = (outputs[:, self._column] - self._record["thrust"])[self._seen] / self.scale
        return residual, tangents[:, self._column][self._seen] @ (self.coordinates.jacobian(x) / self.scale)


def refine(model: Model, record: Record, start: Mapping[str, float], names: Sequence[str] = BASE_PARAMETERS) -> Refinement:
    """Fit the parameters `names` of `model` to the thrust of `record`, from the values `start`.

    `start`: changes to the model's defaults, by name.
    """
    began = time.perf_counter()
    values = model.values(start)
    fit = ThrustFit(model, record, values, names)
    found = solve(fit.evaluate, fit.coordinates.vector(values), fit.coordinates.lower, fit.coordinates.upper)
    covariance = _covariance(found, fit.coordinates)
    rows = len(found.residual)
    return Refinement(
        names=tuple(names),
        values=values | fit.coordinates.values(found.value),
        std=dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        cost_start=found.costs[0] / rows,
        cost_final=found.cost / rows,
        costs=tuple(cost / rows for cost in found.costs),
        residual=found.residual * fit.scale,
        evaluations=found.evaluations,
        converged=found.converged,
        seconds=time.perf_counter() - began,
    )


def _covariance(found: Solution, coordinates: Coordinates) -> np.ndarray:
    """Covariance of the parameter values, linearised at the solution, for white residuals of the size that is left."""
    rows, n = found.jacobian.shape
    variance = float(found.residual @ found.residual) / (rows - n)
    to_values = coordinates.jacobian(found.value)
    return to_values @ np.linalg.pinv(found.jacobian.T @ found.jacobian, hermitian=True) @ to_values.T * variance
