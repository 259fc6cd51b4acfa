"""The comparison: every number of the paper, ours on the emulated rig and on the paper's model, and why they differ.

A table holds (rig, model, why), and for an estimate its standard deviation on the rig, by the names in `published`.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from hil.devices.ads1115 import LARGEST, SMALLEST
from hil.devices.frames import ANSWER, FROM_BOARD
from hil.physics.propeller import RPM, settled_inflow
from hil.physics.rig_model import FULL_RIG
from hil.safety.limits import Limits
from identification.assessment.quality import rmse
from identification.fit.refine import paper_cost
from identification.static.static_map import design
from identification.static.steady import samples_needed
from vpp_fmu.app.paper.control import LIMITED, MODEL, PID, PUBLISHED, RIG, SPEED, TUNED, Loop, emulated, judged
from vpp_fmu.app.paper.published import ASSUMED, COST_END, ITERATIONS, LAGS, NUMBERS, STATIC_MAP, Row, shown
from vpp_fmu.app.paper.study import PAPER_UNITS, Study, by_part, by_size, lags, paper_thrust, parts
from vpp_fmu.kernel import ops
from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.record import Record
from vpp_fmu.response import steps

GRAVITY = 9.80665

GOOD = 0.01
"""Required standard deviation of a mean, N."""

THIRTEEN = (
    *("apparent_mass", "inertia", "j_a", "d_a", "kv", "drag", "k_a"),
    *("resistance", "r_a", "inductance", "l_a", "kv", "k_ia"),
)
"""tau_lambda, J, J_a, D_a, k_Q, k_omega, k_a, R_m, R_a, L_m, L_a, k_i, k_ia in the rig's physics; k_Q and k_i come from KV."""

NOT_PUBLISHED = "not published, so chosen here"


def compared(study: Study) -> dict[str, Row]:
    """All rows by name, in the paper's order. KeyError: a number without a counterpart."""
    ours, columns = {}, ("rig", "model", "why", "std")
    for table in (_stand, _campaign, _models):
        ours |= {name: (*values, as_paper(name, values[0], note)) for name, (*values, note) in table(study).items()}
    for table in (_chosen, _static, _averaged, _steps_seen, _fine_tuned, _costs, _improved, _merits, _gains):
        ours |= table(study)
    return {name: replace(row, **dict(zip(columns, ours[name], strict=False))) for name, row in NUMBERS.items()}


def as_paper(name: str, rig: float | str, note: str = "") -> str:
    """In words, whether a value of the set-up, which is not estimated, is the paper's."""
    same = "as the paper" if shown(rig) == shown(NUMBERS[name].value) else "not as the paper"
    return f"{same}; {note}" if note else same


def _stand(study: Study) -> dict[str, tuple]:
    """Parts and gains of the stand: (rig, model, note)."""
    setup = emulated(Limits(), study.seed)
    p = FULL_RIG.values(setup.emulated.parameters)
    reach = -abs(setup.calibration.newton_per_count) * SMALLEST / GRAVITY
    speed = f"without a published unit, one of the PI's output is {p['throttle_unit']:g} of the throttle (chosen)"
    pitch = "without a published unit, drive per share of the travel (chosen)"
    return {
        "kv": (p["kv"], None, ""),
        "supply": (p["supply_voltage"], None, ""),
        "actuator_supply": (p["v_a"], None, ""),
        "load_cell": (reach, None, "the converter's range behind the emulated amplifier"),
        "adc": (float(np.log2(LARGEST - SMALLEST + 1)), None, "the same part, by its registers"),
        **{name: (p[name], None, speed) for name in ("kp_rpm", "ki_rpm")},
        **{name: (p[name], None, pitch) for name in ("kp_lac", "kd_lac")},
    }


