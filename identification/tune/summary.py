"""The content of tuning.json, and its key figures."""

import numpy as np

from identification.tune.margins import least
from identification.tune.objective import SLACK
from identification.tune.tune import JUDGED, Tuned, Tuning
from identification.tune.verdict import Verdict
from vpp_fmu.digits import number
from vpp_fmu.record import Record
from vpp_fmu.response import Step

NAMES = {"dual": "both actuators", "speed_only": "speed alone", "allocated": "both actuators on the best pairs"}


def labels(found: Tuning, tuned: Tuned) -> dict[str, str]:
    return {which: found.task.reference if which == "start" else which for which in tuned.gains}


def step_error(run: Record, step: Step, end: float, scale: float) -> float:
    """Integral of the squared normalised error [s] from a step to the time `end` of the next."""
    rows = (run.time >= step.time - 1e-9) & (run.time < end - 1e-9)
    return float(np.sum(((run["thrust_set"] - run["thrust"])[rows] / scale) ** 2) * (run.time[1] - run.time[0]))


def summary(found: Tuning) -> dict:
    """The content of tuning.json."""
    task, first = found.task, next(iter(found.tuned.values())).objective
    measurement = {name: value for name, value in first.chain.items() if name != "sample_time"}
    return {
        "format": "vpp-tuning/1",
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
        "rig": task.parameters.rig.summary(),
        "reference": task.reference,
        "left_out": dict(task.left_out),
        "controllers": {name: _controller(found, each) for name, each in found.tuned.items()},
        "dual_against_speed_only": against(found),
        "seconds": found.seconds,
    }


