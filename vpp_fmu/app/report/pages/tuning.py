"""The report of a tuning: improvement by the search, benefit of the second actuator, stability margins, robustness."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from identification.tune.summary import (
    NAMES,
    against,
    change_rows,
    headline,
    key_figures,
    labels,
    margin_rows,
    settling,
    summary,
)
from identification.tune.tune import JUDGED, Tuned, Tuning
from identification.tune.verdict import UNITS
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import panels
from vpp_fmu.app.report.figures import closed_loop as loop_figure
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import ParameterSet, to_json
from vpp_fmu.record import write_record

FILES = {"dual": "gains.json", "speed_only": "gains_speed_only.json", "allocated": "gains.json"}


class TuneResult(Result):
    """Gains for both actuators and for speed alone. `found`: the whole tuning."""

    verb = "tune"
    writes = ("tuning.json", "report.html")
    title = "Gains for the model"
    found: Tuning

    def __init__(
        self,
        found: Tuning,
        parameters: ParameterSet | None = None,
        file: str | os.PathLike[str] | None = None,
        setting: Sequence[str] = (),
    ):
        """`parameters`: before the design's assumptions; `setting`: lines about the conditions."""
        super().__init__(found, parameters or found.task.parameters, file)
        self._setting = setting

    @property
    def gains(self) -> dict[str, ParameterSet]:
        """The controllers' values by name, "dual" and "speed_only", for export_fmu and run_loop."""
        return {name: self._gains(name) for name in self.found.tuned}

    def _gains(self, name: str) -> ParameterSet:
        task, tuned = self.found.task, self.found.tuned[name]
        source = {
            "made_by": "vpp tune",
            "assumed": {n: task.parameters.values[n] for n in task.assumed},
            "robust": task.robust,
            "cost": tuned.cost(tuned.chosen),
            "verdict": {which: each.words() for which, each in tuned.verdicts.items()},
            "rig": task.parameters.rig.summary(),
        }
        return ParameterSet(task.controller, source=source).replaced(tuned.objective.with_gains(tuned.final))

    def headline(self) -> str:
        return headline(self.found)

    def key_figures(self) -> list[tuple[str, str, str]]:
        return key_figures(self.found)

    def to_dict(self) -> dict[str, Any]:
        return summary(self.found)

    def lines(self) -> list[str]:
        return list(self._setting)

    def details(self) -> list[str]:
        """Every step and margin, before and after."""
        lines = []
        for name, tuned in self.found.tuned.items():
            for which, verdict in tuned.verdicts.items():
                lines.append(f"{NAMES[name]}, {self.found.task.reference} → {which}")
                for step, *changes in change_rows(verdict):
                    lines.append(f"  {step}: " + ", ".join(f"{n} {c}" for n, c in zip(UNITS, changes, strict=True)))
                lines.append("  " + ", ".join(f"{margin} {change}" for margin, change in margin_rows(verdict)))
        return [*lines, f"tuned in {self.found.seconds:.1f} s"]

    def write(self, folder: OutputFolder) -> None:
        for name, gains in self.gains.items():
            folder.write(FILES[name], to_json(self._dated(gains)))
        write_record(folder, "profile.csv", self.found.task.profile)
        super().write(folder)

    def tiles(self) -> list[tuple[str, str, str]]:
        return [each for each in self.key_figures() if "gains" not in each[0]]  # the notes have those

    def fill(self, page: Page) -> None:
        found, task = self.found, self.found.task
        assumed = ", ".join(f"{name} = {task.parameters.values[name]:g}" for name in task.assumed)
        for name, tuned in found.tuned.items():
            _add_controller(page, found, name, tuned)
        if len(found.tuned) > 1:
            _add_comparison(page, found)
        if found.plants is not None:
            _add_robust(page, found)
        page.section(
            "How the gains were found",
            f"The search (Nelder and Mead, on the compiled loop) minimises the squared thrust error over the test signal plus "
            f"{task.alpha:g} times the squared norm of the gains. Limits: overshoot {100 * task.overshoot:g} %, sensitivity at "
            f"the operating points {task.sensitivity:g}, and the settling and ringing of each step under the initial gains."
            + (f" Assumed for the design: {assumed}." if assumed else ""),
        )


