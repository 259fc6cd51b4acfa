"""Diagnosis of the power in time: the effects that the steady power model needs to explain the records.

The residual of the identified model (fit.py) at the simulated speed and pitch is regressed on what is not of interest here: a map
of degree DEGREE, the copper loss, the acceleration of the rotor (J omega domega/dt and its copper loss), and errors of the lags
of speed and pitch. Residuals are whitened by an autoregression. Candidates (effects.py) are added one by one. Each must pass the
rules of a diagnosis of thrust: likelihood ratio, evidence, cross-validation, size, and a 95 % interval without 0. A score test
on shapes of the commands and of time reports lack of fit. The voltage over the current is a second reading, with lines in time
as its base. The current is predicted from the power by the records, so its noise does not bias the resistance (two-stage least
squares).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2

from identification.assessment.prediction import Prediction
from identification.diagnose.command_shapes import output_shapes, regress_out
from identification.diagnose.crossval import folds
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
from identification.fit.coordinates import slowest
from identification.fit.noise import Blocks, Colour, blocks, colour_of
from identification.fit.uncertainty import NORMAL_95
from identification.power.effects import EFFECTS, POWER, SAG, PowerEffect, Signals
from identification.power.fit import EXACT, TIMES, electrical
from identification.power.model import PowerModel
from vpp_fmu.kernel.power import MOTOR, RAD_PER_S
from vpp_fmu.native import Simulator
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

DEGREE = 4
"""Degree in speed, and in pitch, of the map that is refined on the records: that of the copper loss of a torque of degree 2."""

SCAN = 1.6
"""Ratio of neighbouring time constants of a scan: a lag loses less than 2 % of its power between two of them."""

STEP = 1e-4
"""Relative step of a derivative."""

FINE = 0.01
"""Largest step of a difference quotient, as a share of the slowest time constant."""

LEAST_SPEED = 0.02
"""Share of the speed scale below which a speed is replaced by it where power is divided by speed."""

UNITS = {"power": "W", "voltage": "V"}


@dataclass(frozen=True, eq=False)
class Part:
    """One reading of one record: `measured` (rows,) and `base` (rows, k), whose coefficients are free; `shapes` that span the
    residual of a missing effect, for the noise and the lack of fit. Block means are compared."""

    name: str
    record: Record
    at: Blocks
    measured: np.ndarray
    base: np.ndarray
    signals: Signals
    shapes: Callable[[], Iterator[np.ndarray]]

    @cached_property
    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Block means of the reading (blocks,) and of the base (blocks, k)."""
        return self.at.mean(self.measured), self.at.mean(self.base)

    def response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Block means (blocks,) of effects with parameters `x`."""
        return self.at.mean(self.response_rows(effects, x))

    def response_rows(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """(rows,)."""
        total, first = np.zeros(len(self.measured)), 0
        for effect in effects:
            names = [p.name for p in effect.parameters]
            own = dict(zip(names, x[first : first + len(names)].tolist(), strict=True))
            total, first = total + effect.response(self.signals, own), first + len(names)
        return total


class Problem:
    """A reading of all records, whitened by the colour of the noise of each."""

    def __init__(self, parts: Sequence[Part], colours: Sequence[Colour]):
        self.parts, self.colours = parts, colours
        self._seen = [np.isfinite(c.whiten(p.means[0])) for p, c in zip(parts, colours, strict=True)]
        base = self.whitened([p.means[1] for p in parts])
        self.size = np.linalg.norm(base, axis=0)
        self.size[self.size == 0.0] = 1.0
        self.base, self.measured = base / self.size, self.whitened([p.means[0] for p in parts])
        turned, power, _ = np.linalg.svd(self.base, full_matrices=False)
        self.basis = turned[:, power > 1e-8 * power[0]]

    @classmethod
    def of(cls, parts: Sequence[Part], effects: Sequence[PowerEffect] = (), x: np.ndarray = np.zeros(0)) -> "Problem":
        """With the noise of the residual beside `effects`, after a regression on base and shapes."""
        found = []
        for p in parts:
            residual = p.measured - p.response_rows(effects, x)
            rest, removed = regress_out(
                lambda p=p: (*p.shapes(), *p.base.T), p.at.mean, residual, np.zeros((len(p.at.time), 0))
            )
            colour = colour_of([p.at.mean(rest)], removed)
            least = EXACT * float(np.nanmax(np.abs(p.measured)))  # readings without noise
            found.append(replace(colour, innovation=max(colour.innovation, least)))
        return cls(parts, found)

    def whitened(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """(n, ...) of block means of each record, where the reading exists."""
        white = [c.whiten(column) for column, c in zip(columns, self.colours, strict=True)]
        return np.concatenate([w[seen] for w, seen in zip(white, self._seen, strict=True)])

    @cached_property
    def slices(self) -> list[slice]:
        """Rows of each record."""
        ends = np.cumsum([0, *(int(seen.sum()) for seen in self._seen)])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def held(self, split: Callable[[np.ndarray, float], np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Fold of each whitened row, and of the blocks of each record."""
        own = [split(p.at.time, float(p.record.time[-1])) for p in self.parts]
        rows = [f[len(f) - len(s) :][s] for f, s in zip(own, self._seen, strict=True)]
        return np.concatenate(rows), own

    def orthogonal(self, columns: np.ndarray) -> np.ndarray:
        """Part of columns (n, ...) that the base does not span."""
        return columns - self.basis @ (self.basis.T @ columns)

    def fit(self, effects: Sequence[PowerEffect] = (), start: np.ndarray = np.zeros(0)) -> "Fit":
        """Least squares of effects beside the base, from a `start` of their parameters."""
        declared = [p for e in effects for p in e.parameters]
        if not declared:
            return Fit(self, (), start)
        bounds = np.array([(p.minimum, p.maximum) for p in declared]).T
        found = least_squares(partial(self.residual, effects), np.clip(start, *bounds), bounds=bounds, x_scale=np.abs(start))
        return Fit(self, tuple(effects), found.x)

    def residual(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Whitened residual (n,), orthogonal to the base."""
        return self.orthogonal(self.measured - self.whitened([p.response(effects, x) for p in self.parts]))

    def started(self, fit: "Fit", effect: PowerEffect) -> np.ndarray:
        """Start of the parameters of an effect beside a fit: the best of a scan; a size of 0 if no possible one fits."""
        left = fit.residual
        beside, _ = np.linalg.qr(self.orthogonal(fit.jacobian)) if fit.effects else (np.zeros((len(left), 0)), None)
        tiny, best = STEP * ACCURACY * max(float(np.nanmax(np.abs(p.measured))) for p in self.parts), (0.0, np.zeros(1))
        for further in scan(effect):
            column = self.whitened([p.response([effect], np.array([tiny, *further])) for p in self.parts]) / tiny
            column = self.orthogonal(column)
            column -= beside @ (beside.T @ column)
            power = float(column @ column)
            size = float(column @ left) / power if power > 0.0 else 0.0
            if effect.possible(size) and size**2 * power > best[0]:
                best = size**2 * power, np.array([size, *further])
        return best[1]


def scan(effect: PowerEffect) -> list[tuple[float, ...]]:
    """Values of the parameters of an effect beside its size, at which a search tries it."""
    further = effect.parameters[1:]
    if not further:
        return [()]
    (p,) = further
    return [(float(v),) for v in np.geomspace(p.minimum, p.maximum, round(np.log(p.maximum / p.minimum) / np.log(SCAN)) + 1)]


@dataclass(frozen=True, eq=False)
class Fit:
    """Effects with parameters `x` beside the base of a problem."""

    problem: Problem
    effects: tuple[PowerEffect, ...]
    x: np.ndarray

    @cached_property
    def residual(self) -> np.ndarray:
        """Whitened (n,), orthogonal to the base."""
        return self.problem.residual(self.effects, self.x)

    @cached_property
    def slopes(self) -> list[np.ndarray]:
        """Derivatives (blocks, k) of the effects' block means by their parameters, for each record."""
        found = []
        for p in self.problem.parts:
            columns = []
            for k, step in enumerate(STEP * np.maximum(np.abs(self.x), STEP)):
                ends = [p.response(self.effects, self.x + s * step * (np.arange(len(self.x)) == k)) for s in (1.0, -1.0)]
                columns.append((ends[0] - ends[1]) / (2.0 * step))
            found.append(np.stack(columns, axis=1) if columns else np.zeros((len(p.at.time), 0)))
        return found

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives (n, k)."""
        return self.problem.whitened(self.slopes)

    @cached_property
    def squares(self) -> float:
        """Sum of squares: twice the negative log-likelihood."""
        return float(self.residual @ self.residual)

    @property
    def evidence(self) -> float:
        """Penalised log-likelihood: minus half the BIC, but for a constant."""
        return -0.5 * (self.squares + len(self.x) * float(np.log(len(self.residual))))

    @property
    def std(self) -> np.ndarray:
        """(k,) standard errors."""
        j = self.problem.orthogonal(self.jacobian)
        return np.sqrt(np.diag(np.linalg.pinv(j.T @ j, hermitian=True)))

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(k,) of the base."""
        p = self.problem
        rest = p.measured - p.whitened([part.response(self.effects, self.x) for part in p.parts])
        return np.linalg.lstsq(p.base, rest, rcond=1e-8)[0] / p.size

    def error(self, part: Part) -> np.ndarray:
        """Block means (blocks,) measured minus model, of any record."""
        measured, base = part.means
        return measured - base @ self.coefficients - part.response(self.effects, self.x)

    @cached_property
    def held_out(self) -> tuple[float, float]:
        """(sum of squares of the whitened residual, rms error of the block means) of folds predicted from the others, each
        after a Gauss-Newton step from this fit."""
        p = self.problem
        white = np.hstack([p.base, self.jacobian])
        raw = [np.hstack([part.means[1] / p.size, s]) for part, s in zip(p.parts, self.slopes, strict=True)]
        fold, own = p.held(folds)
        squares, errors = 0.0, []
        for k in range(int(fold.max()) + 1):
            out = fold == k
            move, *_ = np.linalg.lstsq(white[~out], self.residual[~out], rcond=1e-8)
            squares += float(np.sum((self.residual[out] - white[out] @ move) ** 2))
            errors += [(self.error(part) - r @ move)[f == k] for part, r, f in zip(p.parts, raw, own, strict=True)]
        return squares, float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))

    def change(self, effect: PowerEffect) -> float:
        """Rms change of the block means by one effect, beyond that which the base follows."""
        first = sum(len(e.parameters) for e in self.effects[: self.effects.index(effect)])
        x, changes, bases = self.x[first : first + len(effect.parameters)], [], []
        for part in self.problem.parts:
            changes.append(part.response([effect], x))
            bases.append(part.means[1])
        change, base = np.concatenate(changes), np.concatenate(bases)
        seen = np.isfinite(base).all(axis=1)
        rest = change[seen] - base[seen] @ np.linalg.lstsq(base[seen], change[seen], rcond=1e-8)[0]
        return float(np.sqrt(np.mean(rest**2)))

    def interval(self, k: int) -> tuple[float, float]:
        """95 % interval of a parameter: by its standard error if its effect is linear, else by the profile likelihood."""
        effect, declared = [(e, p) for e in self.effects for p in e.parameters][k]
        if len(effect.parameters) == 1:
            half = NORMAL_95 * float(self.std[k])
            return float(self.x[k]) - half, float(self.x[k]) + half
        others, most = np.delete(np.arange(len(self.x)), k), float(chi2.ppf(0.95, 1))
        bounds = np.array([(p.minimum, p.maximum) for e in self.effects for p in e.parameters])[others].T

        def beyond(logarithm: float) -> float:
            def residual(rest: np.ndarray) -> np.ndarray:
                return self.problem.residual(self.effects, np.insert(rest, k, self.x[k] * np.exp(logarithm)))

            start = self.x[others]
            return 2.0 * least_squares(residual, start, bounds=bounds, x_scale=np.abs(start)).cost - self.squares - most

        ends = []
        for bound in (declared.minimum, declared.maximum):
            reach = float(np.log(max(bound / self.x[k], STEP)))
            steps = np.sign(reach) * np.minimum(0.1 * 2.0 ** np.arange(8), abs(reach))
            end = next((float(s) for s in steps if beyond(float(s)) > 0.0), None)
            ends.append(bound if end is None else float(self.x[k]) * np.exp(brentq(beyond, 0.0, end, xtol=1e-2)))
        return ends[0], ends[1]


