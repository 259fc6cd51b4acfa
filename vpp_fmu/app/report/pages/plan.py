"""The report of a planned experiment: the expected accuracy, and its commands."""

from collections.abc import Sequence

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from identification.plan.excitation import PAPERS_HOLD
from identification.plan.plan import Plan
from vpp_fmu.app.report.canvas import thinning
from vpp_fmu.app.report.figures.parameters import interval_widths
from vpp_fmu.app.report.figures.time import planned_commands
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.sentences import titled, words

UNKNOWN = 10.0
"""Ratio of standard deviation to size above which a parameter counts as unknown."""


def headline(found: Plan) -> str:
    """The expected accuracy in a sentence."""
    (direction, after), paper = found.after.weakest(), _percent(found.paper.weakest()[1])
    before = "" if found.before is None else f", from {_percent(found.before.weakest()[1])}"
    worst = f"the weakest direction ({combination(found.after.names, direction)})"
    return f"{_seconds(found)} s of commands determine {worst} to {_percent(after)}{before}; the paper's plan: {paper}."


def key_figures(found: Plan) -> list[tuple[str, str, str]]:
    """Key figures (label, value, note)."""
    figures = []
    stages = (("before", found.before), ("with the paper's plan", found.paper), ("with this plan", found.after))
    for when, forecast in stages:
        if forecast is not None:
            direction, spread = forecast.weakest()
            note = f"std of {combination(forecast.names, direction)}, in parts of the parameters"
            figures.append((f"weakest direction {when}", _percent(spread), note))
    figures.append(("gain over the paper's plan", f"{found.gain:.2f}", f"weakest direction, {_seconds(found)} s each"))
    return figures


def plan_page(found: Plan, basis: Sequence[str] = (), remarks: Sequence[str] = (), source: str = "") -> Page:
    """The report of a plan; its assumptions (`basis`) and `remarks` are above its figures; `source`: of the parameters."""
    after = found.after
    page = Page(
        "The next experiment",
        f"{headline(found)} This holds if a thrust reading every {1e3 * found.step:g} ms has white noise of "
        f"{found.noise_std:.3g} N. Effects that the model does not have, and any colour of the noise, widen all intervals.",
        source,
    )
    page.tiles(key_figures(found))
    page.remarks(basis)
    for remark in remarks:
        page.note(remark)
    for name, why in found.not_identifiable.items():
        page.note(f"{titled(name)} is not planned for and counts as known: {why}.")
    title = f"The paper's plan leaves {_percent(found.paper.weakest()[1])} in the weakest direction, this one"
    widths = {"before": found.before, "the paper's plan": found.paper, "after this plan": after}
    shown = {name: 100.0 * NORMAL_95 * forecast.relative for name, forecast in widths.items() if forecast is not None}
    hold = [time * found.rig.scales.time_scale for time in PAPERS_HOLD]
    page.figure(
        interval_widths(after.names, shown, f"{title} {_percent(after.weakest()[1])}"),
        "Predicted 95 % intervals. The paper's plan: as long, a third speed only, a third pitch only, a third both, "
        f"levels held for {hold[0]:g} to {hold[1]:g} s."
        + ("" if found.before is None else " Both plans add to what is known before."),
    )
    columns = found.commands.columns
    changes = int(np.sum(np.any(np.diff([columns["omega_ref"], columns["beta_ref"]]) != 0.0, axis=0)))
    title = f"Commands change at {changes} of {len(found.commands)} rows; thrust is predicted between "
    title += f"{found.thrust.min():.3g} and {found.thrust.max():.3g} N"
    drawn = planned_commands(columns["time"], columns["omega_ref"], columns["beta_ref"], found.thrust, title)
    page.figure(drawn, f"plan.csv. {thinning(len(found.commands))}")
    _add_tables(page, found)
    return page


def _add_tables(page: Page, found: Plan) -> None:
    before, paper, after = found.before, found.paper, found.after
    known = [None] * len(after.names) if before is None else np.where(before.relative < UNKNOWN, before.std, np.nan)
    units = [found.units[name] for name in after.names]
    rows = zip(after.names, units, after.values, known, paper.std, after.std, *after.intervals.T, strict=True)
    columns = ("parameter", "unit", "value", "std before", "std, paper's plan", "std after", "95 % from", "to")
    page.table(columns, list(rows), "Unit 1: normalised.")


def combination(names, direction: np.ndarray) -> str:
    """A direction in words: its three largest components, by decreasing size."""
    largest = [k for k in np.argsort(-np.abs(direction))[:3] if abs(direction[k]) > 0.2]
    return " ".join(f"{direction[k]:+.2f} {words(names[k])}" for k in largest).removeprefix("+")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < UNKNOWN else "unknown"


def _seconds(found: Plan) -> str:
    return f"{found.commands.time[-1]:g}"
