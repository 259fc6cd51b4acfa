"""What a diagnosis' fit tells of its parameters: the covariance of whitened residuals, (J^T J)^-1 with J the Jacobian.

What the records leave open (an eigenvalue below UNTOLD of the largest) has no standard deviation.
"""

from collections.abc import Mapping

import numpy as np

from identification.diagnose.search.fits import UNTOLD, Fit
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from vpp_fmu.kernel.types import Effect


def uncertainty_of(fit: Fit, renamed: Mapping[str, str]) -> tuple[Uncertainty, list[str]]:
    """(covariance of the parameters that the records tell, names of those that they leave open).

    `renamed`: names to go by, where they are not the fit's own.
    """
    coordinates = fit.evidence.coordinates
    free = np.flatnonzero(~fit.solution.active)
    columns = fit.tangent()[1][:, free]
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    told, axes = np.linalg.eigh((columns / size).T @ (columns / size))
    known = told > UNTOLD * told[-1]
    tangent = coordinates.jacobian(fit.solution.value)[:, free] / size
    scatter = tangent @ (axes[:, known] / np.sqrt(told[known]))
    unknown = np.linalg.norm(tangent @ axes[:, ~known], axis=1)
    left_open = unknown > np.sqrt(UNTOLD) * np.linalg.norm(tangent, axis=1)
    kept, open_ones = np.flatnonzero(~left_open), np.flatnonzero(left_open)
    names = [renamed.get(name, name) for name in coordinates.names]
    values = np.array([fit.values[coordinates.names[k]] for k in kept])
    covariance = (scatter @ scatter.T)[np.ix_(kept, kept)]
    doubt = Uncertainty(tuple(names[k] for k in kept), values, covariance, np.ones(len(kept)))
    return doubt, [names[k] for k in open_ones]


def leaves_open(fit: Fit, effect: Effect) -> bool:
    """Whether the records leave open how large any of an effect's fitted parameters is."""
    _, names = uncertainty_of(fit, {})
    return any(effect.full(p.name) in names for p in effect.parameters)


def standard_deviations(fit: Fit, renamed: Mapping[str, str]) -> dict[str, float | None]:
    """Of all fitted parameters; a threshold's from its interval; None where the records leave open where a parameter is."""
    doubt, left_open = uncertainty_of(fit, renamed)
    found = dict(zip(doubt.names, doubt.std.tolist(), strict=True)) | dict.fromkeys(left_open)
    return found | {n: (high - low) / (2.0 * NORMAL_95) for n, (low, high) in fit.thresholds.items()}