@dataclass(frozen=True)
class Lack:
    """Score test for lack of fit: p-value, and rms `size` [W] of what the shapes explain, with its minimum `least`."""

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


class _Residual:
    """The residual of a fit, for the score test."""

    def __init__(self, fit: Fit):
        self.residual = fit.residual
        self.basis = np.linalg.qr(np.hstack([fit.problem.basis, fit.problem.orthogonal(fit.jacobian)]))[0]

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray:
        """`rows` (k, n) less their part in the fitted directions, in place; their products."""
        rows -= (rows @ self.basis) @ self.basis.T
        return rows @ rows.T


def lack_of_fit(fit: Fit, least: float) -> Lack:
    """As `score_test` of the thrust."""
    problem, about = fit.problem, _Residual(fit)
    each = [[p.at.mean(shape) for shape in p.shapes()] for p in problem.parts]
    columns = np.ascontiguousarray(problem.whitened([np.stack(shapes, axis=1) for shapes in each]).T)
    turned, score = orthonormal_scores(about, columns, slice(0, columns.shape[1]))
    if not len(score):
        return Lack(1.0, 0.0, least, bool(fit.effects))
    rest = about.residual - columns.T @ (turned.T @ score)
    parts = []
    for i in problem.slices:
        own = turned @ columns[:, i]
        parts.append((own, rest[None, i], np.vstack([own, about.basis.T[:, i]])))
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


