"""Diagnosis of the power in time: the effects that the steady power model needs to explain the records.

Candidates (effects.py) are added one by one to the regression of the readings (records.py, regression.py). Each must pass the
rules of a diagnosis of thrust: likelihood ratio, evidence, cross-validation and size. A score test on shapes of the commands
and of time reports lack of fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from identification.diagnose.crossval import rms
from identification.diagnose.judgement import (
    ALTERNATIVE_WINDOW,
    FORM,
    MIN_EVIDENCE,
    Judgement,
    chance_threshold,
    refusals,
)
from identification.diagnose.lack_of_fit import LackOfFit
from identification.power.effects import EFFECTS, POWER, SAG, PowerEffect
from identification.power.fit import TIMES, electrical
from identification.power.model import PowerModel
from identification.power.records import power_part, respond, squared_torque, supply_parts
from identification.power.regression import STARTS, Part, Regression, RegressionFit
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

UNITS = {"power": "W", "voltage": "V"}

COMPARISONS = sum(STARTS ** (len(e.parameters) - 1) for e in EFFECTS)
"""Number of points of a search."""


@dataclass(frozen=True)
class Tried:
    """An effect that was tried `beside` others."""

    effect: PowerEffect
    beside: tuple[str, ...]
    judged: Judgement


def lack_of_fit(fit: RegressionFit) -> LackOfFit:
    """Score test of the power, in W; `size`: rms that the shapes explain."""
    test, errors = fit.score_test(), [fit.error(p) for p in fit.problem.parts]
    size = float(np.sqrt(max(2.0 * test.gain, 0.0) / len(fit.residual))) * rms(errors)
    return LackOfFit((), test, test.p, size, fit.problem.least, bool(fit.effects))


def select(problem: Regression, effects: Sequence[PowerEffect]) -> tuple[RegressionFit, RegressionFit, list[Tried]]:
    """(fit without effects, with the accepted ones, all that were tried): forward selection by evidence."""
    base = fit = problem.fit()
    tried: list[Tried] = []
    while others := [e for e in effects if e.name not in {a.name for a in fit.effects}]:
        names = tuple(e.name for e in fit.effects)
        fits = {e: fit.with_effect(e) for e in others}
        judgements = {e: judged(fit, f, e) for e, f in fits.items()}
        tried += [Tried(e, names, j) for e, j in judgements.items()]
        accepted = {fits[e]: j.evidence for e, j in judgements.items() if not j.refused}
        if not accepted:
            break
        best = max(accepted, key=accepted.__getitem__)
        # A missing effect looks like slow noise: the colour is estimated again beside the accepted effects.
        fit = Regression.of(problem.parts, best.effects, best.x).fit(best.effects, best.x)
    return base, fit, tried


def judged(beside: RegressionFit, fit: RegressionFit | None, effect: PowerEffect) -> Judgement:
    """Judge an effect against the fit without it; None: its best size is impossible."""
    problem, k = beside.problem, len(effect.parameters)
    needed = chance_threshold(k, COMPARISONS) + FORM * max(problem.fit().squares - beside.squares, 0.0) / 2.0
    if fit is None:
        wrong = ("its best size has the wrong sign",)
        return Judgement(effect.name, 0.0, needed, 0.0, {effect.reading: 0.0}, 0.0, problem.least, False, wrong)
    likelihood, evidence = 0.5 * (beside.squares - fit.squares), fit.evidence - beside.evidence
    size = rms([beside.error(p) - fit.error(p) for p in problem.parts])
    gain = {effect.reading: 0.5 * len(problem.measured) * float(np.log(beside.held_out[0] / fit.held_out[0]))}
    material = size > problem.least
    refused = refusals(likelihood, needed, evidence, gain, k, material)
    return Judgement(effect.name, likelihood, needed, evidence, gain, size, problem.least, material, tuple(refused))


def rivals(fit: RegressionFit, effects: Sequence[PowerEffect]) -> dict[str, list[str]]:
    """By accepted effect: others that in its place have an evidence within ALTERNATIVE_WINDOW."""
    found, first = {}, 0
    for effect in fit.effects:
        at = np.arange(first, first := first + len(effect.parameters))
        rest = fit.problem.fit([e for e in fit.effects if e is not effect], np.delete(fit.x, at))
        others = [e for e in effects if e.name not in {a.name for a in fit.effects}]
        near = ((e.name, f) for e in others if (f := rest.with_effect(e)) and f.evidence > rest.evidence + MIN_EVIDENCE)
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
    voltage: Sequence[RegressionFit] | None
    lack: tuple[LackOfFit, LackOfFit]
    tried: Sequence[Tried]
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
    def fits(self) -> list[RegressionFit]:
        """Final fits, of power and of the voltage."""
        return [self.after, *(self.voltage or ())[1:]]

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
            declared = [(e.name, p) for e in fit.effects for p in e.parameters]
            for (name, p), x, std, ends in zip(declared, fit.x.tolist(), fit.std.tolist(), fit.intervals, strict=True):
                found.setdefault(name, {})[p.name] = {"value": x, "std": std, "interval": list(ends), "unit": p.unit}
        return found

    def why_not(self, tried: Tried) -> str | None:
        """Why a candidate is rejected; None if it is accepted."""
        if tried.judged.refused or tried.effect in self.effects:
            return "; ".join(tried.judged.refused) or None
        return self.refuted or "another effect explains more"

    def summary(self) -> dict:
        """The entry `power` of diagnosis.json."""
        accepted = {t.effect: t.judged for t in self.tried if not t.judged.refused}
        source = {
            "record": (self.unseen or self.after.problem.parts[0]).name,
            "from": "validation" if self.unseen else "cross-validation",
        }
        before, after = ({**source, "rmse_power": _in("W", error)} for error in self.errors)
        found = {
            "verdict": self.verdict,
            "refuted": self.refuted or None,
            "effects": [
                {
                    "name": e.name,
                    "form": e.form,
                    "parameters": self.parameters[e.name],
                    "evidence": accepted[e].summary(UNITS[e.reading]),
                }
                for e in self.effects
            ],
            "family": dict(self.family),
            "before": before,
            "after": after,
            "block": _in("s", self.block),
            "lack_of_fit": {
                when: {"p": lack.p, "size": _in("W", lack.size), "least_size": _in("W", lack.least)}
                for when, lack in zip(("before", "after"), self.lack, strict=True)
            },
            "candidates": [
                {
                    "name": t.effect.name,
                    "form": t.effect.form,
                    "beside": list(t.beside),
                    **t.judged.summary(UNITS[t.effect.reading]),
                    "why_not": self.why_not(t),
                }
                for t in self.tried
            ],
        }
        if not self.voltage:
            return found | {"not_identifiable": {SAG.name: "needs measured voltage and current"}}
        before, after = (_in("V", fit.held_out[1]) for fit in self.voltage)
        return found | {"voltage": {"before": before, "after": after}}


def _in(unit: str, value: float) -> dict:
    return {"value": value, "unit": unit}


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
    of_power = [e for e in EFFECTS if e.reading == POWER]
    before, after, tried = select(Regression.of(parts), of_power)
    family, hold_out, refuted, voltage = rivals(after, of_power), None, "", None
    if unseen is not None and electrical(unseen.columns) is not None:
        hold_out = power_part("validation", plant(unseen), model, block, largest)
    if held_out_error(after, hold_out) > held_out_error(before, hold_out):
        after, family, refuted = before, {}, "the error on held-out data increases"
    if supply := supply_parts(after):
        *voltage, further = select(Regression.of(supply), [SAG])
        tried += further
    lack = lack_of_fit(before), lack_of_fit(after)
    return PowerDiagnosis(before, after, voltage, lack, tried, family, hold_out, refuted)