def _names(found: Tuning, tuned: Tuned) -> dict[str, str]:
    return {which: f"{name} (before)" if which == "start" else name for which, name in labels(found, tuned).items()}


def _add_controller(page: Page, found: Tuning, name: str, tuned: Tuned) -> None:
    names, objective = _names(found, tuned), tuned.objective
    start, cost = tuned.cost("start"), tuned.cost("tuned")
    page.section(f"Gains of {NAMES[name]}", f"Chosen: the {labels(found, tuned)[tuned.chosen]} gains.")
    rows = [(gain, *(own[k] for own in tuned.gains.values())) for k, gain in enumerate(objective.names)]
    rows.append(("cost", *(tuned.cost(which) for which in tuned.gains)))
    page.table(("gain, normalised", *names.values()), rows, "Gains and their cost on the nominal plant.")
    for which, verdict in tuned.verdicts.items():
        page.note(f"{which.capitalize()} gains: {verdict.words()}.")
        page.table(
            ("step", "settling", "overshoot", "ringing"),
            change_rows(verdict),
            f"Each step without noise, {found.task.reference} → {which}.",
        )
    runs = {names[which]: objective.run(gains) for which, gains in tuned.gains.items()}
    title = f"{NAMES[name].capitalize()}: cost {number(start)} before the search, {number(cost)} after"
    own = objective.settings
    limits = {f"{n}_ref": (own[f"{n}_min"], own[f"{n}_max"]) for n in ("omega", "beta")}
    page.figure(loop_figure(runs, title, limits), f"{found.task.profile.source}. Thrust is the plant's, not its reading.")
    _add_margins(page, found, tuned)


def _add_margins(page: Page, found: Tuning, tuned: Tuned) -> None:
    names = _names(found, tuned)
    if not tuned.points[tuned.chosen]:
        page.note("No operating point at which a command is free to move: no margins.")
        return
    own = labels(found, tuned)
    worst = {w: max((m.sensitivity for m in tuned.margins[w]), default=np.nan) for w in tuned.gains}
    title = f"Largest sensitivity: {', '.join(f'{own[w]} {s:.3g}' for w, s in worst.items())}"
    fig = panels(title, ["phase [deg]", "delay [ms]", "sensitivity [-]"], [130] * 3, "thrust at the operating point [N]")
    colours = style.colours(names.values())
    for panel, (quantity, scale) in enumerate((("phase", 1.0), ("delay", 1e3), ("sensitivity", 1.0))):
        for which, name in names.items():
            thrust, margins = [p.thrust for p in tuned.points[which]], [getattr(m, quantity) for m in tuned.margins[which]]
            values = np.array([np.nan if value is None else scale * value for value in margins])
            fig.line(thrust, values, name, colours[name], 1.6, panel, size=6)
    fig.level("y2", found.task.sensitivity, "limit")
    fig.axes["x"]["format"] = ".3~g"
    page.figure(fig, "Operating points at which the loop settles, on levels of thrust up and down.")


def _add_comparison(page: Page, found: Tuning) -> None:
    page.section("Both actuators against speed alone")
    runs = {NAMES[name]: tuned.objective.run(tuned.final) for name, tuned in found.tuned.items()}
    title = "Both actuators against speed alone"
    if down := [row for row in against(found) if row["after"] < row["before"]]:
        times = [settling(down[0][name]["settling"]) for name in found.tuned]
        title = f"Step down: both actuators settle in {times[0]}, speed alone in {times[1]}"
    page.figure(loop_figure(runs, title), "The chosen gains.")


def _add_robust(page: Page, found: Tuning) -> None:
    rows = []
    for name, tuned in found.tuned.items():
        for which, label in _names(found, tuned).items():
            costs, overshoot = tuned.judged[which], 100.0 * tuned.overshoots[which].max()
            rows.append((NAMES[name], label, tuned.cost(which), costs.mean(), costs.max(), overshoot))
    page.section("Robustness over plants within the uncertainty")
    columns = ("controller", "gains", "cost, nominal plant", "mean", "worst", "largest overshoot [%]")
    page.table(columns, rows, f"Costs on the nominal plant and on {JUDGED} others, which the search did not use.")
