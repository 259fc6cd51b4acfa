"""The report of a rig's day: model and controller by round."""

import numpy as np

from hil.run import profile_start
from vpp_fmu.app.day import GAINS, PRESENT, Day
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, panels
from vpp_fmu.app.report.figures import closed_loop
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.rig import add_twin


def day_page(day: Day) -> Page:
    """Model and controller round by round."""
    last, (began, cost) = day.rounds[-1], day.cost
    page = Page("A day of the rig", f"{len(day.rounds)} rounds, {day.alarms} with an alarm of the twin.", day.begun.label)
    page.tiles(
        [
            ("cost on the rig, as it began", began, "eq. 21, of measured thrust"),
            ("cost of what flies now", cost, f"{100.0 * (cost / began - 1.0):+.1f} %"),
            ("error of the model's thrust [N]", last.after, "in the last mission"),
            ("effects added", str(len(day.added)), ", ".join(day.added)),
        ]
    )
    page.section("Model and controller, round by round")
    noise = float(np.std(np.diff(last.mission.record["thrust"])) / np.sqrt(2.0))
    page.figure(
        by_round(day, noise),
        "Above: the present model has not seen the round's mission; the next one is fitted to it. Below: all gains go through "
        "the profile several times.",
    )
    rows = [
        (
            str(r.number),
            ", ".join(r.hidden) or "-",
            "; ".join(f"after {one.time:.0f} s, {one.cause}" for one in r.alarms) or "none",
            f"{r.verdict} {' + '.join(r.named)}",
            r.winner,
        )
        for r in day.rounds
    ]
    page.table(("round", "hidden in the rig", "alarm", "diagnosis", "flies next"), rows, "What happened.")
    gains = [(n, day.first[n], *(r.settings[n] for r in day.rounds)) for n in GAINS]
    page.table(("gain", "as it began", *(f"after round {r.number}" for r in day.rounds)), gains, "Gains that fly.")
    page.section("The last mission")
    log, begin = last.mission.log, profile_start(last.mission.log)
    twin = last.mission.session.rig.twin.summary() | {"alarms": [one._asdict() for one in last.alarms]}
    add_twin(page, log.with_columns(time=log.time - begin), twin)
    page.figure(closed_loop({"rig": last.mission.record}, f"The mission of round {last.number}, as it was flown"))
    return page


def by_round(day: Day, noise: float) -> Figure:
    """Errors of the present and of the next model in each round's mission, with the `noise` [N] of a reading; measured costs of
    all gains, and of those that fly next."""
    rounds, numbers, (began, cost) = day.rounds, [r.number for r in day.rounds], day.cost
    title = f"From the first round to the last: error of the model {rounds[0].before:.3g} to {rounds[-1].after:.3g} N, "
    title += f"cost on the rig {began:.4f} to {cost:.4f}"
    fig = panels(title, ["rms error of thrust [N]", "integral of (error / scale)² [s]"], [260, 260], "round [-]")
    fig.points(numbers, [r.before for r in rounds], "present model, unseen mission", style.BEFORE, 11)
    fig.points(numbers, [r.after for r in rounds], "next model, fitted", style.AFTER, 11)
    fig.level("y0", noise, "noise of a reading")
    colours = {PRESENT: style.BEFORE, "model-based": style.AFTER}
    for name in dict.fromkeys(name for r in rounds for name in r.costs):
        at = [(r.number, cost) for r in rounds for cost in r.costs.get(name, ())]
        x, y = np.array(at, float).T
        fig.points(x, y, name, colours[name], 10, 1)
    fig.line(numbers, [r.cost for r in rounds], "flies next", style.FIT, 1.4, 1)
    fig.axes["x"] |= {"step": 1, "range": [0.5, len(rounds) + 0.5]}
    return fig
