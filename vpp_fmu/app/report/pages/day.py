"""The report of a rig's day: model and controller by round."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.day.day import DIAGNOSED, TIMES, Day, diagnosed
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_line, add_points, figure, thinning
from vpp_fmu.app.report.figures.loop import adapted_parameters
from vpp_fmu.app.report.figures.time import closed_loop
from vpp_fmu.app.report.page import Page


def day_page(day: Day) -> Page:
    """Model and controller round by round."""
    first, last = day.rounds[0], day.rounds[-1]
    began = float(np.mean(first.costs["what flew"]))
    added = [n for r in day.rounds if r.chosen.name == DIAGNOSED for n in r.named]
    alarms = sum(r.alarm is not None for r in day.rounds)
    page = Page("A day of the rig", f"{len(day.rounds)} rounds, {alarms} with an alarm of the twin.", day.begun.label)
    page.tiles(
        [
            ("cost on the rig, as it began", began, "eq. 21, of measured thrust"),
            ("cost of what flies now", last.cost, f"{100.0 * (last.cost / began - 1.0):+.1f} %"),
            ("error of the model's thrust [N]", last.chosen.error, "in the last mission"),
            ("effects added", str(len(added)), ", ".join(added)),
        ]
    )
    page.section("The model, round by round")
    errors = [{m.name: m.error for m in r.models} for r in day.rounds]
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
    return page


def errors_by_round(errors: Sequence[Mapping[str, float]], chosen: Sequence[str], noise: float) -> go.Figure:
    """rms error [N] of each model by name, one mapping per round, on an unseen mission if there was one; `chosen`: the accepted
    model; `noise` [N] of a reading."""
    rounds, on = np.arange(1, len(errors) + 1), np.array([e[name] for e, name in zip(errors, chosen, strict=True)])
    title = f"Error of the model's thrust: {on[0]:.3g} N in the first round, {on[-1]:.3g} N in the last"
    fig = figure(title, 360, "round", "rms error of thrust [N]")
    names = list(dict.fromkeys(name for each in errors for name in each))
    for name, colour in zip(names, (style.BEFORE, style.LIGHT_BLUE, style.AFTER), strict=False):
        add_points(fig, rounds, np.array([each.get(name, np.nan) for each in errors]), name, colour, 11)
    add_line(fig, rounds, on, "goes on", style.FIT, 1.4)
    add_line(fig, rounds[[0, -1]], [noise, noise], "noise of a reading", style.SET_POINT, 2.0, dash="dot")
    fig.update_xaxes(dtick=1, range=[0.5, len(errors) + 0.5])
    fig.update_yaxes(rangemode="tozero")
    return fig


def costs_by_round(
    costs: Sequence[Mapping[str, Sequence[float]]], tries: Sequence[Sequence[float]], winners: Sequence[str]
) -> go.Figure:
    """Measured costs of each branch's finalist, one mapping per round, and those of the winning branch; `tries`: costs of the
    search's flights."""
    flies = np.array([np.mean(each[name]) for each, name in zip(costs, winners, strict=True)])
    first, last = np.mean(next(iter(costs[0].values()))), flies[-1]
    title = f"Cost on the rig: {first:.4f} as the day began, {last:.4f} of what flies at its end"
    fig = figure(title, 360, "round", "integral of (error / scale)² [s]")
    tried = [(k, cost) for k, each in enumerate(tries, start=1) for cost in each]
    if tried:
        x, y = np.array(tried, float).T
        add_points(fig, x + 0.12, y, "tries of the search", style.FAINT)
    colours = {"what flew": style.BEFORE, "model-based": style.AFTER, "model-free": "#009e73", "learned": "#cc79a7"}
    for name in dict.fromkeys(name for each in costs for name in each):
        at = [(k, cost) for k, each in enumerate(costs, start=1) for cost in each.get(name, ())]
        x, y = np.array(at, float).reshape(-1, 2).T
        add_points(fig, x, y, name, colours.get(name, style.FIT), 10)
    add_line(fig, np.arange(1, len(flies) + 1), flies, "flies next", style.FIT, 1.4)
    fig.update_xaxes(dtick=1, range=[0.5, len(costs) + 0.5])
    return fig
