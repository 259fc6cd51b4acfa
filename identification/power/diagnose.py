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
from identification.diagnose.judgement import ALTERNATIVE_WINDOW, FORM, MIN_EVIDENCE, Judgement, chance_threshold, refusals
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
    """An effect that was tried `beside` others. `fit`: None if its best size is impossible."""

    effect: PowerEffect
    beside: tuple[str, ...]
    fit: RegressionFit | None
    judged: Judgement

    def summary(self) -> dict:
        """Its statistics, for diagnosis.json."""
        return self.judged.summary(UNITS[self.effect.reading])


def select(parts: Sequence[Part], effects: Sequence[PowerEffect]) -> tuple[RegressionFit, RegressionFit, list[Tried]]:
    """(fit without effects, with the accepted ones, all that were tried): forward selection by evidence."""
    base = fit = Regression(parts).fit()
    tried: list[Tried] = []
    while now := [judged(fit, e) for e in effects if e.name not in fit.names]:
        tried += now
        best = max(now, key=lambda t: -np.inf if t.judged.refused else t.judged.evidence)
        if best.judged.refused or not best.fit:
            break
        # A missing effect looks like slow noise: the colour is estimated again beside the accepted effects.
        fit = Regression(parts, best.fit.effects, best.fit.x).fit(best.fit.effects, best.fit.x)
    return base, fit, tried


def judged(beside: RegressionFit, effect: PowerEffect) -> Tried:
    """Fit one more effect, and judge it against the fit without it."""
    problem, fit, k = beside.problem, beside.with_effect(effect), len(effect.parameters)
    needed = chance_threshold(k, COMPARISONS) + FORM * max(problem.fit().squares - beside.squares, 0.0) / 2.0
    likelihood, evidence, gain, size, refused = 0.0, 0.0, 0.0, 0.0, ["its best size has the wrong sign"]
    if fit:
        likelihood, evidence = 0.5 * (beside.squares - fit.squares), fit.evidence - beside.evidence
        gain = 0.5 * len(fit.residual) * float(np.log(beside.held_out[0] / fit.held_out[0]))
        size = rms([beside.errors - fit.errors])
        refused = refusals(likelihood, needed, evidence, {effect.reading: gain}, k, size > problem.least)
    gains, least = {effect.reading: gain}, problem.least
    found = Judgement(effect.name, likelihood, needed, evidence, gains, size, least, size > least, tuple(refused))
    return Tried(effect, beside.names, fit, found)


def rivals(fit: RegressionFit, effects: Sequence[PowerEffect]) -> dict[str, list[str]]:
    """By accepted effect: others that in its place have an evidence within ALTERNATIVE_WINDOW."""
    found, own = {}, [e.name for e in fit.effects for _ in e.parameters]
    for name in fit.names:
        rest = fit.problem.fit([e for e in fit.effects if e.name != name], fit.x[[n != name for n in own]])
        least = max(rest.evidence + MIN_EVIDENCE, fit.evidence - ALTERNATIVE_WINDOW)
        others = [e for e in effects if e.name not in fit.names]
        if names := {e.name for e in others if (f := rest.with_effect(e)) and f.evidence > least}:
            found[name] = sorted(names)
    return found


