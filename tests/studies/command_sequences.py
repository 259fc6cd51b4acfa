"""What the studies' rig is told to do, in shares of its speed and pitch: the records of a campaign.

Times are those of the paper's rig; `Clock` stretches them for a slower one.
"""

from dataclasses import dataclass

import numpy as np

SPEED, PITCH = (0.37, 0.98), (0.03, 0.97)
GRID_SPEED, GRID_PITCH = (1.0 / 3.0, 1.0), (-1.0 / 3.0, 1.0)
"""The static map's, and all that the rig may do: 2000 to 6000 rpm, -10 to 10 deg on the paper's."""

HOLDS = (0.4, 2.8)
"""For how long one command is held, s."""

RAMPS = 0.15
"""Share of the commands that are approached on a straight line instead of at once."""

RESTING = 0.75, 0.6
"""Of the channel that is not in play."""

Commands = tuple[np.ndarray, np.ndarray]
"""Speed and pitch (rows,), normalised."""


@dataclass(frozen=True)
class Clock:
    """`row` s from row to row on a rig that is `slow` times slower than the paper's."""

    row: float
    slow: float

    def rows(self, seconds: float) -> int:
        """In so many seconds of the paper's rig."""
        return max(1, round(seconds * self.slow / self.row))


def levels(rng: np.random.Generator, clock: Clock, rows: int, low: float, high: float) -> np.ndarray:
    """A command (rows,) that goes from level to level, mostly at once."""
    values, now = [], rng.uniform(low, high)
    while len(values) < rows:
        hold = clock.rows(rng.uniform(*HOLDS))
        # Small moves as often as large ones: thresholds show in them.
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
    """So many seconds of both."""
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
    """Speed and pitch of steady points, each channel's so many."""
    return [(w, b) for w in np.linspace(*GRID_SPEED, points) for b in np.linspace(*GRID_PITCH, points)]
