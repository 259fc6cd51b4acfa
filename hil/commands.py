"""What a campaign tells the rig, in rpm and deg: the paper's grid and steps (section 3), and sequences for the fine-tuning."""

from dataclasses import dataclass

import numpy as np

from vpp_fmu.record import Record

SPEEDS, PITCHES = (2000.0, 6000.0), (-10.0, 10.0)
"""Ranges of the static map [rpm], [deg]."""

REGION = (2200.0, 5900.0), (-4.5, 9.5)
"""Ranges of the open-loop sequences: within what the paper's model is for, and off its edges."""

RESTING = 4500.0, 4.0
"""rpm, deg of the channel that is not in play."""

_HOLDS = (0.4, 2.8)  # s, for how long one command is held
_SMALLEST, _LARGEST = -1.3, -0.05  # decades of a move's share of the range


@dataclass(frozen=True)
class Step:
    """One step response: commands (omega_ref [rpm], beta_ref [deg]) before and after."""

    before: tuple[float, float]
    after: tuple[float, float]


def grid(points: int) -> list[tuple[float, float]]:
    """points x points commands of the static map, speed by speed as the paper's two loops."""
    speeds, pitches = np.linspace(*SPEEDS, points), np.linspace(*PITCHES, points)
    return [(round(float(w), 3), round(float(b), 4)) for w in speeds for b in pitches]


def steps(levels: int = 5) -> list[Step]:
    """The paper's steps: five sizes up, five down, of speed at `levels` pitches and of pitch at `levels` speeds."""
    found = []
    for pitch in np.linspace(-4.0, 8.0, levels).tolist():
        for end in np.linspace(2500.0, 6000.0, 5).tolist():
            found.append(Step((2000.0, pitch), (end, pitch)))
        for end in np.linspace(5500.0, 2000.0, 5).tolist():
            found.append(Step((6000.0, pitch), (end, pitch)))
    for speed in np.linspace(2800.0, 6000.0, levels).tolist():
        for end in np.linspace(-6.0, 10.0, 5).tolist():
            found.append(Step((speed, -10.0), (speed, end)))
        for end in np.linspace(6.0, -10.0, 5).tolist():
            found.append(Step((speed, 10.0), (speed, end)))
    return found


def open_loop(seed: int, section: float, dt: float) -> Record:
    """Three sections of `section` s each: speed moves, pitch moves, both move."""
    rng, rows = np.random.default_rng(seed), round(section / dt)
    (speed, pitch), (still_speed, still_pitch) = REGION, (np.full(rows, RESTING[0]), np.full(rows, RESTING[1]))
    omega = np.concatenate([_levels(rng, rows, *speed, 1, dt), still_speed, _levels(rng, rows, *speed, 1, dt)])
    beta = np.concatenate([still_pitch, _levels(rng, rows, *pitch, 3, dt), _levels(rng, rows, *pitch, 3, dt)])
    return _record(omega, beta, dt, "open loop")


def validation(seed: int, seconds: float, dt: float) -> Record:
    """Both move, by other numbers than `open_loop` has."""
    rng, rows = np.random.default_rng([seed, 1]), round(seconds / dt)
    return _record(_levels(rng, rows, *REGION[0], 1, dt), _levels(rng, rows, *REGION[1], 3, dt), dt, "validation")


def resampled(commands: Record, dt: float) -> Record:
    """A command record at the loop's own times, each command held to the next row."""
    time = np.arange(round(commands.time[-1] / dt) + 1) * dt
    held = np.searchsorted(commands.time, time + 1e-9, side="right") - 1
    return Record({"time": time, **{n: commands[n][held] for n in ("omega_ref", "beta_ref")}}, commands.source)


def _levels(rng: np.random.Generator, rows: int, low: float, high: float, digits: int, dt: float) -> np.ndarray:
    """(rows,) from level to level. Small moves are as frequent as large ones: thresholds show in them."""
    values, now = [], rng.uniform(low, high)
    while len(values) < rows:
        values += [now] * round(rng.uniform(*_HOLDS) / dt)
        now = float(np.clip(now + rng.choice([-1, 1]) * (high - low) * 10 ** rng.uniform(_SMALLEST, _LARGEST), low, high))
    return np.round(values[:rows], digits)


def _record(omega: np.ndarray, beta: np.ndarray, dt: float, source: str) -> Record:
    return Record({"time": np.arange(len(omega)) * dt, "omega_ref": omega, "beta_ref": beta}, source)
