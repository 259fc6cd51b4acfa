"""Records with a known rotor speed, for fits of thrust alone: a fault of the speed then leaves no trace in the thrust.

The speed is that of a fitted model plus what its readings show beyond it. This remainder is placed at the instants of the
readings and smoothed by a Gaussian kernel (Nadaraya, 1964; Watson, 1964). Its width differs from reading to reading, by the
intersection of confidence intervals (Goldenshluger and Nemirovski, Math. Methods Statist., 1997): the widest whose mean agrees
with those of all narrower ones. It is wide where the remainder is noise, and narrow where the model lacks a fast effect.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import fftconvolve
from scipy.signal.windows import gaussian

from identification.diagnose.initial_model import AlwaysOn
from identification.diagnose.search.fits import Fit
from identification.fit.tachometer import Tachometer
from identification.roles import Fitted
from vpp_fmu.kernel.effects import measured_speed
from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

WIDTHS = tuple((2.0 ** (0.5 * np.arange(0, 13))).tolist())
"""Widths of the kernel, in median intervals between readings."""

CLEAR = 3.0
"""Standard errors of a mean within which means of other widths agree with it."""


def with_given_speed(library: Sequence[Effect]) -> tuple[Effect, ...]:
    """The library with the known speed in place of that of the speed channel, which no effect behind it changes."""
    at = [e.name for e in library].index("thrust_map")
    return (*library[:at], measured_speed.EFFECT, *library[at:])


def given_speed(records: Sequence[Record], first: Fit, readings: bool = True) -> tuple[list[Record], float]:
    """(records of the same commands with the columns of the known speed; its standard error from the noise of the readings,
    rpm). `first`: the fit of the speed; `readings`: add what the readings show beyond it."""
    simulator, as_read = first.problem.simulator, {}
    for e in first.problem.model.effects:
        if "speed" in e.reading:
            as_read |= (e.origin if isinstance(e, AlwaysOn) else e).switched_off
    shown = simulator.simulate(first.values, *records[0].run)[:, 1]
    speed = simulator.simulate({**first.values, **as_read}, *records[0].run)[:, 1] if as_read else shown
    beyond = [found for record in records if readings and (found := _beyond(record, shown)) is not None]
    error = float(np.sqrt(sum(std**2 for _, std in beyond))) / max(len(beyond), 1)
    if beyond:
        speed = np.maximum(speed + np.mean([rows for rows, _ in beyond], axis=0), 0.0)
    columns = {"speed_at_row": speed, "speed_at_next_row": np.append(speed[1:], speed[-1:])}
    within = max(_instant_within(record) for record in records)
    columns[measured_speed.WITHIN] = np.full(len(speed), within)
    return [record.with_columns(**columns) for record in records], error


def with_speed_of(groups: Sequence[Sequence[Fitted]], first: Fit, readings: bool = True) -> tuple[list[list[Fitted]], float]:
    """The same for groups of fitted records; the largest standard error."""
    given = [given_speed([one.record for one in group], first, readings) for group in groups]
    known = [
        [Fitted(one.name, record) for one, record in zip(group, records, strict=True)]
        for group, (records, _) in zip(groups, given, strict=True)
    ]
    return known, max(error for _, error in given)


def _instant_within(record: Record) -> float:
    """Uncertainty [s] of the instants of a record's speed readings: half a row at least."""
    read = "omega" in record and np.isfinite(record["omega"]).sum() > 1
    return max(0.5 * record.period, Tachometer(record).unknown if read else 0.0)


def _beyond(record: Record, shown: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(what the readings show beyond a model's speed (rows,), smoothed, (rows,) rpm; its standard error, rpm); None without
    enough readings."""
    if "omega" not in record or len(sensor := Tachometer(record)) < 3:
        return None
    found, centres = sensor.measured - sensor.shows(shown), np.maximum.accumulate(sensor.centres)
    weights, step = 1.0 / sensor.std**2, record.period
    at = np.maximum(np.round((centres - record.time[0]) / step).astype(int), 0)
    count, apart = int(at.max()) + 1, float(np.median(np.diff(centres))) / step
    change = np.diff(found * np.sqrt(weights)) / np.sqrt(2.0)
    noise = max(1.0, 1.4826 * float(np.median(np.abs(change))))  # of a reading, in its standard deviations
    low, high = np.full(len(found), -np.inf), np.full(len(found), np.inf)
    best, error, going = found.copy(), noise * sensor.std, np.ones(len(found), bool)
    sums = np.array([np.bincount(at, v, count) for v in (weights * found, weights)])
    for width in (apart * share for share in WIDTHS):
        kernel = gaussian(2 * round(4.0 * width) + 1, width)
        total, whole = fftconvolve(sums, kernel[None] / kernel.sum(), "same", axes=1)[:, at]
        mean = total / whole
        # The mean over a Gaussian kernel has 1 / (2 sqrt(pi) width) of the variance of independent readings.
        std = noise / np.sqrt(whole * max(2.0 * np.sqrt(np.pi) * width, 1.0))
        low, high = np.maximum(low, mean - CLEAR * std), np.minimum(high, mean + CLEAR * std)
        going &= low <= high
        best[going], error[going] = mean[going], std[going]
    return np.interp(record.time, centres, best), float(np.sqrt(np.mean(error**2)))
