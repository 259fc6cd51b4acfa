"""The report of an identification: parameters, errors of prediction, tests, static map and step responses."""

from collections.abc import Sequence

import numpy as np

from identification.fit.problem import Prior
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.gate.finding import ERROR, Finding
from identification.identify import Identification
from identification.static.static_map import design
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import figure, panels
from vpp_fmu.app.report.figures import measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Knowledge, Result, dated
from vpp_fmu.app.report.sentences import size, titled, words
from vpp_fmu.digits import interval, number
from vpp_fmu.files import OutputFolder
from vpp_fmu.linear import Linearisable
from vpp_fmu.parameters import ParameterSet, to_json, to_ssv

TELLING = 0.2
"""Minimum component of the weakest direction for its parameter to be named."""

SETTLED, ROOM, BEFORE = 0.02, 1.5, 0.13
"""Share of a step within which a fit counts as settled; the drawn time as a multiple of that settling time, and before it."""


class IdentifyResult(Result, Linearisable):
    """A campaign's parameters and their uncertainty. `found`: the whole identification, with predictions and the search."""

    verb = "identify"
    writes = ("identification.json", "report.html")
    title = "Identification"
    found: Identification

    def __init__(self, found: Identification):
        super().__init__(found, found.parameters, source=found.campaign.label)

    @property
    def parameters(self) -> ParameterSet:
        """Values with their standard deviations."""
        return self.found.parameters

    @property
    def knowledge(self) -> Knowledge:
        """The uncertainty of the parameters."""
        own, noise = self.found.uncertainty, self.found.noise
        prior = Prior(own.names, own.values, own.covariance)
        return Knowledge(prior, float(np.median(own.inflation)), (noise.std, noise.basis) if noise else None)

    def headline(self) -> str:
        found = self.found
        missing = found.not_identifiable
        known = len(found.uncertainty.names) - len({*found.uncertainty.names} & {*missing})
        known_of = f"{known} of {len({*found.uncertainty.names, *missing})} parameters are identified"
        shown = found.unseen or _shown(found)
        errors = [found.predictions[name].rmse_thrust for name in shown]
        if not errors or errors[-1] is None:
            return f"{known_of}; there is no record to predict."
        noise = size(found.noise.std if found.noise else None, "N")
        word = "Unseen" if found.unseen else "Fitted"
        return f"{word} thrust error {size(errors[-1], 'N')} on {shown[-1]}; noise {noise}. {known_of}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        found = self.found
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
            note = f"{_newton(found.static.rmse)} rms of {found.static.used.sum()} steady points"
            known = found.static.r2_adjusted
            figures.append(("fit of the static map", "–" if known is None else f"adjusted R² {known:.4f}", note))
        unidentified = found.not_identifiable
        names = {*found.uncertainty.names, *unidentified}
        note = f"not: {', '.join(map(words, unidentified))}" if unidentified else "all fitted parameters"
        return [*figures, ("identifiable parameters", f"{len(names) - len(unidentified)} of {len(names)}", note)]

    def lines(self) -> list[str]:
        found = self.found
        lines = [*(finding.text for finding in found.quality), *remarks(found), *not_identifiable(found)]
        return lines + [f"your logger: {line}" for line in found.logger.lines]

    def write(self, folder: OutputFolder) -> None:
        folder.write("parameters.json", to_json(dated(self.parameters)))
        folder.write("parameters.ssv", to_ssv(self.parameters, "parameters"))
        super().write(folder)

    def fill(self, page: Page) -> None:
        found = self.found
        add_quality(page, found.quality)
        page.remarks(remarks(found))
        if found.predictions:
            page.section("How well the model predicts", f"Fitted together: {', '.join(found.fitted)}.")
            for name in _shown(found):
                page.figure(*_record_figure(found, name))
            _add_sections(page, found)
            share = 100.0 * found.tests.outside["itself"]
            page.note(f"The residual correlates with itself at {share:.0f} % of the lags; chance gives 5 %.")
        _add_parameters(page, found)
        if found.static is not None:
            page.section("The static map")
            add_map(page, found)
        if found.steps is not None:
            _add_steps(page, found)


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


