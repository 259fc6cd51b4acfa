"""The report of an identification: what was found, how good it is, what it rests on."""

import numpy as np

from identification.identify import Identification, Prediction
from identification.map_selection import select_terms
from identification.static_map import coefficient_grid, design
from identification.steady import samples_needed
from vpp_fmu.report import (
    Page,
    autocorrelation,
    correlation_heatmap,
    cross_correlation,
    learning_curve,
    map_residuals,
    map_surface,
    measured_against_predicted,
    parameter_change,
    thinning,
)
from vpp_fmu.report.coefficients import map_uncertainty, mean_convergence, thrust_coefficients
from vpp_fmu.report.steps import step_responses


def key_figures(found: Identification) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    figures = []
    for name, p in found.predictions.items():
        role = "fitted" if name == "open_loop" else "not used to fit"
        figures.append(
            (f"thrust error, {name}", f"{p.rmse_thrust:.3f} N", f"rmse, fit {p.summary()['fit_thrust']:.1f} %, {role}")
        )
    if found.noise_floor is not None:
        figures.append(("noise of one reading", f"{found.noise_floor:.3f} N", "from the repeated record"))
    r = found.refinement
    figures.append(
        (
            "cost",
            f"{r.cost_start:.3g} → {r.cost_final:.3g}",
            f"mean(e²)/2, {r.evaluations} evaluations, {r.starts} starts, {r.seconds:.2f} s",
        )
    )
    if found.static is not None:
        figures.append(("static map", f"{found.static.r2_adjusted:.4f}", f"adjusted R², {found.static.rmse:.3f} N rms"))
    return figures


def identification_page(found: Identification) -> Page:
    """The page of one identification."""
    page = Page("Identification", f"Campaign {found.campaign.folder.name}: from measured records to the plant's parameters.")
    add_identification(page, found)
    return page


def add_identification(page: Page, found: Identification) -> None:
    """Tiles, figures and tables of an identification, onto a page."""
    page.tiles(key_figures(found))
    for missing in found.campaign.missing:
        page.note(f"{missing} is missing: what it would have told is left out.")
    for left_out in found.left_out:
        page.note(f"open_loop.csv: {left_out}.")
    page.section("How well the model predicts")
    for name, p in found.predictions.items():
        page.figure(
            _record_figure(name, p, found.noise_floor),
            f"{name}.csv of campaign {found.campaign.folder.name}. {thinning(len(p.record))}",
        )
    _add_sections(page, found)
    _add_tests(page, found)
    page.section("What was found")
    r, doubt = found.refinement, found.refinement.uncertainty
    start, (low, high) = np.array([found.start[n] for n in r.names]), doubt.intervals.T
    moved = "Fine-tuning moves the parameters from steps and static map to what the record asks for"
    page.figure(parameter_change(r.names, start, doubt.values, low, high, moved), "Change in % of the start, 95 % intervals.")
    rows = list(zip(r.names, start, doubt.values, doubt.std, low, high, doubt.inflation, strict=True))
    columns = ("parameter", "start", "final", "std", "95 % from", "to", "std over white")
    page.table(columns, rows, "Time constants in s, coefficients normalised; std accounts for the residuals' colour.")
    for name, why in r.held.items():
        page.note(f"{name} is held at {r.values[name]:.4g}: {why}.")
    curve = np.array(r.curve)
    fall = f"The search's cost falls to {curve[-1] / curve[0]:.1%} in {len(curve) - 1} steps"
    page.figure(
        learning_curve(np.arange(len(curve)), curve, fall), "Half the weighted sum of squares, under the first weights."
    )
    correlation = doubt.correlation
    apart = _strongest(r.names, correlation)
    page.figure(correlation_heatmap(r.names, correlation, apart), "Correlation of the estimates.")
    if found.static is not None:
        _add_static(page, found)
    if found.steps is not None:
        _add_steps(page, found)


def _add_tests(page: Page, found: Identification) -> None:
    tests, outside = found.tests, found.tests.outside
    title = f"The residual remembers itself at {outside['itself']:.0%} of the lags; chance gives 5 %"
    page.figure(
        autocorrelation(tests.lags, tests.own, tests.band, title), "Thrust residual of open_loop.csv, means over 20 ms."
    )
    if tests.crossed:
        worst = max((n for n in outside if n != "itself"), key=outside.get)
        title = f"Changes of {worst} show in the residual at {outside[worst]:.0%} of the lags"
        figure = cross_correlation(tests.lags, tests.crossed, tests.band, title)
        page.figure(figure, "The residual against the changes of each command before it.")