def _campaign(study: Study) -> dict[str, tuple]:
    """How the campaign was measured: (rig, model, note)."""
    files, plan, runs, hurry = study.campaign, study.plan, study.steps[0].runs, "" if study.is_full else "a quick study"
    speeds, pitches = np.unique(files.static.omega_ref), np.unique(files.static.beta_ref)
    noise = (files.open_loop["thrust"] - files.repeat["thrust"]) / np.sqrt(2.0)
    enough = f"{samples_needed(noise[np.isfinite(noise)], GOOD).number} make a mean good to {GOOD:g} N here"
    step = files.steps[0]
    at = int(np.argmax(np.abs(np.diff(step["omega_ref"])) + np.abs(np.diff(step["beta_ref"])))) + 1
    levels = {channel: {run.level for run in runs if run.channel == channel} for channel in ("omega", "beta")}
    where = f"{NOT_PUBLISHED}: pitch {_range(levels['omega'])} deg, speed {_range(levels['beta'])} rpm"
    count, moves = {}, {}
    for name, channel in (("speed", "omega"), ("pitch", "beta")):
        for way in ("up", "down"):
            own = [run for run in runs if run.channel == channel and run.direction == way]
            ends = sorted({run.end for run in own}, reverse=way == "down")
            count[f"{name}_{way}"] = len(ends)
            moves[f"{name}_{way}"] = (f"{own[0].start:g} to {ends[0]:g} ... {ends[-1]:g}", None, "")
    return moves | {
        "speeds": (_range(speeds), None, ""),
        "pitches": (_range(pitches), None, ""),
        "grid": (f"{len(speeds)} x {len(pitches)}", None, hurry),
        "settle": (plan.settle, None, hurry),
        "rate": (float(1.0 / np.median(files.open_loop.steps)), None, ""),
        "samples": (float(np.median(files.static.samples)), None, "; ".join(filter(None, (hurry, enough)))),
        "steps": (f"{count['speed_up']} up, {count['speed_down']} down", None, ""),
        "states": (float(len(levels["omega"])), None, where),
        "before": (at * step.period, None, "; ".join(filter(None, (hurry, f"{plan.settle:g} s more go before")))),
        "after": ((len(step) - at) * step.period, None, hurry),
    }


def _models(study: Study) -> dict[str, tuple]:
    """The models and the test of their controllers: (rig, model, note)."""
    found, scales = study.found.parameters, ("omega_scale", "beta_offset", "beta_scale", "thrust_scale")
    models, fits = (found.model, BASE), (study.found.refinement, study.fine_tuning[1].ours)
    both, alone = (study.compared(name) for name in (PID, SPEED))
    first, scale = [steps(test.mean)[0] for test in both], found.values["thrust_scale"]
    return {
        "order": (*(float(len(model.states)) for model in models), ""),
        "time_constants": (*(float(sum(p.name.startswith("tau_") for p in model.parameters)) for model in models), ""),
        "fitted_parameters": (*(float(len(fit.names)) for fit in fits), ""),
        **{name: (found.values[name], BASE.values()[name], "") for name in scales},
        "t_filter": (*(test.settings["t_filter"] for test in both), ""),
        "step_from": (*(step.before / scale for step in first), ""),
        "step_to": (*(step.after / scale for step in first), ""),
        "step_at": (*(step.time for step in first), "the next sample of the controller"),
        "beta_fixed": (*(float(np.median(test.mean["beta_ref"])) for test in alone), ""),
    }


def _chosen(study: Study) -> dict[str, tuple]:
    """Parts and data of the emulated rig in place of the paper's."""
    p, points = FULL_RIG.values(emulated(Limits(), study.seed).emulated.parameters), study.campaign.static
    known = [parameter.name for parameter in FULL_RIG.parameters]
    thirteen = f"k_Q and k_i are one number; with maps, supplies and controllers it has {len(known)}"
    travel = f"{p['beta_low']:g} to {p['beta_high']:g} deg"
    noise, bits = f"{float(np.median(points.thrust_std)):.3f} N left", f"{8 * FROM_BOARD[ANSWER]} bits"
    largest = float(points.thrust.max()), float(paper_thrust(np.array([6000.0]), np.array([10.0]))[0])
    moves = f"moves and holds are {NOT_PUBLISHED}; {study.plan.section:g} s each"
    return {
        "full_parameters": (float(sum(name in known for name in THIRTEEN)), None, thirteen),
        "supplies": (None, None, "emulated supplies hold their voltage at any current"),
        "esc": (None, None, "the emulated ESC limits no current"),
        "propeller": (f"radius {1e3 * p['radius']:.0f} mm", None, "lift and drag fitted to the paper's static map"),
        "actuator": (travel, None, "its motor's and screw's constants are chosen, no data sheet"),
        "capacitors": (noise, None, "noise of one reading; chosen, since the paper tells none"),
        "largest_thrust": (*largest, "the model is the paper's static map at 6000 rpm and 10 deg"),
        "rpm_bits": (bits, None, "four bits hold 16 values: a misprint; here a frame with a checksum"),
        "sections": (", ".join(parts(study.campaign.open_loop)), None, moves),
    }