def select(problem: Problem, effects: Sequence[PowerEffect], comparisons: int) -> tuple[Fit, Fit, list[Tried]]:
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
        # A missing effect passes for slow noise: the colour is estimated again beside what was found.
        fit = Problem.of(problem.parts, best.effects, best.x).fit(best.effects, best.x)
    return base, fit, tried


def with_effect(fit: Fit, effect: PowerEffect) -> Fit | None:
    """One more effect beside a fit; None if no possible size fits."""
    start = fit.problem.started(fit, effect)
    return fit.problem.fit((*fit.effects, effect), np.append(fit.x, start)) if start[0] != 0.0 else None


def judged_effect(beside: Fit, fit: Fit | None, effect: PowerEffect, comparisons: int) -> Tried:
    """Statistics of an effect against the fit without it, and the reasons to reject it."""
    problem, k, names = beside.problem, len(effect.parameters), tuple(e.name for e in beside.effects)
    largest = max(float(np.nanmax(np.abs(p.measured))) for p in problem.parts)
    form = FORM * max(problem.fit().squares - beside.squares, 0.0) / 2.0
    needed, least = chance_threshold(k, comparisons) + form, ACCURACY * largest
    if fit is None:
        return Tried(effect, names, 0.0, needed, 0.0, 0.0, 0.0, least, ("its best size is impossible",))
    likelihood = 0.5 * (beside.squares - fit.squares)
    evidence, size = fit.evidence - beside.evidence, fit.change(effect)
    (before, _), (after, _) = beside.held_out, fit.held_out
    gain = 0.5 * len(problem.measured) * float(np.log(before / after))
    refused = refusals(likelihood, needed, evidence, {effect.reading: gain}, k, size > least)
    low, high = (0.0, 0.0) if refused else fit.interval(len(fit.x) - k)
    if not refused and low <= 0.0 <= high:
        refused = ["the 95 % interval of its size includes 0"]
    return Tried(effect, names, likelihood, needed, evidence, gain, size, least, tuple(refused))


