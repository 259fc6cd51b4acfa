"""The pages of the closed loop and the open loop of two records."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from identification.assessment.prediction import Prediction
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, panels
from vpp_fmu.app.report.figures import closed_loop, measured_against_predicted, two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.app.report.sentences import size, words
from vpp_fmu.comparison import Comparison
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import QUANTITIES, Record, write_record
from vpp_fmu.response import UNITS, Step, steps

ADAPTED, STD = "adapted.", "std."
"""Prefixes of a twin's outputs."""

STEP_COLUMNS = ("loop", "at [s]", "from [N]", "to [N]", "settled after [s]", "overshoot [%]")


class LoopResult(Result):
    """A closed loop's run: `record` holds `time, thrust_set, omega_ref, beta_ref, thrust, omega, beta`, each (n,)."""

    verb = "cosim"
    title = "Closed loop"

    def __init__(
        self,
        record: Record,
        title: str,
        limits: Mapping[str, tuple[float, float]] | None = None,
        twin: tuple[Mapping[str, np.ndarray], Mapping[str, str]] | None = None,
    ):
        """`limits` as of `vpp_fmu.response.steps`; `twin`: outputs of a twin beside the loop, and their units."""
        super().__init__(record, source=title.removesuffix("."))
        self.record = Record({**record.columns, **twin[0]}, record.source) if twin else record
        self._limits, self._twin = limits, twin

    @property
    def steps(self) -> list[Step]:
        """Every change of the thrust set-point, with its settling time and overshoot."""
        return steps(self.record, limits=self._limits)

    def headline(self) -> str:
        return headline(self.steps)

    def key_figures(self) -> list[tuple[str, str, str]]:
        def words(step: Step) -> str:
            never = f"out of reach: {step.reached}" if step.stuck else "not settled"
            when = never if step.settling is None else f"settled after {number(step.settling, 3)} s"
            return f"{when}, overshoot {percent(step.overshoot)}{_later([step])}"

        return [(f"{number(s.before)} → {number(s.after)} N", words(s), f"at {number(s.time)} s") for s in self.steps]

    def to_dict(self) -> dict[str, Any]:
        return {"format": "vpp-loop/1", "units": UNITS, "steps": [asdict(step) for step in self.steps]}

    def write(self, folder: OutputFolder) -> None:
        write_record(folder, "run.csv", self.record)
        super().write(folder)

    def tiles(self) -> list[tuple[str, str, str]]:
        error = float(np.sqrt(np.mean((self.record["thrust_set"] - self.record["thrust"]) ** 2)))
        return [
            *step_tiles(self.steps),
            ("error", size(error, "N"), "rms of set-point less thrust, the steps themselves included"),
        ]

    def fill(self, page: Page) -> None:
        add_loops(page, {"loop": self.record}, {"loop": self.steps}, self._limits)
        if self._twin:
            add_adaptive(page, self.record.time, *self._twin, "the twin's", "The twin's adapted parameters.")


class SimulateResult(Result):
    """A record, and the model's open-loop response to its commands. `found`: the prediction."""

    verb = "simulate"
    writes = ()
    title = "Open loop"
    found: Prediction

    @property
    def record(self) -> Record:
        """The commands, and predicted `thrust` [N], `omega` [rpm] and `beta` [deg], each (n,), with torque and power if the
        model has them."""
        p = self.found
        commands = {name: p.record[name] for name in ("time", "omega_ref", "beta_ref")}
        return Record({**commands, "thrust": p.thrust, "omega": p.omega, "beta": p.beta, **p.further}, "vpp simulate")

    @property
    def rmse_thrust(self) -> float | None:
        """Error against the record, N; None if that has no thrust."""
        return self.found.rmse_thrust if "thrust" in self.found.record else None

    def headline(self) -> str:
        thrust, error = self.found.thrust, self.rmse_thrust
        ends = f"{size(thrust.min())} to {size(thrust.max(), 'N')} over {size(float(self.found.record.time[-1]), 's')}"
        against = "; the record has no thrust to compare with" if error is None else f", {size(error, 'N')} rms off the reading"
        return f"Predicted thrust {ends}{against}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        p, thrust = self.found, self.found.thrust
        figures = [("predicted thrust", f"{size(thrust.min())} to {size(thrust.max(), 'N')}", f"{len(thrust)} rows")]
        error = ("thrust error", size(self.rmse_thrust, "N"), f"rms against {p.record.source}")
        return figures if self.rmse_thrust is None else [error, *figures]

    def to_dict(self) -> dict[str, Any]:
        p, units = self.found, {"rmse_thrust": "N", "rmse_omega": "rpm", "fit_thrust": "%"}
        content = {"format": "vpp-simulation/1", "rows": len(p.record), "seconds": float(p.record.time[-1]), "units": units}
        fit = None if self.rmse_thrust is None else p.fit_thrust
        return content | {"rmse_thrust": self.rmse_thrust, "rmse_omega": p.rmse_omega, "fit_thrust": fit}

    @property
    def source(self) -> str:
        return self.found.record.source

    def fill(self, page: Page) -> None:
        p = self.found
        title = "Thrust, as the model predicts it"
        if self.rmse_thrust is not None:
            title = f"The model errs by {size(self.rmse_thrust, 'N')}"
        page.figure(measured_against_predicted(p.record, {"model": p.thrust}, title))

    def write(self, folder: OutputFolder) -> None:
        write_record(folder, "prediction.csv", self.record)


