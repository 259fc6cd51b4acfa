"""The static characterisation in the paper's own units, beside the paper's polynomial (sections 3.1 and 4.1)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.static.static_map import StaticFit, design, fit_static_map, thrust_coefficient
from vpp_fmu.campaign import StaticMap
from vpp_fmu.paper.published import R2_ADJUSTED, STATIC_MAP

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: below it the blades stall and the cubic no longer fits."""

PAPER_UNITS = {"omega_scale": 1.0, "beta_offset": 0.0, "beta_scale": 1.0, "thrust_scale": 1.0}
"""A map in rpm, deg and N."""


def paper_thrust(omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Thrust (n,) N by the paper's static map, of speed (n,) rpm and pitch (n,) deg."""
    return design(np.asarray(omega, float), np.asarray(beta, float), PAPER_UNITS) @ np.array(list(STATIC_MAP.values()))


@dataclass(frozen=True, eq=False)
class Statics:
    """`rig`: the paper's fit to the rig's points; `model`: the same fit to the paper's own polynomial at these points, with the
    rig's noise. `apart` (points used,) N: the rig less the paper's polynomial. `r2_of_paper`: adjusted R² of that polynomial,
    as it stands, on the rig's points. `scatter` N: what the paper's R² leaves on its own surface. `mean_std` N: uncertainty of
    a mean of that many white readings. `held` N: what a fit leaves, rms, that holds one coefficient at the paper's value.
    `ct_by_speed`: rms change of C_T with speed, of the rig and of the paper's polynomial; `ct_by_pitch`: its range over the
    pitch.
    """

    points: StaticMap
    rig: StaticFit
    model: StaticFit
    apart: np.ndarray
    r2_of_paper: float
    scatter: float
    mean_std: float
    held: Mapping[str, float]
    ct_by_speed: tuple[float, float]
    ct_by_pitch: tuple[float, float]

    @property
    def apart_rms(self) -> float:
        """N."""
        return float(np.sqrt(np.mean(self.apart**2)))


def statics(points: StaticMap, seed: int) -> Statics:
    """Hold the steady points of a campaign against the paper's static map."""
    rng, error = np.random.default_rng([seed, 3]), points.thrust_std / np.sqrt(points.samples)
    on_paper = paper_thrust(points.omega, points.beta_ref)
    fit = fit_static_map(points, PAPER_UNITS, OPERATING_PITCH)
    used, n, k = fit.used, int(fit.used.sum()), len(STATIC_MAP)
    measured, papers = points.thrust[used], on_paper[used]
    squares = float(np.sum((measured - papers) ** 2))
    noisy = replace(points, thrust=on_paper + error * rng.standard_normal(len(error)))
    ct = [_ct(points, used, thrust) for thrust in (points.thrust, on_paper)]
    return Statics(
        points=points,
        rig=fit,
        model=fit_static_map(noisy, PAPER_UNITS, OPERATING_PITCH),
        apart=measured - papers,
        r2_of_paper=1.0 - squares / (n - k) / float(np.var(measured, ddof=1)),
        scatter=float(np.sqrt((1.0 - R2_ADJUSTED) * np.var(papers, ddof=1))),
        mean_std=float(error[used].mean()),
        held={name: _held(points, used, name) for name in STATIC_MAP},
        ct_by_speed=tuple(speed for speed, _ in ct),
        ct_by_pitch=tuple(pitch for _, pitch in ct),
    )


def _held(points: StaticMap, used: np.ndarray, name: str) -> float:
    """What is left [N rms] of the thrust by a map whose coefficient `name` is the paper's."""
    terms, k = design(points.omega[used], points.beta_ref[used], PAPER_UNITS), list(STATIC_MAP).index(name)
    wanted, others = points.thrust[used] - STATIC_MAP[name] * terms[:, k], np.delete(terms, k, axis=1)
    others = others / np.abs(others).max(axis=0)
    found, *_ = np.linalg.lstsq(others, wanted, rcond=None)
    return float(np.sqrt(np.mean((wanted - others @ found) ** 2)))


def _ct(points: StaticMap, used: np.ndarray, thrust: np.ndarray) -> tuple[float, float]:
    """(rms change with speed, range over pitch) of the thrust coefficient in the operating region."""
    ct, pitch = thrust_coefficient(thrust, points.omega)[used], points.beta_ref[used]
    groups = [ct[pitch == b] for b in np.unique(pitch)]
    return float(np.sqrt(np.mean([np.var(group) for group in groups]))), float(np.ptp([group.mean() for group in groups]))
