"""The verdict on a set of effects, and its validation on data that were not fitted, before it replaces the identified model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.signal import detrend
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from identification.assessment.prediction import predict
from identification.diagnose.acceptance import Judge
from identification.diagnose.crossval import (
    HeldOut,
    by_thirds,
    error_decreases,
    error_increases,
    held_out_gain,
)
from identification.diagnose.judgement import ALPHA_BASE, MAJORITY, MIN_EVIDENCE, SLOW
from identification.diagnose.lack_of_fit import LackOfFit, bands_of
from identification.diagnose.score_test import channel_rows, mean_powers, noise_levels
from identification.diagnose.search.fits import Fit
from identification.diagnose.selection import without
from identification.fit.noise import Noise, blocks
from identification.fit.uncertainty import NORMAL_95
from identification.roles import Unseen
from identification.static.at_rest import Knowledge
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


def verdict(base: Fit, final: Fit, before: LackOfFit, after: LackOfFit, family: Mapping[str, Sequence[str]]) -> str:
    """The verdict in one word, from the lack of fit of the base and of the final set."""
    if not final.effects:
        return unnamed(before)
    if after.significant:
        return "partly" if share_explained(base, final, before, after) > MAJORITY else "unexplained"
    if after.turns:
        return "partly"
    return "family" if any(family.values()) else "attributed"


def unnamed(lack: LackOfFit) -> str:
    """The verdict on a model without further effects, from its lack of fit."""
    return "unexplained" if lack.significant or lack.turns else "none"


def share_explained(base: Fit, final: Fit, before: LackOfFit, after: LackOfFit) -> float:
    """Share of the lack of fit that a set explains: of the pure error's power with a repeat, else of the log-likelihood. If the
    remaining lack of fit is in the transient thrust, the share of that, if smaller. Lack of fit of the speed alone does not
    reduce the share: it is a fault of the motor, and hides no effect of the rotor."""
    gain = 0.5 * (base.deviance - final.deviance)
    if before.bands or (not before.score.count and before.speed_rpm):
        share = 1.0 - after.missing / before.missing if before.missing > 0.0 else 0.0
    else:
        share = gain / (gain + max(after.score.gain, 0.0)) if gain > 0.0 else 0.0
    if after.transient_lack_of_fit:
        share = min(share, 1.0 - (after.transient_size / before.transient_size) ** 2) if before.transient_size > 0.0 else 0.0
    return share


UNEXPLAINED = ("partly", "unexplained")
"""Verdicts with an unexplained lack of fit; a best guess is added."""

NAMED = ("attributed", "family")
"""Verdicts that name all effects."""

CHANGED = ("attributed", "family", "partly", "learned")
"""Verdicts that add effects to the model."""


def validated(
    judge: Judge,
    knowledge: Knowledge | None,
    unseen: Unseen | None,
    present: Fit,
    base: Fit,
    found: Fit,
    parts: Sequence[Fit] = (),
    partly: bool = False,
) -> tuple[Fit, str]:
    """(final model, reason why `found` does not replace the `present` model; empty if it does).

    An effect with its own initial state (the phase of a vibration) is kept only if the step responses confirm it."""
    for effect in (e for e in found.problem.model.effects if e.name in found.effects):
        if any(p.initial for p in effect.parameters):
            rest = without(judge.searcher, base, found, effect.name)
            if not (judge.runs and error_decreases([], (judge.on_runs(rest) - judge.on_runs(found)).tolist())):
                found = rest
    if found.effects == base.effects:
        return present, ""
    try:
        final = _estimated(judge, knowledge, present, found, parts)
    except np.linalg.LinAlgError:
        return present, "fitted to all channels, it diverges"
    too_small = [name for name in final.effects if not judge.matters(name, final)]
    given = Replacement(judge, present, base, found, final, unseen, partly)
    why = NOTHING_LEFT.format(too_small[0]) if too_small else reason_against(given)
    if why and not too_small and (narrowed := at_supported_thresholds(given)):
        return narrowed, ""
    return (present, why) if why else (final, "")


POINTS = 9
"""Values of a threshold that are tried within its interval."""


def at_supported_thresholds(given: "Replacement") -> Fit | None:
    """The set with thresholds that the unseen record supports, within the intervals that the fitted records leave open. None if
    held-out data refute it there, too, or if no threshold is open.

    The fitted records do not distinguish these values, but validation would refute the set for one of them. The record is then
    used for an estimate, and is no longer unseen."""
    final, unseen, noise = given.final, given.unseen, given.judge.searcher.experiments[0].noise
    names = [name for name, (low, high) in final.thresholds.items() if high > low]
    if unseen is None or not names:
        return None
    grids = (np.linspace(*final.thresholds[name], POINTS).tolist() for name in names)
    points = [dict(zip(names, point, strict=True)) for point in product(*grids)]
    shown = [predict(final.problem.model, {**final.values, **point}, unseen.record) for point in points]
    best = min(shown, key=lambda prediction: prediction.rmse_thrust)
    least = -0.5 * NORMAL_95**2
    inside = [p for p, one in zip(points, shown, strict=True) if sum(held_out_gain(noise, best, one).values()) >= least]
    ends, middle = {}, {}
    for name in names:
        tried, (low, high) = [point[name] for point in inside], final.thresholds[name]
        gap = (high - low) / (POINTS - 1)  # the interval ends somewhere before the next value
        ends[name] = max(low, min(tried) - gap), min(high, max(tried) + gap)
        middle[name] = 0.5 * (min(tried) + max(tried))
    found = final.with_thresholds(middle, {**final.thresholds, **ends})
    return None if reason_against(replace(given, final=found)) else found


NOTHING_LEFT = "{} is below the minimum size when estimated for the best prediction of held-out data"


def worse_than_noise(unseen: Unseen, known: Fit, noise: Noise, final: Fit, least: float) -> str:
    """Why the unseen record shows that a model without lack of fit on the fitted records misses something; empty if it does
    not. In a band below SLOW its whitened error has more power than the noise, by an F test, and the excess has the size
    `least` [N]. `known`: the fit by maximum likelihood, whose residual gives the noise; `final`: the model that predicts.

    What the standard errors of its parameters allow is no error of the model: it is compared at their most likely shift. The
    level and the trend of an error are not compared: the zero of a cell differs from record to record, and drifts."""
    record, step = unseen.record, max(noise.block, unseen.record.period)
    thrusts, block = _error_and_shifts(final, record), blocks(record, noise.block)
    white = np.array([noise.colour.whiten(block.mean(each)) for each in thrusts])
    white = detrend(white[:, np.isfinite(white[0])])
    spectra, frequency = np.fft.rfft(white) / np.sqrt(white.shape[1]), np.fft.rfftfreq(white.shape[1], step)
    usual, noises = _noise_of(known, step), []
    for low, high, inside in bands_of(frequency):
        within = [(at >= low) & (at < high) & (at > 0.0) for at, _, _ in usual]
        degrees = sum(float(np.sum(own[rows])) for rows, (_, _, own) in zip(within, usual, strict=True))
        level = sum(float(own[rows] @ each[rows]) for rows, (_, each, own) in zip(within, usual, strict=True)) / degrees
        noises.append((inside, level, degrees))
    if not noises:
        return ""
    shift = _most_likely_shift([spectra[:, inside] / np.sqrt(level) for inside, level, _ in noises])
    power = np.abs(shift @ spectra) ** 2
    tests, excess, whole = [], 0.0, float(np.sum(power[frequency < SLOW]))
    for inside, level, degrees in noises:
        own, count = float(np.mean(power[inside])), int(inside.sum())
        tests.append(float(f_distribution.sf(own / level, 2 * count, degrees)))
        excess += count * max(own - level, 0.0) if tests[-1] < ALPHA_BASE else 0.0
    slow = blocks(record, 0.5 / SLOW).mean(shift @ thrusts)
    size = float(np.sqrt(np.var(detrend(slow[np.isfinite(slow)])) * excess / whole)) if whole else 0.0
    if size <= least or -np.expm1(len(tests) * np.log1p(-min(tests, default=1.0))) >= ALPHA_BASE:
        return ""
    return f"{unseen.name}.csv is predicted worse than the noise allows, by {size:.2g} N rms below {SLOW:g} Hz"


def _error_and_shifts(fit: Fit, record: Record) -> np.ndarray:
    """(1 + n, rows) N: the error of the predicted thrust, and its changes by one standard error of the n parameters along each
    principal axis of their covariance."""
    names, covariance = fit.uncertainty.names, fit.uncertainty.covariance
    tangents = np.empty((len(record), len(names)))
    thrust = Simulator(fit.problem.model, names).simulate(fit.values, *record.run, {0: tangents})[:, 0]
    power, axes = np.linalg.eigh(covariance)
    return np.vstack([thrust - record["thrust"], (axes * np.sqrt(np.maximum(power, 0.0))).T @ tangents.T])


def _most_likely_shift(parts: Sequence[np.ndarray]) -> np.ndarray:
    """(1 + n,) the share of an error, 1, and the most likely numbers of standard errors of n shifts, which have standard normal
    distributions; 0 if they are too large for that (chi^2 test, ALPHA_BASE). `parts`: ordinates (1 + n, k) of their spectra,
    over the root of the noise power."""
    ordinates = np.sqrt(2.0) * np.hstack(parts)
    error, *shifts = np.hstack([ordinates.real, ordinates.imag])
    moved = np.array(shifts).reshape(-1, len(error))
    shift = -np.linalg.solve(np.eye(len(moved)) + moved @ moved.T, moved @ error)
    return np.append(1.0, shift * (chi2.sf(shift @ shift, len(shift)) > ALPHA_BASE))


def _noise_of(fit: Fit, step: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each experiment (frequencies [Hz], power of the whitened noise of the thrust there, degrees of freedom), from
    differences of repeated records, else from the residual, corrected for what the fit absorbs. `step` [s]: of its rows."""
    about, scale, found = fit.linearised(), fit.problem.scale["thrust"], []
    for e, rows in zip(fit.problem.experiments, channel_rows(fit, "thrust"), strict=True):
        repeated = len(e.records) > 1
        samples = e.differences() if repeated else scale * about.residual[None, rows]
        gone = about.directions(rows)
        level, free = noise_levels(mean_powers(samples) / len(samples), mean_powers(gone[:0] if repeated else gone))
        found.append((np.fft.rfftfreq(samples.shape[1], step), level, 2.0 * len(samples) * free))
    return found


