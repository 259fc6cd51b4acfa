"""The report of a planned experiment: the expected accuracy, and its commands."""

import numpy as np

from identification.plan.excitation import PAPERS_HOLD
from identification.plan.plan import Plan
from vpp_fmu.app.report.figures import stacked
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.app.report.sentences import titled, words
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record, write_record
from vpp_fmu.rig import DECLARED

UNKNOWN = 10.0
"""Ratio of standard deviation to size above which a parameter counts as unknown."""


COLOURED = 1.5
"""Factor by which autocorrelated residuals must widen the present intervals for a remark."""


class PlanResult(Result):
    """The next experiment. `found`: the whole plan."""

    verb = "plan"
    writes = ("plan.json", "report.html")
    title = "The next experiment"

    def __init__(self, found: Plan, parameters: ParameterSet, inflation: float = 1.0, noise: str = ""):
        super().__init__(found, parameters)
        self._inflation, self._noise = inflation, noise

    @property
    def commands(self) -> Record:
        """`time` [s], `omega_ref` [rpm], `beta_ref` [deg], within the rig's range and slew."""
        return self.found.commands

    def headline(self) -> str:
        found = self.found
        (direction, after), paper = found.after.weakest(), _percent(found.paper.weakest()[1])
        before = "" if found.before is None else f", from {_percent(found.before.weakest()[1])}"
        worst = f"the weakest direction ({combination(found.after.names, direction)})"
        return f"{_seconds(found)} s of commands determine {worst} to {_percent(after)}{before}; the paper's plan: {paper}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        found, figures = self.found, []
        stages = (("before", found.before), ("with the paper's plan", found.paper), ("with this plan", found.after))
        for when, forecast in stages:
            if forecast is not None:
                direction, spread = forecast.weakest()
                note = f"std of {combination(forecast.names, direction)}, in parts of the parameters"
                figures.append((f"weakest direction {when}", _percent(spread), note))
        return [*figures, ("gain over the paper's plan", f"{found.gain:.2f}", f"weakest direction, {_seconds(found)} s each")]

    def _basis(self) -> list[str]:
        return [f"commands within {', '.join(self.found.rig.command_lines())}", self._noise]

    def _remarks(self) -> list[str]:
        """Remarks on autocorrelated residuals, and on a predicted thrust outside of the rig's declared range."""
        found, wider, remarks = self.found, self._inflation, []
        if wider > COLOURED:
            remarks.append(
                f"Coloured residuals made the intervals of the data so far {wider:.1f} times as wide as white noise would; the "
                "forecast is for white noise, so before and after do not compare. "
                f"--noise {wider * found.noise_std:.2g} would allow for as much again."
            )
        (low, high), least, most = found.rig.thrust, float(found.thrust.min()), float(found.thrust.max())
        if found.rig.origin.get("thrust") == DECLARED and (least < low or most > high):
            remarks.append(
                f"The model predicts {least:.3g} to {most:.3g} N, and the rig is declared for {low:g} to {high:g} N: narrow "
                "--omega or --pitch before this is run."
            )
        return remarks

    def lines(self) -> list[str]:
        return [*self._basis(), *(f"note: {remark}" for remark in self._remarks())]

    def write(self, folder: OutputFolder) -> None:
        write_record(folder, "plan.csv", self.found.commands)
        super().write(folder)

    def fill(self, page: Page) -> None:
        """Assumptions and remarks are above the figures."""
        found = self.found
        page.remarks(self._basis())
        page.note(
            f"The forecast holds if a thrust reading every {1e3 * found.step:g} ms has white noise of {found.noise_std:.3g} N. "
            "Effects that the model does not have, and any colour of the noise, widen all intervals."
        )
        for remark in self._remarks():
            page.note(remark)
        for name, why in found.not_identifiable.items():
            page.note(f"{titled(name)} is not planned for and counts as known: {why}.")
        _add_forecast(page, found)
        columns = found.commands.columns
        changes = int(np.sum(np.any(np.diff([columns["omega_ref"], columns["beta_ref"]]) != 0.0, axis=0)))
        title = f"Commands change at {changes} of {len(found.commands)} rows; thrust is predicted between "
        title += f"{found.thrust.min():.3g} and {found.thrust.max():.3g} N"
        lines = {"speed [rpm]": {"speed command": columns["omega_ref"]}, "pitch [deg]": {"pitch command": columns["beta_ref"]}}
        lines["predicted thrust [N]"] = {"thrust": found.thrust}
        page.figure(stacked(columns["time"], lines, title), "plan.csv.")


def _add_forecast(page: Page, found: Plan) -> None:
    before, paper, after = found.before, found.paper, found.after
    known = [None] * len(after.names) if before is None else np.where(before.relative < UNKNOWN, before.std, np.nan)
    units = [found.units[name] for name in after.names]
    rows = zip(after.names, units, after.values, known, paper.std, after.std, *after.intervals.T, strict=True)
    columns = ("parameter", "unit", "value", "std before", "std, paper's plan", "std after", "95 % from", "to")
    low, high = (time * found.rig.scales.time_scale for time in PAPERS_HOLD)
    caption = "Unit 1: normalised. The paper's plan: as long, a third speed only, a third pitch only, a third both, levels "
    caption += f"held for {low:g} to {high:g} s." + ("" if before is None else " Both plans add to what is known before.")
    page.table(columns, list(rows), caption)


def combination(names, direction: np.ndarray) -> str:
    """A direction in words: its three largest components, by decreasing size."""
    largest = [k for k in np.argsort(-np.abs(direction))[:3] if abs(direction[k]) > 0.2]
    return " ".join(f"{direction[k]:+.2f} {words(names[k])}" for k in largest).removeprefix("+")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < UNKNOWN else "unknown"


def _seconds(found: Plan) -> str:
    return f"{found.commands.time[-1]:g}"