def rivals(fit: Fit, effects: Sequence[PowerEffect]) -> dict[str, list[str]]:
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
    `lack`: of both fits of the power. `family`: by effect, others that fit as well. `unseen`: the
    validation record, if it has power. `refuted`: why the validation record
    refutes the effects of power, else ""."""

    before: Fit
    after: Fit
    voltage: tuple[Fit, Fit] | None
    lack: tuple[Lack, Lack]
    tried: tuple[Tried, ...]
    family: Mapping[str, Sequence[str]]
    unseen: Part | None
    refuted: str

    @property
    def verdict(self) -> str:
        """As of the thrust: none, attributed, family, partly, unexplained."""
        if self.lack[1].significant:
            return "partly" if self.effects else "unexplained"
        return "family" if self.family else "attributed" if self.effects else "none"

    @property
    def fits(self) -> tuple[Fit, ...]:
        """Final fits, of power and of the voltage."""
        return (self.after, self.voltage[1]) if self.voltage else (self.after,)

    @property
    def effects(self) -> list[PowerEffect]:
        """The accepted effects."""
        return [e for fit in self.fits for e in fit.effects]

    @cached_property
    def errors(self) -> tuple[float, float]:
        """Rms error [W] of block means before and after: on the validation record, else in cross-validation."""
        return tuple(_unseen_error(fit, self.unseen) if self.unseen else fit.held_out[1] for fit in (self.before, self.after))

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
            {"name": t.effect.name, "form": t.effect.form, "beside": list(t.beside), **t.summary()}
            | {
                "why_not": "; ".join(t.refused)
                or (None if t.effect in self.effects else self.refuted or "another explains more")
            }
            for t in self.tried
        ]
        return found


def _unseen_error(fit: Fit, part: Part) -> float:
    return float(np.sqrt(np.nanmean(fit.error(part) ** 2)))


def diagnose_power(
    records: Mapping[str, Record], unseen: Record | None, parameters: ParameterSet, block: float
) -> PowerDiagnosis | None:
    """Diagnose the power of records, by name, beside a plant; `block` [s]: length of the means of readings that are compared.

    None if no record has electrical power, if the plant has none, or if the records are too short for the base.
    """
    if "power" not in {y.name for y in parameters.model.outputs}:
        return None
    model, plant = PowerModel.of(parameters), partial(respond, parameters)
    measured = {name: plant(record) for name, record in records.items() if electrical(record.columns) is not None}
    if not measured:
        return None
    squared = {name: _squared_torque(model, r.shown) for name, r in measured.items()}
    largest = max(float(s.max()) for s in squared.values())
    parts = [_part(name, r, model, block, largest) for name, r in measured.items()]
    if sum(int(np.isfinite(p.means[0]).sum()) for p in parts) < TIMES * (parts[0].base.shape[1] + len(list(parts[0].shapes()))):
        return None
    with_both = {name: r.shown for name, r in measured.items() if {"voltage", "current"} <= set(r.shown.record.columns)}
    offered = [e for e in EFFECTS if e.reading == POWER or with_both]
    comparisons = sum(len(scan(e)) for e in offered)
    of_power = [e for e in offered if e.reading == POWER]
    before, after, tried = select(Problem.of(parts), of_power, comparisons)
    family = rivals(after, of_power)
    least = ACCURACY * max(float(np.nanmax(np.abs(p.measured))) for p in parts)
    hold_out, refuted = None, ""
    if unseen is not None and electrical(unseen.columns) is not None:
        hold_out = _part("validation", plant(unseen), model, block, largest)
        errors = [_unseen_error(fit, hold_out) for fit in (before, after)]
        if errors[1] > errors[0]:
            after, refuted, family = before, "the error on the validation record increases", {}
    lack = lack_of_fit(before, least), lack_of_fit(after, least)
    voltage = None
    if with_both:
        fitted = {p.name: p for p in parts}
        supply = [_supply(fitted[name], p, after) for name, p in with_both.items()]
        one, two, further = select(Problem.of(_side_by_side(supply)), [SAG], comparisons)
        voltage, tried = (one, two), [*tried, *further]
    return PowerDiagnosis(before, after, voltage, lack, tuple(tried), family, hold_out, refuted)


@dataclass(frozen=True, eq=False)
class Response:
    """Of a plant to a record. `rates` (rows, 2): of speed [rpm/s] and pitch [deg/s]. `lags` (rows, k): derivatives of the power by
    the plant's lags. `turns` (rows, k): derivatives of the rate of speed by the lags of speed."""

    shown: Prediction
    rates: np.ndarray
    lags: np.ndarray
    turns: np.ndarray