def _estimated(judge: Judge, knowledge: Knowledge | None, present: Fit, found: Fit, parts: Sequence[Fit] = ()) -> Fit:
    """Estimate the accepted set for the best prediction of held-out folds and step responses.

    The prior from the static map had been widened to agree with records beside the base. It is weighted again beside the
    effects, unless the cross-validated thrust error then increases significantly. If folds or step responses are predicted
    worse than by the `present` model, the values of the fits of single channels, its `parts`, are tried; then the estimates of
    an identification, which give slow errors more weight. Then, for effects without influence at rest, those with the map of
    the `present` model are tried.
    """
    if len(parts) > 1 and _worse(judge, found, present) and not _worse(judge, apart := found.with_values_of(parts), present):
        return apart
    if knowledge is not None:
        agreed = found.agreed(knowledge)
        old, new = judge.held_out(found).thrust, judge.held_out(agreed).thrust
        times = [e.record.time for e in found.problem.experiments]
        found = found if error_increases(list(zip(times, old, new, strict=True))) else agreed
    if _worse(judge, found, present):
        again = found.as_identified(knowledge)
        better = judge.held_out(again).rmse_thrust < judge.held_out(found).rmse_thrust
        found = again if better or not _worse(judge, again, present) else found
        if _worse(judge, found, present) and not found.at_rest:
            held = found.with_map_of(present)
            found = held if not _worse(judge, held, present) else found
    return found


