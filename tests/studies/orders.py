"""What the studies' rig is told to do, in rpm and deg: the records of a campaign."""

import numpy as np

from .physics import ROW

SPEED, PITCH = (2200.0, 5900.0), (-4.5, 9.5)
HOLDS = (0.4, 2.8)
"""For how long one command is held, s."""

RAMPS = 0.15
"""Share of the commands that are approached on a straight line instead of at once."""

SECTION = 30.0
"""Speed only, pitch only, both: this long each in the open-loop record, s."""

RESTING = 4500.0, 4.0
"""rpm, deg of the channel that is not in play."""


def levels(rng: np.random.Generator, rows: int, low: float, high: float, digits: int) -> np.ndarray:
    """A command (rows,) that goes from level to level, mostly at once."""
    values, now = [], rng.uniform(low, high)
    while len(values) < rows:
        hold = round(rng.uniform(*HOLDS) / ROW)
        # Small moves as often as large ones: thresholds show in them.
        wanted = np.clip(now + rng.choice([-1, 1]) * (high - low) * 10 ** rng.uniform(-1.3, -0.05), low, high)
        if rng.random() < RAMPS:
            values += np.linspace(now, wanted, hold).tolist()
        else:
            values += [wanted] * hold
        now = wanted
    return np.round(values[:rows], digits)


def open_loop(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Speed and pitch commands (rows,): speed only, pitch only, both."""
    rows = round(SECTION / ROW)
    speed, pitch = levels(rng, 2 * rows, *SPEED, 1), levels(rng, 2 * rows, *PITCH, 3)
    rest = np.full(rows, RESTING[0]), np.full(rows, RESTING[1])
    return np.concatenate([speed[:rows], rest[0], speed[rows:]]), np.concatenate([rest[1], pitch])


def validation(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """60 s of both."""
    rows = round(2 * SECTION / ROW)
    return levels(rng, rows, *SPEED, 1), levels(rng, rows, *PITCH, 3)


def steps() -> list[tuple[np.ndarray, np.ndarray]]:
    """3 s each, the step after 0.5 s: in speed at two pitches, in pitch at two speeds."""
    found = []
    for pitch in (0.0, 7.0):
        for first, last in [(2000.0, v) for v in (2500, 3500, 4500, 5250, 6000)] + [
            (6000.0, v) for v in (5500, 4500, 3500, 2750, 2000)
        ]:
            found.append((_step(first, last), np.full(750, pitch)))
    for speed in (3500.0, 5500.0):
        for first, last in [(-5.0, v) for v in (-3, 0, 4, 7, 10)] + [(10.0, v) for v in (8, 5, 1, -2, -5)]:
            found.append((np.full(750, speed), _step(first, last)))
    return found


def _step(first: float, last: float) -> np.ndarray:
    return np.repeat([first, last], [125, 625]).astype(float)
