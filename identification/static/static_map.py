"""The static thrust map by weighted least squares (paper, eq. 8 and section 3.1)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput

TERMS = {"c20": (2, 0), "c11": (1, 1), "c21": (2, 1), "c12": (1, 2), "c30": (3, 0)}
"""Powers of w and b of each term of the paper's polynomial."""

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: below it the blades stall and the cubic no longer fits."""

DIAMETER = 0.254
"""m: the 1045 propeller's 10 in."""

DENSITY = 1.225
"""kg/m^3: air at sea level, 15 degC."""


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

    def summary(self) -> dict:
        """For identification.json."""
        return {
            "coefficients": dict(self.coefficients),
            "std": self.std,
            "r2_adjusted": self.r2_adjusted,
            "rmse": self.rmse,
            "points": int(self.used.sum()),
        }

    def uncertainty(self, omega: np.ndarray, beta: np.ndarray, scales: Mapping[str, float]) -> np.ndarray:
        """Standard deviation [N] of the fitted map at speed [rpm] and pitch [deg], of the shape the two broadcast to.

        sqrt(a.T C a), a the terms at a point: what the coefficients' doubt is worth there. That the rig may differ from any
        such polynomial is in it only as far as the points' scatter tells; `scales` must be those of the fit.
        """
        omega, beta = np.broadcast_arrays(omega, beta)
        a = design(omega.ravel(), beta.ravel(), scales)
        variance = np.einsum("ni,ij,nj->n", a, self.covariance, a)
        return np.sqrt(variance).reshape(omega.shape) * scales["thrust_scale"]


@dataclass(frozen=True, eq=False)
class Regression:
    """What a fit of terms starts from: the points used, as mask (n,); of these, terms (points, terms), normalised thrust
    and weights (points,), one over the standard deviation of the normalised mean."""

    used: np.ndarray
    terms: np.ndarray
    thrust: np.ndarray
    weight: np.ndarray

    @property
    def total(self) -> float:
        """Variance of the thrust over the points, normalised: what adjusted R^2 compares with."""
        return float(np.var(self.thrust, ddof=1))


def design(
    omega: np.ndarray, beta: np.ndarray, scales: Mapping[str, float], terms: Iterable[tuple[int, int]] = tuple(TERMS.values())
) -> np.ndarray:
    """Columns (n, terms) w^i b^j of the map in normalised thrust, for speed [rpm] and pitch [deg], each (n,)."""
    w = omega / scales["omega_scale"]
    b = (beta + scales["beta_offset"]) / scales["beta_scale"]
    return np.column_stack([w**i * b**j for i, j in terms])


def regression(
    static: StaticMap,
    scales: Mapping[str, float],
    pitch: tuple[float, float] = OPERATING_PITCH,
    terms: Iterable[tuple[int, int]] = tuple(TERMS.values()),
) -> Regression:
    """The points with pitch inside `pitch` [deg], each weighing by how well its mean is known (`thrust_std`, `samples`)."""
    used = (static.beta_ref >= pitch[0]) & (static.beta_ref <= pitch[1])
    a = design(static.omega[used], static.beta_ref[used], scales, terms)
    error = np.maximum(static.thrust_std[used], 1e-3) / np.sqrt(static.samples[used])
    return Regression(used, a, static.thrust[used] / scales["thrust_scale"], scales["thrust_scale"] / error)


def fit_static_map(static: StaticMap, scales: Mapping[str, float], pitch: tuple[float, float] = OPERATING_PITCH) -> StaticFit:
    """Fit the paper's map to steady points with pitch inside `pitch` [deg].

    Each point weighs by how well its mean is known (`thrust_std`, `samples`). The points scatter around the polynomial by
    more than that, so the covariance is scaled to what they leave. `scales`: the parameters of the normalisation, by name.
    Adjusted R^2 is 1 - (sum of squares left / (n - k)) / (variance of the thrust), every point counting the same, as the
    paper's. BadInput where the points cannot tell the terms apart.
    """
    r = regression(static, scales, pitch)
    weighted = r.terms * r.weight[:, None]
    n, k = weighted.shape
    check_enough(static, pitch, n, k, int(np.linalg.matrix_rank(weighted)) if n else 0)
    c, *_ = np.linalg.lstsq(weighted, r.thrust * r.weight, rcond=None)
    left = r.thrust - r.terms @ c
    scatter = float((left * r.weight) @ (left * r.weight)) / (n - k)
    covariance = np.linalg.inv(weighted.T @ weighted) * scatter
    return StaticFit(
        coefficients=dict(zip(TERMS, c.tolist(), strict=True)),
        covariance=covariance,
        residual=left * scales["thrust_scale"],
        used=r.used,
        r2_adjusted=1.0 - float(left @ left) / (n - k) / r.total,
        rmse=float(np.sqrt(np.mean(left**2))) * scales["thrust_scale"],
    )


def check_enough(static: StaticMap, pitch: tuple[float, float], points: int, terms: int, rank: int) -> None:
    """BadInput where the points inside `pitch` [deg] are no more than the terms, or lie so that these cannot be told apart."""
    if points <= terms or rank < terms:
        found = f"{points} points from {pitch[0]:g} to {pitch[1]:g} deg that tell {rank} terms apart"
        allowed = f"more than {terms} points on a grid that tells {terms} terms apart"
        raise BadInput(static.source, "steady points", found, allowed)


def thrust_coefficient(
    thrust: np.ndarray, omega: np.ndarray, diameter: float = DIAMETER, density: float = DENSITY
) -> np.ndarray:
    """C_T = T / (rho n^2 D^4) [-] of thrust [N] at speed [rpm] above 0, n in rev/s (paper, section 4.1); they broadcast."""
    n = np.asarray(omega) / 60.0
    return thrust / (density * n**2 * diameter**4)


def coefficient_grid(
    static: StaticMap, diameter: float = DIAMETER, density: float = DENSITY
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commanded speeds (m,) [rpm], pitches (k,) [deg] and C_T (m, k) of all steady points; the mean where a point was
    measured more than once, NaN where never. C_T is that at the measured speed."""
    speeds, row = np.unique(static.omega_ref, return_inverse=True)
    pitches, column = np.unique(static.beta_ref, return_inverse=True)
    total, count = np.zeros((2, len(speeds), len(pitches)))
    np.add.at(total, (row, column), thrust_coefficient(static.thrust, static.omega, diameter, density))
    np.add.at(count, (row, column), 1.0)
    return speeds, pitches, np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
