"""The report of an identification: parameters, errors of prediction, tests, static map and step responses."""

from identification.found_report import add_found
from identification.gate.report import add_quality, quality_tile
from identification.identify import Identification
from identification.static.report import add_static
from vpp_fmu.digits import number
from vpp_fmu.report import (
    Page,
    autocorrelation,
    cross_correlation,
    measured_against_predicted,
    thinning,
)
from vpp_fmu.report.steps import step_responses


def key_figures(found: Identification) -> list[tuple[str, str, str]]:
    """(label, value, note) of the figures of the first screen."""
    figures = [quality_tile(found.quality)] if found.quality else []
    for name in _shown(found):
        p, role = found.predictions[name], "fitted" if name in found.fitted else "not used to fit"
        fit = "" if p.fit_thrust is None else f", fit {p.fit_thrust:.1f} %"
        figures.append((f"thrust error, {name}", _newton(p.rmse_thrust), f"rmse{fit}, {role}"))
    if found.noise is not None:
        figures.append(("noise of one reading", _newton(found.noise.std), found.noise.basis))
    if (r := found.refinement) is not None:
        spent = f"{r.evaluations} evaluations, {r.starts} starts, {number(r.seconds, 3)} s"
        figures.append(("cost", f"{number(r.cost_start, 3)} → {number(r.cost_final, 3)}", f"mean(e²)/2, {spent}"))
    if found.static is not None:
        note = f"adjusted R², {_newton(found.static.rmse)} rms of {found.static.used.sum()} steady points"
        known = found.static.r2_adjusted
        figures.append(("static map", "–" if known is None else f"{known:.6f}", note))
    unidentified = found.not_identifiable
    names = {*found.uncertainty.names, *unidentified}
    note = f"not: {', '.join(unidentified)}" if unidentified else "all fitted parameters"
    return [*figures, ("identifiable parameters", f"{len(names) - len(unidentified)} of {len(names)}", note)]


def _newton(value: float | None) -> str:
    return "–" if value is None else f"{number(value)} N"


def remarks(found: Identification) -> list[str]:
    """Limits of the result, as sentences without full stop."""
    missing = found.campaign.missing
    lines = [f"missing files, which are not used: {', '.join(missing)}"] if missing else []
    if not found.predictions:
        sources = " and ".join(n for n, there in (("steady points", found.static), ("steps", found.steps)) if there is not None)
        lines.append(f"there is no record to fit or to validate with: the parameters are those of {sources} alone")
        if found.steps is not None and found.static is None:
            lines.append("without steady points the lags are those of the thrust, not of speed and pitch behind it")
    elif not found.unseen:
        lines.append("all records were fitted: there is no hold-out record, and the error on other data is not known")
    return lines


def _shown(found: Identification) -> list[str]:
    """Records to show: all but a repeat of the open-loop record, whose figure would be the same."""
    return [name for name in found.predictions if name != "repeat" or "open_loop" not in found.predictions]


def identification_page(found: Identification) -> Page:
    """The page of one identification."""
    page = Page("Identification", "From measured records to the plant's parameters.", found.campaign.label)
    add_identification(page, found)
    return page


def add_identification(page: Page, found: Identification) -> None:
    """Add tiles, figures and tables of an identification to a page."""
    page.tiles(key_figures(found))
    add_quality(page, found.quality)
    if lines := remarks(found):
        page.note("\n\n".join(f"{line[0].upper()}{line[1:]}." for line in lines))
    if found.predictions:
        page.section("How well the model predicts", f"Fitted together: {', '.join(found.fitted)}.")
        for name in _shown(found):
            page.figure(*_record_figure(found, name))
        _add_sections(page, found)
        _add_tests(page, found)
    add_found(page, found)
    if found.static is not None:
        add_static(page, found)
    if found.steps is not None:
        _add_steps(page, found)


def _add_tests(page: Page, found: Identification) -> None:
    tests, outside = found.tests, found.tests.outside
    title = f"The residual correlates with itself at {100 * outside['itself']:.0f} % of the lags; chance gives 5 %"
    page.figure(
        autocorrelation(tests.lags, tests.own, tests.band, title), f"Thrust residual of {found.fitted[0]}, means over 20 ms."
    )
    if tests.crossed:
        worst = max((n for n in outside if n != "itself"), key=outside.get)
        title = (
            f"The residual is correlated with changes of {worst} at {100 * outside[worst]:.0f} % of the lags; chance gives 5 %"
        )
        figure = cross_correlation(tests.lags, tests.crossed, tests.band, title)
        page.figure(figure, "Correlation of the residual with earlier changes of each command.")


def _add_steps(page: Page, found: Identification) -> None:
    steps = found.steps
    page.section("The step responses")
    for channel, unit, level in (("omega", "rpm", "deg"), ("beta", "deg", "rpm")):
        runs = [run for run in steps.runs if run.channel == channel]
        if runs:
            slow, fast = (steps.start.get(f"tau_{channel}_{k}") for k in (1, 2))
            kept = sum(not run.reason for run in runs)
            lags = "" if slow is None else f": lags of {number(slow)} and {number(fast)} s on average"
            title = f"{kept} of {len(runs)} steps of {'speed' if channel == 'omega' else 'pitch'} are used{lags}"
            figure = step_responses(runs, title, unit, level, steps.delayed(channel))
            page.figure(figure, "Thrust as a share of the step; black: two lags through the static map.")
    rows = [(run.source.rsplit("/", 1)[-1], run.reason) for run in steps.outliers]
    if rows:
        page.table(("run", "reason"), rows, "Step responses that are not used.")


def _record_figure(found: Identification, name: str):
    """(figure, caption) of a record beside its prediction."""
    p, noise = found.predictions[name], found.noise.std
    beside = f"; the noise alone is {_newton(noise)}"
    used = "which was fitted" if name in found.fitted else "which no fit saw"
    title = f"Thrust error on {name}, {used}: {_newton(p.rmse_thrust)}{beside}"
    if p.rmse_thrust is None:
        title = f"Prediction for {name}, which has no thrust"
    commands = {n: p.record[n] for n in ("omega_ref", "beta_ref")}
    figure = measured_against_predicted(
        *(p.record.time, p.record["thrust"], {"model": p.thrust}, title),
        commands=commands,
        noise=noise,
        band=found.bands[name],
    )
    share = found.coverage[name]
    within = "An unknown share of" if share is None else f"{100 * share:.1f} % of"
    coverage = f"{within} the readings of {name} are within the 95 % prediction band"
    return figure, f"{coverage}, from parameters and residual. {thinning(len(p.record))}"


def _add_sections(page: Page, found: Identification) -> None:
    rows = []
    for name, p in found.predictions.items():
        used, summary = "fitted" if name in found.fitted else "unseen", p.summary()
        for section, figures in ({"all": summary} | summary["sections"]).items():
            share, fit = found.coverage[name], figures["fit_thrust"]
            within = f"{100 * share:.1f}" if section == "all" and share is not None else ""
            rows.append((name, used, section, figures["rmse_thrust"], None if fit is None else f"{fit:.1f}", within))
    columns = ("record", "used", "section", "rmse [N]", "fit [%]", "readings in the 95 % band [%]")
    page.table(columns, rows, "Thrust error by moving command.")