def respond(parameters: ParameterSet, record: Record) -> Response:
    """Simulate. Rates bend where a command steps. So they are taken forwards, over fractions of a row, within which commands are
    held."""
    values, model = parameters.values, parameters.model
    wrt = tuple(f"tau_{u}_{k}" for u in ("omega", "beta") for k in (1, 2))
    parts = max(int(np.ceil(record.period / (FINE * slowest(values, values)))), 3)
    split = {name: np.repeat(column, parts) for name, column in record.columns.items() if column.dtype.kind == "f"}
    steps = np.append(record.steps, record.period) / parts
    split["time"] = record.time[0] + np.append(0.0, np.cumsum(np.repeat(steps, parts))[:-1])
    fine = replace(record, columns=split, late=0.0).commands_later(parts * record.late)
    outputs, tangents = Simulator(model, wrt).sensitivities(values, *fine.run)
    moving = np.column_stack([outputs[:, 1:3], tangents[:, 1, :2]])
    rates = (4.0 * moving[1::parts] - moving[2::parts] - 3.0 * moving[::parts]) / (2.0 * steps[:, None])
    names = [y.name for y in model.outputs]
    thrust, omega, beta, *further = outputs[::parts].T
    shown = Prediction(record, thrust, omega, beta, dict(zip(names[3:], further, strict=True)))
    return Response(shown, rates[:, :2], tangents[::parts, names.index("power")], rates[:, 2:])


