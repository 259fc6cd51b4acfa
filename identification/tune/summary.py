"""The content of tuning.json, and what of it a reader must know first."""

import numpy as np

from identification.tune.tune import JUDGED, Tuned, Tuning
from vpp_fmu.record import Record
from vpp_fmu.response import Step, steps

NAMES = {"dual": "both actuators", "speed_only": "speed alone"}


def judged_steps(tuned: Tuned, which: str) -> list[Step]:
    """Steps of the wanted thrust in the loop with these gains; changes too small to judge are left out."""
    return [s for s in steps(tuned.objective.run(tuned.gains[which])) if abs(s.after - s.before) >= tuned.objective.course.jump]


def step_error(run: Record, step: Step, following: float, scale: float) -> float:
    """Integral of the squared normalised error [s] from a step to the time of the next."""
    rows = (run.time >= step.time - 1e-9) & (run.time < following - 1e-9)
    return float(np.sum(((run["thrust_set"] - run["thrust"])[rows] / scale) ** 2) * (run.time[1] - run.time[0]))


def summary(found: Tuning) -> dict:
    """As CONTRACT.md names the file."""
    task, first = found.task, next(iter(found.tuned.values())).objective
    measurement = {name: value for name, value in first.chain.items() if name != "sample_time"}
    return {
        "objective": {
            "cost": "integral of the squared normalised thrust error [s] + alpha |gains|^2",
            "alpha": task.alpha,
            "profile": task.profile.source,
            "overshoot_limit": task.overshoot,
            "sensitivity_limit": task.sensitivity,
            "sample_time": first.course.dt,
            "measurement": {**measurement, "noise": task.noise_std},
            "assumed": {name: task.parameters.values[name] for name in task.assumed},
            "effects": list(task.parameters.model.optional),
            "robust": task.robust,
            "draws": task.draws if task.robust else 0,
            "seed": task.seed,
        },
        "controllers": {name: _controller(each, task.reference) for name, each in found.tuned.items()},
        "dual_against_speed_only": against(found),
        "seconds": found.seconds,
    }


def _controller(tuned: Tuned, reference: str) -> dict:
    names = {"start": reference}
    content = {names.get(which, which): _gains(tuned, which) for which in tuned.gains}
    content["evaluations"] = {which: len(each.curve) for which, each in tuned.searches.items()}
    content["stages"] = {which: [list(stage) for stage in each.stages] for which, each in tuned.searches.items()}
    content["fmu_difference_thrust"] = tuned.fmu_difference
    if tuned.judged:
        content["judged"] = {
            names.get(which, which): {
                "plants": JUDGED,
                "worst": float(costs.max()),
                "mean": float(costs.mean()),
                "overshoot": float(100.0 * tuned.overshoots[which].max()),
            }
            for which, costs in tuned.judged.items()
        }
        content["price_of_robustness"] = tuned.cost("robust") / tuned.cost("tuned") - 1.0
    return content


def _gains(tuned: Tuned, which: str) -> dict:
    gains = tuned.gains[which]
    points = [
        {"thrust": p.thrust, "commands": list(p.commands), "channels": list(p.channels), **m.summary()}
        for p, m in zip(tuned.points[which], tuned.margins[which], strict=True)
    ]
    return {
        "gains": dict(zip(tuned.objective.names, gains.tolist(), strict=True)),
        "cost": tuned.cost(which),
        "squared_error": float(tuned.objective.nominal.merits(gains)[0, 0]),
        "steps": [vars(step) for step in judged_steps(tuned, which)],
        "margins": points,
    }


def against(found: Tuning) -> list[dict]:
    """Each step, up and down, with both actuators and with speed alone: the gains that were asked for."""
    columns = {}
    for name, tuned in found.tuned.items():
        which = list(tuned.gains)[-1]
        run, judged = tuned.objective.run(tuned.gains[which]), judged_steps(tuned, which)
        ends = [step.time for step in judged[1:]] + [float(run.time[-1])] * bool(judged)
        scale = tuned.objective.course.scale
        columns[name] = [(step, step_error(run, step, end, scale)) for step, end in zip(judged, ends, strict=True)]
    rows = []
    for row in zip(*columns.values(), strict=True):
        step = row[0][0]
        rows.append({"time": step.time, "before": step.before, "after": step.after})
        for name, (own, error) in zip(columns, row, strict=True):
            rows[-1][name] = {"settling": own.settling, "overshoot": own.overshoot, "squared_error": error}
    return rows


def key_figures(found: Tuning) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    figures = []
    for name, tuned in found.tuned.items():
        start, cost = tuned.cost("start"), tuned.cost("tuned")
        told = [_told_steps(tuned, which) for which in ("tuned", "start")]
        note = f"{cost / start - 1.0:+.1%}; {told[0]}, {found.task.reference}: {told[1]}"
        figures.append((f"cost, {NAMES[name]}", f"{start:.4f} → {cost:.4f}", note))
        figures.append((f"margins, {NAMES[name]}", *told_margins(tuned, found.task.reference)))
    for row in against(found) if len(found.tuned) > 1 else ():
        errors = [row[name]["squared_error"] for name in found.tuned]
        times = " against ".join(settling(row[name]["settling"]) for name in found.tuned)
        label = f"step {row['before']:.3g} → {row['after']:.3g} N, dual against speed alone"
        figures.append((label, times, f"squared error {errors[0]:.4f} against {errors[1]:.4f} s"))
    for name, tuned in found.tuned.items():
        if tuned.judged:
            over = np.mean if found.task.robust == "mean" else np.max
            costs = [over(tuned.judged[which]) for which in ("tuned", "robust")]
            price = tuned.cost("robust") / tuned.cost("tuned") - 1.0
            note = f"{found.task.robust} of {JUDGED} other plants, nominal against robust; on the nominal plant {price:+.1%}"
            figures.append((f"robust, {NAMES[name]}", f"{costs[0]:.4f} → {costs[1]:.4f}", note))
    largest = max(tuned.fmu_difference for tuned in found.tuned.values())
    figures.append(("through the FMUs", f"{largest:.2g} N", "largest difference of thrust to the tuned loop, both controllers"))
    return figures


def told_margins(tuned: Tuned, reference: str) -> tuple[str, str]:
    """(least margins of the gains that were asked for, where they belong)."""
    margins = list(tuned.margins.values())[-1]
    if not margins:
        return "none", "no operating point at which a command is free"
    if not all(m.stable for m in margins):
        return "unstable", "at one operating point at least"
    gain, phase, delay = ([v for m in margins if (v := getattr(m, name)) is not None] for name in ("gain", "phase", "delay"))
    parts = [f"{20.0 * np.log10(min(gain)):.1f} dB" if gain else "any gain"]
    parts += [f"{min(phase):.0f} deg, {1e3 * min(delay):.0f} ms" if phase else "any phase"]
    worst, before = (max(m.sensitivity for m in each) for each in (margins, tuned.margins["start"] or margins))
    note = f"gain, phase, delay: the least of {len(margins)} operating points; sensitivity up to {worst:.2f}"
    return ", ".join(parts), f"{note}, {reference} {before:.2f}"


def settling(seconds: float | None) -> str:
    """A settling time as text."""
    return "not settled" if seconds is None else f"{seconds:.3f} s"


def _told_steps(tuned: Tuned, which: str) -> str:
    return " and ".join(f"{settling(s.settling)} {s.overshoot:.1f} %" for s in judged_steps(tuned, which)[:2]) or "no steps"