def _static(study: Study) -> dict[str, tuple]:
    """The static characterisation (section 4.1)."""
    s, points = study.statics, study.campaign.static
    used, region = s.rig.used, _range(points.beta_ref[s.rig.used], ".3g")
    mean_std = float((points.thrust_std / np.sqrt(points.samples))[used].mean())
    scatter = (
        f"the paper's points scatter by {s.scatter:.2f} N rms, ours by {s.rig.rmse:.3f}; means are known to {mean_std:.4f} "
        "N: an emulated stand comes back to its points"
    )
    (speed, pitch), (papers_speed, papers_pitch) = s.ct
    blades = f"against {pitch:.3f} and {papers_pitch:.3f} over the pitch; the rig's blades know no Reynolds number"
    found = {
        "region": (region, region, f"{used.sum()} points of the grid lie inside"),
        "r2_adjusted": (s.rig.r2_adjusted, s.model.r2_adjusted, scatter),
        "ct_speed": (f"{speed:.4f} rms", f"{papers_speed:.4f} rms", blades),
    }
    terms = design(points.omega[used], points.beta_ref[used], PAPER_UNITS)
    for k, (name, value) in enumerate(STATIC_MAP.items()):
        wanted, others = points.thrust[used] - value * terms[:, k], np.delete(terms, k, axis=1)
        others = others / np.abs(others).max(axis=0)
        residual = wanted - others @ np.linalg.lstsq(others, wanted, rcond=None)[0]
        why = (
            f"held at the paper's value the map leaves {rmse(residual):.3f} N rms instead of {s.rig.rmse:.3f}; the two "
            f"maps are {rmse(s.difference):.2f} N rms apart"
        )
        found[f"static.{name}"] = (s.rig.coefficients[name], s.model.coefficients[name], why, s.rig.std[name])
    return found


def _averaged(study: Study) -> dict[str, tuple]:
    """Averaged time constants (section 4.2)."""
    start, ((small, first), *_, (large, last)) = study.found.start, by_size(study.steps[0], "beta").items()
    whys = {
        "omega": "inertia and PI unit are chosen for the paper's steps; thrust bends the lags (see the model), speed itself "
        f"has {start['tau_omega_1']:.2f} and {start['tau_omega_2']:.2f} s",
        "beta": f"no constant: both add up to {sum(first):.2f} s for steps of {small:g} deg, {sum(last):.2f} s for {large:g} "
        "deg: the actuator's speed has a limit",
    }
    found = {}
    for channel, pair in LAGS.items():
        (means, spread), (models, _) = (lags(summary.used(channel)) for summary in study.steps)
        total = sum(AVERAGED[name] for name in pair)
        faster = f"as the slower one's; both add up to {means.sum():.2f} s, the paper's to {total:.2f} s"
        for k, (name, why) in enumerate(zip(pair, (whys[channel], faster), strict=True)):
            found[f"averaged.{name}"] = (float(means[k]), float(models[k]), why, float(spread[k]))
    return found


def _steps_seen(study: Study) -> dict[str, tuple]:
    """Step responses that overshoot, and those that were left out (section 4.2)."""
    seen, left_out, largest = [], [], {}
    for summary in study.steps:
        runs = summary.used("beta")
        fastest = [run for run in runs if run.level == max(run.level for run in runs)]
        seen.append(f"seen in {sum(run.overshoots for run in fastest)} of {len(fastest)} at {fastest[0].level:g} rpm")
        left_out.append(f"{len(summary.outliers)} of {len(summary.runs)}")
        for run in summary.outliers:
            largest[run.channel] = max(largest.get(run.channel, 0.0), abs(run.end - run.start))
    p = SimpleNamespace(**FULL_RIG.values())
    inflow = 1e3 * p.apparent_mass / (4.0 * settled_inflow(ops.NUMBERS, p, 10.0) * 6000.0 * RPM)
    why = (
        f"the model has none but by noise; the rig's inflow lags by {inflow:.1f} ms, too quick against its pitch. What made "
        "the paper's is in neither"
    )
    sizes = " and ".join(f"{size:g} {'rpm' if channel == 'omega' else 'deg'}" for channel, size in largest.items())
    noisy = f"their noise is too large a share; steps of up to {sizes}" if sizes else "none is too noisy"
    return {"overshoots": (*seen, why), "excluded": (*left_out, noisy)}


