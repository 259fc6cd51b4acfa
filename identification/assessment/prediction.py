"""A record with the model's prediction for its commands, and the uncertainty of the prediction."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from identification.assessment.sections import sections
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


def rmse(error: np.ndarray) -> float | None:
    """Root mean square of an error (rows,) without NaN, in its unit; None without a value."""
    seen = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else None


def fit_percent(measured: np.ndarray, predicted: np.ndarray) -> float | None:
    """100 (1 - |measured - predicted| / |measured - its mean|) in %, as MATLAB's `compare`; None for a constant."""
    seen = np.isfinite(measured)
    y = measured[seen]
    spread = float(np.sqrt(np.mean((y - y.mean()) ** 2))) if len(y) else 0.0
    return 100.0 * (1.0 - rmse(y - predicted[seen]) / spread) if spread > 0 else None


@dataclass(frozen=True)
class Prediction:
    """A record and the model's open-loop response to its commands; `thrust` N, `omega` rpm, `beta` deg, each (rows,).

    `further`: the model's other outputs, such as torque and power, by name (rows,).
    """

    record: Record
    thrust: np.ndarray
    omega: np.ndarray
    beta: np.ndarray
    further: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def rmse_thrust(self) -> float | None:
        """N; None without a thrust reading."""
        return rmse(self.thrust - self.record["thrust"])

    @property
    def rmse_omega(self) -> float | None:
        """rpm; None without measured speed."""
        return rmse(self.omega - self.record["omega"]) if "omega" in self.record else None

    @property
    def fit_thrust(self) -> float | None:
        """%, as `fit_percent`."""
        return fit_percent(self.record["thrust"], self.thrust)

    def within(self, std: np.ndarray) -> float | None:
        """Share of the readings within 1.96 `std` (rows,) N of the prediction; None without a reading."""
        error = self.thrust - self.record["thrust"]
        seen = np.isfinite(error)
        return float(np.mean(np.abs(error[seen]) <= NORMAL_95 * std[seen])) if seen.any() else None

    def summary(self) -> dict:
        """Errors for `identification.json` (docs/reference/files.md): over the record, and by section with a reading."""
        measured = self.record["thrust"]
        by_section = {
            name: {
                "rmse_thrust": rmse((self.thrust - measured)[mask]),
                "fit_thrust": fit_percent(measured[mask], self.thrust[mask]),
            }
            for name, mask in sections(self.record).items()
            if np.isfinite(measured[mask]).any()
        }
        return {
            "rmse_thrust": self.rmse_thrust,
            "rmse_omega": self.rmse_omega,
            "fit_thrust": self.fit_thrust,
            "sections": by_section,
        }


def summaries(predictions: Mapping[str, Prediction]) -> dict:
    """For identification.json: the errors over each record, and by section."""
    names = "rmse_thrust", "rmse_omega", "fit_thrust"
    records = {name: p.summary() for name, p in predictions.items()}
    return {"records": records} | {each: {name: record[each] for name, record in records.items()} for each in names}


def predict(model: Model, values: Mapping[str, float], record: Record) -> Prediction:
    """The model's open-loop response to a record's commands."""
    outputs = Simulator(model).simulate(values, *record.run).T
    further = {y.name: column for y, column in zip(model.outputs[3:], outputs[3:], strict=True)}
    return Prediction(record, *outputs[:3], further)


def band(
    model: Model, values: Mapping[str, float], uncertainty: Uncertainty, record: Record, residual_std: float
) -> np.ndarray:
    """Standard deviation (rows,) N of a predicted reading, from the parameters' covariance and the `residual_std` [N]."""
    variance = np.empty(len(record))
    for at, _, tangents in Simulator(model, uncertainty.names).pieces(values, *record.run):
        slope = tangents[:, 0]
        variance[at] = np.einsum("ij,jk,ik->i", slope, uncertainty.covariance, slope)
    return np.sqrt(variance + residual_std**2)
