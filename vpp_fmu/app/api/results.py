"""Results of the verbs: key figures to print, all numbers as a dictionary, files in a folder, and figures."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from plotly import graph_objects as go

from identification.assessment.prediction import Prediction
from identification.assessment.quality import rmse
from identification.diagnose.diagnose import Diagnosis
from identification.identify import Identification
from identification.plan.plan import Plan
from identification.power.allocation import COLUMNS, Allocation, allocated_controller, table
from identification.tune import summary as tuned
from identification.tune.learn import LearnedLaw
from identification.tune.tune import Tuning
from vpp_fmu.app.api.linear import Linearisable
from vpp_fmu.app.api.objects import PathLike
from vpp_fmu.app.cli import allocate, learn
from vpp_fmu.app.cli.check import Checked, write_check
from vpp_fmu.app.cli.diagnose import write_diagnosis
from vpp_fmu.app.cli.identify import write_identification
from vpp_fmu.app.cli.plan import remarks_on, write_plan
from vpp_fmu.app.cli.tune import gains_of, write_tuning
from vpp_fmu.app.report import summary as diagnosed
from vpp_fmu.app.report.canvas import thinning
from vpp_fmu.app.report.figures.time import measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages import allocation, diagnosis, learning, plan
from vpp_fmu.app.report.pages import identification as identified
from vpp_fmu.app.report.pages.loop import loop_page, percent
from vpp_fmu.app.report.pages.tuning import tuning_page
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.notebook import table_html
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.policy import Policy
from vpp_fmu.record import Record, write_record
from vpp_fmu.response import Step, steps

KeyFigures = list[tuple[str, str, str]]
"""(label, value, note)."""


class Result(ABC):
    """The result of a verb. `verb`: its name; `save` writes its files."""

    verb: ClassVar[str]

    @abstractmethod
    def key_figures(self) -> KeyFigures:
        """Key figures (label, value, note)."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """All numbers, as the verb's JSON file holds them; strictly valid JSON."""

    @abstractmethod
    def page(self) -> Page:
        """The report."""

    @abstractmethod
    def _write(self, folder: OutputFolder) -> None:
        """The verb's files."""

    @property
    def identity(self) -> str | None:
        """Identity of the parameters in the files."""
        return None

    def save(self, folder: PathLike) -> Path:
        """Write the files of `vpp VERB -o folder`, and return the folder. An earlier run's files of the same model are removed,
        other files stay. BadInput if it can't be written."""
        target = OutputSet(folder, self.verb)
        self._write(target)
        target.finish(self.identity)
        return target.path

    def plot(self, figure: int = 1) -> go.Figure:
        """A figure of the report by its number, from 1. BadInput if it has no such figure."""
        figures = self.page().figures
        if not 1 <= figure <= len(figures):
            allowed = f"1 to {len(figures)}" if figures else "none, there is nothing to draw"
            raise BadInput(type(self).__name__, "figure", figure, allowed)
        return figures[figure - 1]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(f'{label}: {value}' for label, value, _ in self.key_figures())})"

    def _repr_html_(self) -> str:
        return table_html(type(self).__name__, ("what", "value", "note"), self.key_figures())


class Functions(NamedTuple):
    """What a verb makes of its result: key figures, the content of its JSON file, the report, and the files in a folder."""

    key_figures: Callable[[Any], KeyFigures]
    summary: Callable[[Any], dict[str, Any]]
    page: Callable[..., Page]
    write: Callable[..., None]


class Found(Result):
    """A result that is `found`, described by the functions of its verb. Page and files may name the `source` of parameters."""

    _functions: ClassVar[Functions]

    def __init__(self, found: Any, parameters: ParameterSet, *source: str):
        self.found, self._parameters, self._source = found, parameters, source

    @property
    def identity(self) -> str:
        return self._parameters.identity

    def key_figures(self) -> KeyFigures:
        return self._functions.key_figures(self.found)

    def to_dict(self) -> dict[str, Any]:
        return self._functions.summary(self.found)

    def page(self) -> Page:
        return self._functions.page(self.found, *self._source)

    def _write(self, folder: OutputFolder) -> None:
        self._functions.write(folder, self.found, *self._source)