def _fine_tuned(study: Study) -> dict[str, tuple]:
    """Fine-tuned parameters, and the lag that the paper assumes (section 4.2)."""
    rig, model, found = study.found.refinement, study.fine_tuning[1].ours, {}
    own, there = _by_speed(rig.values), _by_speed(model.values)
    whys = _why_lags(study) | {name: _why_coefficient(study, name) for name in STATIC_MAP}
    for name, paper in FINE_TUNED.items():
        value, std = model.values[there[name]], model.std.get(there[name], np.nan)
        why = f"{whys[name]}. On the paper's model the search comes back within {abs(value - paper) / std:.1f} sd"
        found[f"fine_tuned.{name}"] = (rig.values[own[name]], value, why, rig.std.get(own[name]))
    slow, fast = (own[name] for name in LAGS["beta"])
    why = f"nothing is assumed on the rig: its slower lag is identified, and so is the other, {rig.values[fast]:.2f} s"
    return found | {"assumed": (rig.values[slow], ASSUMED["tau_beta_2"], why, rig.std.get(slow))}


def _by_speed(values: Mapping[str, float]) -> dict[str, str]:
    """The paper's name of each fine-tuned parameter -> its name in a fit: the slower lag there is the slower one here."""
    names = dict(zip(FINE_TUNED, FINE_TUNED, strict=True))
    for pair in LAGS.values():
        names |= zip(pair, sorted(pair, key=lambda name: -values[name]), strict=True)
    return names


def _why_lags(study: Study) -> dict[str, str]:
    moves = np.abs(np.diff(study.campaign.open_loop["beta_ref"]))
    typical = float(np.median(moves[moves > 0.0]))
    ends = {
        "omega": ": the sum is what a record tells",
        "beta": f"; half of this record's moves are below {typical:.1f} deg, where the actuator keeps up",
    }
    found = {}
    for channel, pair in LAGS.items():
        rig, paper = (sum(values[name] for name in pair) for values in (study.found.refinement.values, FINE_TUNED))
        found |= dict.fromkeys(pair, f"both add up to {rig:.2f} s, the paper's to {paper:.2f} s{ends[channel]}")
    return found


def _why_coefficient(study: Study, name: str) -> str:
    uncertainty, start = study.found.refinement.uncertainty, study.found.start[name]
    rest = f"at rest the rig has {start:.3f}, the paper {AVERAGED[name]:.3f}"
    if name not in uncertainty.names:
        return rest
    k = uncertainty.names.index(name)
    partner = int(np.argmax(np.abs(uncertainty.correlation[k]) * (np.arange(len(uncertainty.names)) != k)))
    return f"{rest}; correlated with {uncertainty.names[partner]} at {uncertainty.correlation[k, partner]:.2f}"


def _costs(study: Study) -> dict[str, tuple]:
    """Costs of the fine-tuning (section 4.2)."""
    rig, model = study.fine_tuning
    scale = BASE.values()["thrust_scale"]
    noise = 0.5 * (study.found.noise.std / scale) ** 2
    papers, ours = (scale * np.sqrt(2.0 * cost) for cost in (COST_END, rig.ours.cost_final))
    only_lags = paper_cost(model.ours.problem, BASE.values({n: v for n, v in AVERAGED.items() if n.startswith("tau_")}))
    taken = [len(tuned.ours.curve) - 1 for tuned in study.fine_tuning]
    rate = f"the paper's descent, at a rate of 0.5 (it gives none); our search takes {taken[0]} and {taken[1]} to less"
    start = f"other commands and noise; with the lags alone averaged the model has {only_lags:.3g}"
    end = (
        f"agrees by construction on the paper's model: its noise is set from the paper's cost. Residual {papers:.2f} N rms "
        f"in the paper, {ours:.2f} N by our search on the rig ({rig.ours.cost_final:.3g}, its noise alone {noise:.2g})"
    )
    reduction = f"it tells of the start; our search takes off {rig.reduction[1]:.1f} and {model.reduction[1]:.1f} %"
    return {
        "iterations": (*(float(len(tuned.costs) - 1) for tuned in study.fine_tuning), rate),
        "cost_start": (*(float(tuned.costs[0]) for tuned in study.fine_tuning), start),
        "cost_end": (*(float(tuned.costs[: ITERATIONS + 1][-1]) for tuned in study.fine_tuning), end),
        "cost_fall": (*(tuned.reduction[0] for tuned in study.fine_tuning), reduction),
    }


