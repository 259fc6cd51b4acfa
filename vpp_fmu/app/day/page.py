"""The report of a day."""

import numpy as np

from vpp_fmu.app.day.day import BETTER, DIAGNOSED, TIMES, Day, Round, diagnosed
from vpp_fmu.report import Page, adapted_parameters, closed_loop, thinning
from vpp_fmu.report.day import costs_by_round, errors_by_round, framework

FRAMEWORK = (
    (
        "digital twin",
        "the adaptive twin beside the mission; what it does not explain of an alarm, the diagnosis of its record does",
    ),
    ("model-based policy", "gains retuned on that model, within limits on overshoot and sensitivity"),
    ("model-free policy", "covariance matrix adaptation on the rig's own cost, a generation a round"),
    ("which of them leads", f"that whose gains cost less on the rig (p < {BETTER:g}); what flies stays where neither does"),
    ("safety", "the model refuses gains that break limits before they fly; limits and watchdogs of the rig as always"),
)


def day_page(day: Day) -> Page:
    """Model and controller round by round."""
    first, last = day.rounds[0], day.rounds[-1]
    began = float(np.mean(first.costs["what flew"]))
    added = [n for r in day.rounds if r.chosen.name == DIAGNOSED for n in r.named]
    page = Page("A day of the rig", _summary(day), day.begun.label)
    page.tiles(
        [
            ("cost on the rig, as it began", began, "eq. 21, of measured thrust"),
            ("cost of what flies now", last.cost, f"{100.0 * (last.cost / began - 1.0):+.1f} %"),
            ("error of the model's thrust [N]", _error(last), "in the last mission"),
            ("effects added", str(len(added)), ", ".join(added)),
        ]
    )
    page.section("The model, round by round")
    errors = [{m.name: m.fitted if np.isnan(m.unseen) else m.unseen for m in r.models} for r in day.rounds]
    noise = float(np.std(np.diff(last.mission.record["thrust"])) / np.sqrt(2.0))
    page.figure(
        errors_by_round(errors, [r.chosen.name for r in day.rounds], noise),
        "Where there is another model they are held against a mission that none of them saw; the noise is a single reading's.",
    )
    page.section("The controller, round by round")
    costs = costs_by_round([r.costs for r in day.rounds], [r.tries for r in day.rounds], [r.winner for r in day.rounds])
    page.figure(costs, f"Each finalist goes through the profile {TIMES} times.")
    rows = [
        (
            str(r.number),
            ", ".join(r.hidden) or "-",
            f"{r.alarm[1]}, after {r.alarm[0]:.0f} s" if r.alarm else "none",
            diagnosed(r) or ("explained without" if r.alarm else "-"),
            r.chosen.name,
            r.winner,
        )
        for r in day.rounds
    ]
    page.table(("round", "hidden in the rig", "alarm", "diagnosis", "model that goes on", "flies next"), rows, "What happened.")
    names = [n for n in last.settings if n.startswith(("kp_", "ki_", "kd_"))]
    gains = [(n, day.settings[n], *(r.settings[n] for r in day.rounds)) for n in names]
    page.table(("gain", "as it began", *(f"after round {r.number}" for r in day.rounds)), gains, "Gains that fly.")
    page.section("What the twin made of its parameters")
    for r in day.rounds:
        if not r.mission.twin:
            continue
        units = {p.name: p.unit for p in r.chosen.parameters.model.parameters}
        units |= {n.removeprefix("adapted."): "" for n in r.mission.twin if n.startswith("adapted.") and n[8:] not in units}
        figure = adapted_parameters(r.mission.record.time, r.mission.twin, units)
        page.figure(figure, f"Round {r.number}. {thinning(len(r.mission.record))}")
    page.section("The last mission")
    page.figure(
        closed_loop({"rig": last.mission.record}, f"The mission of round {last.number}, as it was flown"),
        thinning(len(last.mission.record)),
    )
    page.section("The paper's framework, and what stands for its parts here")
    statements = {
        **{name: f"{np.mean(c):.4f}" for name, c in last.costs.items()},
        "twin": f"{_error(last):.3g} N off",
        "flies": f"{last.winner}, {last.cost:.4f}",
    }
    title = "Twin and policies teach each other; the rig's measured cost decides"
    page.diagram(framework(statements), title, f"With what each had to say in round {last.number}.")
    page.table(("Reinforcement Twinning", "here"), FRAMEWORK, "Who gives what.")
    return page


def _error(r: Round) -> float:
    return r.chosen.fitted if np.isnan(r.chosen.unseen) else r.chosen.unseen


def _summary(day: Day) -> str:
    alarms = sum(r.alarm is not None for r in day.rounds)
    return f"{len(day.rounds)} rounds, {alarms} with an alarm of the twin."
