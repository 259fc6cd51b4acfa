"""The content of diagnosis.json, and of the identification.json of a model that a diagnosis fitted."""

import os
from dataclasses import asdict

import numpy as np

from identification.assessment.model_error import model_error
from identification.assessment.prediction import Prediction, predict, summaries
from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.judgement import MIN_EVIDENCE, Judgement
from identification.diagnose.learned.description import FILE as LEARNED
from identification.diagnose.learned.description import block, source
from identification.diagnose.learned.refit import Term
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.refits import CandidateFit
from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report.result import dated
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import to_json, to_ssv
from vpp_fmu.record import write_record
from vpp_fmu.structured import as_json

FORMAT = "vpp-diagnosis/2"

NEXT = "next_experiment.csv"

UNITS = {
    "rmse_thrust": "N",
    "rmse_omega": "rpm",
    "fit_thrust": "%",
    "noise_floor_thrust": "N",
    "noise_floor_thrust_range": "N",
    "delta_bic": "1",
    "evidence": "nat",
    "held_out_gain": "nat",
    "log_likelihood": "nat",
    "explained_fraction": "1",
    "explains": "1",
    "most_explained": "1",
}
"""Units of the numbers without a unit beside them."""

LEFT_OUT = "its start value differs from record to record: not in the exported model"

ACTS = 1e-3
"""Minimum change of a response by an active limit, as a share of the response's range."""

HOW_READ = {"thrust": "load cell, stand, amplifier or logger", "speed": "tachometer or logger", "thrust and speed": "logger"}


def summary(found: Diagnosis) -> dict:
    """The content of diagnosis.json."""
    return {
        "format": FORMAT,
        "units": UNITS,
        "verdict": found.verdict,
        "refuted": {"effects": list(found.selection.final.effects), "why": found.refuted} if found.refuted else None,
        "missed": found.missed or None,
        "quality": [finding.summary() for finding in found.quality],
        "logger": found.logger.summary(),
        "lack_of_fit": {"before": found.before.summary(), "after": found.after.summary()},
        "learned": block(found.learned, found.std) if found.learned else None,
        "learning": _learning(found),
        "effects": [_effect(found, name) for name in (*found.final.effects, *found.left_out)],
        "channels": found.channels,
        "family": {name: others for name, others in found.selection.family.items() if others},
        "best_guess": _best_guess(found),
        "not_tried": list(found.not_tried),
        "next_experiment": NEXT if found.verdict != "none" else None,
        "fitted": [one.name for one in found.fitted],
        "before": errors(found, found.base),
        "after": errors(found, found.final),
        **({"given": _given(found)} if found.given else {}),
        **found.reading_noise.summary(),
        "noise_floor_verified": found.noise.verified,
        "explained_fraction": found.explained,
        "base_parameters": _shift(found),
        "lag_order": found.lag_order,
        "candidates": [_tried(found, t) for tried in found.selection.rounds for t in tried],
        "cannot_be_seen": found.distinguishability.invisible(),
        "cannot_be_told_apart": [{"effects": [a, b], "overlap": overlap} for a, b, overlap in found.distinguishability.alike()],
        **({"power": found.power.summary()} if found.power else {}),
        "unexplained": {"share_left": None if found.explained is None else 1.0 - found.explained, **found.location},
    }


def _best_guess(found: Diagnosis) -> dict | None:
    """The best candidate, if the lack of fit is not explained."""
    guess = found.best_guess
    if guess is None:
        return None
    sizes = {name: {} for name in guess.effects}
    for size in guess.sizes:
        sizes[size.effect][size.name] = {"value": size.value, "std": size.std, "unit": size.unit}
    return {
        "effects": [{"name": name, "parameters": own} for name, own in sizes.items()],
        "beside": list(guess.beside),
        "near": guess.near,
        "evidence": guess.evidence,
        "explains": guess.explains,
        "most_explained": guess.most,
        "against": list(guess.against),
        "next_experiment": {
            "file": NEXT,
            "tells_from": guess.rival or None,
            "difference": {"value": guess.there, "unit": "N"},
            "difference_so_far": {"value": guess.here, "unit": "N"},
        },
    }


def _learning(found: Diagnosis) -> dict | None:
    """Terms that were tried, if the library does not explain the lack of fit."""
    attempt = found.attempt
    if not attempt.comparisons:
        return None
    tried = [
        {
            "port": term.lead.port,
            "driver": term.lead.driver,
            "shape": term.lead.shape,
            "lag": term.values.get("lag"),
            "evidence": judged.evidence,
            "held_out_gain": dict(judged.gain),
            "why_not": why_not_term(found, term, judged),
        }
        for term, judged in attempt.tried
    ]
    return {"looks": attempt.comparisons, "tried": tried, "refuted": attempt.refuted or None}