def _add_steps(page: Page, found: Identification) -> None:
    steps = found.steps
    page.section("The step responses")
    for channel, unit, level in (("omega", "rpm", "deg"), ("beta", "deg", "rpm")):
        runs = [run for run in steps.runs if run.channel == channel]
        if runs:
            slow, fast = (steps.start.get(f"tau_{channel}_{k}") for k in (1, 2))
            kept = sum(not run.reason for run in runs)
            lags = "" if slow is None else f": lags of {slow:.3f} and {fast:.3f} s on average"
            title = f"{kept} of {len(runs)} steps of {'speed' if channel == 'omega' else 'pitch'} count{lags}"
            figure = step_responses(runs, title, unit, level, steps.delayed(channel))
            page.figure(figure, "Thrust as a share of the step; black: two lags through the static map.")
    rows = [(run.source.rsplit("/", 1)[-1], run.reason) for run in steps.outliers]
    if rows:
        page.table(("run", "left out because"), rows, "Runs that tell nothing of the lags.")


def _record_figure(name: str, p: Prediction, noise: float | None):
    beside = "" if noise is None else f"; the noise alone is {noise:.3f} N"
    used = "the record it was fitted to" if name == "open_loop" else "a record it has never seen"
    title = f"The model predicts {used} to {p.rmse_thrust:.3f} N{beside}"
    commands = {n: p.record[n] for n in ("omega_ref", "beta_ref")}
    return measured_against_predicted(
        p.record.time, p.record["thrust"], {"model": p.thrust}, title, commands=commands, noise=noise
    )


def _add_sections(page: Page, found: Identification) -> None:
    rows = [
        (name, section, figures["rmse_thrust"], figures["fit_thrust"])
        for name, p in found.predictions.items()
        for section, figures in p.summary()["sections"].items()
    ]
    page.table(("record", "section", "rmse [N]", "fit [%]"), rows, "Thrust error by what is commanded.")
    shares = ", ".join(f"{name} {share:.1%}" for name, share in found.coverage.items())
    page.note(f"Readings within the prediction's 95 % band: {shares}.")


def _strongest(names, correlation) -> str:
    pairs = np.abs(np.triu(correlation, 1))
    i, j = np.unravel_index(np.argmax(pairs), pairs.shape)
    return f"{names[i]} and {names[j]} are the hardest to tell apart: correlation {correlation[i, j]:.2f}"


def _add_static(page: Page, found: Identification) -> None:
    static, points = found.static, found.campaign.static
    page.section("The static map")
    scales = found.refinement.values
    omega, beta = np.linspace(2000, 6000, 41), np.linspace(-5, 10, 31)
    grid_omega, grid_beta = np.meshgrid(omega, beta)
    coefficients = np.array([static.coefficients[n] for n in static.coefficients])
    thrust = design(grid_omega.ravel(), grid_beta.ravel(), scales) @ coefficients * scales["thrust_scale"]
    used = points.omega[static.used], points.beta_ref[static.used], points.thrust[static.used]
    title = f"A cubic fits {static.used.sum()} steady points to {static.rmse:.3f} N (adjusted R² {static.r2_adjusted:.4f})"
    page.figure(map_surface(omega, beta, thrust.reshape(grid_omega.shape), used, title), "Surface: fitted; points: measured.")
    left = f"What the cubic leaves stays below {np.max(np.abs(static.residual)):.3f} N"
    commanded = points.omega_ref[static.used], used[1]
    page.figure(map_residuals(*commanded, static.residual, left), "Measured less fitted.")
    page.figure(thrust_coefficients(*coefficient_grid(points), COEFFICIENT), "C_T = T / (ρ n² D⁴), 10 inch propeller.")
    doubt = static.uncertainty(omega, beta[:, None], scales)
    title = f"The map is known to {doubt.max():.3f} N or better where it was measured"
    page.figure(map_uncertainty(omega, beta, doubt, title), "Standard deviation from the coefficients' covariance.")
    chosen = select_terms(points, scales)
    caption = (
        f"The best of each number of terms w^i b^j; the paper's are number {chosen.rank(chosen.of(), 'bic')} of their size."
    )
    page.table(("terms", "best set", "BIC", "adjusted R²", "leave-one-out rmse [N]"), chosen.rows(), caption)
    _add_samples(page, found)


COEFFICIENT = "C_T over pitch hardly depends on speed: the blades work in their linear range"

MEAN_STD = 0.01
"""N; how well a steady point's mean shall be known."""


def _add_samples(page: Page, found: Identification) -> None:
    record, repeat = found.campaign.open_loop, found.campaign.repeat
    if repeat is None:
        return
    noise = (record["thrust"] - repeat["thrust"]) / np.sqrt(2.0)
    need = samples_needed(noise[np.isfinite(noise)], MEAN_STD)
    title = f"A steady point needs {need.number} readings for a mean that is good to {MEAN_STD} N"
    page.figure(mean_convergence(need.m, need.std, need.white, title), "Standard deviation of a mean over m readings.")
