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
"""Level of the F test that rejects the map over all measured pitch in favour of the pitch range of the records."""

WIDE = 10.0
"""Prior standard deviation of a normalised coefficient: the bounds of the thrust map's parameters."""

FINEST = 1e-4
"""Minimum standard deviation of the mean of a steady point, in thrust scales."""

ROUNDING = 1e-8
"""Minimum residual variance over that of the means: a smaller one is rounding error, of computed or equal points."""


@dataclass(frozen=True)
class StaticFit:
    """A fitted map: coefficients by name (normalised), covariance (terms, terms), residuals, and quality of fit.

    `used` (n,): the points of the campaign with pitch inside `pitch` [deg]; `residual` (points used,) N, measured minus fitted.
    `not_identifiable`: coefficients that are not identifiable, such as the pitch's at a single pitch.
    """

    coefficients: Mapping[str, float]
    covariance: np.ndarray
    residual: np.ndarray
    used: np.ndarray
    r2_adjusted: float | None
    rmse: float
    pitch: tuple[float, float]
    not_identifiable: tuple[str, ...] = ()

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
            "not_identifiable": list(self.not_identifiable),
        }


@dataclass(frozen=True, eq=False)
class Regression:
    """Data of a fit: the points used, as mask (n,); their terms (points, terms), normalised thrust and weights (points,), one
    over the standard deviation of the normalised mean."""

    used: np.ndarray
    terms: np.ndarray
    thrust: np.ndarray
    weight: np.ndarray

    @property
    def total(self) -> float:
        """Variance of the thrust over the points, normalised: the reference of adjusted R^2."""
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
    """The points with pitch inside `pitch` [deg] (None: all), weighted by the standard error of their means (`thrust_std`,
    `samples`)."""
    low, high = pitch or (-np.inf, np.inf)
    used = (static.beta_ref >= low) & (static.beta_ref <= high)
    a = design(static.omega[used], static.beta_ref[used], scales, terms)
    error = np.maximum(static.thrust_std[used], FINEST * scales["thrust_scale"]) / np.sqrt(static.samples[used])
    return Regression(used, a, static.thrust[used] / scales["thrust_scale"], scales["thrust_scale"] / error)


def static_fit(campaign: Campaign, scales: Mapping[str, float]) -> StaticFit | None:
    """The map of a campaign's steady points; None without points.

    It covers all measured pitch, unless the residual variance there is larger than over the pitch range of the campaign's
    records (F test at the level ALIKE), for example because blades stall outside it. Then it covers that range.
    """
    static = campaign.static
    if static is None:
        return None
    whole, commanded = fit_static_map(static, scales), _commanded_pitch(campaign)
    if commanded is None:
        return whole
    inside = (static.beta_ref >= commanded[0]) & (static.beta_ref <= commanded[1])
    degrees = int(inside.sum()) - len(TERMS)
    if inside.all() or degrees < 1 or whole.not_identifiable:
        return whole
    part = fit_static_map(static, scales, commanded)
    more = _scatter(static, scales, whole) / _scatter(static, scales, part)
    return (
        part
        if f_distribution.sf(more, len(whole.residual) - len(TERMS), degrees) < ALIKE and not part.not_identifiable
        else whole
    )


def _commanded_pitch(campaign: Campaign) -> tuple[float, float] | None:
    """Range of the pitch command [deg] of the campaign's fitted records."""
    records = [r for r in (campaign.open_loop, campaign.repeat, *campaign.steps) if r is not None]
    if not records:
        return None
    return min(float(r["beta_ref"].min()) for r in records), max(float(r["beta_ref"].max()) for r in records)


def _scatter(static: StaticMap, scales: Mapping[str, float], fit: StaticFit) -> float:
    """Weighted residual sum of squares of a fit per degree of freedom."""
    weight = regression(static, scales, fit.pitch).weight / scales["thrust_scale"]
    return max(float((fit.residual * weight) @ (fit.residual * weight)) / (len(fit.residual) - len(TERMS)), ROUNDING)


def fit_static_map(static: StaticMap, scales: Mapping[str, float], pitch: tuple[float, float] | None = None) -> StaticFit:
    """Fit the paper's map to steady points with pitch inside `pitch` [deg]; None: all of them.

    Each point is weighted by the standard error of its mean (`thrust_std`, `samples`). The points scatter more around the
    polynomial, so the covariance is scaled by the residual variance. `scales`: the parameters of the normalisation, by name.
    Adjusted R^2 is 1 - (residual sum of squares / (n - k)) / (variance of the thrust), unweighted, as in the paper. If the
    points do not identify all terms, the coefficients are the nearest to the paper's, and the covariance is as wide as their
    bounds in directions that are not identifiable. BadInput without any point.
    """
    r = regression(static, scales, pitch)
    weighted = r.terms * r.weight[:, None]
    n, k = weighted.shape
    if n == 0:
        raise BadInput(static.source, "steady points", f"none from {pitch[0]:g} to {pitch[1]:g} deg", "at least one point")
    rank = int(np.linalg.matrix_rank(weighted))
    c, covariance = (_determined if n > k == rank else _nearest)(weighted, r.thrust * r.weight, n - rank)
    residual = r.thrust - r.terms @ c
    spread = np.sqrt(np.diag(covariance))
    return StaticFit(
        coefficients=dict(zip(TERMS, c.tolist(), strict=True)),
        covariance=covariance,
        residual=residual * scales["thrust_scale"],
        used=r.used,
        r2_adjusted=1.0 - float(residual @ residual) / (n - rank) / r.total if n > max(rank, 1) and r.total > 0.0 else None,
        rmse=float(np.sqrt(np.mean(residual**2))) * scales["thrust_scale"],
        pitch=(float(static.beta_ref[r.used].min()), float(static.beta_ref[r.used].max())),
        not_identifiable=tuple(name for name, std in zip(TERMS, spread, strict=True) if std > UNKNOWN),
    )


def _determined(weighted: np.ndarray, thrust: np.ndarray, degrees: int) -> tuple[np.ndarray, np.ndarray]:
    """(coefficients, covariance) if the points identify all of them."""
    c, *_ = np.linalg.lstsq(weighted, thrust, rcond=None)
    residual = thrust - weighted @ c
    return c, np.linalg.inv(weighted.T @ weighted) * max(float(residual @ residual) / degrees, ROUNDING)


def _nearest(weighted: np.ndarray, thrust: np.ndarray, degrees: int) -> tuple[np.ndarray, np.ndarray]:
    """The same if they do not: with the paper's coefficients as prior, of standard deviation WIDE."""
    usual = np.array([FINE_TUNED[name] for name in TERMS])
    c, *_ = np.linalg.lstsq(weighted, thrust - weighted @ usual, rcond=1e-10)
    residual = thrust - weighted @ (usual + c)
    scatter = max(1.0, float(residual @ residual) / degrees) if degrees > 0 else 1.0
    return usual + c, np.linalg.inv(weighted.T @ weighted / scatter + np.eye(len(c)) / WIDE**2)
