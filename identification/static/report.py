"""The report's section on the static map: how it fits, what it leaves, how well it is known, how many readings it needs."""

import numpy as np

from identification.identify import Identification
from identification.static.selection import Selection, select_terms
from identification.static.static_map import coefficient_grid, design
from identification.static.steady import noise, samples_needed, stretches
from vpp_fmu.report import Page, map_residuals, map_surface
from vpp_fmu.report.coefficients import map_uncertainty, mean_convergence, thrust_coefficients

MEAN_STD = 0.01
"""N; how well a steady point's mean shall be known."""


def add_static(page: Page, found: Identification) -> None:
    """Figures and tables of the static map of an identification that has one."""
    static, points = found.static, found.campaign.static
    page.section("The static map")
    scales = found.refinement.values
    omega, beta = np.linspace(points.omega_ref.min(), points.omega_ref.max(), 41), np.linspace(*static.pitch, 31)
    grid_omega, grid_beta = np.meshgrid(omega, beta)
    thrust = design(grid_omega.ravel(), grid_beta.ravel(), scales) @ list(static.coefficients.values()) * scales["thrust_scale"]
    used = points.omega[static.used], points.beta_ref[static.used], points.thrust[static.used]
    title = f"A cubic fits {static.used.sum()} steady points to {static.rmse:.3f} N (adjusted R² {static.r2_adjusted:.6f})"
    page.figure(map_surface(omega, beta, thrust.reshape(grid_omega.shape), used, title), "Surface: fitted; points: measured.")
    left = f"What the cubic leaves stays below {np.max(np.abs(static.residual)):.3f} N"
    commanded = points.omega_ref[static.used], used[1]
    page.figure(map_residuals(*commanded, static.residual, left), "Measured less fitted.")
    speeds, pitches, ct = coefficient_grid(points)
    page.figure(thrust_coefficients(speeds, pitches, ct, _coefficients_say(pitches, ct, static.pitch)), _COEFFICIENT)
    doubt = static.uncertainty(omega, beta[:, None], scales)
    title = f"The map is known to {doubt.max():.3f} N or better where it was measured"
    page.figure(map_uncertainty(omega, beta, doubt, title), "Standard deviation from the coefficients' covariance.")
    _add_selection(page, select_terms(points, scales))
    _add_samples(page, found)


_COEFFICIENT = "C_T = T / (ρ n² D⁴), 10 inch propeller, air at sea level; blades in their linear range draw one line."


def _coefficients_say(pitches: np.ndarray, ct: np.ndarray, fitted: tuple[float, float]) -> str:
    """What C_T (speeds, pitches) depends on, inside the `fitted` range [deg]."""
    inside = ct[:, (pitches >= fitted[0]) & (pitches <= fitted[1])]
    with_pitch = float(np.ptp(np.nanmean(inside, axis=0)))
    with_speed = float(np.sqrt(np.nanmean(np.nanvar(inside, axis=0))))
    return f"C_T moves by {with_pitch:.2f} with pitch, and by {with_speed:.3f} rms with speed"


def _add_selection(page: Page, chosen: Selection) -> None:
    rank = chosen.rank(chosen.of(), "bic") if chosen.of() else None
    papers = "these points cannot tell the paper's apart" if rank is None else f"the paper's are number {rank} of their size"
    rows = [(size, name, bic, f"{r2:.6f}", loo) for size, name, bic, r2, loo in chosen.rows()]
    columns = ("terms", "best set", "BIC", "adjusted R²", "leave-one-out rmse [N]")
    page.table(columns, rows, f"The best of each number of terms w^i b^j; {papers}.")


def _add_samples(page: Page, found: Identification) -> None:
    record, repeat, raw = found.campaign.open_loop, found.campaign.repeat, found.campaign.static_raw
    if raw is not None:
        readings, source = noise(stretches(raw)), "the raw samples of the steady points, each less its point's mean"
    elif record is not None and repeat is not None:
        readings, source = (record["thrust"] - repeat["thrust"]) / np.sqrt(2.0), "the difference of the repeated records"
    else:
        return
    need = samples_needed(readings, MEAN_STD)
    title = f"A steady point needs {need.number} readings for a mean that is good to {MEAN_STD} N"
    worth = f"One reading in {max(1.0, need.inflation):.1f} counts, since neighbours share noise"
    if not need.settled:
        worth = "The readings wander more slowly than their record is long: the number is too small"
    caption = f"Standard deviation of a mean over m readings, from {source}. {worth}."
    page.figure(mean_convergence(need.m, need.std, need.white, title, (need.number, MEAN_STD)), caption)