class CompareResult(Result):
    """Two records, at the times of the first. `found`: their common part."""

    verb = "compare"
    writes = ("comparison.json", "report.html")
    title = "Two records"
    found: Comparison

    def __init__(self, found: Comparison, first: str, second: str):
        super().__init__(found, source=f"{second} beside {first}, at the times of the latter")
        self._names = first, second

    def _said(self) -> dict[str, str]:
        """The difference of each column in words."""
        found = {}
        for name, figures in self.found.summary()["columns"].items():
            sizes = f"{size(figures['rms'], _unit(name))} rms, at most {size(figures['largest'], _unit(name))}"
            found[name] = f"{style.label(name).partition(' [')[0]} differs by {sizes}"
        return found

    def headline(self) -> str:
        said = next(iter(self._said().values()), "no shared column")
        return f"Over {self.found.time[-1] - self.found.time[0]:.4g} s that both records have: {said}."

    def lines(self) -> list[str]:
        return list(self._said().values())[1:]

    def fill(self, page: Page) -> None:
        found, rows = self.found, []
        for name, title in self._said().items():
            figures = found.summary()["columns"][name]
            rows.append((f"{name} [{_unit(name)}]", figures["rms"], figures["mean"], figures["largest"]))
            values = zip(self._names, (found.first[name], found.second[name]), strict=True)
            pair = ((file, found.time, column) for file, column in values)
            quantity = style.label(name).partition(" [")[0]
            page.figure(two_records(*pair, title, quantity, _unit(name)), "Second less first below.")
        page.table(("column", "rms", "mean", "largest"), rows, "Differences, second less first.")


def _unit(name: str) -> str:
    return QUANTITIES[name].unit if name in QUANTITIES else "as recorded"


def step_tiles(found: Sequence[Step], of: str = "") -> list[tuple[str, str, str]]:
    """Key figures (label, value, note) of the steps, if there are any; `of`: which loop."""
    if not found:
        return []
    settled = [step.settling for step in found if step.settling is not None]
    note = f"{len(settled)} of {len(found)} steps settle; overshoot up to {percent(max(step.overshoot for step in found))}"
    return [(f"slowest settling{of}", f"{number(max(settled))} s" if settled else "none", note)]


def add_loops(
    page: Page,
    loops: Mapping[str, Record],
    judged: Mapping[str, Sequence[Step]],
    limits: Mapping[str, tuple[float, float]] | None = None,
    title: str = "",
    within: str = "within 2 % of the step",
) -> None:
    """Closed loops over one profile and their steps, by name; `limits` of the commands by name, drawn if known."""
    first = next(iter(judged.values()))
    title = title or (sentence(first[0]) if first else "Thrust under a constant set-point")
    caption = "Thrust with its set-point, speed and pitch with their commands."
    page.figure(closed_loop(loops, title, limits), caption)
    table = [(name, *row(step)) for name, steps in judged.items() for step in steps]
    page.table(STEP_COLUMNS, table, f"Every change of the set-point. Settled: {within} from then on.")


