"""The report's section on the static map: fit, residuals, uncertainty, and the number of readings that it needs."""

import numpy as np

from identification.identify import Identification
from identification.static.selection import Selection, select_terms
from identification.static.static_map import TERMS, StaticFit, coefficient_grid, design
from identification.static.steady import FEWEST, noise, resting, samples_needed
from vpp_fmu.campaign import StaticMap
from vpp_fmu.digits import number
from vpp_fmu.report import Page, map_lines, map_residuals, map_section
from vpp_fmu.report.coefficients import map_uncertainty, mean_convergence, thrust_coefficients

MEAN_STD = 1.0 / 1500.0
"""Required standard deviation of a steady point's mean, in thrust scales: the paper's 0.01 N of 15 N."""


def add_static(page: Page, found: Identification) -> None:
    """Figures and tables of the static map of an identification that has one."""
    static, points = found.static, found.campaign.static
    page.section("The static map")
    speeds, pitches = points.omega_ref[static.used], points.beta_ref[static.used]
    if np.ptp(speeds) > 0.0 and np.ptp(pitches) > 0.0:
        _add_grid(page, static, points, found.parameters.values)
    elif static.used.sum() > 1:
        _add_line(page, static, points, found.parameters.values)
    else:
        _add_point(page, static, points)
    if static.not_identifiable:
        where = f"{static.used.sum()} steady points at {_count(speeds, 'speed')} and {_count(pitches, 'pitch')}"
        page.note(
            f"{where} identify only combinations of {', '.join(static.not_identifiable)} with others: they stay near the "
            "paper's."
        )
    elif static.used.sum() > len(TERMS) and static.r2_adjusted is not None:
        _add_selection(page, select_terms(points, found.parameters.values))
    _add_samples(page, found)


def _count(values: np.ndarray, word: str) -> str:
    count = len(np.unique(values))
    return f"one {word}" if count == 1 else f"{count} {'pitches' if word == 'pitch' else 'speeds'}"


def _quality(static: StaticFit) -> str:
    return "" if static.r2_adjusted is None else f" (adjusted R² {static.r2_adjusted:.6f})"


def _add_grid(page: Page, static: StaticFit, points: StaticMap, scales) -> None:
    """The map over both commands."""
    omega, beta = np.linspace(points.omega_ref.min(), points.omega_ref.max(), 41), np.linspace(*static.pitch, 31)
    used = points.omega_ref[static.used], points.beta_ref[static.used], points.thrust[static.used]
    levels = np.unique(used[0])
    # One line for each commanded speed, at the mean measured speed, which may differ from the command.
    speeds = np.array([points.omega[static.used][used[0] == level].mean() for level in levels])
    thrust = _mapped(static, scales, *np.meshgrid(speeds, beta, indexing="ij"))
    title = f"A cubic fits {static.used.sum()} steady points to {number(static.rmse)} N{_quality(static)}"
    page.figure(
        map_lines(speeds, beta, thrust, (points.omega[static.used], *used[1:]), title), "Lines: fitted; points: measured."
    )
    largest = f"The largest residual of the cubic is {number(np.max(np.abs(static.residual)))} N"
    page.figure(map_residuals(*used[:2], static.residual, largest), "Measured minus fitted.")
    speeds, pitches, ct = coefficient_grid(points, 1.0, scales["thrust_scale"] / (scales["omega_scale"] / 60.0) ** 2)
    figure = thrust_coefficients(speeds, pitches, ct, _coefficients_say(pitches, ct, static.pitch), _COEFFICIENT)
    page.figure(figure, "Normalised; blades in their linear range give one line.")
    uncertainty = static.uncertainty(omega, beta[:, None], scales)
    title = f"The map's standard deviation is {number(uncertainty.max())} N or less in the measured range"
    page.figure(map_uncertainty(omega, beta, uncertainty, title), "Standard deviation from the coefficients' covariance.")


_COEFFICIENT = "thrust over speed squared, T / w² [-]"


