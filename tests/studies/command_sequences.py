"""Commands of the records of a campaign, as shares of the rig's speed and pitch.

Times are those of the paper's rig; `Clock` stretches them for a slower one.
"""

from dataclasses import dataclass

import numpy as np

SPEED, PITCH = (0.37, 0.98), (0.03, 0.97)
GRID_SPEED, GRID_PITCH = (1.0 / 3.0, 1.0), (-1.0 / 3.0, 1.0)
"""Ranges of the static map and of the rig: 2000 to 6000 rpm, -10 to 10 deg on the paper's."""

HOLDS = (0.4, 2.8)
"""s for which a command is held."""

RAMPS = 0.15
"""Share of the commands that are reached by a ramp instead of a step."""

RESTING = 0.75, 0.6
"""Speed and pitch while only the other channel moves."""

Commands = tuple[np.ndarray, np.ndarray]
"""Speed and pitch (rows,), normalised."""


@dataclass(frozen=True)
class Clock:
    """`row` s from row to row on a rig that is `slow` times slower than the paper's."""

    row: float
    slow: float

    def rows(self, seconds: float) -> int:
        """Rows in so many seconds of the paper's rig."""
        return max(1, round(seconds * self.slow / self.row))


def levels(rng: np.random.Generator, clock: Clock, rows: int, low: float, high: float) -> np.ndarray:
    """A command (rows,) that goes from level to level, mostly in steps."""
    values, now = [], rng.uniform(low, high)
    while len(values) < rows:
        hold = clock.rows(rng.uniform(*HOLDS))
        # Small moves are as frequent as large ones, because they show thresholds.
        wanted = np.clip(now + rng.choice([-1, 1]) * (high - low) * 10 ** rng.uniform(-1.3, -0.05), low, high)
        if rng.random() < RAMPS:
            values += np.linspace(now, wanted, hold).tolist()
        else:
            values += [wanted] * hold
        now = wanted
    return np.array(values[:rows])


def open_loop(rng: np.random.Generator, clock: Clock, seconds: float) -> Commands:
    """A record of so many seconds: speed only, pitch only, both, a third each."""
    rows = round(seconds / clock.row / 3.0)
    speed, pitch = levels(rng, clock, 2 * rows, *SPEED), levels(rng, clock, 2 * rows, *PITCH)
    rest = np.full(rows, RESTING[0]), np.full(rows, RESTING[1])
    return np.concatenate([speed[:rows], rest[0], speed[rows:]]), np.concatenate([rest[1], pitch])


def both(rng: np.random.Generator, clock: Clock, seconds: float) -> Commands:
    """A record of so many seconds in which both channels move."""
    rows = round(seconds / clock.row)
    return levels(rng, clock, rows, *SPEED), levels(rng, clock, rows, *PITCH)


def steps(clock: Clock) -> list[Commands]:
    """3 s each, the step after 0.5 s: in speed at two pitches, in pitch at two speeds."""
    ups, downs = (0.42, 0.58, 0.75, 0.88, 1.0), (0.92, 0.75, 0.58, 0.46, 1.0 / 3.0)
    speeds = [(1.0 / 3.0, v) for v in ups] + [(1.0, v) for v in downs]
    pitches = [(0.0, v) for v in (0.13, 0.33, 0.6, 0.8, 1.0)] + [(1.0, v) for v in (0.87, 0.67, 0.4, 0.2, 0.0)]
    found = [(_step(clock, *ends), _step(clock, pitch, pitch)) for pitch in (0.33, 0.8) for ends in speeds]
    return found + [(_step(clock, speed, speed), _step(clock, *ends)) for speed in (0.58, 0.92) for ends in pitches]


def _step(clock: Clock, first: float, last: float) -> np.ndarray:
    return np.repeat([first, last], [clock.rows(0.5), clock.rows(2.5)])


def grid(points: int = 10) -> list[tuple[float, float]]:
    """Speed and pitch of steady points, `points` of each channel."""
    return [(w, b) for w in np.linspace(*GRID_SPEED, points) for b in np.linspace(*GRID_PITCH, points)]