def quality_tile(findings: Sequence[Finding]) -> tuple[str, str, str]:
    """(label, value, note) for the first screen."""
    codes = list(dict.fromkeys(f.code.replace("_", " ") for f in findings))
    errors = sum(f.level == ERROR for f in findings)
    parts = [f"{n} {word}{'s' * (n > 1)}" for n, word in ((errors, "error"), (len(findings) - errors, "warning")) if n]
    return "quality of the data", ", ".join(parts) or "no findings", "; ".join(codes)


def add_quality(page: Page, findings: Sequence[Finding]) -> None:
    """Add the findings as a table, if there are any."""
    if not findings:
        return
    page.section("Quality of the data")
    rows = [(f.level, f.code, f"{f.file}, {f.field}", f.told, f.cause, f.advice) for f in findings]
    columns = ("level", "code", "where", "what shows it", "likely cause", "what to do")
    page.table(columns, rows, "Findings on the files, and on the fit to them, that limit the results below.")


def _record_figure(found: Identification, name: str):
    """(figure, caption) of a record beside its prediction."""
    p, noise = found.predictions[name], found.noise and found.noise.std
    beside = f"; the noise alone is {_newton(noise)}" if noise else ""
    used = "which was fitted" if name in found.fitted else "which no fit saw"
    title = f"Thrust error on {name}, {used}: {_newton(p.rmse_thrust)}{beside}"
    if p.rmse_thrust is None:
        title = f"Prediction for {name}, which has no thrust"
    figure = measured_against_predicted(p.record, {"model": p.thrust}, title, noise, found.bands[name])
    share = found.coverage[name]
    within = "An unknown share of" if share is None else f"{100 * share:.1f} % of"
    coverage = f"{within} the readings of {name} are within the 95 % prediction band"
    return figure, f"{coverage}, from parameters and residual."


def _add_sections(page: Page, found: Identification) -> None:
    rows = []
    for name, p in found.predictions.items():
        used, summary = "fitted" if name in found.fitted else "unseen", p.summary()
        for section, figures in ({"all": summary} | summary["sections"]).items():
            rows.append((name, used, section, figures["rmse_thrust"], figures["fit_thrust"]))
    page.table(("record", "used", "section", "rmse [N]", "fit [%]"), rows, "Thrust error by moving command.")


def _add_steps(page: Page, found: Identification) -> None:
    """Normalised thrust over the time from the step, of the used runs of each channel; a panel per direction."""
    steps = found.steps
    page.section("The step responses")
    for channel, word in (("omega", "speed"), ("beta", "pitch")):
        every = [run for run in steps.runs if run.channel == channel]
        if not (runs := [run for run in every if not run.reason]):
            continue
        slow, fast = (steps.start.get(f"tau_{channel}_{k}") for k in (1, 2))
        lags = "" if slow is None else f": lags of {number(slow)} and {number(fast)} s on average"
        ways = list(dict.fromkeys(run.direction for run in runs))
        labels = [f"thrust, steps {way} [share of step]" for way in ways]
        fig = panels(f"{len(runs)} of {len(every)} steps of {word} are used{lags}", labels, [260] * len(ways))
        shares = [run.normalised(steps.delayed(channel)) for run in runs]
        settled = [run.time[np.abs(fit - 1.0) > SETTLED].max(initial=0.0) for run, (_, fit) in zip(runs, shares, strict=True)]
        after = ROOM * max(settled) or runs[0].time[-1]
        for place, name, colour in ((0, "measured", style.FAINT), (1, "fitted", style.AFTER)):
            for run, share in zip(runs, shares, strict=True):
                near = (run.time >= -BEFORE * after) & (run.time <= after)
                fig.line(run.time[near], share[place][near], name, colour, 1.0, ways.index(run.direction), mute=True)
        page.figure(fig, "Thrust as a share of the step; fitted: two lags through the static map.")
    rows = [(run.source.rsplit("/", 1)[-1], run.reason) for run in steps.outliers]
    if rows:
        page.table(("run", "reason"), rows, "Step responses that are not used.")


