"""The report of the paper's study: its result, a figure for every figure of the paper, then every number; and paper.json."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from plotly import graph_objects as go

from hil.campaign import PARTS
from hil.campaign import seconds as seconds_on_rig
from hil.physics.reduction import reduced, two_lags, two_lags_with_zero
from identification.assessment.pairs import forms
from identification.assessment.prediction import predict
from identification.assessment.quality import rmse
from identification.static.static_map import coefficient_grid, design, thrust_coefficient
from identification.steps.lag_fit import two_lags as lag_response
from identification.steps.run import StepRun
from vpp_fmu.app.paper.control import MODEL, PI, PID, PUBLISHED, RIG, SPEED, TUNED, Loop, Merit
from vpp_fmu.app.paper.inside import dips, terms, worst_dip
from vpp_fmu.app.paper.published import (
    COLUMNS,
    COST_END,
    COST_START,
    FIGURES,
    ITERATIONS,
    KEY,
    LAGS,
    NUMBERS,
    REACHED,
    STATIC_MAP,
)
from vpp_fmu.app.paper.rows import compared
from vpp_fmu.app.paper.study import (
    OPERATING_PITCH,
    PAPER_UNITS,
    FineTuning,
    Statics,
    Study,
    by_part,
    by_size,
    lags,
    noise_of,
    paper_thrust,
    parts,
)
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import add_level, add_line, add_points, figure, thinning
from vpp_fmu.app.report.figures.map import map_lines, map_residuals, thrust_coefficients
from vpp_fmu.app.report.figures.time import closed_loop, measured_against_predicted, stacked, step_responses
from vpp_fmu.app.report.page import Page
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.response import steps

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
"""Data that the paper does not give, and the replacement here."""

CHANNELS = {"5": ("speed", "omega", "rpm", "deg"), "6": ("pitch", "beta", "deg", "rpm")}
"""The paper's figure of each channel's steps: its name, its name in the model, its unit, the other channel's."""

INITIAL, DESCENT, OURS, PAPERS = "initial", "the paper's descent", "fine-tuned", "paper's published model"

PARTS_SHOWN = {"8a": ("speed only", "speed"), "8b": ("pitch only", "pitch"), "8c": ("both", "both inputs")}
"""The part of the record in each figure of the paper, and its moving inputs."""

AT = 4500.0, 4.0
"""rpm, deg around which the relations between gains and time constants are taken: where the open loop rests."""


def summary(study: Study, total: float) -> dict:
    """The content of paper.json; `total`: s of the whole."""
    tests = [loop._asdict() | {"up": asdict(test.up), "down": asdict(test.down)} for loop, test in study.tests.items()]
    return {
        "format": "vpp-paper/1",
        "verdict": verdict(study),
        "seed": study.seed,
        "plan": asdict(study.plan) | {"as_the_paper": study.is_full},
        "rows": [asdict(row) for row in compared(study).values()],
        "step_tests": tests,
        "seconds": dict(study.seconds) | {"total": total},
    }


def paper_page(study: Study, total: float) -> Page:
    """The report; `total`: s of the study before it."""
    rows = compared(study)
    page = Page("The paper's study on the emulated rig", f"{_done(study)}\n\n{verdict(study)}")
    page.tiles(tiles(study, total))
    page.section("The numbers that matter")
    page.table(COLUMNS, [rows[name].cells() for name in KEY], "± is a standard deviation. A dash: there is none.")
    if not study.is_full:
        page.note("A quick study: fewer points, readings, steps and shorter records than the paper's. Its numbers are rough.")
    places = {}
    for add in (_add_loops, _add_static, _add_steps, _add_fine_tuning, _add_control):
        places |= add(page, study)
    page.section("All figures")
    shown = [(f"figure {n}", what, NOT_HERE.get(n) or f"figure {places[n]}") for n, what in FIGURES.items()]
    page.table(("paper", "shows", "here"), shown, "Figures of the paper and of this page.")
    page.section("All numbers")
    page.table(COLUMNS, [row.cells() for row in rows.values()], "In the paper's order.")
    page.table(("not in the paper", "here"), UNPUBLISHED, "Data that the paper does not give.")
    page.section("Time")
    times = [*study.seconds.items(), ("the whole, before this page", total)]
    caption = f"Seed {study.seed}. In virtual time: the rig's own clock runs ahead of this one's."
    page.table(("stage", "time [s]"), times, caption)
    return page


