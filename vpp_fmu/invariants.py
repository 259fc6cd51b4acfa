"""Invariants of every optional effect: `vpp check-effect` checks them for a user-defined effect, the tests for the library.

Each invariant takes a `Trial` and returns a number with its unit as the result, or raises `Broken`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.native import Simulator

STEP = 0.004
"""The paper's sampling period, s."""

SHOWS = (0.03, 3.0, 0.03)
"""N, rpm, deg: the probe must change at least one output by this much, or the effect is not visible."""

APART = 1e-3
"""Maximum difference [N] between communication steps of 1 to 8 ms."""

SLOPE = 3e-3
"""Maximum relative error of a sensitivity against the central difference."""


class Broken(Exception):
    """An invariant does not hold; the message says where."""


def random_steps(rows: int, hold: int, seed: int = 0, model: Model = BASE) -> dict[str, np.ndarray]:
    """Random speed and pitch commands over the rig's whole range, each held for 1 to `hold` rows. Any other input of the model
    varies by a tenth around its nominal value; a row of a log lasts 2 STEP."""
    rng = np.random.default_rng(seed)

    def steps(low, high):
        lengths = rng.integers(1, hold + 1, rows)
        return np.repeat(rng.uniform(low, high, rows), lengths)[:rows]

    ranges = {"omega_ref": (2000.0, 6000.0), "beta_ref": (-5.0, 10.0)}
    wander = {u.name: (0.9 * u.nominal, 1.1 * u.nominal) for u in model.inputs} | ranges
    return {u.name: np.full(rows, 2.0 * STEP) if u.clock else steps(*wander[u.name]) for u in model.inputs}


def reference(model: Model, parameters: Mapping[str, float], inputs: Mapping[str, np.ndarray], steps) -> np.ndarray:
    """As `Simulator.simulate`, computed by the model's functions in Python."""
    simulation = Simulation(model, parameters)
    names = [s.name for s in model.inputs]
    rows = list(zip(*(np.asarray(inputs[name]).tolist() for name in names), strict=True))
    shown = [list(simulation.start(dict(zip(names, rows[0], strict=True))).values())]
    for row, dt in zip(rows, np.asarray(steps).tolist(), strict=False):
        shown.append(list(simulation.advance(dict(zip(names, row, strict=True)), dt).values()))
    return np.array(shown)


def slopes(model: Model, values: Mapping[str, float], name: str, inputs, steps):
    """Numeric derivatives of the outputs in a parameter: (central differences, mask of valid rows, their size).

    A row is valid if the curve is smooth there: both one-sided differences agree, and so do central differences at h and h / 4.
    The central difference at a kink of twice SLOPE is off by SLOPE; an output that switches at a threshold is flat in between.
    """
    nominal = next(p.nominal for p in model.parameters if p.name == name)
    h = 1e-5 * max(abs(values[name]), 1e-2 * nominal)
    small = 2e-3 * np.array([s.nominal for s in model.outputs]) / nominal

    def at(change):
        return Simulator(model).simulate({**values, name: values[name] + change}, inputs, steps)

    below, here, above = at(-h), at(0.0), at(h)
    wide, narrow = (above - below) / (2.0 * h), (at(h / 4.0) - at(-h / 4.0)) / (h / 2.0)
    size = np.abs(narrow).max(axis=0) + small
    smooth = (np.abs(above - 2.0 * here + below) / h < 2.0 * SLOPE * size) & (np.abs(wide - narrow) < 1e-3 * size)
    return wide, smooth, size


@dataclass(frozen=True)
class Trial:
    """An effect in its place in a library."""

    effect: Effect
    library: tuple[Effect, ...]

    @cached_property
    def model(self) -> Model:
        """The plain plant with the effect."""
        return plant([self.effect.name], self.library)

    def named(self, values: Mapping[str, float]) -> dict[str, float]:
        """The effect's values under their full names."""
        return {self.effect.full(name): value for name, value in values.items()}

    def both(self, values: Mapping[str, float], inputs, steps) -> np.ndarray:
        """Outputs of the functions in Python. Broken if the C differs in a bit, or a number is not finite."""
        shown, run = reference(self.model, values, inputs, steps), Simulator(self.model).simulate(values, inputs, steps)
        if not np.isfinite(shown).all():
            raise Broken(f"a number that is not finite at {_words(values)}")
        if not np.array_equal(shown, run):
            row = int(np.argmax((shown != run).any(axis=1)))
            raise Broken(f"row {row} is {run[row].tolist()} in C and {shown[row].tolist()} in Python at {_words(values)}")
        return shown


def declared(trial: Trial) -> str:
    """`off` and `probe` name the effect's parameters, all values lie within their bounds, everything is described."""
    effect = trial.effect
    own = {p.name: p for p in effect.parameters}
    off = dict(effect.off or {})
    if not off or not effect.probe or not set(off) <= set(effect.probe) <= set(own):
        raise Broken(f"off {sorted(off)} and probe {sorted(effect.probe)} of the parameters {sorted(own)}")
    if all(effect.probe[name] == value for name, value in off.items()):
        raise Broken(f"off {off} and probe {dict(effect.probe)}, which are the same")
    if not set(effect.delays.values()) <= set(own):
        raise Broken(f"delays {dict(effect.delays)}")
    for thing in (effect, *effect.parameters, *effect.states, *effect.inputs):
        if not thing.description:
            raise Broken(f"{thing.name} without a description")
    for p in effect.parameters:
        if not (np.isfinite([p.minimum, p.maximum, p.nominal]).all() and p.minimum < p.maximum and p.nominal > 0.0):
            raise Broken(f"{p.name}: {p.minimum:g} to {p.maximum:g}, nominal {p.nominal:g}")
        for value in (p.default, off.get(p.name, p.default), effect.probe.get(p.name, p.default), *p.choices):
            if not p.minimum <= value <= p.maximum:
                raise Broken(f"{p.name} = {value:g}, outside {p.minimum:g} to {p.maximum:g}")
    return f"{len(own)} parameters, {len(effect.states)} states"


