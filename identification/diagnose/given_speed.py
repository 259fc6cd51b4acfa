"""Records with a known rotor speed, for fits of thrust alone: a fault of the speed then leaves no trace in the thrust.

The speed is that of a fitted model plus what its readings show beyond it. This remainder is placed at the instants of the
readings and smoothed by a Gaussian kernel (Nadaraya, 1964; Watson, 1964), whose width leave-one-out cross-validation selects:
a wide one where the remainder is noise, a narrow one where the model lacks a fast effect.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from identification.diagnose.search.fits import Fit
from identification.fit.tachometer import Tachometer
from identification.roles import Fitted
from vpp_fmu.kernel.effects import measured_speed
from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

WIDTHS = tuple((2.0 ** (0.5 * np.arange(0, 13))).tolist())
"""Widths of the kernel, in median intervals between readings."""


def with_given_speed(library: Sequence[Effect]) -> tuple[Effect, ...]:
    """The library with the known speed in place of that of the speed channel, which no effect behind it changes."""
    at = [e.name for e in library].index("thrust_map")
    return (*library[:at], measured_speed.EFFECT, *library[at:])


def given_speed(records: Sequence[Record], first: Fit, readings: bool = True) -> list[Record]:
    """Records of the same commands with the columns of the known speed. `first`: the fit of the speed; `readings`: add what
    the readings show beyond it."""
    simulator, shown_at = first.problem.simulator, {}
    for e in first.problem.model.effects:
        if "speed" in e.reading and e.off:
            shown_at |= e.switched_off
    shown = simulator.simulate(first.values, *records[0].run)[:, 1]
    speed = simulator.simulate({**first.values, **shown_at}, *records[0].run)[:, 1] if shown_at else shown
    beyond = [found for record in records if readings and (found := _beyond(record, shown)) is not None]
    speed = np.maximum(speed + np.mean(beyond, axis=0), 0.0) if beyond else speed
    columns = {"speed_at_row": speed, "speed_at_next_row": np.append(speed[1:], speed[-1:])}
    return [record.with_columns(**columns) for record in records]


def with_speed_of(groups: Sequence[Sequence[Fitted]], first: Fit, readings: bool = True) -> list[list[Fitted]]:
    """The same for groups of fitted records."""
    given = [given_speed([one.record for one in group], first, readings) for group in groups]
    return [[Fitted(one.name, r) for one, r in zip(group, own, strict=True)] for group, own in zip(groups, given, strict=True)]


def _beyond(record: Record, shown: np.ndarray) -> np.ndarray | None:
    """(rows,) rpm: what the readings show beyond a model's speed (rows,), smoothed; None without enough readings."""
    if "omega" not in record or len(sensor := Tachometer(record)) < 3:
        return None
    found, centres = sensor.measured - sensor.shows(shown), np.maximum.accumulate(sensor.centres)
    weights, step = 1.0 / sensor.std**2, record.period
    at = np.maximum(np.round((centres - record.time[0]) / step).astype(int), 0)
    count, apart = int(at.max()) + 1, float(np.median(np.diff(centres))) / step
    best, least = found, np.inf
    for width in (apart * share for share in WIDTHS):
        sums = [
            gaussian_filter1d(np.bincount(at, v, count), width, mode="constant", truncate=5.0)[at]
            for v in (weights * found, weights)
        ]
        own = weights / (np.sqrt(2.0 * np.pi) * width)
        others = np.maximum(sums[1] - own, 1e-300)
        error = found - np.where(others > 1e-9 * own, (sums[0] - own * found) / others, 0.0)
        cost = float(np.sum(weights * error**2))
        if cost < least:
            best, least = sums[0] / sums[1], cost
    return np.interp(record.time, centres, best)
