"""The report of all steps on the campaign that ships with the project."""

from typing import Any

from identification.demo import Demo
from identification.tune.profile import step_profile
from vpp_fmu.app.report.figures import measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult, findings
from vpp_fmu.app.report.pages.identification import add_map
from vpp_fmu.app.report.pages.loop import LoopResult, add_loops, sentence
from vpp_fmu.app.report.result import Result, dated
from vpp_fmu.app.report.sentences import change, size
from vpp_fmu.app.report.summary import write_diagnosis
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.parameters import ParameterSet, to_json
from vpp_fmu.record import Record, write_record


class DemoResult(Result):
    """All steps on the campaign that ships with the project, in `seconds`."""

    verb = "demo"
    title = "From rig data to FMUs"
    found: Demo

    def __init__(self, found: Demo, seconds: float):
        self.diagnosis = DiagnoseResult(found.diagnosis)
        super().__init__(found, self.diagnosis.parameters, source=self.diagnosis.source)
        self.loops, self._seconds = {name: LoopResult(loop, "") for name, loop in found.loops.items()}, seconds

    def headline(self) -> str:
        done = self.found
        errors = change(done.rmse["before"], done.rmse["after"], "N")
        return f"{self.diagnosis.headline()} Of the FMUs in fmpy: {errors}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        return _through_fmus(self.found, self.diagnosis.key_figures())

    def to_dict(self) -> dict[str, Any]:
        loops = {name: loop.to_dict() for name, loop in self.loops.items()}
        content = {"format": "vpp-demo/1", "diagnosis": self.diagnosis.to_dict(), "loops": loops, "seconds": self._seconds}
        return content | {"rmse_thrust_fmu": {**self.found.rmse, "unit": "N"}}

    def lines(self) -> list[str]:
        steps = [f"{name}: {sentence(step)}" for name, loop in self.loops.items() for step in loop.steps]
        return [*steps, f"{self._seconds:.1f} s"]

    def write(self, folder: OutputFolder) -> None:
        done, found = self.found, self.found.diagnosis
        write_diagnosis(folder, found)
        for name, gains in (("gains.json", DUAL), ("gains_speed_only.json", SPEED_ONLY)):
            folder.write(
                name, to_json(dated(ParameterSet(CONTROLLER, source={"made_by": "the paper's gains"}).replaced(gains)))
            )
        write_record(folder, "profile.csv", step_profile(found.rig))
        commands = {name: done.validation[name] for name in ("time", "omega_ref", "beta_ref")}
        for name, file in (("before", "prediction_base.csv"), ("after", "prediction.csv")):
            write_record(folder, file, Record({**commands, "thrust": done.thrust[name]}, "vpp demo"))
        for name, loop in done.loops.items():
            write_record(folder, f"run_{name.replace(' ', '_')}.csv", loop)
        super().write(folder)

    def tiles(self) -> list[tuple[str, str, str]]:
        return _through_fmus(self.found, self.diagnosis.tiles())

    def fill(self, page: Page) -> None:
        done = self.found
        found, validation = done.diagnosis, done.validation
        before, after = (size(done.rmse[when], "N") for when in ("before", "after"))
        page.findings(findings(found))
        page.section("The plant FMUs against measurement")
        title = (
            f"On an unseen record the FMU errs by {before} before and {after} after; noise is {size(found.noise.floor, 'N')}"
        )
        lines = {f"FMU {name}": thrust for name, thrust in done.thrust.items()}
        figure = measured_against_predicted(validation, lines, title, found.noise.floor)
        page.figure(figure, "validation.csv.")
        self._add_loops(page)
        self.diagnosis.fill_effects(page)
        if found.identification.static is not None:
            page.section("The map")
            add_map(page, found.identification)

    def _add_loops(self, page: Page) -> None:
        settling = {name: loop.steps[-1].settling for name, loop in self.loops.items()}
        words = {name: "not in time" if s is None else f"in {number(s, 3)} s" for name, s in settling.items()}
        title = f"Step down: both actuators settle {words['dual']}, speed alone {words['speed only']}"
        page.section("The closed loop of both FMUs", "The paper's gains on the augmented plant.")
        add_loops(page, self.found.loops, {name: loop.steps for name, loop in self.loops.items()}, title=title)


def _through_fmus(done: Demo, figures: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """The figures, with the thrust error of the FMUs in place of that of the model."""
    before, after = done.rmse["before"], done.rmse["after"]
    note = f"unseen record, noise of one reading {size(done.diagnosis.noise.floor, 'N')}"
    through = ("thrust error, FMU in fmpy", f"{number(before)} → {size(after, 'N')}", note)
    return [through if label.startswith("thrust error") else (label, *rest) for label, *rest in figures]
