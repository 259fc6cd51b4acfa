"""Where no effect explains the error: a linear filter that corrects the prediction, named for what it is.

The thrust residual r is regressed on what the model predicts,

    r(t) = r0 + sum_ij a_ij s_i(t - l_j),    s: speed, pitch, thrust and their rates,    l: LAGS,

by ridge regression on standardised columns, the penalty chosen by cross-validation over contiguous blocks of the fitted
record, whose surroundings are left out as well. It stands only behind a gain on unseen data by the gate that effects pass,
and never in a parameter file: it is no physics, and other commands than these may make it wrong.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.evidence.noise import blocks
from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.search.judge import ENOUGH_HELD_OUT
from identification.worth.quality import rmse
from vpp_fmu.digits import number
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

LAGS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
"""s."""

SIGNALS = {"omega": "rpm", "beta": "deg", "thrust": "N"}
"""Predicted quantities and their units; each also by its rate."""

FOLDS, APART = 6, 2.0
"""Blocks of the cross-validation, and s around each that teach nothing."""

PENALTIES = np.geomspace(1e-5, 10.0, 19)
"""Of standardised columns, per row."""


@dataclass(frozen=True)
class Empirical:
    """A linear correction of the thrust [N]: `offset` [N] and `coefficients` [N per unit] by (signal, lag).

    `gain`: log-likelihood of unseen thrust; `before`, `after`: rmse there [N]; `penalty`: None where cross-validation prefers
    no correction. `refused`: why it does not stand; empty: it does.
    """

    offset: float
    coefficients: Mapping[tuple[str, float], float]
    penalty: float | None
    gain: float
    before: float
    after: float
    refused: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """Whether it stands."""
        return not self.refused

    @property
    def told(self) -> str:
        """The outcome in a sentence."""
        change = f"thrust error on unseen data {number(self.before)} -> {number(self.after)} N, log-likelihood {self.gain:+.1f}"
        return f"empirical correction, no physics: {change}" if self.accepted else f"no empirical correction: {self.refused[0]}"

    def correction(self, time: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """What to add (rows,) N to the predicted thrust, from the model's outputs (rows, 3) at time (rows,) s."""
        return self.offset + columns(time, outputs) @ np.array(list(self.coefficients.values()))

    def summary(self) -> dict:
        """The content of empirical.json."""
        terms = [
            {"signal": signal, "lag": lag, "coefficient": value, "unit": unit_of(signal)}
            for (signal, lag), value in self.coefficients.items()
        ]
        return {
            "kind": "empirical: a linear filter of the model's own outputs, no physics and not part of parameters.json",
            "accepted": self.accepted,
            "refused": list(self.refused),
            "rmse_thrust": {"before": self.before, "after": self.after},
            "held_out_gain": self.gain,
            "penalty": self.penalty,
            "offset": {"value": self.offset, "unit": "N"},
            "terms": terms,
        }


def unit_of(signal: str) -> str:
    """The unit of a coefficient of a signal or its rate."""
    name = signal.removeprefix("rate of ")
    return f"N/{SIGNALS[name]}" if name == signal else f"N.s/{SIGNALS[name]}"


