"""Diagnosis of the power in time: the effects that the steady power model needs to explain the records.

Candidates (effects.py) are added one by one to the regression of the readings (records.py, regression.py). Each must pass the
rules of a diagnosis of thrust: likelihood ratio, evidence, cross-validation, size, and a 95 % interval without 0. A score test
on shapes of the commands and of time reports lack of fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from identification.diagnose.judgement import (
    ACCURACY,
    ALPHA,
    ALPHA_BASE,
    ALTERNATIVE_WINDOW,
    FORM,
    MIN_EVIDENCE,
    MOST,
    chance_threshold,
    refusals,
)
from identification.diagnose.score_test import ScoreTest, orthonormal_scores, scores_covariance
from identification.power.effects import EFFECTS, POWER, SAG, PowerEffect
from identification.power.fit import TIMES, electrical
from identification.power.model import PowerModel
from identification.power.records import power_part, respond, squared_torque, supply_parts
from identification.power.regression import Part, Regression, RegressionFit, scan
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

UNITS = {"power": "W", "voltage": "V"}


@dataclass(frozen=True)
class Lack:
    """Score test for lack of fit: p-value, and rms `size` [W] that the shapes explain, with its minimum `least`."""

    p: float
    size: float
    least: float
    has_effects: bool

    @property
    def significant(self) -> bool:
        """Whether the test rejects, above the minimum size."""
        return self.p < (ALPHA if self.has_effects else ALPHA_BASE) and self.size > self.least

    def summary(self) -> dict:
        """For diagnosis.json."""
        size, least = ({"value": value, "unit": "W"} for value in (self.size, self.least))
        return {"p": self.p, "size": size, "least_size": least}


def lack_of_fit(fit: RegressionFit, least: float) -> Lack:
    """Score test of the power, as `score_test` of the thrust."""
    problem = fit.problem
    each = [np.stack([p.at.mean(shape) for shape in p.shapes()], axis=1) for p in problem.parts]
    columns = np.ascontiguousarray(problem.whitened(each).T)
    turned, score = orthonormal_scores(fit, columns, slice(0, columns.shape[1]))
    if not len(score):
        return Lack(1.0, 0.0, least, bool(fit.effects))
    rest, parts = fit.residual - columns.T @ (turned.T @ score), []
    which = problem.rows_of([np.full(len(p.at.time), k) for k, p in enumerate(problem.parts)])
    for k in range(len(problem.parts)):
        own = turned @ columns[:, which == k]
        parts.append((own, rest[None, which == k], np.vstack([own, fit.basis[which == k].T])))
    covariance, bands = scores_covariance(parts)
    test = ScoreTest(0.5 * float(score @ np.linalg.solve(covariance, score) - len(score)), len(score), bands)
    power = float(np.nanmean(np.concatenate([fit.error(p) for p in problem.parts]) ** 2))
    return Lack(test.p, float(np.sqrt(max(2.0 * test.gain, 0.0) / len(rest) * power)), least, bool(fit.effects))


@dataclass(frozen=True)
class Tried:
    """A candidate beside `beside` others: its statistics, and why it is rejected; empty: accepted."""

    effect: PowerEffect
    beside: tuple[str, ...]
    likelihood_gain: float
    needed: float
    evidence: float
    gain: float
    size: float
    least: float
    refused: tuple[str, ...]

    def summary(self) -> dict:
        """For diagnosis.json."""
        unit = UNITS[self.effect.reading]
        return {
            "evidence": self.evidence,
            "log_likelihood": self.likelihood_gain,
            "log_likelihood_by_chance": self.needed,
            "held_out_gain": self.gain,
            "size": {"value": self.size, "unit": unit},
            "least_size": {"value": self.least, "unit": unit},
        }


def select(
    problem: Regression, effects: Sequence[PowerEffect], comparisons: int
) -> tuple[RegressionFit, RegressionFit, list[Tried]]:
    """(fit without effects, with the accepted ones, all that were tried): forward selection by evidence."""
    base = fit = problem.fit()
    tried: list[Tried] = []
    while len(fit.effects) < MOST and (others := [e for e in effects if e.name not in {a.name for a in fit.effects}]):
        fits = [(with_effect(fit, e), e) for e in others]
        judged = [(f, judged_effect(fit, f, e, comparisons)) for f, e in fits]
        tried += [t for _, t in judged]
        accepted = [(f, t) for f, t in judged if not t.refused]
        if not accepted:
            break
        best, _ = max(accepted, key=lambda pair: pair[1].evidence)
        # A missing effect looks like slow noise: the colour is estimated again beside the accepted effects.
        fit = Regression.of(problem.parts, best.effects, best.x).fit(best.effects, best.x)
    return base, fit, tried


def with_effect(fit: RegressionFit, effect: PowerEffect) -> RegressionFit | None:
    """One more effect beside a fit; None if no possible size fits."""
    start = fit.problem.started(fit, effect)
    return fit.problem.fit((*fit.effects, effect), np.append(fit.x, start)) if start[0] != 0.0 else None


def judged_effect(beside: RegressionFit, fit: RegressionFit | None, effect: PowerEffect, comparisons: int) -> Tried:
    """Statistics of an effect against the fit without it, and the reasons to reject it."""
    problem, k, names = beside.problem, len(effect.parameters), tuple(e.name for e in beside.effects)
    form = FORM * max(problem.fit().squares - beside.squares, 0.0) / 2.0
    needed, least = chance_threshold(k, comparisons) + form, ACCURACY * problem.largest
    if fit is None:
        return Tried(effect, names, 0.0, needed, 0.0, 0.0, 0.0, least, ("its best size has the wrong sign",))
    likelihood = 0.5 * (beside.squares - fit.squares)
    changes = [beside.error(p) - fit.error(p) for p in problem.parts]
    evidence, size = fit.evidence - beside.evidence, float(np.sqrt(np.nanmean(np.concatenate(changes) ** 2)))
    (before, _), (after, _) = beside.held_out, fit.held_out
    gain = 0.5 * len(problem.measured) * float(np.log(before / after))
    refused = refusals(likelihood, needed, evidence, {effect.reading: gain}, k, size > least)
    low, high = (0.0, 0.0) if refused else fit.interval(len(fit.x) - k)
    if not refused and low <= 0.0 <= high:
        refused = ["the 95 % interval of its size includes 0"]
    return Tried(effect, names, likelihood, needed, evidence, gain, size, least, tuple(refused))


def rivals(fit: RegressionFit, effects: Sequence[PowerEffect]) -> dict[str, list[str]]:
    """By accepted effect: others that in its place have an evidence within ALTERNATIVE_WINDOW."""
    found, first = {}, 0
    for effect in fit.effects:
        at = np.arange(first, first := first + len(effect.parameters))
        rest = fit.problem.fit([e for e in fit.effects if e is not effect], np.delete(fit.x, at))
        others = [e for e in effects if e.name not in {a.name for a in fit.effects}]
        near = ((e.name, f) for e in others if (f := with_effect(rest, e)) and f.evidence > rest.evidence + MIN_EVIDENCE)
        if names := {name for name, f in near if f.evidence > fit.evidence - ALTERNATIVE_WINDOW}:
            found[effect.name] = sorted(names)
    return found


@dataclass(frozen=True, eq=False)
class PowerDiagnosis:
    """Result. `before`, `after`: fits of the power; `voltage`: the same of the voltage, None if not measured with the current.
    `lack`: of both fits of the power. `family`: by effect, others that fit as well. `unseen`: the validation record, if it has
    power. `refuted`: why held-out data refute the effects of power, else ""."""

    before: RegressionFit
    after: RegressionFit
    voltage: tuple[RegressionFit, RegressionFit] | None
    lack: tuple[Lack, Lack]
    tried: tuple[Tried, ...]
    family: Mapping[str, Sequence[str]]
    unseen: Part | None
    refuted: str

    @property
    def verdict(self) -> str:
        """As of the thrust: none, attributed, family, partly, unexplained."""
        if self.lack[1].significant:
            return "partly" if self.after.effects else "unexplained"
        return "family" if self.family else "attributed" if self.effects else "none"

    @property
    def fits(self) -> tuple[RegressionFit, ...]:
        """Final fits, of power and of the voltage."""
        return (self.after, self.voltage[1]) if self.voltage else (self.after,)

    @property
    def effects(self) -> list[PowerEffect]:
        """The accepted effects."""
        return [e for fit in self.fits for e in fit.effects]

    @cached_property
    def errors(self) -> tuple[float, float]:
        """`held_out_error` [W] before and after."""
        return held_out_error(self.before, self.unseen), held_out_error(self.after, self.unseen)

    @property
    def block(self) -> float:
        """s, of the means that are compared."""
        time = self.after.problem.parts[0].at.time
        return float(time[1] - time[0])

    @property
    def shown(self) -> tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Name, columns as block means, and the power of each fit [W], of the validation record, else of the first one."""
        part = self.unseen or self.after.problem.parts[0]
        columns = {name: part.record[name][part.at.edges[:-1]] for name in ("omega_ref", "beta_ref")}
        columns |= {"time": part.at.time, "power": part.at.mean(electrical(part.record.columns))}
        fits = {"before": self.before, "after": self.after} if self.after.effects else {"model": self.before}
        return part.name, columns, {name: columns["power"] - fit.error(part) for name, fit in fits.items()}

    @cached_property
    def parameters(self) -> dict[str, dict[str, dict]]:
        """By effect and name: value, standard error, 95 % interval, unit."""
        found: dict[str, dict[str, dict]] = {}
        for fit in self.fits:
            declared = [(e, p) for e in fit.effects for p in e.parameters]
            for k, (effect, p) in enumerate(declared):
                own = {"value": float(fit.x[k]), "std": float(fit.std[k]), "interval": list(fit.interval(k)), "unit": p.unit}
                found.setdefault(effect.name, {})[p.name] = own
        return found

    def why_not(self, tried: Tried) -> str | None:
        """Why a candidate is rejected; None if it is accepted."""
        if tried.refused or tried.effect in self.effects:
            return "; ".join(tried.refused) or None
        return self.refuted or "another effect explains more"

    def summary(self) -> dict:
        """The entry `power` of diagnosis.json."""
        accepted = {t.effect.label: t for t in self.tried if not t.refused}
        source = {"record": (self.unseen or self.after.problem.parts[0]).name}
        source["from"] = "validation" if self.unseen else "cross-validation"
        before, after = ({**source, "rmse_power": {"value": error, "unit": "W"}} for error in self.errors)
        effects = []
        for effect in self.effects:
            entry = {"name": effect.name, "form": effect.form, "parameters": self.parameters[effect.name]}
            effects.append({**entry, "evidence": accepted[effect.label].summary()})
        found = {"verdict": self.verdict, "refuted": self.refuted or None, "effects": effects, "family": dict(self.family)}
        found |= {"before": before, "after": after, "block": {"value": self.block, "unit": "s"}}
        if self.voltage:
            found["voltage"] = dict(
                zip(("before", "after"), ({"value": f.held_out[1], "unit": "V"} for f in self.voltage), strict=True)
            )
        else:
            found["not_identifiable"] = {SAG.name: "needs measured voltage and current"}
        found["lack_of_fit"] = dict(zip(("before", "after"), (lack.summary() for lack in self.lack), strict=True))
        found["candidates"] = [
            {"name": t.effect.name, "form": t.effect.form, "beside": list(t.beside), **t.summary(), "why_not": self.why_not(t)}
            for t in self.tried
        ]
        return found