def _worse(judge: Judge, fit: Fit, present: Fit) -> bool:
    """Whether folds or step responses are predicted worse by a fit, significantly or not."""
    if judge.held_out(fit).rmse_thrust > judge.held_out(present).rmse_thrust:
        return True
    return bool(judge.runs) and float(np.mean(judge.on_runs(fit) - judge.on_runs(present))) > 0.0


@dataclass(frozen=True)
class Replacement:
    """A set that may replace the `shipped` model. `found`: the set at its maximum likelihood; `final`: as estimated for
    prediction; `base`: the base model fitted by the same likelihood; `partly`: it explains only a part of the lack of fit."""

    judge: Judge
    shipped: Fit
    base: Fit
    found: Fit
    final: Fit
    unseen: Unseen | None
    partly: bool

    @cached_property
    def folds(self) -> tuple[HeldOut, HeldOut]:
        """Cross-validation of (`shipped`, `final`) on interleaved folds."""
        return self.judge.held_out(self.shipped), self.judge.held_out(self.final)

    @cached_property
    def thirds(self) -> tuple[HeldOut, HeldOut]:
        """The same with whole thirds of each record left out."""
        return by_thirds(self.shipped), by_thirds(self.final)

    def pairs(self, was: HeldOut, now: HeldOut) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(time [s], error before, error after) [N] of the thrust, by experiment."""
        times = [e.record.time for e in self.found.problem.experiments]
        return list(zip(times, was.thrust, now.thrust, strict=True))

    @cached_property
    def steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean square errors of the step responses (before, after), N^2."""
        return self.judge.on_runs(self.shipped), self.judge.on_runs(self.final)