def why_not_term(found: Diagnosis, term: Term, judged: Judgement) -> str | None:
    """Why a learned term is rejected, for table and JSON; None if it is accepted."""
    if found.learned and term is found.learned.curve:
        return None
    return "; ".join(judged.refused) or "another term has a larger cross-validated gain"


def errors(found: Diagnosis, fit: Fit) -> dict:
    """Errors of the base or final model on the validation record, else cross-validated."""
    if found.unseen is not None:
        return {"record": found.unseen.name, "from": "validation", **found.prediction(fit, found.unseen.record).summary()}
    held_out = found.held_out_before if fit is found.base else found.held_out_after
    record, residual = found.fitted[0].record, held_out.thrust[0]
    measured, unknown = record["thrust"] + 0.0 * residual, np.full(len(record), np.nan)  # the readings that were held out
    shown = Prediction(record.with_columns(thrust=measured), measured + residual, unknown, unknown)
    return {
        "record": found.fitted[0].name,
        "from": "cross-validation",
        **shown.summary(),
        "rmse_omega": held_out.rmse_omega,
    }


def _effect(found: Diagnosis, name: str) -> dict:
    exported, judged = name not in found.left_out, found.selection.judgements[name]
    fit, std = (found.final, found.std) if exported else (found.selection.final, found.selection.final.std())
    units = {p.name: p.unit for p in fit.problem.model.parameters}
    own = [n for n in (*fit.free, *fit.forms) if n.startswith(f"{name}.")]
    values = {n.partition(".")[2]: {"value": fit.values[n], "std": std.get(n), "unit": units[n]} for n in own}
    searched = {*fit.thresholds, *fit.uncertainty.profiled}  # the others are from the standard error
    intervals = {n.partition(".")[2]: list(i) for n, i in fit.intervals().items() if n in searched and n in own}
    for parameter, (seconds, times) in reached(fit, name).items():
        values[parameter] |= {"acts_seconds": seconds, "acts_times": times}
    found_in = {"artefact": text} if (text := artefact(found, name)) else {}
    found_in |= {} if exported else {"left_out": LEFT_OUT}
    return {"name": name, "parameters": values, "intervals": intervals, "evidence": evidence(found, judged), **found_in}


def reached(fit: Fit, name: str) -> dict[str, tuple[float, int]]:
    """(seconds, times) for which each limit of an effect changes the response to the fitted commands.

    The estimate of a limit rests on these moments alone; beyond them it extrapolates.
    """
    effect, simulator, found = next(e for e in fit.problem.model.effects if e.name == name), fit.problem.simulator, {}
    for p in effect.parameters:
        if p.unlimited is None or fit.values[effect.full(p.name)] == p.unlimited:
            continue
        seconds, times = 0.0, 0
        for e in fit.problem.experiments:
            ways = ({}, {effect.full(p.name): p.unlimited})
            limited, free = (simulator.simulate(fit.values | change, *e.record.run) for change in ways)
            acts = np.any(np.abs(limited - free) > ACTS * np.ptp(free, axis=0), axis=1)
            seconds += float(np.sum(e.record.steps[acts[1:]]))
            times += int(acts[0]) + int(np.sum(acts[1:] & ~acts[:-1]))
        found[p.name] = seconds, times
    return found


def evidence(found: Diagnosis, judged: Judgement) -> dict:
    """Statistics of an effect."""
    return {"delta_bic": 2.0 * judged.evidence, **judged.summary(), "explained_fraction": found.explained}


def artefact(found: Diagnosis, name: str) -> str:
    """In words, why an effect belongs to the measurement and not to the rotor; empty if it does not.

    A delay of the rotor's speed also shows in the measured speed. If the measured speed is predicted worse, the thrust reading
    is late instead.
    """
    fit = found.selection.final
    effect = next(e for e in fit.problem.model.effects if e.name == name)
    if effect.reading:
        words = f"your {HOW_READ[effect.reading]}, not your rotor: it is in the reading of the {effect.reading}"
        if any(u.clock for u in effect.inputs):
            (rows,) = (fit.values[effect.full(n)] for n in effect.off)
            late = number(1e3 * rows * found.fitted[0].record.period, 2)
            words += f"; {number(rows, 2)} rows are {late} ms of dead time of both, if rows are equidistant"
        return words
    if "omega" in effect.channels and found.selection.judgements[name].gain.get("omega", 0.0) < -MIN_EVIDENCE:
        return "thrust shows it and measured speed does not: the logger's thrust is late, not the rotor"
    return ""