def off_is_nothing(trial: Trial) -> str:
    """Switched off, the model equals the one without the effect to the bit, at any step."""
    effect = trial.effect
    for dt in (0.001, STEP, 0.0073, 0.05):
        inputs, steps = random_steps(300, 20, model=trial.model), np.full(299, dt)
        without = reference(BASE, {}, {name: inputs[name] for name in ("omega_ref", "beta_ref")}, steps)
        for values in (effect.off or {}, {**effect.probe, **(effect.off or {})}):
            apart = np.abs(trial.both(trial.named(values), inputs, steps) - without).max()
            if apart != 0.0:
                raise Broken(f"{apart:.3g} apart at {_words(values)}, steps of {1e3 * dt:g} ms")
    return "same bits"


def compiled(trial: Trial) -> str:
    """The generated C equals Python to the bit, at uneven steps."""
    steps = np.random.default_rng(3).choice([STEP, STEP, 0.0013, 0.011], 1499)
    trial.both(trial.named(trial.effect.probe), random_steps(1500, 150, model=trial.model), steps)
    return "same bits"


def visible(trial: Trial) -> str:
    """The probe changes an output."""
    inputs, steps = random_steps(5000, 250, model=trial.model), np.full(4999, STEP)
    inputs["omega_ref"][2000:3000] = 0.0  # standstill, without which start_from_rest is not visible
    on = Simulator(trial.model).simulate(trial.named(trial.effect.probe), inputs, steps)
    moved = np.abs(on - Simulator(BASE).simulate({}, inputs, steps)).max(axis=0)
    sizes = ", ".join(f"{x:.3g} {unit}" for x, unit in zip(moved, ("N", "rpm", "deg"), strict=True))
    if not (moved > SHOWS).any():
        raise Broken(f"the probe moves thrust, speed and pitch by {sizes}")
    return f"moves {sizes}"


def bounded(trial: Trial) -> str:
    """At every bound all numbers are finite, and C equals Python."""
    for dt in (1e-6, STEP, 0.05):
        inputs, steps = random_steps(12, 3, model=trial.model), np.full(11, dt)
        for p in trial.effect.parameters:
            for value in (p.minimum, p.maximum):
                trial.both(trial.named({**trial.effect.probe, p.name: value}), inputs, steps)
    return "finite"


def step_free(trial: Trial) -> str:
    """The outputs do not depend on the communication step: 1, 2 and 4 ms give those of 8 ms."""
    slow, fast = random_steps(2000, 150, model=trial.model), random_steps(200, 1, model=trial.model)
    coarse, values = {name: np.r_[slow[name], fast[name]] for name in slow}, trial.named(trial.effect.probe)
    run, apart = Simulator(trial.model), 0.0
    at_8_ms = run.simulate(values, coarse, np.full(2199, 0.008))[:, 0]
    for split in (2, 4, 8):
        fine = {name: np.repeat(column, split)[: 2199 * split + 1] for name, column in coarse.items()}
        shown = run.simulate(values, fine, np.full(2199 * split, 0.008 / split))[::split, 0]
        apart = max(apart, float(np.abs(shown - at_8_ms).max()))
    if apart > APART:
        raise Broken(f"{apart:.3g} N between steps of 1 to 8 ms; `largest_step`, or an exact form, mends it")
    return f"{apart:.2g} N apart"


def differentiable(trial: Trial) -> str:
    """Sensitivities equal central differences, away from kinks."""
    model, worst = trial.model, 0.0
    wrt = tuple(trial.effect.full(p.name) for p in trial.effect.parameters)
    values, known = model.values(trial.named(trial.effect.probe)), {p.name: p for p in model.parameters}
    inputs, steps = random_steps(2000, 150, model=model), np.full(1999, STEP)
    tangents = Simulator(model, wrt).sensitivities(values, inputs, steps)[1]
    for j, name in enumerate(wrt):
        p = known[name]
        if p.choices or not p.minimum < values[name] < p.maximum:
            continue  # a discrete parameter, or one-sided
        numeric, smooth, size = slopes(model, values, name, inputs, steps)
        error = float((np.where(smooth, np.abs(tangents[:, :, j] - numeric), 0.0).max(axis=0) / size).max())
        if error > SLOPE:
            raise Broken(f"{name}: off by {error:.2g} of its size")
        worst = max(worst, error)
    return f"off by {worst:.1g} of their size"


INVARIANTS: dict[str, Callable[[Trial], str]] = {
    "declares itself": declared,
    "off is the model without it": off_is_nothing,
    "C is Python": compiled,
    "the probe shows": visible,
    "finite at every bound": bounded,
    "free of the communication step": step_free,
    "sensitivities are differences": differentiable,
}


def _words(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())