class CheckResult(Result):
    """A campaign's files, missing data and quality problems. `found`: the whole check."""

    verb = "check"

    def __init__(self, found: Checked):
        self.found = found

    @property
    def ok(self) -> bool:
        """Whether `identify` and `diagnose` accept the campaign."""
        return not self.found.errors

    @property
    def findings(self) -> tuple[str, ...]:
        """Quality problems of the data, one per line, errors first."""
        return tuple(finding.text for finding in self.found.findings)

    def key_figures(self) -> KeyFigures:
        errors, all_of_them = len(self.found.errors), len(self.found.findings)
        held = [(h.name, h.row()[1], "") for h in self.found.held]
        return [*held, ("errors", str(errors), ""), ("warnings", str(all_of_them - errors), "")]

    def to_dict(self) -> dict[str, Any]:
        return self.found.summary()

    def page(self) -> Page:
        page = Page(
            f"Check of {self.found.campaign.folder.name}", "; ".join(self.found.campaign.rig.lines()), self.found.campaign.label
        )
        page.tiles(self.key_figures())
        for line in self.findings:
            page.note(line)
        return page

    def _write(self, folder: OutputFolder) -> None:
        write_check(folder, self.found)


class IdentifyResult(Found, Linearisable):
    """A campaign's parameters and their uncertainty. `found`: the whole identification, with predictions and the search."""

    verb = "identify"
    _functions = Functions(identified.key_figures, Identification.summary, identified.identification_page, write_identification)
    found: Identification

    @property
    def parameters(self) -> ParameterSet:
        """Values with their standard deviations."""
        return self._parameters


class DiagnoseResult(Found, Linearisable):
    """The effects that the model lacks, and the model with them. `found`: the whole diagnosis."""

    verb = "diagnose"
    _functions = Functions(diagnosis.key_figures, diagnosed.summary, diagnosis.diagnosis_page, write_diagnosis)
    found: Diagnosis

    @property
    def verdict(self) -> str:
        """`attributed`, `family`, `learned`, `partly`, `unexplained` or `none`; see the README."""
        return self.found.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the final model's effects."""
        return self.parameters.model.optional

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of the final model."""
        return self._parameters

    @property
    def base(self) -> ParameterSet:
        """Parameters of the model without the found effects."""
        return self.found.parameters(self.found.base)

    def _write(self, folder: OutputFolder) -> None:
        super()._write(folder)
        folder.write("report.html", self.page().html())


class PlanResult(Found):
    """The next experiment. `found`: the whole plan; `inflation`: factor by which autocorrelated residuals widen the
    present intervals."""

    verb = "plan"
    _functions = Functions(plan.key_figures, Plan.summary, plan.plan_page, write_plan)
    found: Plan

    def __init__(self, found: Plan, parameters: ParameterSet, inflation: float = 1.0):
        super().__init__(found, parameters)
        self._inflation = inflation

    @property
    def commands(self) -> Record:
        """`time` [s], `omega_ref` [rpm], `beta_ref` [deg], within the rig's range and slew."""
        return self.found.commands

    def page(self) -> Page:
        return plan.plan_page(self.found, self._basis(), remarks_on(self.found, self._inflation), self._parameters.label)

    def _basis(self) -> list[str]:
        return [f"commands within {', '.join(self.found.rig.command_lines())}"]

    def _write(self, folder: OutputFolder) -> None:
        write_plan(folder, self.found, self._basis(), remarks_on(self.found, self._inflation), self._parameters.label)


class TuneResult(Found):
    """Gains for both actuators and for speed alone. `found`: the whole tuning."""

    verb = "tune"
    _functions = Functions(tuned.key_figures, tuned.summary, tuning_page, write_tuning)
    found: Tuning

    @property
    def gains(self) -> dict[str, ParameterSet]:
        """The controllers' values by name, "dual" and "speed_only", for export_fmu and run_loop."""
        return {name: gains_of(self.found, name) for name in self.found.tuned}


class AllocateResult(Found):
    """The pair of speed and pitch of least power for each thrust. `found`: the whole allocation."""

    verb = "allocate"
    _functions = Functions(allocation.key_figures, allocate.summary, allocation.allocation_page, allocate.write_allocation)
    found: Allocation

    @property
    def pairs(self) -> dict[str, np.ndarray]:
        """Columns of allocation.csv, (thrusts,) each: `thrust` [N], `omega` [rpm], `beta` [deg], `power` [W], 95 % limits."""
        return dict(zip(COLUMNS, np.array(table(self.found)).T, strict=True))

    @property
    def gains(self) -> ParameterSet:
        """The controller that rests on these pairs (mode 2), for export_fmu and run_loop."""
        return allocated_controller(self.found, self._parameters)