def row(step: Step) -> tuple:
    """A step as cells of a table."""
    never = "out of reach" if step.stuck else "not by the end" if step.last else "not before the next"
    settled = never if step.settling is None else step.settling
    return step.time, step.before, step.after, settled, percent(step.overshoot).removesuffix(" %")


def sentence(step: Step) -> str:
    change = f"The step from {number(step.before)} to {number(step.after)} N at {number(step.time, 4)} s"
    if step.stuck:
        return f"{change}: the set-point of {number(step.after)} N is out of reach: {step.reached}"
    never = "has not settled " + ("by the end of the run" if step.last else "before the next")
    when = never if step.settling is None else f"has settled after {number(step.settling)} s"
    return f"{change} {when}, overshoot {percent(step.overshoot)}{_later([step])}"


def headline(found: Sequence[Step]) -> str:
    """All steps of a run in a sentence."""
    if not found:
        return "The set-point is constant: there is no step to judge."
    if len(found) == 1:
        return f"{sentence(found[0])}."
    missed = [step for step in found if step.settling is None]
    if missed:
        return f"{len(missed)} of {len(found)} steps do not settle; the first: {sentence(missed[0])}."
    slowest, largest = max(found, key=lambda s: s.settling), max(step.overshoot for step in found)
    change = f"{number(slowest.before)} to {number(slowest.after)} N at {number(slowest.time, 4)} s"
    within = f"{number(slowest.settling)} s (slowest: {change})"
    return f"All {len(found)} steps settle within {within}; overshoot {percent(largest)} at most{_later(found)}."


def percent(share: float) -> str:
    """An overshoot as text, the same in a tile, a table and a sentence."""
    return f"{share:.1f} %"


def _later(found: Sequence[Step]) -> str:
    """Departures after the steps have settled, in words; empty without one."""
    departures = [d for step in found for d in step.departures]
    if not departures:
        return ""
    largest = max(departures, key=lambda d: d.largest)
    size = f"by {percent(largest.largest)} of the step for {number(largest.duration)} s at {number(largest.time, 4)} s"
    if len(departures) == 1:
        return f"; later a disturbance {size}"
    return f"; later {len(departures)} disturbances, the largest {size}"


def add_adaptive(
    page: Page, time: np.ndarray, outputs: Mapping[str, np.ndarray], units: Mapping[str, str], model: str, caption: str
) -> None:
    """Residual and parameters of an adaptive twin from its outputs (rows,) by name, with their units; `model`: whose thrust is
    subtracted, `caption`: of the parameters."""
    page.figure(residual_in_band(time, outputs), f"Measured thrust less {model}.")
    own = {name.removeprefix(ADAPTED): unit for name, unit in units.items() if name.startswith(ADAPTED)}
    page.figure(adapted_parameters(time, outputs, own), caption)


def residual_in_band(time: np.ndarray, twin: Mapping[str, np.ndarray]) -> Figure:
    """Measured thrust less the twin's [N] over time [s], with the 95 % band; (n,) by the twin's outputs."""
    alarms = time[np.diff(twin["alarm"], prepend=0.0) > 0.5]
    said = f"alarm at {', '.join(f'{at:.1f}' for at in alarms[:5])} s" if len(alarms) else "no alarm"
    fig = panels(f"Twin: {said}, {twin['changes'][-1]:.0f} changes followed", ["residual [N]"], [240])
    fig.envelope(time, -twin["band"], twin["band"], "95 % of readings expected", style.BAND)
    fig.line(time, twin["residual"], "rig − twin", style.MEASURED, 1)
    for at in alarms:
        fig.level("x", at, "alarm", style.BEFORE)
    return fig


def adapted_parameters(time: np.ndarray, twin: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Figure:
    """Each adapted parameter over time [s] with +-2 standard deviations; `units` by its name."""
    names = [name.removeprefix(ADAPTED) for name in twin if name.startswith(ADAPTED)]
    fig = panels("Adapted parameters", [f"{words(name)} [{units[name]}]" for name in names], [150] * len(names))
    for panel, name in enumerate(names):
        value, reach = twin[ADAPTED + name], 2.0 * twin[STD + name]
        fig.envelope(time, value - reach, value + reach, "± 2 standard deviations", style.BAND, panel)
        fig.line(time, value, words(name), style.AFTER, 1.6, panel, "adapted")
    return fig
