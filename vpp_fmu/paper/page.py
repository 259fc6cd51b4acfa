"""The report of the paper's study: what came of it, a figure for every figure of the paper, then every number."""

from hil.campaign import PARTS
from hil.campaign import seconds as seconds_on_rig
from vpp_fmu.paper.control import PID, RIG, SPEED, TUNED, Loop
from vpp_fmu.paper.control_page import add_control
from vpp_fmu.paper.control_rows import DOWN, UP, seconds
from vpp_fmu.paper.fine_tuning_page import add_fine_tuning
from vpp_fmu.paper.measuring_page import add_loops, add_static, add_steps
from vpp_fmu.paper.published import FIGURES, NUMBERS
from vpp_fmu.paper.rows import COLUMNS, KEY, compared
from vpp_fmu.paper.study import Study
from vpp_fmu.report import Page

NOT_HERE = {
    "1a": "a photo: the stand here is software; wiring and parts in hil/README.md",
    "1b": "a drawing: the mechanism here is a map from rod to pitch, and its play an effect that can be hidden",
}
"""Figures of the paper that have no counterpart, and why."""

UNPUBLISHED = (
    ("records, commands of the open loop", "drawn with a seed: moves of 5 % to 90 % of the range, held 0.4 to 2.8 s"),
    ("levels of the other command in the steps", "evenly spread, away from where thrust vanishes"),
    ("rate and threshold of the gradient descent", "rate 0.5, 350 iterations as the paper; more than 1 diverges on its map"),
    ("weight alpha and period of the control cost", "1e-8, at which the published gains lie nearest to a minimum; 10 s"),
    ("limits of the speed command", "2000 to 6000 rpm, the range of the static map"),
    ("noise, its colour, repeated records", "chosen: 0.12 N before the mark's vibration; each record measured twice here"),
    ("motor's winding and inertia, actuator's motor and screw", "chosen such that steps take as long as the paper's"),
)
"""What the paper leaves open, and what stands in its place here."""


def page(study: Study, total: float) -> Page:
    """The report; `total`: s that everything took before it."""
    rows = compared(study)
    made = Page("The paper's study on the emulated rig", f"{_done(study)}\n\n{verdict(study)}")
    made.tiles(tiles(study, total))
    made.section("The numbers that matter")
    made.table(COLUMNS, [rows[name].cells() for name in KEY], "± is a standard deviation. A dash: there is none.")
    if not study.is_full:
        made.note("A quick study: fewer points, readings, steps and shorter records than the paper's. Its numbers are rough.")
    places = {}
    for add in (add_loops, add_static, add_steps, add_fine_tuning, add_control):
        places |= add(made, study)
    made.section("All figures")
    figures = [(f"figure {n}", what, NOT_HERE.get(n) or f"figure {places[n]}") for n, what in FIGURES.items()]
    made.table(("paper", "shows", "here"), figures, "Which figure of this page stands beside which of the paper.")
    made.section("All numbers")
    made.table(COLUMNS, [row.cells() for row in rows.values()], "In the paper's order.")
    made.table(("not in the paper", "here"), UNPUBLISHED, "What the paper leaves open.")
    _add_times(made, study, total)
    return made


def verdict(study: Study) -> str:
    """What the study says of the paper's claims, in a sentence."""
    both, alone = (study.control.merits[Loop(RIG, TUNED, name)] for name in (PID, SPEED))
    said = [
        f"{both[way].against(alone[way])} {name} (settled in {seconds(both[way])}, {seconds(alone[way])})"
        for way, name in ((UP, "up"), (DOWN, "down"))
    ]
    found = {"r2_adjusted": study.statics.rig.r2_adjusted, "cost_fall": study.fine_tuning.fall[0]}
    told = {name: (value, NUMBERS[name].value) for name, value in found.items()}
    return (
        "On the emulated rig the cubic map has an adjusted R² of {:.4f} (paper {:.3f}), ".format(*told["r2_adjusted"])
        + "fine-tuning takes {:.0f} % off the cost (paper {:.0f} %), ".format(*told["cost_fall"])
        + f"and in squared error both actuators are, against speed alone, {said[0]} and {said[1]}."
    )


def tiles(study: Study, total: float) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    dual, alone = (study.control.merits[Loop(RIG, TUNED, name)] for name in (PID, SPEED))
    rmse = study.found.predictions["validation"].rmse_thrust
    up, down = (f"{seconds(dual[way])} / {seconds(alone[way])}" for way in (UP, DOWN))
    errors = [f"squared error {dual[way].squared_error:.3f} / {alone[way].squared_error:.3f} s" for way in (UP, DOWN)]
    return [
        ("error on an unseen record", f"{rmse:.3f} N", f"rms; the noise alone is {study.found.noise.std:.3f} N"),
        ("step up, both / speed alone", up, f"{errors[UP]}; rig, tuned gains"),
        ("step down, both / speed alone", down, f"{errors[DOWN]}; rig, tuned gains"),
        ("the whole study", f"{total:.0f} s", f"{_minutes(study):.0f} min on a real rig" if study.is_full else "quick"),
    ]


def _minutes(study: Study) -> float:
    """How long the campaign and the loops take in the rig's own time, min."""
    logged = sum(len(run) for run in study.control.runs.values() if run.source.startswith("mean")) * study.control.repeats
    return (seconds_on_rig(study.plan, PARTS) + 0.004 * logged) / 60.0


def _done(study: Study) -> str:
    plan, points = study.plan, study.campaign.static
    return (
        f"The paper's campaign on the emulated rig ({len(points.thrust)} steady points of {plan.samples} readings, "
        f"{len(study.campaign.steps)} steps, {3 * plan.section:g} s of open loop), then its model, fine-tuning, controllers, "
        "loops. Where only the paper's numbers are known, its model runs. Blades, inertia and the PI's unit of the emulated "
        "rig were fitted to the paper: where the two agree in map and speed, that confirms no physics."
    )


def _add_times(made: Page, study: Study, total: float) -> None:
    made.section("Time")
    rows = [(name, seconds) for name, seconds in study.seconds.items()] + [("the whole, before this page", total)]
    made.table(
        ("stage", "time [s]"), rows, f"Seed {study.seed}. In virtual time: the rig's own clock runs ahead of this one's."
    )
