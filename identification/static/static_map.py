"""The static thrust map by weighted least squares (paper, eq. 8 and section 3.1)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from identification.fit.identifiability import UNKNOWN
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import FINE_TUNED

TERMS = {"c20": (2, 0), "c11": (1, 1), "c21": (2, 1), "c12": (1, 2), "c30": (3, 0)}
"""Powers of w and b of each term of the paper's polynomial."""

ALIKE = 0.01
"""Level of the F test that takes the map over all measured pitch for worse than over the pitch that records use: so often a map
that fits everywhere is cut down to these."""

WIDE = 10.0
"""Standard deviation of a normalised coefficient before anything was measured: the bounds of the thrust map's parameters."""

FINEST = 1e-4
"""Share of the thrust scale that the mean of a steady point is never known better than."""

ROUNDING = 1e-8
"""Variance of what a fit leaves, in those of the means, that is rounding: of points that were made up, or are all the same."""

DIAMETER = 0.254
"""m: the 1045 propeller's 10 in."""

DENSITY = 1.225
"""kg/m^3: air at sea level, 15 degC."""


@dataclass(frozen=True)
class StaticFit:
    """A fitted map: coefficients by name (normalised), covariance (terms, terms), what it leaves, and how well it fits.

    `used` (n,): the points of the campaign with pitch inside `pitch` [deg]; `residual` (points used,) N, measured less fitted.
    `untold`: coefficients that the points do not tell by themselves, such as the pitch's at a single pitch.
    """

    coefficients: Mapping[str, float]
    covariance: np.ndarray
    residual: np.ndarray
    used: np.ndarray
    r2_adjusted: float | None
    rmse: float
    pitch: tuple[float, float]
    untold: tuple[str, ...] = ()

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
            "pitch": list(self.pitch),
            "not_identifiable": list(self.untold),
        }

    def uncertainty(self, omega: np.ndarray, beta: np.ndarray, scales: Mapping[str, float]) -> np.ndarray:
        """Standard deviation [N] of the fitted map at speed [rpm] and pitch [deg], of the shape the two broadcast to.

        sqrt(a.T C a), a the terms at a point: what the coefficients' uncertainty is worth there. That the rig may differ from
        any such polynomial is in it only as far as the points' scatter tells; `scales` must be those of the fit.
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
    pitch: tuple[float, float] | None = None,
    terms: Iterable[tuple[int, int]] = tuple(TERMS.values()),
) -> Regression:
    """The points with pitch inside `pitch` [deg] (None: all), each weighing by how well its mean is known (`thrust_std`,
    `samples`)."""
    low, high = pitch or (-np.inf, np.inf)
    used = (static.beta_ref >= low) & (static.beta_ref <= high)
    a = design(static.omega[used], static.beta_ref[used], scales, terms)
    error = np.maximum(static.thrust_std[used], FINEST * scales["thrust_scale"]) / np.sqrt(static.samples[used])
    return Regression(used, a, static.thrust[used] / scales["thrust_scale"], scales["thrust_scale"] / error)


def static_fit(campaign: Campaign, scales: Mapping[str, float]) -> StaticFit | None:
    """The map of a campaign's steady points; None where it has none.

    Over all measured pitch, unless there the polynomial leaves more than over the pitch that the campaign's records use (F test
    of the two fits' scatter at the level ALIKE): blades that stall beyond it are then no matter of this map.
    """
    static = campaign.static
    if static is None:
        return None
    whole, commanded = fit_static_map(static, scales), _commanded_pitch(campaign)
    if commanded is None:
        return whole
    inside = (static.beta_ref >= commanded[0]) & (static.beta_ref <= commanded[1])
    spare = int(inside.sum()) - len(TERMS)
    if inside.all() or spare < 1 or whole.untold:
        return whole
    part = fit_static_map(static, scales, commanded)
    more = _scatter(static, scales, whole) / _scatter(static, scales, part)
    return part if f_distribution.sf(more, len(whole.residual) - len(TERMS), spare) < ALIKE and not part.untold else whole


def _commanded_pitch(campaign: Campaign) -> tuple[float, float] | None:
    """Least and greatest pitch [deg] that the campaign's fitted records command."""
    records = [r for r in (campaign.open_loop, campaign.repeat, *campaign.steps) if r is not None]
    if not records:
        return None
    return min(float(r["beta_ref"].min()) for r in records), max(float(r["beta_ref"].max()) for r in records)