def verdict(study: Study) -> str:
    """The study's results beside the paper's, in a sentence."""
    both, alone = (study.compared(name)[0] for name in (PID, SPEED))
    said = [
        f"{dual.against(single)} {way} (settled in {dual.seconds}, {single.seconds})"
        for way, dual, single in (("up", both.up, alone.up), ("down", both.down, alone.down))
    ]
    r2, reduction = study.statics.rig.r2_adjusted, study.fine_tuning[0].reduction[0]
    return (
        f"On the emulated rig the cubic map has an adjusted R² of {r2:.4f} (paper {NUMBERS['r2_adjusted'].value:.3f}), "
        f"fine-tuning takes {reduction:.0f} % off the cost (paper {NUMBERS['cost_fall'].value:.0f} %), "
        f"and in squared error both actuators are, against speed alone, {said[0]} and {said[1]}."
    )


def tiles(study: Study, total: float) -> list[tuple[str, str, str]]:
    """(label, value, note) of the figures of the first screen."""
    both, alone = (study.compared(name)[0] for name in (PID, SPEED))
    rmse = study.found.predictions["validation"].rmse_thrust
    logged = sum(len(run) for loop, test in study.tests.items() if loop.plant != MODEL for run in test.runs)
    minutes = (seconds_on_rig(study.plan, PARTS) + 0.004 * logged) / 60.0
    found = [("error on an unseen record", f"{rmse:.3f} N", f"rms; the noise alone is {study.found.noise.std:.3f} N")]
    for way, dual, single in (("up", both.up, alone.up), ("down", both.down, alone.down)):
        errors = f"squared error {dual.squared_error:.3f} / {single.squared_error:.3f} s; rig, tuned gains"
        found.append((f"step {way}, both / speed alone", f"{dual.seconds} / {single.seconds}", errors))
    return [*found, ("the whole study", f"{total:.0f} s", f"{minutes:.0f} min on a real rig" if study.is_full else "quick")]


def _done(study: Study) -> str:
    plan, points = study.plan, study.campaign.static
    return (
        f"The paper's campaign on the emulated rig ({len(points.thrust)} steady points of {plan.samples} readings, "
        f"{len(study.campaign.steps)} steps, {3 * plan.section:g} s of open loop), then its model, fine-tuning, controllers, "
        "loops. Where only the paper's numbers are known, its model runs. Blades, inertia and the PI's unit of the emulated "
        "rig were fitted to the paper: where the two agree in map and speed, that confirms no physics."
    )


def _add_loops(page: Page, study: Study) -> dict[str, int]:
    page.section(
        "Loops (figures 2, 3)",
        "The paper draws the loops of speed and pitch, and the loop of the thrust around them, as blocks. Both run here as "
        "drawn; what their signals do is shown instead.",
    )
    found = dips(study.campaign.steps)
    level, depth, back = worst_dip(found)
    title = (
        f"The speed PI makes up for 20 deg of pitch: {depth:.0f} rpm lost at {level:g} rpm, back within 1 % after {back:.2f} s"
    )
    first = page.figure(
        speed_dips(found, title),
        "Pitch from -10 to 10 deg on the emulated rig, speed as mean over 0.1 s. The paper calls its PI 'effectively "
        "rejecting the disturbance caused by pitch changes', without a number.",
    )
    title = "Published gains: the proportional terms ask for far more than the actuators have, the integrals hold what stays"
    second = page.figure(
        stacked(*terms(study.compared(PID)[1]), title),
        "What each term of the two PIDs adds to its command around the step upwards, on the paper's model. Commands end "
        "at 1, and clamping stops the integrals there.",
    )
    r, identified = reduced(*AT), forms(study.found.refinement.uncertainty)
    rows = []
    for name, channel, pair in (
        ("speed, the text's relations", "omega", two_lags(r)["omega"]),
        ("speed, its zero counted", "omega", two_lags_with_zero(r)),
        ("pitch, the text's relations", "beta", two_lags(r)["beta"]),
    ):
        total, product = (identified[channel][form]["value"] if channel in identified else None for form in ("sum", "product"))
        rows.append((name, float(sum(pair).real), total, float(np.prod(pair).real), product))
    page.table(
        ("channel", "sum by gains [s]", "sum identified [s]", "product by gains [s²]", "product identified [s²]"),
        rows,
        f"Section 2.2: time constants from gains and parts, at {AT[0]:g} rpm and {AT[1]:g} deg. The text drops the zero of "
        "its PI; counting it comes nearer to what was identified. Pitch is identified from larger moves too, which meet the "
        "drive's limit.",
    )
    return {"2": first, "3": second}


