"""The report of all steps on the campaign that ships with the project."""

from identification.demo import Demo
from vpp_fmu.app.report.canvas import thinning
from vpp_fmu.app.report.figures.time import closed_loop, measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.diagnosis import add_diagnosis, findings, tiles
from vpp_fmu.app.report.pages.diagnosis import headline as diagnosis_headline
from vpp_fmu.app.report.pages.diagnosis import key_figures as diagnosed
from vpp_fmu.app.report.pages.identification import add_map
from vpp_fmu.app.report.pages.loop import STEP_COLUMNS, row
from vpp_fmu.app.report.sentences import change, size
from vpp_fmu.digits import number
from vpp_fmu.response import steps


def key_figures(done: Demo) -> list[tuple[str, str, str]]:
    """(label, value, note): those of the diagnosis, and the errors of the FMUs."""
    return _through_fmus(done, diagnosed(done.diagnosis))


def _through_fmus(done: Demo, figures: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """The figures, with the thrust error of the FMUs in place of that of the model."""
    before, after = done.rmse["before"], done.rmse["after"]
    note = f"unseen record, noise of one reading {size(done.diagnosis.noise.floor, 'N')}"
    through = ("thrust error, FMU in fmpy", f"{number(before)} → {size(after, 'N')}", note)
    return [through if label.startswith("thrust error") else (label, *rest) for label, *rest in figures]


def headline(done: Demo) -> str:
    """The finding in a sentence, with the errors of the FMUs."""
    found, errors = diagnosis_headline(done.diagnosis), change(done.rmse["before"], done.rmse["after"], "N")
    return f"{found} Of the FMUs in fmpy: {errors}."


def demo_page(done: Demo) -> Page:
    """The report of all steps."""
    found, validation = done.diagnosis, done.validation
    before, after = (size(done.rmse[when], "N") for when in ("before", "after"))
    page = Page("From rig data to FMUs", headline(done), found.campaign.label)
    page.tiles(_through_fmus(done, tiles(found)))
    page.findings(findings(found))
    page.section("The plant FMUs against measurement")
    title = f"On an unseen record the FMU errs by {before} before and {after} after; noise is {size(found.noise.floor, 'N')}"
    lines = {f"FMU {name}": thrust for name, thrust in done.thrust.items()}
    figure = measured_against_predicted(validation, lines, title, found.noise.floor)
    page.figure(figure, f"validation.csv. {thinning(len(validation))}")
    _add_loops(page, done)
    add_diagnosis(page, found)
    if found.identification.static is not None:
        page.section("The map")
        add_map(page, found.identification)
    return page


def _add_loops(page: Page, done: Demo) -> None:
    page.section("The closed loop of both FMUs")
    found = {name: steps(loop) for name, loop in done.loops.items()}
    settling = {name: each[-1].settling for name, each in found.items()}
    words = {name: "not in time" if s is None else f"in {number(s, 3)} s" for name, s in settling.items()}
    title = f"Step down: both actuators settle {words['dual']}, speed alone {words['speed only']}"
    caption = "The paper's gains on the augmented plant."
    page.figure(closed_loop(done.loops, title), caption)
    rows = [(name, *row(step)) for name, each in found.items() for step in each]
    page.table(("loop", *STEP_COLUMNS), rows, "Settled: within 2 % of the step from then on.")