class LearnResult(Found):
    """A learned control law beside the tuned PID. `found`: the search, and the comparison on held-out plants."""

    verb = "learn"
    _functions = Functions(learning.key_figures, learn.summary, learning.learning_page, learn.write_learning)
    found: LearnedLaw

    def __init__(self, found: LearnedLaw, parameters: ParameterSet):
        super().__init__(found, parameters, parameters.label)

    @property
    def policy(self) -> Policy:
        """The law, for export_fmu."""
        return self.found.policy


class SimulateResult(Result):
    """A record, and the model's open-loop response to its commands."""

    verb = "simulate"

    def __init__(self, prediction: Prediction, parameters: ParameterSet):
        self.prediction, self._parameters = prediction, parameters

    @property
    def record(self) -> Record:
        """The commands, and predicted `thrust` [N], `omega` [rpm] and `beta` [deg], each (n,)."""
        p = self.prediction
        commands = {name: p.record[name] for name in ("time", "omega_ref", "beta_ref")}
        return Record({**commands, "thrust": p.thrust, "omega": p.omega, "beta": p.beta}, "vpp simulate")

    @property
    def rmse_thrust(self) -> float | None:
        """Error against the record, N; None if that has no thrust."""
        p = self.prediction
        return rmse(p.thrust - p.record["thrust"]) if "thrust" in p.record else None

    @property
    def identity(self) -> str:
        return self._parameters.identity

    def key_figures(self) -> KeyFigures:
        wrong = self.rmse_thrust
        thrust = self.prediction.thrust
        ends = f"{number(float(thrust.min()))} to {number(float(thrust.max()))} N"
        against = (
            [] if wrong is None else [("thrust error", f"{number(wrong)} N", f"rms against {self.prediction.record.source}")]
        )
        return [*against, ("predicted thrust", ends, f"{len(thrust)} rows")]

    def to_dict(self) -> dict[str, Any]:
        p = self.prediction
        measured = {"rmse_thrust": self.rmse_thrust, "rmse_omega": p.rmse_omega}
        measured |= {"fit_thrust": p.fit_thrust} if "thrust" in p.record else {}
        return {**measured, "columns": {name: column.tolist() for name, column in self.record.columns.items()}}

    def page(self) -> Page:
        p = self.prediction
        page = Page("Open loop", f"The model's response to the commands of {p.record.source}.")
        page.tiles(self.key_figures())
        title = "Thrust, as the model predicts it"
        if self.rmse_thrust is not None:
            title = f"The model errs by {number(self.rmse_thrust)} N"
        figure = measured_against_predicted(p.record, {"model": p.thrust}, title)
        page.figure(figure, thinning(len(p.record)))
        return page

    def _write(self, folder: OutputFolder) -> None:
        write_record(folder, "prediction.csv", self.record)


class LoopResult(Result):
    """A closed loop's run: `record` holds `time, thrust_set, omega_ref, beta_ref, thrust, omega, beta`, each (n,)."""

    verb = "cosim"

    def __init__(self, record: Record, title: str, limits: Mapping[str, tuple[float, float]] | None = None):
        self.record, self._title, self._limits = record, title, limits

    @property
    def steps(self) -> list[Step]:
        """Every change of the thrust set-point, with its settling time and overshoot."""
        return steps(self.record, limits=self._limits)

    def key_figures(self) -> KeyFigures:
        def words(step: Step) -> str:
            never = "out of reach" if step.stuck else "not settled"
            when = never if step.settling is None else f"{number(step.settling, 3)} s"
            return f"{when}, overshoot {percent(step.overshoot)}"

        return [(f"{number(s.before)} → {number(s.after)} N", words(s), f"at {number(s.time)} s") for s in self.steps]

    def to_dict(self) -> dict[str, Any]:
        columns = {name: column.tolist() for name, column in self.record.columns.items()}
        return {"steps": [asdict(step) for step in self.steps], "columns": columns}

    def page(self) -> Page:
        return loop_page(self.record, self._title, self._limits)

    def _write(self, folder: OutputFolder) -> None:
        write_record(folder, "run.csv", self.record)
        folder.write("report.html", self.page().html())