def _add_static(page: Page, study: Study) -> dict[str, int]:
    s = study.statics
    page.section("Static map (figure 4)")
    title = (
        f"The cubic fits {len(s.difference)} points to {s.rig.rmse:.3f} N, adjusted R² {s.rig.r2_adjusted:.4f}; the paper's "
        f"map lies {rmse(s.difference):.2f} N rms off"
    )
    first = page.figure(static_map(s, title), "Lines: fitted to the rig; dotted: the paper's map, section 4.1.")
    used, measured = s.rig.used, s.points.thrust[s.rig.used]
    largest = float(np.max(np.abs(s.difference)))
    r2 = 1.0 - float(np.sum(s.difference**2)) / (len(measured) - len(STATIC_MAP)) / float(np.var(measured, ddof=1))
    title = (
        f"The rig is within {largest:.2f} N of the paper's map; the paper's points scatter by {s.scatter:.2f} N rms around it"
    )
    page.figure(
        map_residuals(s.points.omega_ref[used], s.points.beta_ref[used], s.difference, title),
        "Rig less the paper's map. Not a test of the physics: three numbers of its blades were fitted to that map. By the "
        f"unchanged map of the paper the rig's points have an adjusted R² of {r2:.4f}.",
    )
    speed, pitch = zip(*s.ct, strict=True)
    title = (
        f"Speed moves C_T by {speed[0]:.4f} rms, the paper's map by {speed[1]:.4f}; pitch by {pitch[0]:.2f} and {pitch[1]:.2f}"
    )
    second = page.figure(
        coefficient(s, title),
        "C_T = T / (ρ n² D⁴). On the rig all speeds draw one line, for its blades have no Reynolds number; the paper's linear "
        "and cubic terms in speed spread its lines, most at 2000 rpm.",
    )
    return {"4a": first, "4b": second}


def _add_steps(page: Page, study: Study) -> dict[str, int]:
    page.section(
        "Step responses (figures 5, 6)",
        "Fitted as the paper did: two lags to the thrust as a share of its step. Dashed: the paper's averaged time constants.",
    )
    rig, model = study.steps
    places, on_model = {}, []
    for number, (name, channel, *units) in CHANNELS.items():
        runs, kept = [run for run in rig.runs if run.channel == channel], rig.used(channel)
        slow, fast = lags(kept)[0]
        paper = tuple(AVERAGED[lag] for lag in LAGS[channel])
        title = (
            f"{len(kept)} of {len(runs)} {name} steps give {slow:.2f} and {fast:.2f} s on average, the paper's "
            f"{paper[0]:g} and {paper[1]:g} s"
        )
        figure = step_panels(runs, paper, title, *units)
        places[number] = page.figure(figure, "Thrust as a share of its step; black: fitted. Grey runs drown in noise.")
        slow, fast = lags(model.used(channel))[0]
        on_model.append((name, paper[0], float(slow), paper[1], float(fast)))
    page.table(
        ("step of pitch [deg]", "slow [s]", "fast [s]", "sum [s]"),
        [(size, *pair.tolist(), float(pair.sum())) for size, pair in by_size(rig, "beta").items()],
        "Why averages of pitch steps mislead: the actuator has a highest speed, so large steps take longer; two equal lags are "
        f"its mark. The paper averages {sum(AVERAGED[n] for n in LAGS['beta']):.2f} s over all sizes.",
    )
    page.table(
        ("channel", "slow, true [s]", "slow, found [s]", "fast, true [s]", "fast, found [s]"),
        on_model,
        f"The method on the paper's own initial model under the same steps, {noise_of(rig):.2f} N of noise: what it costs to "
        "read lags from a thrust that does not follow in a straight line.",
    )
    return places