def _add_parameters(page: Page, found: Identification) -> None:
    uncertainty = found.uncertainty
    units = {p.name: p.unit for p in found.parameters.model.parameters}
    page.section("Parameters")
    rows = []
    for k, name in enumerate(uncertainty.names):
        by = "on its bound" if name in found.at_bounds else uncertainty.kind(name)
        std, ends = number(float(uncertainty.std[k]), 3), interval(*uncertainty.intervals[k].tolist())
        rows.append((name, units[name], found.start[name], float(uncertainty.values[k]), std, ends, by))
    columns = ("parameter", "unit", "start", "value", "std", "95 % interval", "by")
    page.table(columns, rows, "Unit 1: normalised; std accounts for the autocorrelation of the residuals.")
    page.remarks(not_identifiable(found))
    if uncertainty.profiled:
        page.note(
            f"The cost is not quadratic in {', '.join(map(words, uncertainty.profiled))}: their 95 % intervals are from the "
            "profile likelihood."
        )
    if len(uncertainty.names) > 1:
        page.note(_weakest(uncertainty))


def not_identifiable(found: Identification) -> list[str]:
    """Parameters that are not identifiable, or that ended on a bound, as sentences without full stop."""
    reasons: dict[str, list[str]] = {}
    for name, why in found.not_identifiable.items():
        state = "fitted to" if name in found.uncertainty.names else "stays at"
        reasons.setdefault(why, []).append(f"{words(name)} ({state} {number(found.parameters.values[name])})")
    lines = [f"not identifiable from these data: {', '.join(names)}: {why}" for why, names in reasons.items()]
    return lines + [f"on a bound: {words(name)}, which ended at {number(bound)}" for name, bound in found.at_bounds.items()]


def _weakest(uncertainty: Uncertainty) -> str:
    """The most correlated pair, and the direction of the largest uncertainty, as sentences."""
    condition, direction, spread = uncertainty.directions()
    named = [
        f"{direction[k]:+.2f} {words(uncertainty.names[k])}"
        for k in np.argsort(-np.abs(direction))
        if abs(direction[k]) >= TELLING
    ]
    weakest = f"Largest uncertainty: direction {', '.join(named)} (relative), ± {number(100 * NORMAL_95 * spread, 3)} %"
    correlation = uncertainty.correlation
    i, j = np.unravel_index(np.argmax(np.abs(np.triu(correlation, 1))), correlation.shape)
    pair = f"{titled(uncertainty.names[i])} and {words(uncertainty.names[j])} are correlated most strongly"
    return f"{pair}: {correlation[i, j]:.2f}. {weakest}; condition number {number(condition, 3)}."


def add_map(page: Page, found: Identification) -> None:
    """The fitted map with the steady points: over the pitch, or over the speed if that alone varies."""
    static, points, scales = found.static, found.campaign.static, found.parameters.values
    used = static.used
    speed, pitch, thrust = points.omega_ref[used], points.beta_ref[used], points.thrust[used]
    along = ("pitch [deg]", pitch), ("speed [rpm]", speed)
    (label, at), (_, beside) = along if np.ptp(pitch) > 0.0 or np.ptp(speed) == 0.0 else along[::-1]
    over = np.linspace(at.min(), at.max(), 61)
    quality = "" if static.r2_adjusted is None else f" (adjusted R² {static.r2_adjusted:.4f})"
    fig = figure(f"A cubic fits {used.sum()} steady points to {number(static.rmse)} N{quality}", 400, label, "thrust [N]")
    levels = np.unique(beside)
    for level, shade in zip(levels, style.shades(len(levels)), strict=True):
        # Each line is at the mean measured speed, which may differ from the command.
        own = beside == level
        other = np.full(61, points.omega[used][own].mean() if beside is speed else level)
        omega, beta = (other, over) if beside is speed else (over, other)
        fitted = design(omega, beta, scales) @ list(static.coefficients.values()) * scales["thrust_scale"]
        name = f"{number(float(other[0]))} {'rpm' if beside is speed else 'deg'}"
        fig.line(over, fitted, name, shade, 1.6)
        fig.points(at[own], thrust[own], name, shade)
    page.figure(fig, "Lines: fitted; points: measured.")
    if static.not_identifiable:
        page.note(
            f"The steady points identify only combinations of {', '.join(map(words, static.not_identifiable))} with others: "
            "they stay near the paper's."
        )