def columns(time: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """The regressors (rows, signals * lags) from thrust, speed and pitch (rows, 3) at time (rows,) s."""
    found = []
    for signal in (dict(zip(("thrust", "omega", "beta"), outputs.T, strict=True))[n] for n in SIGNALS):
        for values in (signal, np.gradient(signal, time)):
            found += [np.interp(time - lag, time, values) for lag in LAGS]
    return np.column_stack(found)


def empirical(found: Diagnosis) -> Empirical | None:
    """A correction of a diagnosis' final model; None where an effect explains the error or there is none."""
    if found.verdict not in ("partly", "unexplained"):
        return None
    fit = found.final
    held = [Experiment([record], found.noise) for record in found.held]
    return correct(fit.evidence.model, fit.values, fit.evidence.experiments[0], held)


def correct(model: Model, values: Mapping[str, float], fitted: Experiment, held: Sequence[Experiment]) -> Empirical:
    """Fit a correction to an experiment and judge it on unseen ones."""
    simulator = Simulator(model)
    outputs = simulator.simulate(values, fitted.record.columns, fitted.record.steps)
    at = blocks(fitted.record)
    x, r = at.mean(columns(fitted.record.time, outputs)), fitted.thrust - at.mean(outputs[:, 0])
    there = np.isfinite(r) & np.isfinite(x).all(axis=1)
    time, x, r = at.time[there], x[there], r[there]
    penalty = _penalty(time, x, r)
    offset, a = (0.0, np.zeros(x.shape[1])) if penalty is None else (each[0] for each in _ridge(x, r, [penalty]))
    signals = [kind + name for name in SIGNALS for kind in ("", "rate of ")]
    names = [(signal, lag) for signal in signals for lag in LAGS]
    found = Empirical(float(offset), dict(zip(names, a.tolist(), strict=True)), penalty, 0.0, 0.0, 0.0, ())
    return _judged(found, simulator, values, held)


def _ridge(x: np.ndarray, r: np.ndarray, penalties: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """(offsets (p,), coefficients (p, k)) of r on x, columns standardised, for each of the penalties per row."""
    mean, spread = x.mean(axis=0), x.std(axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    z = (x - mean) / spread
    powers, axes = np.linalg.eigh(z.T @ z / len(z))
    along = axes.T @ (z.T @ (r - r.mean())) / len(z)
    a = np.array([axes @ (along / (powers + penalty)) for penalty in penalties]) / spread
    return r.mean() - a @ mean, a


def _penalty(time: np.ndarray, x: np.ndarray, r: np.ndarray) -> float | None:
    """The penalty that predicts left-out blocks best; None where nothing beats no correction at all."""
    edges = np.linspace(time[0], time[-1] + 1e-9, FOLDS + 1)
    errors = np.zeros(len(PENALTIES))
    for low, high in pairwise(edges):
        left = (time >= low) & (time < high)
        taught = (time < low - APART) | (time > high + APART)
        offsets, a = _ridge(x[taught], r[taught], PENALTIES)
        errors += np.sum((r[left] - offsets[:, None] - a @ x[left].T) ** 2, axis=1)
    best = int(np.argmin(errors))
    return float(PENALTIES[best]) if errors[best] < float(r @ r) else None


def _judged(found: Empirical, simulator: Simulator, values, held: Sequence[Experiment]) -> Empirical:
    """The same with its gain on unseen experiments, and why it is refused."""
    before, after, errors = 0.0, 0.0, {"before": [], "after": []}
    for e in held:
        outputs = simulator.simulate(values, e.record.columns, e.record.steps)
        with_it = outputs[:, 0] + found.correction(e.record.time, outputs)
        before += float(np.sum(e.thrust_residual(outputs[:, 0]) ** 2))
        after += float(np.sum(e.thrust_residual(with_it) ** 2))
        errors["before"].append(outputs[:, 0] - e.record["thrust"])
        errors["after"].append(with_it - e.record["thrust"])
    gain = 0.5 * sum(e.sizes["thrust"] for e in held) * float(np.log(before / after))
    rms = {name: rmse(np.concatenate(each)) for name, each in errors.items()}
    refused = []
    if found.penalty is None:
        refused.append("left-out blocks of the fitted record are predicted best without one")
    if gain < ENOUGH_HELD_OUT:
        refused.append(f"unseen data gain nothing: log-likelihood {gain:.1f}, {ENOUGH_HELD_OUT:g} is asked for")
    if rms["after"] > rms["before"]:
        refused.append(f"thrust error on unseen data rises from {number(rms['before'])} to {number(rms['after'])} N")
    return Empirical(found.offset, found.coefficients, found.penalty, gain, rms["before"], rms["after"], tuple(refused))


def corrected(found: Diagnosis, correction: Empirical, record: Record) -> Record:
    """The record's commands with the model's thrust, `thrust`, and the corrected one, `thrust_empirical`, both N."""
    shown = found.prediction(found.final, record)
    outputs = np.column_stack([shown.thrust, shown.omega, shown.beta])
    added = correction.correction(record.time, outputs)
    known = {name: record[name] for name in ("time", "omega_ref", "beta_ref")}
    return Record({**known, "thrust": shown.thrust, "thrust_empirical": shown.thrust + added}, "vpp diagnose --empirical")