def _add_fine_tuning(page: Page, study: Study) -> dict[str, int]:
    page.section("Fine-tuning (figures 7, 8)")
    (rig, model), noise = study.fine_tuning, study.found.noise.std
    title = (
        f"The paper's descent takes {rig.reduction[0]:.0f} % off the cost in {len(rig.costs) - 1} iterations; ours "
        f"{rig.reduction[1]:.0f} % in {len(rig.ours.curve) - 1}"
    )
    caption = (
        f"Descent {rig.seconds:.2f} s, ours {rig.ours.seconds:.2f} s. The paper's record is not published: its model under "
        "this record's commands, with noise that gives the paper's final cost, is used instead."
    )
    noise_cost = 0.5 * (noise / BASE.values()["thrust_scale"]) ** 2
    places = {"7": page.figure(learning_curves(rig, model, noise_cost, title), caption)}
    record = rig.record
    models = {INITIAL: rig.start, DESCENT: rig.values, OURS: study.found.parameters.values, PAPERS: FINE_TUNED}
    errors, lines = by_part(record, models), {n: predict(BASE, BASE.values(own), record).thrust for n, own in models.items()}
    del lines[DESCENT]
    for number, (part, name) in PARTS_SHOWN.items():
        rows, own = parts(record)[part], errors[part]
        title = f"{name.capitalize()} in action: {own[INITIAL]:.3f} N before, {own[OURS]:.3f} N after fine-tuning"
        shown = {name: line[rows] for name, line in lines.items()}
        figure = measured_against_predicted(record.part(rows), shown, title, noise)
        caption = "The published model is that of the paper's blades and actuator, not of these. "
        places[number] = page.figure(figure, caption + thinning(len(rows)))
    page.table(
        ("part", *(f"{name} [N]" for name in models)),
        [(part, *own.values()) for part, own in errors.items()],
        f"Thrust error, rms, of the record that was fitted; noise of one reading {noise:.3f} N. Fine-tuned: "
        "this project's identification, of this record and its repeat together.",
    )
    return places


def _add_control(page: Page, study: Study) -> dict[str, int]:
    repeats = len(study.compared(PID)[0].runs)
    page.section(
        "Control (figures 9, 10)",
        "On the paper's model (tau_beta_2 = 0.05 s) run the published gains, on the emulated rig the gains that were tuned for "
        f"the model its campaign gave. The rig's lines are means over {repeats} runs with other noise.",
    )
    places = {}
    for number, controllers in (("9", (PI, PID)), ("10", (SPEED, PID))):
        for plant, gains in ((MODEL, PUBLISHED), (RIG, TUNED)):
            tests = {name: study.tests[Loop(plant, gains, name)] for name in controllers}
            content = "; ".join(f"{name} {test.up.seconds} up, {test.down.seconds} down" for name, test in tests.items())
            runs = {name: test.mean for name, test in tests.items()}
            figure, run = closed_loop(runs, f"{plant.capitalize()}, {gains}: {content}"), tests[PID].mean
            if SPEED not in controllers:
                mark_reached(figure, steps(run)[0].time)
            figure.update_xaxes(range=[steps(run)[0].time - 0.5, float(run.time[-1])])
            here = page.figure(figure, "Settled: within 2 % of the step from then on. Commands dotted.")
            places.setdefault(number, here)
    tests = study.tests.items()
    page.table(
        ("loop", "controller", "up [s]", "overshoot [%]", "error [s]", "down [s]", "overshoot [%]", "error [s]"),
        [(f"{loop.plant}, {loop.gains}", loop.controller, *_cells(t.up), *_cells(t.down)) for loop, t in tests],
        "Both actuators against speed alone, up and down, in numbers. Up, down: settled after so many s, a dash: not before "
        "the next step. Error: of normalised thrust, squared, until the next step. Slew limits: 20 000 rpm/s and 60 deg/s, as "
        "vpp hil run has them.",
    )
    return places


def _cells(merit: Merit) -> tuple:
    error = merit.squared_error if merit.error_std is None else f"{merit.squared_error:.4f} ± {merit.error_std:.4f}"
    return merit.settling, merit.overshoot, error


def _published(dash: str, width: float = 2) -> dict:
    return {"colour": style.PUBLISHED, "width": width, "dash": dash}


