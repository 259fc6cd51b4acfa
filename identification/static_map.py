"""The static thrust map by weighted least squares (paper, eq. 8 and section 3.1)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vpp_fmu.campaign import StaticMap

TERMS = {"c20": (2, 0), "c11": (1, 1), "c21": (2, 1), "c12": (1, 2), "c30": (3, 0)}
"""Powers of w and b of each term of the paper's polynomial."""

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: below it the blades stall and the cubic no longer fits."""


@dataclass(frozen=True)
class StaticFit:
    """A fitted map: coefficients by name (normalised), covariance (terms, terms), what it leaves, and how well it fits.

    `used` (n,): the points of the campaign within the operating region; `residual` (points used,) N, measured less fitted.
    """

    coefficients: Mapping[str, float]
    covariance: np.ndarray
    residual: np.ndarray
    used: np.ndarray
    r2_adjusted: float
    rmse: float

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each coefficient."""
        return dict(zip(self.coefficients, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def design(omega: np.ndarray, beta: np.ndarray, scales: Mapping[str, float]) -> np.ndarray:
    """Columns (n, terms) of the map in normalised thrust, for speed [rpm] and pitch [deg], each (n,)."""
    w = omega / scales["omega_scale"]
    b = (beta + scales["beta_offset"]) / scales["beta_scale"]
    return np.column_stack([w**i * b**j for i, j in TERMS.values()])


def fit_static_map(static: StaticMap, scales: Mapping[str, float], pitch: tuple[float, float] = OPERATING_PITCH) -> StaticFit:
    """Fit the paper's map to steady points with pitch inside `pitch` [deg].

    Each point weighs by how well its mean is known (`thrust_std`, `samples`). The points scatter around the polynomial by
    more than that, so the covariance is scaled to what they leave. `scales`: the parameters of the normalisation, by name.
    """
    used = (static.beta_ref >= pitch[0]) & (static.beta_ref <= pitch[1])
    a = design(static.omega[used], static.beta_ref[used], scales)
    thrust = static.thrust[used]
    t = thrust / scales["thrust_scale"]
    error = np.maximum(static.thrust_std[used], 1e-3) / np.sqrt(static.samples[used]) / scales["thrust_scale"]
    weight = 1.0 / error
    c, *_ = np.linalg.lstsq(a * weight[:, None], t * weight, rcond=None)
    left = t - a @ c
    n, k = a.shape
    scatter = float((left * weight) @ (left * weight)) / (n - k)
    covariance = np.linalg.inv((a * weight[:, None]).T @ (a * weight[:, None])) * scatter
    unexplained = float(left @ left) / (n - k)
    total = float(np.sum((t - t.mean()) ** 2)) / (n - 1)
    return StaticFit(
        coefficients=dict(zip(TERMS, c.tolist(), strict=True)),
        covariance=covariance,
        residual=left * scales["thrust_scale"],
        used=used,
        r2_adjusted=1.0 - unexplained / total,
        rmse=float(np.sqrt(np.mean(left**2))) * scales["thrust_scale"],
    )
