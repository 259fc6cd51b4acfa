"""The identification.json of a model that a diagnosis fitted: what `vpp identify` says of its own, as far as this fit tells it.

Its covariance is that of whitened residuals, J the Jacobian: (J^T J)^-1. What the records leave open (an eigenvalue below
UNTOLD of the largest) has no standard deviation, and stands under `not_identifiable` instead of in the correlation.
"""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.search.fits import UNTOLD, Fit
from identification.fit.uncertainty import NORMAL_95, Uncertainty


def identification_of(found: Diagnosis, fit: Fit) -> dict:
    """For the model whose parameters `found.parameters(fit)` are: the same values under the same names.

    Of the base that the campaign was identified with, all that the identification told.
    """
    if fit is found.base and found.identification is not None:
        return found.identification.summary()
    doubt, left_open = _uncertainty(fit)
    condition, weakest, spread = doubt.directions()
    campaign = found.campaign
    records = {"open_loop": campaign.open_loop, "repeat": campaign.repeat, "validation": campaign.validation}
    shown = {name: found.prediction(fit, record) for name, record in records.items() if record is not None}
    rows = zip(doubt.names, doubt.values.tolist(), doubt.std.tolist(), doubt.intervals.tolist(), strict=True)
    parameters = {
        name: {"value": value, "std": std, "interval": interval, "interval_from": "covariance"}
        for name, value, std, interval in rows
    }
    for name, (low, high) in fit.thresholds.items():
        entry = {"value": fit.values[name], "std": (high - low) / (2.0 * NORMAL_95), "interval": [low, high]}
        parameters[name] = entry | {"interval_from": "scan"}
    return {
        "made_by": "vpp diagnose",
        "effects": list(found.parameters(fit).model.optional),
        "parameters": parameters,
        "correlation": {"names": list(doubt.names), "matrix": doubt.correlation.tolist()},
        "condition_number": condition,
        "weakest_direction": dict(zip(doubt.names, weakest.tolist(), strict=True)) | {"relative_std": spread},
        "inflation_by_coloured_residuals": {},  # the residuals were whitened first
        "not_identifiable": dict.fromkeys(left_open, "the records leave open where it is"),
        "noise_floor_thrust": found.noise.floor,
        "fitted": [name for name in ("open_loop", "repeat") if name in shown],
        "records": {name: p.summary() for name, p in shown.items()},
        "rmse_thrust": {name: p.rmse_thrust for name, p in shown.items()},
        "rmse_omega": {name: p.rmse_omega for name, p in shown.items()},
        "fit_thrust": {name: p.fit_thrust for name, p in shown.items()},
        "missing": list(campaign.missing),
    }


def _uncertainty(fit: Fit) -> tuple[Uncertainty, list[str]]:
    """(covariance of the parameters that the records tell, names of those that they leave open)."""
    coordinates = fit.evidence.coordinates
    free = np.flatnonzero(~fit.solution.active)
    columns = fit.solution.jacobian[:, free]
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    told, axes = np.linalg.eigh((columns / size).T @ (columns / size))
    known = told > UNTOLD * told[-1]
    tangent = coordinates.jacobian(fit.solution.value)[:, free] / size
    scatter = tangent @ (axes[:, known] / np.sqrt(told[known]))
    unknown = np.linalg.norm(tangent @ axes[:, ~known], axis=1)
    left_open = unknown > np.sqrt(UNTOLD) * np.linalg.norm(tangent, axis=1)
    kept = np.flatnonzero(~left_open)
    names = tuple(coordinates.names[k] for k in kept)
    values = np.array([fit.values[name] for name in names])
    covariance = (scatter @ scatter.T)[np.ix_(kept, kept)]
    return Uncertainty(names, values, covariance, np.ones(len(names))), [
        coordinates.names[k] for k in np.flatnonzero(left_open)
    ]
