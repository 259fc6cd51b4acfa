"""Sequences of targets within a rig's ranges: what an experiment is made of.

Targets are arrays (rows, 2) of speed [rpm] and pitch [deg], each row held for one step; `vpp_fmu.commands.commanded` makes them
into commands. Times are in the rig's time scales, half a second for the paper's.
"""

import numpy as np

from vpp_fmu.commands import ends
from vpp_fmu.rig import Rig

STEP = 0.008
"""Time between commands where nobody knows how the rig is sampled, in time scales: the paper's 4 ms."""

FASTEST = 0.1
"""s; an experiment for a faster rig is as long as for one of this time scale, with more moves in it: noise is not faster."""

MOVES = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
"""Which of speed and pitch a segment moves: both, speed, pitch."""

SINES = 6
"""Lines of a multisine, spread evenly over its decades."""

HOLD, CLOCK, LOWEST = (0.2, 3.0), (0.2, 2.0), (0.05, 0.25)
"""How long a level is held, and the clock of a binary sequence, in time scales; a multisine's lowest line, periods a time
scale: from well within the plant's memory to when it has settled."""

PAPERS_HOLD = (2.0, 5.0)
"""Time scales for which the paper's fine-tuning record holds a level: 1 to 2.5 s on its rig."""


def candidate(rng: np.random.Generator, rows: int, step: float, rig: Rig) -> np.ndarray:
    """A random segment of a random family: levels held for a while, a random binary sequence, or a multisine."""
    moves, movable, unit = np.array(MOVES[rng.choice(3, p=(0.5, 0.25, 0.25))]), _movable(rig), rig.scales.time_scale
    if not (moves * movable).any():
        moves = movable
    family = rng.random()
    if family < 0.6:
        hold = unit * _between(rng, *HOLD)
        return held_levels(rng, rows, step, rig, (0.6 * hold, 2.0 * hold), moves, extremes=rng.random() < 0.5)
    if family < 0.8:
        return random_binary(rng, rows, step, rig, unit * _between(rng, *CLOCK), moves)
    lowest = rng.uniform(*LOWEST) / unit
    return multisine(rng, rows, step, rig, (lowest, lowest * rng.uniform(3.0, 10.0)), moves)


def held_levels(rng, rows, step, rig: Rig, hold: tuple[float, float], moves, extremes: bool = False) -> np.ndarray:
    """Random levels, each held for `hold` (least, most) seconds; `extremes`: the ends of the ranges are the only levels."""
    commands, row = np.empty((rows, 2)), 0
    level = _level(rng, rig)
    while row < rows:
        new = np.where(rng.random(2) < 0.5, *ends(rig)) if extremes else _level(rng, rig)
        level = np.where(moves, new, level)
        end = row + max(1, round(rng.uniform(*hold) / step))
        commands[row:end] = level
        row = end
    return commands


def random_binary(rng, rows, step, rig: Rig, clock: float, moves) -> np.ndarray:
    """Each channel jumps at random between two levels, every `clock` seconds at most."""
    one, other = _level(rng, rig), _level(rng, rig)
    length = max(1, round(clock / step))
    bits = rng.integers(0, 2, (-(-rows // length), 2)).repeat(length, axis=0)[:rows]
    return np.where(np.array(moves) * bits > 0, other, one)


def multisine(rng, rows, step, rig: Rig, band: tuple[float, float], moves) -> np.ndarray:
    """Sines over a `band` [Hz] with random phases, as large as the ranges allow around a random level."""
    low, high = ends(rig)
    time = np.arange(rows)[:, None] * step
    phases = rng.uniform(0.0, 2.0 * np.pi, (SINES, 2))
    wave = sum(np.sin(2.0 * np.pi * f * time + phase) for f, phase in zip(np.geomspace(*band, SINES), phases, strict=True))
    level = _level(rng, rig)
    room = np.minimum(level - low, high - level)
    return level + np.array(moves) * room * wave / np.abs(wave).max(axis=0)


def variant(rng: np.random.Generator, segment: np.ndarray, step: float, rig: Rig) -> np.ndarray:
    """A segment (rows, 2) changed a little: for a while, one channel or both stand at another level, often a range's end."""
    changed = segment.copy()
    start = rng.integers(len(segment))
    end = start + max(1, round(rig.scales.time_scale * _between(rng, *HOLD) / step))
    level = np.where(rng.random(2) < 0.5, *ends(rig)) if rng.random() < 0.7 else _level(rng, rig)
    channels = ([0], [1], [0, 1])[rng.integers(3)]
    changed[start:end, channels] = level[channels]
    return changed


def paper_plan(rng: np.random.Generator, rows: int, step: float, rig: Rig) -> np.ndarray:
    """The paper's fine-tuning record: a third speed only, a third pitch only, a third both, levels held for PAPERS_HOLD."""
    third, middle = rows // 3, 0.5 * sum(ends(rig))
    hold = tuple(rig.scales.time_scale * time for time in PAPERS_HOLD)
    speed, pitch = (held_levels(rng, third, step, rig, hold, moves) for moves in MOVES[1:])
    speed[:, 1], pitch[:, 0] = middle[1], middle[0]
    return np.vstack([speed, pitch, held_levels(rng, rows - 2 * third, step, rig, hold, MOVES[0])])


def _movable(rig: Rig) -> np.ndarray:
    """(2,): 1 where a channel has a range, 0 where it stands."""
    low, high = ends(rig)
    return (high > low).astype(float)


def _level(rng: np.random.Generator, rig: Rig) -> np.ndarray:
    return rng.uniform(*ends(rig))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
