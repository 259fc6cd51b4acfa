"""Operating points at which a loop settles, and its margins there."""

from dataclasses import replace

import numpy as np

from identification.tune.linear import CHANNELS
from identification.tune.margins import Margins, frequencies, margins
from identification.tune.objective import Objective, Point

LEVELS, HOLD = 5, 6.0
"""Number of levels of thrust from the lowest to the highest wanted; duration of each in time scales."""

RESTS = 0.03
"""Largest error, as a share of the thrust scale, at which a loop has reached a level."""

FREE = 1e-6
"""Least distance of a free command from its limits, as a share of its scale."""


def operating_points(objective: Objective, gains: np.ndarray) -> tuple[Point, ...]:
    """Simulate the loop on levels up and down; levels that are not reached, or at which no channel is free, are left out.

    With two actuators the commands at a thrust are not unique: they depend on the gains and on earlier levels.
    """
    course = objective.course
    levels = np.linspace(course.wanted.min(), course.wanted.max(), LEVELS)
    levels = np.unique(levels) if levels[0] == levels[-1] else np.r_[levels, levels[-2::-1]]
    rows = round(HOLD * objective.time_scale / course.dt)
    stairs = replace(course, wanted=np.repeat(levels, rows), noise=np.zeros(rows * len(levels)))
    run = replace(objective.nominal, course=stairs).run(gains)
    points = []
    for level, end in zip(levels.tolist(), range(rows - 1, rows * len(levels), rows), strict=True):
        commands = tuple(float(run[name][end]) for name in CHANNELS.values())
        channels = _free(objective, commands)
        if channels and abs(run["thrust"][end] - level) <= RESTS * course.scale:
            points.append(Point(level, commands, channels))
    return tuple(points)


def _free(objective: Objective, commands: tuple[float, float]) -> tuple[str, ...]:
    settings, found = objective.settings, []
    for channel, command in zip(CHANNELS, commands, strict=True):
        room = FREE * settings[f"{channel}_scale"]
        if channel in objective.channels and settings[f"{channel}_min"] + room < command < settings[f"{channel}_max"] - room:
            found.append(channel)
    return tuple(found)


def margins_at(objective: Objective, gains: np.ndarray, points: tuple[Point, ...]) -> tuple[Margins, ...]:
    omega = frequencies(objective.course.dt, objective.time_scale)
    loops = objective.open_loops(gains, omega, objective.paths(points, omega))
    return tuple(margins(omega, loop, objective.integrators(point)) for point, loop in zip(points, loops, strict=True))