@dataclass(frozen=True, eq=False)
class PowerDiagnosis:
    """Result. `power`: fits of the power without and with effects; `voltage`: the same of the voltage, empty if it was not
    measured with the current. `family`: by effect, others that fit as well. `unseen`: the validation record, if it has power.
    `refuted`: why held-out data refute the effects of power, else ""."""

    power: tuple[RegressionFit, RegressionFit]
    voltage: tuple[RegressionFit, ...]
    tried: Sequence[Tried]
    family: Mapping[str, Sequence[str]]
    unseen: Part | None
    refuted: str

    @property
    def verdict(self) -> str:
        """As of the thrust: none, attributed, family, partly, unexplained."""
        after = self.power[1]
        if after.lack.significant:
            return "partly" if after.effects else "unexplained"
        return "family" if self.family else "attributed" if self.effects else "none"

    @property
    def effects(self) -> list[PowerEffect]:
        """The accepted effects, of power and of the voltage."""
        return [e for fit in (self.power[1], *self.voltage[1:]) for e in fit.effects]

    @cached_property
    def errors(self) -> tuple[float, float]:
        """`held_out_error` [W] before and after."""
        before, after = (held_out_error(fit, self.unseen) for fit in self.power)
        return before, after

    @property
    def part(self) -> Part:
        """The record to show: the validation record, else the first one."""
        return self.unseen or self.power[1].problem.parts[0]

    @property
    def block(self) -> float:
        """s, of the means that are compared."""
        return float(np.diff(self.part.at.time[:2])[0])

    @cached_property
    def parameters(self) -> dict[str, dict[str, dict]]:
        """By effect and name: value, standard error, 95 % interval, unit."""
        found: dict[str, dict[str, dict]] = {}
        for fit in (self.power[1], *self.voltage[1:]):
            declared = [(e.name, p) for e in fit.effects for p in e.parameters]
            for (name, p), x, std, ends in zip(declared, fit.x.tolist(), fit.std.tolist(), fit.intervals, strict=True):
                found.setdefault(name, {})[p.name] = {"value": x, "std": std, "interval": ends.tolist(), "unit": p.unit}
        return found

    def why_not(self, tried: Tried) -> str | None:
        """Why a candidate is rejected; None if it is accepted."""
        if tried.judged.refused or tried.effect in self.effects:
            return "; ".join(tried.judged.refused) or None
        return self.refuted or "another effect explains more"

    def summary(self) -> dict:
        """The entry `power` of diagnosis.json."""
        evidence = {t.effect: t.summary() for t in self.tried if not t.judged.refused}
        source = {"record": self.part.name, "from": "validation" if self.unseen else "cross-validation"}
        found = {
            "verdict": self.verdict,
            "refuted": self.refuted or None,
            "effects": [
                {"name": e.name, "form": e.form, "parameters": self.parameters[e.name], "evidence": evidence[e]}
                for e in self.effects
            ],
            "family": dict(self.family),
            "block": _in("s", self.block),
            "lack_of_fit": {},
            "candidates": [
                {"name": t.effect.name, "form": t.effect.form, "beside": list(t.beside)}
                | t.summary()
                | {"why_not": self.why_not(t)}
                for t in self.tried
            ],
        }
        for when, fit, error in zip(("before", "after"), self.power, self.errors, strict=True):
            found[when] = {**source, "rmse_power": _in("W", error)}
            lack = {"p": fit.lack.p, "size": _in("W", fit.lack.size), "least_size": _in("W", fit.lack.least)}
            found["lack_of_fit"] |= {when: lack}
        if not self.voltage:
            return found | {"not_identifiable": {SAG.name: "needs measured voltage and current"}}
        before, after = (_in("V", fit.held_out[1]) for fit in self.voltage)
        return found | {"voltage": {"before": before, "after": after}}


def _in(unit: str, value: float) -> dict:
    return {"value": value, "unit": unit}


def held_out_error(fit: RegressionFit, unseen: Part | None) -> float:
    """Rms error [W] of block means on the validation record, else in cross-validation."""
    return rms([fit.error(unseen)]) if unseen else fit.held_out[1]


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
    largest = max(float(squared_torque(model, shown).max()) for shown, *_ in measured.values())
    parts = [power_part(name, r, model, block, largest) for name, r in measured.items()]
    if sum(int(np.isfinite(p.means[0]).sum()) for p in parts) < TIMES * (parts[0].base.shape[1] + parts[0].shapes.shape[1]):
        return None
    of_power = [e for e in EFFECTS if e.reading == POWER]
    before, after, tried = select(parts, of_power)
    family, hold_out, refuted, voltage = rivals(after, of_power), None, "", ()
    if unseen is not None and electrical(unseen.columns) is not None:
        hold_out = power_part("validation", plant(unseen), model, block, largest)
    if held_out_error(after, hold_out) > held_out_error(before, hold_out):
        after, family, refuted = before, {}, "the error on held-out data increases"
    if supply := supply_parts(after):
        *voltage, further = select(supply, [SAG])
        tried += further
    return PowerDiagnosis((before, after), tuple(voltage), tried, family, hold_out, refuted)