def _mapped(static: StaticFit, scales, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Thrust [N] of the map at speeds [rpm] and pitches [deg] of equal shape."""
    normalised = design(omega.ravel(), beta.ravel(), scales) @ list(static.coefficients.values())
    return normalised.reshape(omega.shape) * scales["thrust_scale"]


def _add_line(page: Page, static: StaticFit, points: StaticMap, scales) -> None:
    """The map along the only varied command."""
    speeds, pitches = points.omega_ref[static.used], points.beta_ref[static.used]
    along_speed = np.ptp(speeds) > 0.0
    at = np.linspace(*((speeds.min(), speeds.max()) if along_speed else (pitches.min(), pitches.max())), 61)
    omega, beta = (at, np.full(61, pitches[0])) if along_speed else (np.full(61, speeds[0]), at)
    label, held = ("speed [rpm]", f"{number(pitches[0])} deg") if along_speed else ("pitch [deg]", f"{number(speeds[0])} rpm")
    title = f"At {held} the map fits {static.used.sum()} steady points to {number(static.rmse)} N{_quality(static)}"
    measured = (speeds if along_speed else pitches), points.thrust[static.used]
    band = static.uncertainty(omega, beta, scales)
    figure = map_section(at, _mapped(static, scales, omega, beta), measured, title, label, band)
    page.figure(figure, f"All steady points are at {held}: they do not identify the influence of that command.")


def _add_point(page: Page, static: StaticFit, points: StaticMap) -> None:
    k = int(np.flatnonzero(static.used)[0])
    row = (points.omega_ref[k], points.beta_ref[k], points.thrust[k], points.thrust_std[k])
    columns = ("speed [rpm]", "pitch [deg]", "thrust [N]", "std of a reading [N]")
    page.table(columns, [row], "The only steady point: it determines one thrust, and no map.")


def _coefficients_say(pitches: np.ndarray, ct: np.ndarray, fitted: tuple[float, float]) -> str:
    """Change of thrust over speed squared (speeds, pitches) with speed and pitch, inside the `fitted` range [deg]."""
    inside = ct[:, (pitches >= fitted[0]) & (pitches <= fitted[1]) & np.isfinite(ct).any(axis=0)]
    with_pitch = float(np.ptp(np.nanmean(inside, axis=0)))
    with_speed = float(np.sqrt(np.nanmean(np.nanvar(inside, axis=0))))
    return f"Thrust over speed squared changes by {number(with_pitch)} with pitch, and by {number(with_speed)} rms with speed"


def _add_selection(page: Page, chosen: Selection) -> None:
    rank = chosen.rank(chosen.of(), "bic") if chosen.of() else None
    papers = "these points do not identify the paper's" if rank is None else f"the paper's set has rank {rank} of its size"
    rows = [(size, name, f"{bic:.1f}", f"{r2:.6f}", loo) for size, name, bic, r2, loo in chosen.rows()]
    columns = ("terms", "best set", "BIC", "adjusted R²", "leave-one-out rmse [N]")
    page.table(columns, rows, f"The best of each number of terms w^i b^j; {papers}.")


def _add_samples(page: Page, found: Identification) -> None:
    record, repeat, raw = found.campaign.open_loop, found.campaign.repeat, found.campaign.static_raw
    if raw is not None and (still := resting(raw)):
        readings, source = noise(still), "the raw samples of the steady points, minus each point's mean"
    elif record is not None and repeat is not None:
        readings, source = (record["thrust"] - repeat["thrust"]) / np.sqrt(2.0), "the difference of the repeated records"
    else:
        return
    readings, wanted = readings[np.isfinite(readings)], MEAN_STD * found.parameters.values["thrust_scale"]
    if len(readings) < FEWEST or np.ptp(readings) == 0.0:
        return
    need = samples_needed(readings, wanted)
    title = f"A steady point needs {need.number} readings for a mean with a standard deviation of {number(wanted, 2)} N"
    note = f"One reading in {number(max(1.0, need.inflation), 2)} is independent, because neighbours share noise"
    if not need.settled:
        note = "The noise is slower than the record is long: the number is too small"
    caption = f"Standard deviation of a mean over m readings, from {source}. {note}."
    page.figure(mean_convergence(need.m, need.std, need.white, title, (need.number, wanted)), caption)