def static_map(s: Statics, title: str) -> go.Figure:
    """The rig's points, the map fitted to them at each speed, and the paper's at every other of these speeds."""
    used = s.rig.used
    points = s.points.omega[used], s.points.beta_ref[used], s.points.thrust[used]
    speeds, beta = np.unique(s.points.omega_ref[used]), np.linspace(*OPERATING_PITCH, 25)
    omega, pitches = (grid.ravel() for grid in np.meshgrid(speeds, beta, indexing="ij"))
    fitted = design(omega, pitches, PAPER_UNITS) @ np.array(list(s.rig.coefficients.values()))
    fig = map_lines(speeds, beta, fitted.reshape(-1, 25), points, title)
    for k, values in enumerate(paper_thrust(omega, pitches).reshape(-1, 25)[::2]):
        shared = {"legendgroup": "paper's map", "showlegend": k == 0}
        add_line(fig, beta, values, "paper's map", **_published("dot"), **shared)
    return fig


def coefficient(s: Statics, title: str) -> go.Figure:
    """C_T of all the rig's points over the pitch, and by the paper's map at its lowest, middle and highest speed."""
    fig = thrust_coefficients(*coefficient_grid(s.points), title)
    beta = np.linspace(*OPERATING_PITCH, 31)
    for speed, dash in ((2000.0, "dot"), (4000.0, "dash"), (6000.0, "solid")):
        at = np.full_like(beta, speed)
        values = thrust_coefficient(paper_thrust(at, beta), at)
        add_line(fig, beta, values, f"paper, {speed:.0f} rpm", **_published(dash))
    return fig


def step_panels(runs: Sequence[StepRun], paper: tuple[float, float], title: str, unit: str, level_unit: str) -> go.Figure:
    """Every step of a channel with its fit, and in each panel the response of the paper's averaged lags (slow, fast) s."""
    fig, time = step_responses(runs, title, unit, level_unit), np.linspace(-0.2, 1.5, 86)
    shares, name = np.round(lag_response(time, *paper)[:, 0], 4), f"paper: {paper[0]:g} and {paper[1]:g} s"
    panels = dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in fig.data)
    for k, (x, y) in enumerate(panels):
        shared = {"legendgroup": name, "showlegend": k == 0, "legendrank": 4, "xaxis": x, "yaxis": y}
        add_line(fig, time, shares, name, **_published("dash", 1.8), **shared)
    return fig


def learning_curves(rig: FineTuning, model: FineTuning, noise_cost: float, title: str) -> go.Figure:
    """The paper's cost over iterations: its own two numbers, its descent on the rig's record and on its model's, our search."""
    fig = figure(title, 460, "iterations [-]", "cost mean(e²)/2 [-]")
    add_points(fig, [0, ITERATIONS], [COST_START, COST_END], "paper, published", style.PUBLISHED, 11, "diamond")
    for name, tuned, colour in (("emulated rig", rig, style.AFTER), ("paper's model", model, style.OTHERS[1])):
        ours = np.array(tuned.ours.curve) / tuned.ours.problem.size
        add_line(fig, np.arange(len(tuned.costs)), tuned.costs, f"{name}, the paper's descent", colour, 2)
        add_line(fig, np.arange(len(ours)), ours, f"{name}, our search", colour, 2, dash="dot", mode="lines+markers")
    add_level(fig, noise_cost, "noise of the rig alone", 1.2)
    fig.update_yaxes(type="log", dtick="D2", tickformat=".0e")
    return fig


def mark_reached(fig: go.Figure, step: float) -> None:
    """A line where the paper's step has reached its set-point; `step`: its time, s."""
    name = f"paper: reached about {REACHED:g} s after the step"
    line = {"color": style.PUBLISHED, "width": 1.8, "dash": "dash"}
    fig.add_vline(x=step + REACHED, line=line, name=name, showlegend=True)


def speed_dips(found: Mapping[float, tuple[np.ndarray, np.ndarray]], title: str) -> go.Figure:
    """Speed less its command [rpm] over the time [s] from a step of pitch, by the level of speed [rpm]."""
    fig = figure(title, 380, "time from the step [s]", "speed less its command [rpm]")
    colours = style.colours(f"{level:g} rpm" for level in found)
    for (time, dip), (name, colour) in zip(found.values(), colours.items(), strict=True):
        add_line(fig, time, dip, name, colour, 1.6, shape="hv")
    fig.update_xaxes(range=[-0.5, 3.0])
    return fig