def _given(found: Diagnosis) -> dict:
    """Errors of a given model, before any fit."""
    return {"record": found.shown_name, **predict(found.given.model, found.given.values, found.shown).summary()}


def _shift(found: Diagnosis) -> dict:
    before, after = (found.parameters(fit).values for fit in (found.base, found.final))
    std = found.std
    names = found.base.problem.coordinates.names
    return {n: {"before": before[n], "after": after[n], "std": std.get(n)} for n in names}


def _tried(found: Diagnosis, tried: CandidateFit) -> dict:
    name = tried.candidate.name
    entry = {
        "name": name,
        "form": dict(tried.candidate.form),
        "beside": list(tried.beside),
        "promised_gain": tried.likelihood_gain,
    }
    if tried.fit is None:
        return entry | {"why_not": why_not(found, tried)}
    entry |= {"delta_bic": 2.0 * tried.evidence, "parameters": {n: tried.fit.values[n] for n in tried.candidate.free}}
    return entry | {"why_not": why_not(found, tried)}


def why_not(found: Diagnosis, tried: CandidateFit) -> str | None:
    """Why a candidate is rejected, for figure, table and JSON; None if it is accepted."""
    name, final = tried.candidate.name, found.selection.final
    if tried.fit is None:
        return "after two steps from each start, others fit better"
    if name in final.effects:
        if {n: v for n, v in final.forms.items() if n.startswith(f"{name}.")} != tried.candidate.form:
            return "another form of it explains more"
        if name in found.left_out:
            return None
        if name not in found.final.effects:
            return found.refuted or "removes less than half of the lack of fit"
        return None
    if any(name in others for others in found.selection.family.values()):
        return "these data do not distinguish it from the accepted one"
    if name in found.selection.refused:
        return "; ".join(found.selection.refused[name].refused)
    if tried.evidence <= MIN_EVIDENCE:
        return f"evidence too weak: {tried.evidence:.1f} after the penalty for its parameters, {MIN_EVIDENCE:g} is asked for"
    return "another candidate explains more"


def identification_of(found: Diagnosis, fit: Fit) -> dict:
    """The content of identification.json for a fit; values and names are those of `found.parameters(fit)`.

    If the campaign was identified first, the results of the static map and the steps are included.
    """
    uncertainty = fit.uncertainty.renamed(found.renamed(fit))
    own = uncertainty.summary()
    parameters = {name: entry for name, entry in own["parameters"].items() if name not in uncertainty.left_open}
    for name, (low, high) in fit.thresholds.items():
        entry = {"value": fit.values[name], "std": (high - low) / (2.0 * NORMAL_95), "interval": [low, high]}
        parameters[name] = entry | {"interval_from": "scan"}
    first = found.identification.summary() if found.identification is not None else {}
    records = {one.name: one.record for one in found.fitted}
    records |= {found.unseen.name: found.unseen.record} if found.unseen is not None else {}
    shown = {name: found.prediction(fit, record) for name, record in records.items()}
    unseen = [shown[found.unseen.name]] if found.unseen is not None else []
    fitted = [shown[one.name] for one in found.fitted if one.name != "repeat"]
    whole = found.parameters(fit)
    error = model_error(fitted, unseen, whole.values, len(uncertainty.names), found.noise.floor)
    return {
        "made_by": "vpp diagnose",
        "effects": list(whole.model.optional),
        **own,
        "parameters": parameters,
        "not_identifiable": dict.fromkeys(uncertainty.left_open, "not identifiable from the records"),
        **found.reading_noise.summary(),
        "model_error": error and asdict(error),
        "fitted": [one.name for one in found.fitted],
        **summaries(shown),
        "missing": list(found.campaign.missing),
        **{name: first[name] for name in ("static_map", "steps", "power") if name in first},
    }


def write_diagnosis(folder: OutputFolder, found: Diagnosis, given: str | os.PathLike[str] | None = None) -> None:
    """All files of a diagnosis but its page. `given`: the file that its starting model was read from, if any.

    parameters.json, parameters.ssv and identification.json are of the final model, parameters_base.json and
    identification_base.json of the one without the found effects.
    """
    folder.write("diagnosis.json", as_json(summary(found)))
    parent = {"descends": (given, found.given)} if found.given and given else {}
    for suffix, fit in (("_base", found.base), ("", found.final)):
        folder.write(f"parameters{suffix}.json", to_json(dated(found.parameters(fit), **parent)))
        folder.write(f"identification{suffix}.json", as_json(identification_of(found, fit)))
    folder.write("parameters.ssv", to_ssv(found.parameters(found.final), "parameters"))
    if found.learned:
        folder.write(LEARNED, source(found.learned.term, found.rig.scales, found.campaign.folder.name))
    write_record(folder, NEXT, found.experiment)