def _controller(found: Tuning, tuned: Tuned) -> dict:
    names, limits = labels(found, tuned), ("omega_min", "omega_max", "beta_min", "beta_max", "beta_fixed")
    content: dict = {"handed_out": names[tuned.chosen], "limits": {name: tuned.objective.settings[name] for name in limits}}
    content |= {"verdict": {which: each.summary() for which, each in tuned.verdicts.items()}}
    content |= {names[which]: _gains(tuned, which) for which in tuned.gains}
    content["fmu_difference_thrust"] = tuned.fmu_difference
    if tuned.judged:
        content["judged"] = {
            names[which]: {
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
        {"thrust": p.thrust, "commands": list(p.commands), "channels": list(p.channels), **vars(m)}
        for p, m in zip(tuned.points[which], tuned.margins[which], strict=True)
    ]
    return {
        "gains": dict(zip(tuned.objective.names, gains.tolist(), strict=True)),
        "cost": tuned.cost(which),
        "squared_error": float(tuned.objective.nominal.merits(gains)[0, 0]),
        "steps": [vars(step) for step in tuned.objective.steps(gains)],
        "margins": points,
    }


def against(found: Tuning) -> list[dict]:
    """Compare both actuators with speed alone on each step, under the chosen gains."""
    columns = {}
    for name, tuned in found.tuned.items():
        run, scale = tuned.objective.run(tuned.final), tuned.objective.course.scale
        columns[name] = [(step, step_error(run, step, step.end, scale)) for step in tuned.objective.steps(tuned.final)]
    rows = []
    for row in zip(*columns.values(), strict=True):
        step = row[0][0]
        rows.append({"time": step.time, "before": step.before, "after": step.after})
        for name, (own, error) in zip(columns, row, strict=True):
            rows[-1][name] = {"settling": own.settling, "overshoot": own.overshoot, "squared_error": error}
    return rows


def headline(found: Tuning) -> str:
    """The result in a sentence for each controller."""
    said = []
    for name, tuned in found.tuned.items():
        start, slow = tuned.cost("start"), [step.settling for step in tuned.objective.steps(tuned.final)]
        settle = "" if None in slow or not slow else f", every step settles within {number(max(slow), 3)} s"
        new = f"cost {number(start, 3)} -> {number(tuned.cost(tuned.chosen), 3)}"
        text = f"{found.task.reference} are kept, cost {number(start, 3)}" if tuned.chosen == "start" else f"new gains, {new}"
        said.append(f"{NAMES[name].capitalize()}: {text}{settle}.")
    return " ".join(said)


def key_figures(found: Tuning) -> list[tuple[str, str, str]]:
    """(label, value, note) of each key figure, the most important first."""
    figures = []
    for row in against(found) if len(found.tuned) > 1 else ():
        errors = [row[name]["squared_error"] for name in found.tuned]
        times = [settling(row[name]["settling"]) for name in found.tuned]
        note = f"settling; {times[1]} with speed alone; squared error {number(errors[0])} against {number(errors[1])} s"
        figures.append((f"step {row['before']:.3g} → {row['after']:.3g} N, both actuators", times[0], note))
    for name, tuned in found.tuned.items():
        for which, each in tuned.verdicts.items():
            word = "better" if each.better else "no better"
            figures.append((f"{which} gains, {NAMES[name]}", word, each.words().partition(": ")[2]))
        figures.append((f"cost, {NAMES[name]}", *_cost_words(found, tuned)))
        figures.append((f"phase margin, {NAMES[name]}", *_margins_note(found, tuned)))
    for name, tuned in found.tuned.items():
        if tuned.judged:
            over = np.mean if found.task.robust == "mean" else np.max
            costs = [over(tuned.judged[which]) for which in ("tuned", "robust")]
            price = _percent(tuned.cost("robust") / tuned.cost("tuned") - 1.0)
            note = f"{found.task.robust} of {JUDGED} other plants, nominal against robust; on the nominal plant {price}"
            figures.append((f"robust, {NAMES[name]}", f"{number(costs[0])} → {number(costs[1])}", note))
    largest = max(tuned.fmu_difference for tuned in found.tuned.values())
    same = "the same thrust to the bit" if largest == 0.0 else f"thrust within {largest:.2g} N"
    figures.append(("exported FMUs against the loop of the search", same, "the chosen gains, over the profile"))
    return figures


def _cost_words(found: Tuning, tuned: Tuned) -> tuple[str, str]:
    """(cost of the initial and of the chosen gains, their labels)."""
    start, others = tuned.cost("start"), {which: tuned.cost(which) for which in tuned.verdicts}
    if tuned.chosen == "start":
        changes = (f"{which} {number(cost)}, {_percent(cost / start - 1.0)}" for which, cost in others.items())
        return f"{number(start)}, kept", f"{found.task.reference}; {'; '.join(changes)}"
    cost = others[tuned.chosen]
    return f"{number(start)} → {number(cost)}", f"{_percent(cost / start - 1.0)}, {found.task.reference} → {tuned.chosen}"


def _percent(share: float) -> str:
    return f"{100.0 * share:+.2g} %"


def _margins_note(found: Tuning, tuned: Tuned) -> tuple[str, str]:
    """(smallest phase margin of the chosen gains, note)."""
    own, first = (least(tuned.margins[which]) for which in (tuned.chosen, "start"))
    if own is None:
        return "none", "no operating point with a command within its limits"
    if not own.stable:
        return "unstable", "at one operating point at least"
    points = len(tuned.margins[tuned.chosen])
    gain = "any" if own.gain is None else f"{20.0 * np.log10(own.gain):.3g} dB"
    delay = "" if own.delay is None else f", delay {1e3 * own.delay:.3g} ms"
    note = f"gain {gain}{delay}: the smallest over {points} operating points; sensitivity up to {own.sensitivity:.3g}"
    before = f", {found.task.reference} {first.sensitivity:.3g}" if first else ""
    over = f", more than the limit {found.task.sensitivity:g}" if own.sensitivity > SLACK * found.task.sensitivity else ""
    return "any" if own.phase is None else f"{own.phase:.3g} deg", note + before + over


def change_rows(verdict: Verdict) -> list[tuple[str, str, str, str]]:
    """(step, settling, overshoot, ringing), before and after, of each step."""
    return [(s.name, *(c.text() + (" worse" if c.worse else "") for c in s.changes)) for s in verdict.steps]


def margin_rows(verdict: Verdict) -> list[tuple[str, str]]:
    """(margin, before and after) at the worst operating point."""
    first, other = verdict.margins
    if first is None or other is None:
        return []

    def both(name: str, digits: str, unit: str, scaled=lambda v: v) -> str:
        shown = ("any" if (v := getattr(m, name)) is None else f"{scaled(v):{digits}}" for m in (first, other))
        return f"{' → '.join(shown)}{unit}"

    return [
        ("gain margin", both("gain", ".3g", " dB", lambda v: 20.0 * np.log10(v))),
        ("phase margin", both("phase", ".3g", " deg")),
        ("delay margin", both("delay", ".3g", " ms", lambda v: 1e3 * v)),
        ("largest sensitivity", both("sensitivity", ".3g", "")),
        ("stable", " → ".join("everywhere" if m.stable else "not everywhere" for m in (first, other))),
    ]


def settling(seconds: float | None) -> str:
    return "not settled" if seconds is None else f"{seconds:.3g} s"
