"""A discriminating experiment, as a record of commands: 90 s for a rig of the paper's time scale.

Each section excites other effects. Small stairs and reversals excite dead bands and play; one spectrum at two amplitudes
excites nonlinearities; full steps reach limits; slow sections contain drift; holds contain offsets. If the pitch is fixed, the
speed gets the sections of the pitch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.plan.excitation import FASTEST, STEP
from vpp_fmu.commands import commanded, ends
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig, rounded

LONGEST = 0.04
"""Maximum sampling period of commands, in time scales: at least five samples per period of a multisine's highest line."""

STAIRS = (0.02, 0.05, 0.1, 0.2)
"""Heights of the stairs, as shares of the range."""

AMPLITUDES = (0.075, 0.3)
"""Amplitudes of the two multisines, as shares of the range."""

LINES, BAND = 14, (0.075, 3.0)
"""Lines of a multisine, and their band in cycles per time scale: 0.15 to 6 Hz for the paper's rig."""

SLOWEST = 40.0
"""Maximum duration of a full step with a slew limit, in time scales."""

REVERSALS = (0.7, 1.6, 3.0)
"""Time scales after which a doublet reverses: before, about, and after the rig has settled."""


@dataclass(frozen=True)
class Clock:
    """Converts a number of time scales of `unit` s to rows of `step` s: for a move, and for a `section`."""

    unit: float
    step: float

    def move(self, times: float) -> int:
        return max(1, round(times * self.unit / self.step))

    def section(self, times: float) -> int:
        return max(1, round(times * max(self.unit, FASTEST) / self.step))


def discriminating_experiment(rig: Rig, seed: int = 0, period: float | None = None) -> Record:
    """Commands `time` [s], `omega_ref` [rpm], `beta_ref` [deg] within the limits of the rig; to be run twice.

    `period` s: the sampling period of the rig.
    """
    unit, rng = rig.scales.time_scale, np.random.default_rng(seed)
    step = period if period and period <= LONGEST * unit else rounded((LONGEST if period else STEP) * unit)
    low, high = ends(rig)
    travel = (rig.speed[1] - rig.speed[0]) / rig.speed_slew / unit
    shares = np.concatenate(_sections(rng, Clock(unit, step), *(high > low).tolist(), travel))
    commands = commanded(rig, low + shares * (high - low), step)
    time = np.round(np.arange(len(commands)) * step, 9)
    columns = {"time": time, "omega_ref": commands[:, 0], "beta_ref": commands[:, 1]}
    return Record(columns, "discriminating experiment")


def _sections(rng, clock: Clock, speed: bool, pitch: bool, travel: float) -> list[np.ndarray]:
    """The sections (rows, 2) as shares of the ranges. `speed`, `pitch`: whether they may move; `travel`: duration of a slew of
    the speed over its range, in time scales."""
    rest = _section(clock.section(6.0), 0.0, 0.5)
    if not speed and not pitch:
        return [rest]
    stairs, sines = clock.section(48.0), clock.section(16.0)
    found = [rest, _random_steps(rng, clock, clock.section(40.0))]
    if pitch:
        found.append(_section(stairs, 1.0, _stairs(stairs)))
        found += [_section(sines, 0.5, 0.5 + a * _multisine(rng, clock, sines)) for a in AMPLITUDES]
    elif speed:
        found.append(_section(stairs, _stairs(stairs), 0.0))
        found += [_section(sines, 0.5 + a * _multisine(rng, clock, sines), 0.0) for a in AMPLITUDES]
    if speed:
        if pitch:
            found.append(_section(sines, 0.5 + 0.4 * _multisine(rng, clock, sines), 0.5))
        full = 4 * clock.section(min(max(travel + 2.0, 4.0), SLOWEST))
        found.append(_section(full, _held((0.0, 1.0, 0.0, 1.0), full), 1.0))
    doublets = clock.section(14.0)
    if pitch:
        found += [_section(doublets, w, _doublets(clock, doublets)) for w in ((0.25, 1.0) if speed else (0.0,))]
    else:
        found.append(_section(doublets, _doublets(clock, doublets), 0.0))
    return [*found, rest]


def _section(rows: int, speed: np.ndarray | float, pitch: np.ndarray | float) -> np.ndarray:
    return np.column_stack([np.broadcast_to(speed, rows), np.broadcast_to(pitch, rows)])


def _random_steps(rng, clock: Clock, rows: int) -> np.ndarray:
    parts = []
    while sum(map(len, parts)) < rows:
        parts.append(_section(clock.move(rng.uniform(0.6, 2.4)), *rng.uniform(size=2)))
    return np.concatenate(parts)[:rows]


def _stairs(rows: int) -> np.ndarray:
    """Stairs about the middle, up and down by each of STAIRS."""
    levels = [0.5]
    for size in STAIRS:
        levels += [0.5 + size * k for k in (1, 2, 1, 0, -1, 0)]
    return _held(levels, rows)


def _multisine(rng, clock: Clock, rows: int) -> np.ndarray:
    """Multisine with equal power per line, random phases, peak 1."""
    lines = np.geomspace(*BAND, LINES) / clock.unit
    t = np.arange(rows) * clock.step
    wave = np.sin(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, LINES)).sum(axis=1)
    return wave / np.max(np.abs(wave))


def _doublets(clock: Clock, rows: int) -> np.ndarray:
    """Repeated doublets about the middle, 0.2 up and down, held for each of REVERSALS."""
    once = []
    for hold in REVERSALS:
        once += [0.7] * clock.move(hold) + [0.3] * clock.move(hold) + [0.5] * clock.move(1.0)
    return np.resize(once, rows)


def _held(levels: Sequence[float], rows: int) -> np.ndarray:
    """The levels in sequence (rows,), each equally long."""
    return np.asarray(levels)[np.arange(rows) * len(levels) // rows]
