"""Counterparts of the paper's control design (section 4.3)."""

from dataclasses import replace

import numpy as np

from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.paper.control import LIMITED, MODEL, PID, PUBLISHED, RIG, SPEED, TUNED, Loop, Merit, judged
from vpp_fmu.paper.counterpart import Counterpart, of_setup
from vpp_fmu.paper.study import Study
from vpp_fmu.response import steps

UP, DOWN = 0, 1


def control_rows(study: Study) -> dict[str, Counterpart]:
    """By the names in `published`."""
    return _test(study) | _steps(study) | _gains(study)


def seconds(merit: Merit) -> str:
    """A settling time as text."""
    return "not settled" if merit.settling is None else f"{merit.settling:.2f} s"


def against(study: Study, plant: str, gains: str, way: int) -> str:
    """Settling times of both actuators and of speed alone."""
    dual, alone = (study.control.merits[Loop(plant, gains, name)][way] for name in (PID, SPEED))
    return f"both {seconds(dual)}, speed {seconds(alone)}"


def shaking(study: Study, gains: str) -> float:
    """rpm rms by which reading noise shakes the speed command on the rig, both actuators, before the step.

    From the differences of neighbouring commands, so that slow changes do not count.
    """
    run = study.control.single[Loop(RIG, gains, PID)]
    return float(np.std(np.diff(run["omega_ref"][run.time < steps(run)[0].time])) / np.sqrt(2.0))


def without_noise(study: Study) -> Merit:
    """The step up under the published gains of both actuators, on the rig's model, its readings without noise."""
    objective = study.control.tuned[RIG].tuned["dual"].objective
    course = replace(objective.course, noise=np.zeros_like(objective.course.noise))
    return judged(replace(objective, course=course).run(objective.gains))[UP]


def _test(study: Study) -> dict[str, Counterpart]:
    runs, scale = study.control.runs, study.found.parameters.values["thrust_scale"]
    both, alone = ([Loop(RIG, TUNED, name), Loop(MODEL, PUBLISHED, name)] for name in (PID, SPEED))
    first = [steps(runs[loop])[0] for loop in both]
    fixed = [float(np.median(runs[loop]["beta_ref"])) for loop in alone]
    return {
        "t_filter": of_setup("t_filter", *(study.control.settings[loop]["t_filter"] for loop in both)),
        "step_from": of_setup("step_from", *(step.before / scale for step in first)),
        "step_to": of_setup("step_to", *(step.after / scale for step in first)),
        "step_at": of_setup("step_at", *(step.time for step in first), "the next sample of the controller"),
        "beta_fixed": of_setup("beta_fixed", *fixed),
    }


def _steps(study: Study) -> dict[str, Counterpart]:
    merits = study.control.merits
    rig, model = (merits[loop][UP] for loop in (Loop(RIG, TUNED, PID), Loop(MODEL, PUBLISHED, PID)))
    published, limited = (merits[loop][UP] for loop in (Loop(RIG, PUBLISHED, PID), Loop(LIMITED, TUNED, PID)))
    why = (
        f"to 2 % of the step; rig: tuned gains. The published ones take {seconds(published)} there, on its model without noise "
        f"{seconds(without_noise(study))}: they shake the speed command by {shaking(study, PUBLISHED):.0f} rpm, into its limits"
    )
    down = [merits[loop][DOWN].overshoot for loop in (Loop(RIG, TUNED, PID), Loop(MODEL, PUBLISHED, PID))]
    over = f"the tuning allows 1 % on the model; down {down[0]:.1f} % on the rig, {down[1]:.1f} % on the model"
    behind = f"behind the slew limits of vpp hil run {seconds(limited)} and {limited.overshoot:.1f} %"
    return {
        "reached": Counterpart(rig.settling, model.settling, why),
        "overshoot": Counterpart(rig.overshoot, model.overshoot, f"{over}; {behind}"),
        "up": _way(study, UP, _reached(study)),
        "down": _way(study, DOWN, "pitch takes thrust away while the rotor still runs down"),
    }


def _way(study: Study, way: int, why: str) -> Counterpart:
    """Both actuators against speed alone, and what the second one brings by the squared error."""
    told = []
    for plant, gains in ((RIG, TUNED), (MODEL, PUBLISHED)):
        dual, alone = (study.control.merits[Loop(plant, gains, name)][way].squared_error for name in (PID, SPEED))
        told.append(f"{against(study, plant, gains, way)}, squared error {100.0 * (dual / alone - 1.0):+.0f} %")
    return Counterpart(*told, f"squared error: of both over speed alone's. {why}")


def _reached(study: Study) -> str:
    """Where the commands of both and of speed alone end on the rig, above: the farther the rotor has to go, the longer."""
    ends = []
    for name in (PID, SPEED):
        run = study.control.runs[Loop(RIG, TUNED, name)]
        above = run.time > steps(run)[DOWN].time - 1.0
        above &= run.time < steps(run)[DOWN].time
        ends.append((float(run["omega"][above].mean()), float(run["beta_ref"][above].mean())))
    (both, pitch), (alone, fixed) = ends
    return f"both end at {both:.0f} rpm and {pitch:.1f} deg, speed alone at {alone:.0f} rpm and {fixed:.0f} deg"


def _gains(study: Study) -> dict[str, Counterpart]:
    found = {}
    for prefix, published in (("dual", DUAL), ("speed_only", SPEED_ONLY)):
        rig, model = (study.control.tuned[plant].tuned[prefix] for plant in (RIG, MODEL))
        own = [dict(zip(tuned.objective.names, tuned.final.tolist(), strict=True)) for tuned in (rig, model)]
        worst = [max(m.sensitivity for m in model.margins[which]) for which in ("start", "tuned")]
        why = (
            f"cost under published, tuned gains {model.cost('start'):.4f}, {model.cost('tuned'):.4f} on the paper's model, "
            f"{rig.cost('start'):.4f}, {rig.cost('tuned'):.4f} on the rig's; largest sensitivity {worst[0]:.2f} and "
            f"{worst[1]:.2f} on the paper's"
        )
        found |= {f"{prefix}.{name}": Counterpart(own[0][name], own[1][name], why) for name in published if name in own[0]}
    return found