def held_out_error(fit: RegressionFit, unseen: Part | None) -> float:
    """Rms error [W] of block means on the validation record, else in cross-validation."""
    return float(np.sqrt(np.nanmean(fit.error(unseen) ** 2))) if unseen else fit.held_out[1]


def diagnose_power(
    records: Mapping[str, Record], unseen: Record | None, parameters: ParameterSet, block: float
) -> PowerDiagnosis | None:
    """Diagnose the power of records, by name, beside a plant; `block` [s]: length of the means of readings that are compared.

    The plant has power. None if no record has electrical power, or if the records are too short for the base.
    """
    model, plant = PowerModel.of(parameters), partial(respond, parameters)
    measured = {name: plant(record) for name, record in records.items() if electrical(record.columns) is not None}
    if not measured:
        return None
    squared = {name: squared_torque(model, r.shown) for name, r in measured.items()}
    largest = max(float(s.max()) for s in squared.values())
    parts = [power_part(name, r, model, block, largest) for name, r in measured.items()]
    if sum(int(np.isfinite(p.means[0]).sum()) for p in parts) < TIMES * (parts[0].base.shape[1] + len(list(parts[0].shapes()))):
        return None
    with_both = {name: r.shown for name, r in measured.items() if {"voltage", "current"} <= set(r.shown.record.columns)}
    offered = [e for e in EFFECTS if e.reading == POWER or with_both]
    comparisons = sum(len(scan(e)) for e in offered)
    of_power = [e for e in offered if e.reading == POWER]
    before, after, tried = select(Regression.of(parts), of_power, comparisons)
    family = rivals(after, of_power)
    least = ACCURACY * before.problem.largest
    hold_out, refuted = None, ""
    if unseen is not None and electrical(unseen.columns) is not None:
        hold_out = power_part("validation", plant(unseen), model, block, largest)
    errors = [held_out_error(fit, hold_out) for fit in (before, after)]
    if errors[1] > errors[0]:
        after, family, refuted = before, {}, "the error on held-out data increases"
    lack = lack_of_fit(before, least), lack_of_fit(after, least)
    voltage = None
    if with_both:
        supply = supply_parts({p.name: p for p in parts}, with_both, after)
        one, two, further = select(Regression.of(supply), [SAG], comparisons)
        voltage, tried = (one, two), [*tried, *further]
    return PowerDiagnosis(before, after, voltage, lack, tuple(tried), family, hold_out, refuted)
