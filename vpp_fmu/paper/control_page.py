"""The report's section on the controllers (paper's figures 9 and 10)."""

from vpp_fmu.paper import figures
from vpp_fmu.paper.control import MODEL, PI, PID, PUBLISHED, RIG, SPEED, TUNED, Loop, Merit
from vpp_fmu.paper.control_rows import DOWN, UP, seconds
from vpp_fmu.paper.published import REACHED
from vpp_fmu.paper.study import Study
from vpp_fmu.report import Page, closed_loop
from vpp_fmu.response import steps

_DRAWN = ("time", "thrust_set", "thrust", "omega_ref", "omega", "beta_ref", "beta")


def add_control(page: Page, study: Study) -> dict[str, int]:
    """The step test of both actuators, then both against speed alone; on the paper's model and on the rig."""
    page.section(
        "Control (figures 9, 10)",
        "On the paper's model (tau_beta_2 = 0.05 s) run the published gains, on the emulated rig the gains that were tuned for "
        f"the model its campaign gave. The rig's lines are means over {study.control.repeats} runs with other noise.",
    )
    places = {}
    for number, controllers in (("9", (PI, PID)), ("10", (SPEED, PID))):
        for plant, gains in ((MODEL, PUBLISHED), (RIG, TUNED)):
            found = _add_test(page, study, plant, gains, controllers)
            places.setdefault(number, found)
    _add_merits(page, study)
    return places


def _add_test(page: Page, study: Study, plant: str, gains: str, controllers: tuple[str, str]) -> int:
    loops = [Loop(plant, gains, name) for name in controllers]
    runs = [study.control.runs[loop] for loop in loops]
    merits = [study.control.merits[loop] for loop in loops]
    told = [f"{name} {seconds(m[UP])} up, {seconds(m[DOWN])} down" for name, m in zip(controllers, merits, strict=True)]
    title = f"{plant.capitalize()}, {gains}: {'; '.join(told)}"
    drawn = {name: {c: run[c] for c in _DRAWN if c in run} for name, run in zip(controllers, runs, strict=True)}
    figure = closed_loop(drawn, title)
    if SPEED not in controllers:
        figures.mark_reached(figure, steps(runs[0])[0].time + REACHED, f"paper: reached about {REACHED:g} s after the step")
    figure.update_xaxes(range=[steps(runs[0])[0].time - 0.5, float(runs[0].time[-1])])
    return page.figure(figure, "Settled: within 2 % of the step from then on. Commands dotted.")


def _cells(merit: Merit) -> tuple:
    """A step's figures as cells."""
    error = merit.squared_error if merit.error_std is None else f"{merit.squared_error:.4f} ± {merit.error_std:.4f}"
    return merit.settling, merit.overshoot, error


def _add_merits(page: Page, study: Study) -> None:
    columns = ("loop", "controller", *(name for way in ("up", "down") for name in (f"{way} [s]", "overshoot [%]", "error [s]")))
    rows = [
        (f"{loop.plant}, {loop.gains}", loop.controller, *(value for merit in merits for value in _cells(merit)))
        for loop, merits in study.control.merits.items()
    ]
    page.table(
        columns,
        rows,
        "Both actuators against speed alone, up and down, in numbers. Up, down: settled after so many s, a dash: not before "
        "the next step. Error: of normalised thrust, squared, until the next step. Slew limits: 20 000 rpm/s and 60 deg/s, as "
        "vpp hil run has them.",
    )
