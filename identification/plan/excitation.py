"""Command sequences that move a rig, within its limits: what an experiment is made of.

Commands are arrays (rows, 2) of speed [rpm] and pitch [deg], each row held for one step.
"""

from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF

MOVES = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
"""Which of speed and pitch a segment moves: both, speed, pitch."""

SINES = 6
"""Lines of a multisine, spread evenly over its decades."""


@dataclass(frozen=True)
class Limits:
    """What a rig may be asked for: ranges of speed [rpm] and pitch [deg], largest slew [rpm/s], [deg/s] (infinite: steps are
    allowed), and the time between commands [s]. BadInput names what makes no sense."""

    omega: tuple[float, float] = (2000.0, 6000.0)
    beta: tuple[float, float] = (-5.0, 10.0)
    omega_slew: float = inf
    beta_slew: float = inf
    step: float = 0.004

    def __post_init__(self):
        for name, (low, high), signal in (("speed", self.omega, OMEGA_REF), ("pitch", self.beta, BETA_REF)):
            if not signal.minimum <= low < high <= signal.maximum:
                allowed = f"{signal.minimum:g} to {signal.maximum:g} {signal.unit}, the lower first"
                raise BadInput("limits", f"range of {name}", f"{low:g} to {high:g} {signal.unit}", allowed)
        for name, slew, unit in (("speed", self.omega_slew, "rpm/s"), ("pitch", self.beta_slew, "deg/s")):
            if not slew > 0.0:
                raise BadInput("limits", f"slew of {name}", f"{slew:g} {unit}", f"more than 0 {unit}")
        if not 0.0005 <= self.step <= 0.05:
            raise BadInput("limits", "step", f"{self.step:g} s", "0.0005 to 0.05 s")

    @property
    def low(self) -> np.ndarray:
        """(2,) lowest speed and pitch."""
        return np.array([self.omega[0], self.beta[0]])

    @property
    def high(self) -> np.ndarray:
        """(2,) highest speed and pitch."""
        return np.array([self.omega[1], self.beta[1]])

    def ramped(self, targets: np.ndarray, step: float) -> np.ndarray:
        """Commands (rows, 2) that run to `targets` (rows, 2) as fast as the slew allows, one row every `step` seconds."""
        commands = np.clip(targets, self.low, self.high)
        for column, slew in zip(commands.T, (self.omega_slew, self.beta_slew), strict=True):
            if isfinite(slew):
                largest, at, reached = slew * step, float(column[0]), []
                for wanted in column.tolist():
                    at += min(max(wanted - at, -largest), largest)
                    reached.append(at)
                column[:] = reached
        return commands


def candidate(rng: np.random.Generator, rows: int, step: float, limits: Limits) -> np.ndarray:
    """A random segment of a random family: levels held for a while, a random binary sequence, or a multisine."""
    moves = np.array(MOVES[rng.choice(3, p=(0.5, 0.25, 0.25))])
    family = rng.random()
    if family < 0.6:
        hold = _between(rng, 0.1, 1.5)
        return held_levels(rng, rows, step, limits, (0.6 * hold, 2.0 * hold), moves, extremes=rng.random() < 0.5)
    if family < 0.8:
        return random_binary(rng, rows, step, limits, _between(rng, 0.1, 1.0), moves)
    lowest = rng.uniform(0.1, 0.5)
    return multisine(rng, rows, step, limits, (lowest, lowest * rng.uniform(3.0, 10.0)), moves)


def held_levels(rng, rows, step, limits: Limits, hold: tuple[float, float], moves, extremes: bool = False) -> np.ndarray:
    """Random levels, each held for `hold` (least, most) seconds; `extremes`: the limits are the only levels."""
    commands, row = np.empty((rows, 2)), 0
    level = _level(rng, limits)
    while row < rows:
        new = np.where(rng.random(2) < 0.5, limits.low, limits.high) if extremes else _level(rng, limits)
        level = np.where(moves, new, level)
        end = row + max(1, round(rng.uniform(*hold) / step))
        commands[row:end] = level
        row = end
    return commands


def random_binary(rng, rows, step, limits: Limits, clock: float, moves) -> np.ndarray:
    """Each channel jumps at random between two levels, every `clock` seconds at most."""
    one, other = _level(rng, limits), _level(rng, limits)
    length = max(1, round(clock / step))
    bits = rng.integers(0, 2, (-(-rows // length), 2)).repeat(length, axis=0)[:rows]
    return np.where(np.array(moves) * bits > 0, other, one)


def multisine(rng, rows, step, limits: Limits, band: tuple[float, float], moves) -> np.ndarray:
    """Sines over a `band` [Hz] with random phases, as large as the limits allow around a random level."""
    time = np.arange(rows)[:, None] * step
    phases = rng.uniform(0.0, 2.0 * np.pi, (SINES, 2))
    wave = sum(np.sin(2.0 * np.pi * f * time + phase) for f, phase in zip(np.geomspace(*band, SINES), phases, strict=True))
    level = _level(rng, limits)
    room = np.minimum(level - limits.low, limits.high - level)
    return level + np.array(moves) * room * wave / np.abs(wave).max(axis=0)


def variant(rng: np.random.Generator, segment: np.ndarray, step: float, limits: Limits) -> np.ndarray:
    """A segment (rows, 2) changed a little: for a while, one channel or both stand at another level, often a limit."""
    changed = segment.copy()
    start = rng.integers(len(segment))
    end = start + max(1, round(_between(rng, 0.1, 1.5) / step))
    level = np.where(rng.random(2) < 0.5, limits.low, limits.high) if rng.random() < 0.7 else _level(rng, limits)
    channels = ([0], [1], [0, 1])[rng.integers(3)]
    changed[start:end, channels] = level[channels]
    return changed


def paper_plan(rng: np.random.Generator, rows: int, step: float, limits: Limits) -> np.ndarray:
    """The paper's fine-tuning record: a third speed only, a third pitch only, a third both, levels held for 1 to 2.5 s."""
    third, middle = rows // 3, 0.5 * (limits.low + limits.high)
    speed, pitch = (held_levels(rng, third, step, limits, (1.0, 2.5), moves) for moves in MOVES[1:])
    speed[:, 1], pitch[:, 0] = middle[1], middle[0]
    return np.vstack([speed, pitch, held_levels(rng, rows - 2 * third, step, limits, (1.0, 2.5), MOVES[0])])


def _level(rng: np.random.Generator, limits: Limits) -> np.ndarray:
    return rng.uniform(limits.low, limits.high)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
