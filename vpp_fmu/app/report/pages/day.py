"""The report of a rig's day: model and controller by round."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.app.day import GAINS, PRESENT, Day
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_line, add_points, figure, thinning
from vpp_fmu.app.report.figures.loop import adapted_parameters
from vpp_fmu.app.report.figures.time import closed_loop
from vpp_fmu.app.report.page import Page


def day_page(day: Day) -> Page:
    """Model and controller round by round."""
    first, last = day.rounds[0], day.rounds[-1]
    began = float(np.mean(first.costs[PRESENT]))
    added = [n for r in day.rounds for n in r.named]
    alarms = sum(bool(r.mission.alarms) for r in day.rounds)
    page = Page("A day of the rig", f"{len(day.rounds)} rounds, {alarms} with an alarm of the twin.", day.begun.label)
    page.tiles(
        [
            ("cost on the rig, as it began", began, "eq. 21, of measured thrust"),
            ("cost of what flies now", last.cost, f"{100.0 * (last.cost / began - 1.0):+.1f} %"),
            ("error of the model's thrust [N]", last.after, "in the last mission"),
            ("effects added", str(len(added)), ", ".join(added)),
        ]
    )
    page.section("The model, round by round")
    noise = float(np.std(np.diff(last.mission.record["thrust"])) / np.sqrt(2.0))
    page.figure(
        errors_by_round([(r.before, r.after) for r in day.rounds], noise),
        "The present model has not seen the round's mission; the next one is fitted to it. The noise is a single reading's.",
    )
    page.section("The controller, round by round")
    costs = costs_by_round([r.costs for r in day.rounds], [r.winner for r in day.rounds])
    page.figure(costs, "Each law goes through the profile several times.")
    rows = [
        (
            str(r.number),
            ", ".join(r.hidden) or "-",
            "; ".join(f"after {one.time:.0f} s, {one.cause}" for one in r.mission.alarms) or "none",
            f"{r.verdict} {' + '.join(r.named)}",
            r.winner,
        )
        for r in day.rounds
    ]
    page.table(("round", "hidden in the rig", "alarm", "diagnosis", "flies next"), rows, "What happened.")
    gains = [(n, day.settings[n], *(r.law.settings[n] for r in day.rounds)) for n in GAINS]
    page.table(("gain", "as it began", *(f"after round {r.number}" for r in day.rounds)), gains, "Gains that fly.")
    page.section("What the twin made of its parameters")
    for r in day.rounds:
        figure = adapted_parameters(r.mission.record.time, r.mission.twin, r.mission.units)
        page.figure(figure, f"Round {r.number}. {thinning(len(r.mission.record))}")
    page.section("The last mission")
    page.figure(
        closed_loop({"rig": last.mission.record}, f"The mission of round {last.number}, as it was flown"),
        thinning(len(last.mission.record)),
    )
    return page


def errors_by_round(errors: Sequence[tuple[float, float]], noise: float) -> go.Figure:
    """rms errors [N] of the present and of the next model in each round's mission; `noise` [N] of a reading."""
    rounds, (before, after) = np.arange(1, len(errors) + 1), np.array(errors).T
    title = f"Error of the model's thrust: {before[0]:.3g} N in the first round, {after[-1]:.3g} N in the last"
    fig = figure(title, 360, "round", "rms error of thrust [N]")
    add_points(fig, rounds, before, "present model, unseen mission", style.BEFORE, 11)
    add_points(fig, rounds, after, "next model, fitted", style.AFTER, 11)
    add_line(fig, rounds[[0, -1]], np.array([noise, noise]), "noise of a reading", style.SET_POINT, 2.0, dash="dot")
    fig.update_xaxes(dtick=1, range=[0.5, len(errors) + 0.5])
    fig.update_yaxes(rangemode="tozero")
    return fig


def costs_by_round(costs: Sequence[Mapping[str, Sequence[float]]], winners: Sequence[str]) -> go.Figure:
    """Measured costs of each law by name, one mapping per round, and those of the winners."""
    flies = np.array([np.mean(each[name]) for each, name in zip(costs, winners, strict=True)])
    first, last = np.mean(costs[0][PRESENT]), flies[-1]
    title = f"Cost on the rig: {first:.4f} as the day began, {last:.4f} of what flies at its end"
    fig = figure(title, 360, "round", "integral of (error / scale)² [s]")
    colours = {PRESENT: style.BEFORE, "model-based": style.AFTER, "learned": "#cc79a7"}
    for name in dict.fromkeys(name for each in costs for name in each):
        at = [(k, cost) for k, each in enumerate(costs, start=1) for cost in each.get(name, ())]
        x, y = np.array(at, float).reshape(-1, 2).T
        add_points(fig, x, y, name, colours[name], 10)
    add_line(fig, np.arange(1, len(flies) + 1), flies, "flies next", style.FIT, 1.4)
    fig.update_xaxes(dtick=1, range=[0.5, len(costs) + 0.5])
    return fig
