"""Counterparts of the paper's dynamic characterisation and fine-tuning (section 4.2)."""

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np

from hil.physics.propeller import RPM, settled_inflow
from hil.physics.rig_model import FULL_RIG
from identification.fit.refine import paper_cost
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.paper.averages import by_size, lags, runs_of
from vpp_fmu.paper.counterpart import Counterpart, of_setup
from vpp_fmu.paper.fine_tuning import FineTuning, by_part
from vpp_fmu.paper.published import ASSUMED, COST_END, ITERATIONS
from vpp_fmu.paper.study import Study

SLOW = ("tau_omega_1", "tau_beta_2")
"""What the paper calls the slower lags of the two channels."""


def dynamic_rows(study: Study) -> dict[str, Counterpart]:
    """By the names in `published`."""
    return _averaged(study) | _overshoots(study) | _scales(study) | _fine_tuned(study) | _costs(study) | _improved(study)


def _averaged(study: Study) -> dict[str, Counterpart]:
    found = {}
    for channel, why in (("omega", _speed_lags(study)), ("beta", _pitch_lags(study))):
        means, spread = lags(runs_of(study.averages.rig, channel))
        models, _ = lags(runs_of(study.averages.model, channel))
        total = sum(AVERAGED[f"tau_{channel}_{k}"] for k in (1, 2))
        for name in (f"tau_{channel}_1", f"tau_{channel}_2"):
            k = 0 if name in SLOW else 1
            own = why if k == 0 else f"as the slower one's; both add up to {means.sum():.2f} s, the paper's to {total:.2f} s"
            found[f"averaged.{name}"] = Counterpart(float(means[k]), float(models[k]), own, float(spread[k]))
    return found


def _speed_lags(study: Study) -> str:
    start = study.found.start
    return (
        "inertia and PI unit are chosen for the paper's steps; thrust bends the lags (see the model), speed itself "
        f"has {start['tau_omega_1']:.2f} and {start['tau_omega_2']:.2f} s"
    )


def _pitch_lags(study: Study) -> str:
    (small, first), *_, (large, last) = by_size(study.averages.rig, "beta").items()
    return (
        f"no constant: both add up to {sum(first):.2f} s for steps of {small:g} deg, {sum(last):.2f} s for {large:g} deg: the "
        "actuator's speed has a limit"
    )


def _overshoots(study: Study) -> dict[str, Counterpart]:
    found = []
    for summary in (study.averages.rig, study.averages.model):
        runs = runs_of(summary, "beta")
        fastest = [run for run in runs if run.level == max(run.level for run in runs)]
        found.append(f"seen in {sum(run.overshoots for run in fastest)} of {len(fastest)} at {fastest[0].level:g} rpm")
    p = SimpleNamespace(**FULL_RIG.values())
    inflow = 1e3 * p.apparent_mass / (4.0 * settled_inflow(NUMBERS, p, 10.0) * 6000.0 * RPM)
    why = (
        f"the model has none but by noise; the rig's inflow lags by {inflow:.1f} ms, too quick against its pitch. What made "
        "the paper's is in neither"
    )
    return {"overshoots": Counterpart(*found, why), "excluded": _excluded(study)}


def _excluded(study: Study) -> Counterpart:
    told, largest = [], {}
    for summary in (study.averages.rig, study.averages.model):
        told.append(f"{len(summary.outliers)} of {len(summary.runs)}")
        for run in summary.outliers:
            largest[run.channel] = max(largest.get(run.channel, 0.0), abs(run.end - run.start))
    sizes = " and ".join(f"{size:g} {'rpm' if channel == 'omega' else 'deg'}" for channel, size in largest.items())
    return Counterpart(*told, f"their noise is too large a share; steps of up to {sizes}" if sizes else "none is too noisy")


def _scales(study: Study) -> dict[str, Counterpart]:
    rig, model = study.found.parameters.values, BASE.values()
    names = ("omega_scale", "beta_offset", "beta_scale", "thrust_scale")
    return {name: of_setup(name, rig[name], model[name]) for name in names}


def _fine_tuned(study: Study) -> dict[str, Counterpart]:
    rig, model, found = study.found.refinement, study.fine_tuning_model.ours, {}
    for name in FINE_TUNED:
        own, there = _as_slow(name, rig.values), _as_slow(name, model.values)
        off = abs(model.values[there] - FINE_TUNED[name]) / model.std[there] if there in model.std else np.nan
        why = _why_lag(study, name) if name.startswith("tau_") else _why_coefficient(study, name)
        why = f"{why}. On the paper's model the search comes back within {off:.1f} sd"
        found[f"fine_tuned.{name}"] = Counterpart(rig.values[own], model.values[there], why, rig.std.get(own))
    return found