def _squared_torque(model: PowerModel, p: Prediction) -> np.ndarray:
    """Squared torque (rows,) of the motor; without a measured torque that of the electrical power."""
    values = model.parameters.values
    if MOTOR.name in model.parameters.model.optional:
        return (p.further["torque"] + values[MOTOR.full("friction")]) ** 2
    speed = np.maximum(np.abs(p.omega), LEAST_SPEED * values["omega_scale"])
    return (p.further["power"] / (speed * RAD_PER_S)) ** 2


def _part(name: str, r: Response, model: PowerModel, block: float, largest: float) -> Part:
    """The power of a record, less that of the identified model."""
    p, (faster, rate) = r.shown, r.rates.T
    values, time = model.parameters.values, p.record.time
    expected, load = p.further["power"], _squared_torque(model, p) / largest
    small = {"omega": STEP * values["omega_scale"], "beta": STEP * values["beta_scale"]}
    to_speed, to_pitch = (
        (model.at(p.omega + s * o, p.beta + s * b) - model.at(p.omega - s * o, p.beta - s * b)) / (2.0 * s * (o + b))
        for s, o, b in ((1.0, small["omega"], 0.0), (1.0, 0.0, small["beta"]))
    )
    w, b = p.omega / values["omega_scale"], p.beta / values["beta_scale"]
    static = [w**i * b**j for i in range(DEGREE + 1) for j in range(DEGREE + 1)]
    driven = [faster * term for term in (1.0 + 0.0 * w, w, w**2, w**2 * b, w**2 * b**2, faster)]
    base = [*static, load, *driven, *r.lags.T, *(w * turn for turn in r.turns.T)]
    step, loss = float(np.median(p.record.steps)), values.get(MOTOR.full("loss"), 0.0)
    signals = Signals(
        time, expected, load, rate, p.thrust, np.zeros(len(time)), step, 1.0 / (loss * largest) if loss > 0.0 else 0.0
    )
    outputs = np.column_stack([expected, p.omega, p.beta])
    shapes = partial(output_shapes, p.record, outputs, (to_pitch, to_speed), slowest(values, values))
    reading = electrical(p.record.columns) - expected
    return Part(name, p.record, blocks(p.record, block), reading, np.column_stack(base), signals, shapes)


def _supply(part: Part, p: Prediction, power: Fit) -> Part:
    """The voltage of a record; its current is regressed on the power that the final fit predicts."""
    time, measured = p.record.time, p.record["current"]
    predicted = electrical(p.record.columns) - part.measured + part.base @ power.coefficients
    predicted = predicted + part.response_rows(power.effects, power.x)
    seen, terms = np.isfinite(predicted + measured), np.vander(predicted / np.nanmax(np.abs(predicted)), 3)
    current = terms @ np.linalg.lstsq(terms[seen], measured[seen], rcond=None)[0]
    since = time / time[-1]
    signals = replace(part.signals, current=current)
    return Part(
        part.name, p.record, part.at, p.record["voltage"], np.vander(since, 2), signals, lambda: iter((since**2, current))
    )


def _side_by_side(parts: Sequence[Part]) -> list[Part]:
    """Parts of which each has coefficients of its own."""
    width = parts[0].base.shape[1]
    wide = [np.zeros((len(p.measured), width * len(parts))) for p in parts]
    for k, p in enumerate(parts):
        wide[k][:, k * width : (k + 1) * width] = p.base
    return [replace(p, base=base) for p, base in zip(parts, wide, strict=True)]