def _scatter(static: StaticMap, scales: Mapping[str, float], fit: StaticFit) -> float:
    """Mean square of what a fit leaves at its points, in their standard deviations, per degree of freedom."""
    weight = regression(static, scales, fit.pitch).weight / scales["thrust_scale"]
    return max(float((fit.residual * weight) @ (fit.residual * weight)) / (len(fit.residual) - len(TERMS)), ROUNDING)


def fit_static_map(static: StaticMap, scales: Mapping[str, float], pitch: tuple[float, float] | None = None) -> StaticFit:
    """Fit the paper's map to steady points with pitch inside `pitch` [deg]; None: all of them.

    Each point weighs by how well its mean is known (`thrust_std`, `samples`). The points scatter around the polynomial by
    more than that, so the covariance is scaled to what they leave. `scales`: the parameters of the normalisation, by name.
    Adjusted R^2 is 1 - (sum of squares left / (n - k)) / (variance of the thrust), every point counting the same, as the
    paper's. Points that cannot tell all terms apart tell what they can: the coefficients are then those nearest to the paper's,
    and the covariance is as wide as their bounds where nothing was told. BadInput without any point.
    """
    r = regression(static, scales, pitch)
    weighted = r.terms * r.weight[:, None]
    n, k = weighted.shape
    if n == 0:
        raise BadInput(static.source, "steady points", f"none from {pitch[0]:g} to {pitch[1]:g} deg", "at least one point")
    rank = int(np.linalg.matrix_rank(weighted))
    c, covariance = (_determined if n > k == rank else _nearest)(weighted, r.thrust * r.weight, n - rank)
    left = r.thrust - r.terms @ c
    spread = np.sqrt(np.diag(covariance))
    return StaticFit(
        coefficients=dict(zip(TERMS, c.tolist(), strict=True)),
        covariance=covariance,
        residual=left * scales["thrust_scale"],
        used=r.used,
        r2_adjusted=1.0 - float(left @ left) / (n - rank) / r.total if n > max(rank, 1) and r.total > 0.0 else None,
        rmse=float(np.sqrt(np.mean(left**2))) * scales["thrust_scale"],
        pitch=(float(static.beta_ref[r.used].min()), float(static.beta_ref[r.used].max())),
        untold=tuple(name for name, std in zip(TERMS, spread, strict=True) if std > UNKNOWN),
    )


def _determined(weighted: np.ndarray, thrust: np.ndarray, spare: int) -> tuple[np.ndarray, np.ndarray]:
    """(coefficients, covariance) where the points tell all of them."""
    c, *_ = np.linalg.lstsq(weighted, thrust, rcond=None)
    left = thrust - weighted @ c
    return c, np.linalg.inv(weighted.T @ weighted) * max(float(left @ left) / spare, ROUNDING)


def _nearest(weighted: np.ndarray, thrust: np.ndarray, spare: int) -> tuple[np.ndarray, np.ndarray]:
    """The same where they do not: from coefficients like the paper's, known to WIDE beforehand."""
    usual = np.array([FINE_TUNED[name] for name in TERMS])
    c, *_ = np.linalg.lstsq(weighted, thrust - weighted @ usual, rcond=1e-10)
    left = thrust - weighted @ (usual + c)
    scatter = max(1.0, float(left @ left) / spare) if spare > 0 else 1.0
    return usual + c, np.linalg.inv(weighted.T @ weighted / scatter + np.eye(len(c)) / WIDE**2)


def check_enough(static: StaticMap, points: int, terms: int, rank: int) -> None:
    """BadInput where the points are no more than the terms, or lie so that these cannot be told apart."""
    if points <= terms or rank < terms:
        found = f"{points} points that tell {rank} terms apart"
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
    measured more than once, NaN where never or at standstill. C_T is that at the measured speed."""
    speeds, row = np.unique(static.omega_ref, return_inverse=True)
    pitches, column = np.unique(static.beta_ref, return_inverse=True)
    total, count = np.zeros((2, len(speeds), len(pitches)))
    turns = static.omega > 0.0
    cell = row[turns], column[turns]
    np.add.at(total, cell, thrust_coefficient(static.thrust[turns], static.omega[turns], diameter, density))
    np.add.at(count, cell, 1.0)
    return speeds, pitches, np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
