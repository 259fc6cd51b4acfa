"""Excitation signals within a rig's ranges, the segments of an experiment.

Targets are arrays (rows, 2) of speed [rpm] and pitch [deg], each row held for one step; `vpp_fmu.commands.commanded` converts
them to commands. Times are in the rig's time scales, half a second for the paper's.
"""

import numpy as np

from vpp_fmu.commands import ends
from vpp_fmu.rig import Rig

STEP = 0.008
"""Default time between commands, in time scales: the paper's 4 ms."""

FASTEST = 0.1
"""s: time scale below which an experiment is not shortened further, because the noise is not faster."""

MOVES = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
"""Channels that a segment moves: both, speed, pitch."""

SINES = 6
"""Lines of a multisine, logarithmically spaced."""

HOLD, CLOCK, LOWEST = (0.2, 3.0), (0.2, 2.0), (0.05, 0.25)
"""Hold of a level and clock of a binary sequence [time scales], lowest line of a multisine [periods per time scale]: from well
below the settling time to above it."""

PAPERS_HOLD = (2.0, 5.0)
"""Hold of a level in the paper's fine-tuning record, in time scales: 1 to 2.5 s on its rig."""


def candidate(rng: np.random.Generator, rows: int, step: float, rig: Rig) -> np.ndarray:
    """A random segment of a random kind: held levels, a random binary sequence, or a multisine."""
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
    """Random levels, each held for `hold` (least, most) seconds; `extremes`: only the ends of the ranges."""
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
    """Sines over a `band` [Hz] with random phases, around a random level and as large as the ranges allow."""
    low, high = ends(rig)
    time = np.arange(rows)[:, None] * step
    phases = rng.uniform(0.0, 2.0 * np.pi, (SINES, 2))
    wave = sum(np.sin(2.0 * np.pi * f * time + phase) for f, phase in zip(np.geomspace(*band, SINES), phases, strict=True))
    level = _level(rng, rig)
    room = np.minimum(level - low, high - level)
    return level + np.array(moves) * room * wave / np.abs(wave).max(axis=0)


def variant(rng: np.random.Generator, segment: np.ndarray, step: float, rig: Rig) -> np.ndarray:
    """A segment (rows, 2) with an interval in which one or both channels are held at another level, often a range's end."""
    changed = segment.copy()
    start = rng.integers(len(segment))
    end = start + max(1, round(rig.scales.time_scale * _between(rng, *HOLD) / step))
    level = np.where(rng.random(2) < 0.5, *ends(rig)) if rng.random() < 0.7 else _level(rng, rig)
    channels = ([0], [1], [0, 1])[rng.integers(3)]
    changed[start:end, channels] = level[channels]
    return changed


def paper_plan(rng: np.random.Generator, rows: int, step: float, rig: Rig) -> np.ndarray:
    """The paper's fine-tuning record: a third moves speed, a third pitch, a third both; levels are held for PAPERS_HOLD."""
    third, middle = rows // 3, 0.5 * sum(ends(rig))
    hold = tuple(rig.scales.time_scale * time for time in PAPERS_HOLD)
    speed, pitch = (held_levels(rng, third, step, rig, hold, moves) for moves in MOVES[1:])
    speed[:, 1], pitch[:, 0] = middle[1], middle[0]
    return np.vstack([speed, pitch, held_levels(rng, rows - 2 * third, step, rig, hold, MOVES[0])])


def _movable(rig: Rig) -> np.ndarray:
    """(2,): 1 for a channel with a range, 0 for a fixed one."""
    low, high = ends(rig)
    return (high > low).astype(float)


def _level(rng: np.random.Generator, rig: Rig) -> np.ndarray:
    return rng.uniform(*ends(rig))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
