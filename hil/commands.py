"""Commands of a campaign, in rpm and deg: the paper's grid and steps (section 3), and sequences for the fine-tuning.

All numbers are shares of the rig's ranges; the docstrings give their values in rpm and deg for the paper's rig.
"""

from dataclasses import dataclass, replace

import numpy as np

from vpp_fmu.commands import commanded
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

PAPERS = replace(Rig(), name="the paper's", pitch=(-10.0, 10.0), origin=dict.fromkeys(("speed", "pitch"), "the paper"))
"""The paper's rig: its static map goes from 2000 to 6000 rpm and from -10 to 10 deg."""

EDGES = (0.05, 0.975), (1.0 / 30.0, 29.0 / 30.0)
"""Bounds of the open-loop sequences, as shares of the speed and of the operating region's pitch: 2200 to 5900 rpm, -4.5 to
9.5 deg."""

RESTING = 0.625, 0.6
"""Values of the constant channel, as shares: 4500 rpm, 4 deg."""

_HOLDS = (0.8, 5.6)  # shortest and longest hold of a command, in time scales: 0.4 to 2.8 s
_SMALLEST, _LARGEST = -1.3, -0.05  # log10 of a move as a share of the range


@dataclass(frozen=True)
class StepCommand:
    """One step response: commands (omega_ref [rpm], beta_ref [deg]) before and after."""

    before: tuple[float, float]
    after: tuple[float, float]


def grid(points: int, rig: Rig = PAPERS) -> list[tuple[float, float]]:
    """points x points commands of the static map, speed by speed as in the paper's two loops; one point for a fixed channel."""
    speeds, pitches = (np.linspace(*span, points if _moves(span) else 1) for span in (rig.speed, rig.pitch))
    return _points(rig, [(w, b) for w in speeds for b in pitches])


def steps(levels: int = 5, rig: Rig = PAPERS) -> list[StepCommand]:
    """The paper's steps: five sizes up, five down, of speed at `levels` pitches and of pitch at `levels` speeds. A fixed
    channel has no steps, and is one level for the other."""
    pairs = []
    up, down = np.linspace(0.125, 1.0, 5), np.linspace(0.875, 0.0, 5)
    if _moves(rig.speed):
        for b in np.linspace(0.3, 0.9, levels if _moves(rig.pitch) else 1):
            pairs += [((0.0, b), (w, b)) for w in up] + [((1.0, b), (w, b)) for w in down]
    up, down = np.linspace(0.2, 1.0, 5), np.linspace(0.8, 0.0, 5)
    if _moves(rig.pitch):
        for w in np.linspace(0.2, 1.0, levels if _moves(rig.speed) else 1):
            pairs += [((w, 0.0), (w, b)) for b in up] + [((w, 1.0), (w, b)) for b in down]
    if not pairs:
        return []
    ends = _points(rig, [(_at(rig.speed, w), _at(rig.pitch, b)) for pair in pairs for w, b in pair])
    return [StepCommand(*pair) for pair in zip(ends[::2], ends[1::2], strict=True)]


def open_loop(seed: int, section: float, dt: float, rig: Rig = PAPERS) -> Record:
    """Three sections of `section` s each: speed moves, pitch moves, both move."""
    rng, rows = np.random.default_rng(seed), round(section / dt)
    (speed, pitch), rest = _region(rig), np.ones(rows)
    still_speed, still_pitch = _at(rig.speed, RESTING[0]) * rest, _at(operating_pitch(rig), RESTING[1]) * rest
    omega = np.concatenate([_levels(rng, rows, speed, rig, dt), still_speed, _levels(rng, rows, speed, rig, dt)])
    beta = np.concatenate([still_pitch, _levels(rng, rows, pitch, rig, dt), _levels(rng, rows, pitch, rig, dt)])
    return _record(rig, omega, beta, dt, "open loop")


def validation(seed: int, seconds: float, dt: float, rig: Rig = PAPERS) -> Record:
    """Both channels move, with a different random sequence from `open_loop`."""
    rng, rows = np.random.default_rng([seed, 1]), round(seconds / dt)
    return _record(rig, *(_levels(rng, rows, span, rig, dt) for span in _region(rig)), dt, "validation")


def resampled(commands: Record, dt: float) -> Record:
    """A command record at the loop's own times, each command held to the next row."""
    time = np.arange(round(commands.time[-1] / dt) + 1) * dt
    held = np.searchsorted(commands.time, time + 1e-9, side="right") - 1
    return Record({"time": time, **{n: commands[n][held] for n in ("omega_ref", "beta_ref")}}, commands.source)


def operating_pitch(rig: Rig) -> tuple[float, float]:
    """The part of the pitch range [deg] that the model's map normalises to 0 to 1, if it is at least half of the range; else
    the whole range. Blades may stall below, which only the static map measures."""
    low, high = (rig.scales.absolute(share, "position") for share in (0.0, 1.0))
    low, high = max(low, rig.pitch[0]), min(high, rig.pitch[1])
    return (low, high) if high - low >= 0.5 * (rig.pitch[1] - rig.pitch[0]) else rig.pitch


def _region(rig: Rig) -> list[tuple[float, float]]:
    """Limits of open-loop sequences, for speed and pitch."""
    spans = rig.speed, operating_pitch(rig)
    return [tuple(_at(span, share) for share in edges) for span, edges in zip(spans, EDGES, strict=True)]


def _moves(span: tuple[float, float]) -> bool:
    return span[0] < span[1]


def _at(span: tuple[float, float], share: float) -> float:
    return span[0] + share * (span[1] - span[0])


def _points(rig: Rig, targets: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Single commands without a slew limit."""
    return [tuple(point) for point in commanded(rig, np.array(targets), np.inf).tolist()]


def _levels(rng: np.random.Generator, rows: int, span: tuple[float, float], rig: Rig, dt: float) -> np.ndarray:
    """Random levels (rows,). The logarithm of a move is uniform, because small moves reveal thresholds."""
    low, high = span
    values, now = [], rng.uniform(low, high)
    while len(values) < rows:
        values += [now] * max(1, round(rng.uniform(*_HOLDS) * rig.scales.time_scale / dt))
        now = float(np.clip(now + rng.choice([-1, 1]) * (high - low) * 10 ** rng.uniform(_SMALLEST, _LARGEST), low, high))
    return np.array(values[:rows])


def _record(rig: Rig, omega: np.ndarray, beta: np.ndarray, dt: float, source: str) -> Record:
    commands = commanded(rig, np.column_stack([omega, beta]), dt)
    return Record({"time": np.arange(len(omega)) * dt, "omega_ref": commands[:, 0], "beta_ref": commands[:, 1]}, source)