def _as_slow(name: str, values: Mapping[str, float]) -> str:
    """The time constant of the channel that is the slower, or the faster, as the paper's `name` is; a coefficient is itself."""
    if not name.startswith("tau_"):
        return name
    fast, slow = sorted((f"{name[:-1]}1", f"{name[:-1]}2"), key=lambda n: values[n])
    return slow if name in SLOW else fast


def _why_lag(study: Study, name: str) -> str:
    pair = (f"{name[:-1]}1", f"{name[:-1]}2")
    rig, paper = (sum(values[n] for n in pair) for values in (study.found.refinement.values, FINE_TUNED))
    total = f"both add up to {rig:.2f} s, the paper's to {paper:.2f} s"
    if name.startswith("tau_omega"):
        return f"{total}: the sum is what a record tells"
    moves = np.abs(np.diff(study.campaign.open_loop["beta_ref"]))
    typical = float(np.median(moves[moves > 0.0]))
    return f"{total}; half of this record's moves are below {typical:.1f} deg, where the actuator keeps up"


def _why_coefficient(study: Study, name: str) -> str:
    uncertainty, start = study.found.refinement.uncertainty, study.found.start[name]
    rest = f"at rest the rig has {start:.3f}, the paper {AVERAGED[name]:.3f}"
    if name not in uncertainty.names:
        return rest
    k = uncertainty.names.index(name)
    partner = int(np.argmax(np.abs(uncertainty.correlation[k]) * (np.arange(len(uncertainty.names)) != k)))
    return f"{rest}; correlated with {uncertainty.names[partner]} at {uncertainty.correlation[k, partner]:.2f}"


def _costs(study: Study) -> dict[str, Counterpart]:
    rig, model, scale = study.fine_tuning, study.fine_tuning_model, BASE.values()["thrust_scale"]
    noise = 0.5 * (study.found.noise.std / scale) ** 2
    papers, ours = (scale * np.sqrt(2.0 * cost) for cost in (COST_END, rig.ours.cost_final))
    only_lags = paper_cost(model.ours.problem, BASE.values({n: v for n, v in AVERAGED.items() if n.startswith("tau_")}))
    taken = [len(tuned.ours.curve) - 1 for tuned in (rig, model)]
    return {
        "iterations": Counterpart(
            *(float(len(tuned.costs) - 1) for tuned in (rig, model)),
            f"the paper's descent, at a rate of 0.5 (it gives none); our search takes {taken[0]} and {taken[1]} to less",
        ),
        "cost_start": _both(
            rig, model, 0, f"other commands and noise; with the lags alone averaged the model has {only_lags:.3g}"
        ),
        "cost_end": _both(
            *(rig, model, ITERATIONS),
            f"agrees by construction on the paper's model: its noise is set from the paper's cost. Residual {papers:.2f} N rms "
            f"in the paper, {ours:.2f} N by our search on the rig ({rig.ours.cost_final:.3g}, its noise alone {noise:.2g})",
        ),
        "cost_fall": Counterpart(
            *(rig.fall[0], model.fall[0]),
            f"it tells of the start; our search takes off {rig.fall[1]:.1f} and {model.fall[1]:.1f} %",
        ),
        "assumed": _assumed(study),
    }


def _both(rig: FineTuning, model: FineTuning, k: int, why: str) -> Counterpart:
    """The cost of both descents after k iterations, or where they ended before."""
    return Counterpart(*(float(tuned.costs[min(k, len(tuned.costs) - 1)]) for tuned in (rig, model)), why)


def _assumed(study: Study) -> Counterpart:
    r = study.found.refinement
    own, other = (_as_slow(name, r.values) for name in ("tau_beta_2", "tau_beta_1"))
    why = f"nothing is assumed on the rig: its slower lag is identified, and so is the other, {r.values[other]:.2f} s"
    return Counterpart(r.values[own], ASSUMED["tau_beta_2"], why, r.std.get(own))


def _improved(study: Study) -> dict[str, Counterpart]:
    """By how much fine-tuning lowers the error in each part of the record."""
    told = []
    for tuned in (study.fine_tuning, study.fine_tuning_model):
        parts = by_part(tuned.record, {"start": tuned.start, "end": tuned.values})
        told.append(", ".join(f"{part} {100.0 * (e['end'] / e['start'] - 1.0):+.0f} %" for part, e in parts.items()))
    tuned, serve = study.fine_tuning, {n: study.fine_tuning.start[n] for n in ("tau_omega_1", "tau_omega_2")}
    kept = by_part(tuned.record, {"end": tuned.values, "kept": tuned.values | serve})
    speed, both = (kept[part] for part in ("speed only", "both"))
    why = (
        "rms error by the paper's descent; on the rig speed's lags move for the part where both move: with the "
        f"start's, speed only has {speed['kept']:.3f} N for {speed['end']:.3f}, both {both['kept']:.3f} for {both['end']:.3f}"
    )
    return {"improved": Counterpart(*told, why)}