def base_predicts_better(given: Replacement) -> str:
    """Both estimates of the set predict the folds worse than the base, fitted by the same likelihood."""
    before = given.judge.held_out(given.base)
    best = min((given.judge.held_out(fit) for fit in (given.found, given.final)), key=lambda h: h.rmse_thrust)
    if best.rmse_thrust > before.rmse_thrust and given.judge.held_out(given.found).gain(before)["thrust"] < 0.0:
        return _increases(FOLDED, before.rmse_thrust, best.rmse_thrust)
    return ""


def significantly_worse(given: Replacement) -> str:
    """Folds or thirds are predicted significantly worse; for a `partly`, worse at all."""
    for name in ("folds", "thirds"):
        was, now = getattr(given, name)
        if error_increases(given.pairs(was, now)) or (given.partly and now.rmse_thrust > was.rmse_thrust):
            return _increases(FOLDED, was.rmse_thrust, now.rmse_thrust)
    return ""


def part_does_not_carry_over(given: Replacement) -> str:
    """A `partly` does not predict thirds and step responses significantly better. It must carry over to other commands."""
    if not given.partly:
        return ""
    old, new = given.steps
    if error_decreases(given.pairs(*given.thirds), (old - new).tolist()):
        return ""
    return "a partial explanation, and the held-out thrust error does not decrease significantly"


def steps_lose_more(given: Replacement) -> str:
    """The mean square error of step responses, which cover other commands, increases more than that of folds decreases."""
    if not given.judge.runs:
        return ""
    (was, now), (old, new) = given.folds, given.steps
    if np.mean(new - old) > was.rmse_thrust**2 - now.rmse_thrust**2:
        return _increases("thrust error of the step responses", *(float(np.sqrt(np.mean(e))) for e in (old, new)))
    return ""


def reported_error_increases(given: Replacement) -> str:
    """The error that is reported increases: on the unseen record (`_refuted_by`), else on the folds."""
    if given.unseen is not None:
        return _refuted_by(given.unseen, given.judge.searcher.experiments[0].noise, given.shipped, given.final)
    was, now = (held_out.rmse_thrust for held_out in given.folds)
    return _increases(FOLDED, was, now) if now > was else ""


def reason_against(given: Replacement) -> str:
    """The first reason why held-out data refute a set, empty if they do not."""
    return (
        base_predicts_better(given)
        or significantly_worse(given)
        or part_does_not_carry_over(given)
        or steps_lose_more(given)
        or reported_error_increases(given)
    )


def _refuted_by(unseen: Unseen, noise: Noise, shipped: Fit, final: Fit) -> str:
    """The reason why the unseen record refutes a model, empty if it does not: its thrust error increases.

    The measured speed may outweigh the thrust: the model is not refuted if the evidence of both together is very strong for it,
    and that of the thrust alone is not very strong against it."""
    was, now = (predict(fit.problem.model, fit.values, unseen.record) for fit in (shipped, final))
    if now.rmse_thrust <= was.rmse_thrust:
        return ""
    gain = held_out_gain(noise, was, now)
    if sum(gain.values()) > MIN_EVIDENCE and gain["thrust"] > -MIN_EVIDENCE:
        return ""
    return _increases(f"thrust error on {unseen.name}.csv", was.rmse_thrust, now.rmse_thrust)


FOLDED = "cross-validated thrust error"


def _increases(what: str, before: float, after: float) -> str:
    return f"{what} increases from {before:.4g} to {after:.4g} N"  # four digits, because a small difference decides
