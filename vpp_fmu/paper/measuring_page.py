"""The report's sections on what was measured: loops of the rig, static map, step responses (paper's figures 2 to 6)."""

import numpy as np

from hil.physics.reduction import reduced, two_lags, two_lags_with_zero
from identification.assessment.pairs import forms
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.paper import figures
from vpp_fmu.paper.averages import by_size, lags, runs_of
from vpp_fmu.paper.control import MODEL, PID, PUBLISHED, Loop
from vpp_fmu.paper.loop_figures import dips, terms, worst_dip
from vpp_fmu.paper.study import Study
from vpp_fmu.report import Page, map_residuals, stacked

AT = 4500.0, 4.0
"""rpm, deg around which the relations between gains and time constants are taken: where the open loop rests."""


def add_loops(page: Page, study: Study) -> dict[str, int]:
    """The speed loop under steps of pitch, and the terms of the thrust loop; the paper has block diagrams."""
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
    places = {
        "2": page.figure(
            figures.speed_dips(found, title),
            "Pitch from -10 to 10 deg on the emulated rig, speed as mean over 0.1 s. The paper calls its PI 'effectively "
            "rejecting the disturbance caused by pitch changes', without a number.",
        )
    }
    time, panels = terms(study.control, Loop(MODEL, PUBLISHED, PID))
    title = "Published gains: the proportional terms ask for far more than the actuators have, the integrals hold what stays"
    places["3"] = page.figure(
        stacked(time, panels, title),
        "What each term of the two PIDs adds to its command around the step upwards, on the paper's model. Commands end "
        "at 1, and clamping stops the integrals there.",
    )
    _add_relations(page, study)
    return places


def _add_relations(page: Page, study: Study) -> None:
    """What the paper's relations make of the rig's gains, beside what the record says."""
    r, found = reduced(*AT), forms(study.found.refinement.uncertainty)
    text, zero = two_lags(r), two_lags_with_zero(r)
    rows = []
    for name, channel, pair in (
        ("speed, the text's relations", "omega", text["omega"]),
        ("speed, its zero counted", "omega", zero),
        ("pitch, the text's relations", "beta", text["beta"]),
    ):
        identified = found.get(channel)
        told = [None if identified is None else identified[form]["value"] for form in ("sum", "product")]
        rows.append((name, float(sum(pair).real), told[0], float(np.prod(pair).real), told[1]))
    page.table(
        ("channel", "sum by gains [s]", "sum identified [s]", "product by gains [s²]", "product identified [s²]"),
        rows,
        f"Section 2.2: time constants from gains and parts, at {AT[0]:g} rpm and {AT[1]:g} deg. The text drops the zero of "
        "its PI; counting it comes nearer to what was identified. Pitch is identified from larger moves too, which meet the "
        "drive's limit.",
    )


def add_static(page: Page, study: Study) -> dict[str, int]:
    """Map and thrust coefficient."""
    s = study.statics
    page.section("Static map (figure 4)")
    largest = float(np.max(np.abs(s.apart)))
    title = (
        f"The cubic fits {len(s.apart)} points to {s.rig.rmse:.3f} N, adjusted R² {s.rig.r2_adjusted:.4f}; the paper's map "
        f"lies {s.apart_rms:.2f} N rms off"
    )
    first = page.figure(figures.static_map(s, title), "Lines: fitted to the rig; dotted: the paper's map, section 4.1.")
    title = (
        f"The rig is within {largest:.2f} N of the paper's map; the paper's points scatter by {s.scatter:.2f} N rms around it"
    )
    used = s.rig.used
    page.figure(
        map_residuals(s.points.omega_ref[used], s.points.beta_ref[used], s.apart, title),
        "Rig less the paper's map. Not a test of the physics: three numbers of its blades were fitted to that map. By the "
        f"paper's map, as it stands, the rig's points have an adjusted R² of {s.r2_of_paper:.4f}.",
    )
    speed, pitch = s.ct_by_speed, s.ct_by_pitch
    title = (
        f"Speed moves C_T by {speed[0]:.4f} rms, the paper's map by {speed[1]:.4f}; pitch by {pitch[0]:.2f} and {pitch[1]:.2f}"
    )
    second = page.figure(
        figures.coefficient(s, title),
        "C_T = T / (ρ n² D⁴). On the rig all speeds draw one line, for its blades have no Reynolds number; the paper's linear "
        "and cubic terms in speed spread its lines, most at 2000 rpm.",
    )
    return {"4a": first, "4b": second}


def add_steps(page: Page, study: Study) -> dict[str, int]:
    """Step responses of both inputs."""
    page.section(
        "Step responses (figures 5, 6)",
        "Fitted as the paper did: two lags to the thrust as a share of its step. Dashed: the paper's averaged time constants.",
    )
    places = {}
    for number, channel, unit, level, slow in (("5", "omega", "rpm", "deg", 1), ("6", "beta", "deg", "rpm", 2)):
        runs = [run for run in study.averages.rig.runs if run.channel == channel]
        kept, fast = runs_of(study.averages.rig, channel), 3 - slow
        means, paper = lags(kept)[0], (AVERAGED[f"tau_{channel}_{slow}"], AVERAGED[f"tau_{channel}_{fast}"])
        name = "speed" if channel == "omega" else "pitch"
        title = (
            f"{len(kept)} of {len(runs)} {name} steps give {means[0]:.2f} and {means[1]:.2f} s on average, the paper's "
            f"{paper[0]:g} and {paper[1]:g} s"
        )
        figure = figures.steps(runs, paper, title, unit, level)
        places[number] = page.figure(figure, "Thrust as a share of its step; black: fitted. Grey runs drown in noise.")
    sizes = by_size(study.averages.rig, "beta")
    rows = [(size, slow, fast, slow + fast) for size, (slow, fast) in sizes.items()]
    page.table(
        ("step of pitch [deg]", "slow [s]", "fast [s]", "sum [s]"),
        rows,
        "Why averages of pitch steps mislead: the actuator has a highest speed, so large steps take longer; two equal lags are "
        f"its mark. The paper averages {sum(AVERAGED[n] for n in ('tau_beta_1', 'tau_beta_2')):.2f} s over all sizes.",
    )
    noise, models = study.averages.noise, {c: lags(runs_of(study.averages.model, c))[0] for c in ("omega", "beta")}
    rows = [
        (
            name,
            float(BASE.values(AVERAGED)[f"tau_{c}_{slow}"]),
            float(models[c][0]),
            float(BASE.values(AVERAGED)[f"tau_{c}_{3 - slow}"]),
            float(models[c][1]),
        )
        for name, c, slow in (("speed", "omega", 1), ("pitch", "beta", 2))
    ]
    page.table(
        ("channel", "slow, true [s]", "slow, found [s]", "fast, true [s]", "fast, found [s]"),
        rows,
        f"The method on the paper's own initial model under the same steps, {noise:.2f} N of noise: what it costs to read lags "
        "from a thrust that does not follow in a straight line.",
    )
    return places