def _improved(study: Study) -> dict[str, tuple]:
    """Reduction of the error by fine-tuning in each part of the record (section 4.2)."""
    cells = []
    for tuned in study.fine_tuning:
        errors = by_part(tuned.record, {"start": tuned.start, "end": tuned.values})
        cells.append(", ".join(f"{part} {100.0 * (e['end'] / e['start'] - 1.0):+.0f} %" for part, e in errors.items()))
    rig = study.fine_tuning[0]
    kept = rig.values | {n: rig.start[n] for n in ("tau_omega_1", "tau_omega_2")}
    errors = by_part(rig.record, {"end": rig.values, "kept": kept})
    speed, both = errors["speed only"], errors["both"]
    why = (
        "rms error by the paper's descent; on the rig speed's lags move for the part where both move: with the "
        f"start's, speed only has {speed['kept']:.3f} N for {speed['end']:.3f}, both {both['kept']:.3f} for {both['end']:.3f}"
    )
    return {"improved": (*cells, why)}


def _merits(study: Study) -> dict[str, tuple]:
    """The step test's figures (section 4.3)."""
    tests, pairs = study.tests, [study.compared(name) for name in (PID, SPEED)]
    rig, model = pairs[0]
    published, limited = tests[Loop(RIG, PUBLISHED, PID)], tests[Loop(LIMITED, TUNED, PID)].up
    # From the differences of neighbouring commands before the step, so that slow changes do not count.
    quiet = published.runs[0]["omega_ref"][published.runs[0].time < steps(published.runs[0])[0].time]
    shaken = float(np.std(np.diff(quiet)) / np.sqrt(2.0))
    objective = study.tuned[RIG].tuned["dual"].objective
    course = replace(objective.course, noise=np.zeros_like(objective.course.noise))
    without_noise, _ = judged(replace(objective, course=course).run(objective.gains))
    reached = (
        f"to 2 % of the step; rig: tuned gains. The published ones take {published.up.seconds} there, on its model without "
        f"noise {without_noise.seconds}: they shake the speed command by {shaken:.0f} rpm, into its limits"
    )
    over = (
        f"the tuning allows 1 % on the model; down {rig.down.overshoot:.1f} % on the rig, {model.down.overshoot:.1f} % on the "
        f"model; behind the slew limits of vpp hil run {limited.seconds} and {limited.overshoot:.1f} %"
    )
    (speed, pitch), (alone, fixed) = (_held(test.mean) for test, _ in pairs)
    ends = f"both end at {speed:.0f} rpm and {pitch:.1f} deg, speed alone at {alone:.0f} rpm and {fixed:.0f} deg"
    found = {
        "reached": (rig.up.settling, model.up.settling, reached),
        "overshoot": (rig.up.overshoot, model.up.overshoot, over),
    }
    for way, why in (("up", ends), ("down", "pitch takes thrust away while the rotor still runs down")):
        cells = []
        for dual, single in zip(*pairs, strict=True):
            both, other = getattr(dual, way), getattr(single, way)
            change = 100.0 * (both.squared_error / other.squared_error - 1.0)
            cells.append(f"both {both.seconds}, speed {other.seconds}, squared error {change:+.0f} %")
        found[way] = (*cells, f"squared error: of both over speed alone's. {why}")
    return found


def _held(run: Record) -> tuple[float, float]:
    """Speed [rpm] and pitch command [deg] in the last second before the step down."""
    end = steps(run)[1].time
    rows = (run.time > end - 1.0) & (run.time < end)
    return float(run["omega"][rows].mean()), float(run["beta_ref"][rows].mean())


def _gains(study: Study) -> dict[str, tuple]:
    """Tuned gains (section 4.3)."""
    found = {}
    for prefix, published in (("dual", DUAL), ("speed_only", SPEED_ONLY)):
        rig, model = (study.tuned[plant].tuned[prefix] for plant in (RIG, MODEL))
        own = [dict(zip(tuned.objective.names, tuned.final.tolist(), strict=True)) for tuned in (rig, model)]
        worst = [max(m.sensitivity for m in model.margins[which]) for which in ("start", "tuned")]
        why = (
            f"cost under published, tuned gains {model.cost('start'):.4f}, {model.cost('tuned'):.4f} on the paper's model, "
            f"{rig.cost('start'):.4f}, {rig.cost('tuned'):.4f} on the rig's; largest sensitivity {worst[0]:.2f} and "
            f"{worst[1]:.2f} on the paper's"
        )
        found |= {f"{prefix}.{name}": (own[0][name], own[1][name], why) for name in published if name in own[0]}
    return found


def _range(values, digits: str = "g") -> str:
    return f"{min(values):{digits}} to {max(values):{digits}}"
