"""Whether an effect is detectable from records, without the project's own fits.

The rig without the effect is fitted to the noise-free signals of the rig with it, all nine base settings free. Half the squared
residual over the noise is the log-likelihood of the truth over the best base model.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from vpp_fmu.record import Record

from .physics import BASE, Run
from .rig import JITTER, Rig

STEP = 0.0005
"""Step of the integration, s on the paper's rig: its error is the same in both signals."""

DELAY = 0.1
"""s of the logger's free delay per unit of the search."""

BLOCK = 0.016
"""s on the paper's rig over which speed is averaged, at least a revolution, so that its sensor's errors are nearly white."""

SLOPE = 1e-3
"""Relative change of a setting for a derivative."""

LIMIT = 20.0
"""Log-likelihood from which on an effect counts as detectable: a BIC difference of 10 needs about 10 on the fitted records, and
a gain of 3 on hold-out records of two thirds of their length needs about 18."""


def evidence(
    with_it: Rig,
    base: Mapping[str, float],
    speed: np.ndarray,
    pitch: np.ndarray,
    known: Mapping[str, float] | None = None,
    records: int = 2,
    free: Mapping[str, float] | None = None,
    sensor_filter: float | None = None,
) -> float:
    """Log-likelihood of the truth over the best base model, of so many records of these commands (rpm, deg).

    `known`: settings that the base model has too; `free`: its additional settings that are fitted, with start values.
    `sensor_filter` [s] of the speed reading: if it is given, the logger's nuisance parameters are free too. They are the
    offset of all readings, the delay of the speed reading and, above 0, its filter.
    """
    base = {**base, **(free or {})}
    names = [*BASE, *(free or {})]
    found = with_it.run(speed, pitch, STEP)
    uncertain = _speed_noise(with_it, found)
    true = _white(with_it, found, speed, pitch, uncertain, (0.0, 0.0, sensor_filter or 0.0))
    scale = np.array([base[n] for n in names])
    logger = 0 if sensor_filter is None else 3 if sensor_filter else 2

    def error(x):
        # The fit uses logarithms of time constants, which must stay positive, and relative changes of the map's coefficients.
        factors = np.where([n.startswith("tau") for n in names], np.exp(x[: len(names)]), 1.0 + x[: len(names)])
        other = replace(with_it, settings=dict(zip(names, scale * factors, strict=True)) | dict(known or {}), extra=None)
        offset, delay, filter_change = (*x[len(names) :], 0.0, 0.0, 0.0)[:3]
        read = DELAY * offset, DELAY * delay, (sensor_filter or 0.0) * np.exp(filter_change)
        return _white(other, other.run(speed, pitch, STEP), speed, pitch, uncertain, read) - true

    best = least_squares(error, np.zeros(len(names) + logger), diff_step=1e-4, bounds=(-4.0, 4.0), max_nfev=8)
    return records * float(best.cost)


def efficient_errors(
    rig: Rig, fitted: Iterable[tuple[np.ndarray, np.ndarray]], unseen: tuple[np.ndarray, np.ndarray], draws: np.ndarray
) -> np.ndarray:
    """Rms thrust errors (k,) N on the unseen commands (rpm, deg) of an efficient estimator of the nine base settings, from
    records of the `fitted` commands: the covariance is the Cramer-Rao bound. `draws` (k, 9): standard normal numbers."""
    information = np.zeros((len(BASE), len(BASE)))
    for commands in fitted:
        uncertain = _speed_noise(rig, rig.run(*commands, STEP))
        slopes = _slopes(rig, commands, lambda one, found, c=commands, u=uncertain: _white(one, found, *c, u))
        information += slopes.T @ slopes
    errors = np.linalg.solve(np.linalg.cholesky(information).T, draws.T)
    thrust = _slopes(rig, unseen, lambda one, found: one.force(found, *unseen))
    return np.sqrt(np.mean((thrust @ errors) ** 2, axis=0))


def _slopes(rig: Rig, commands: tuple[np.ndarray, np.ndarray], shown: Callable[[Rig, Run], np.ndarray]) -> np.ndarray:
    """Derivatives (rows, 9) of `shown(rig, run)` in the base settings, each relative to its value."""
    columns = []
    for name in BASE:
        ends = (replace(rig, settings={**rig.settings, name: rig.settings[name] * (1.0 + h)}) for h in (-SLOPE, SLOPE))
        before, behind = (shown(one, one.run(*commands, STEP)) for one in ends)
        columns.append((behind - before) / (2.0 * SLOPE))
    return np.column_stack(columns)


def behind(rig: Rig, record: Record, thrust: np.ndarray, omega: np.ndarray, records: int) -> float:
    """Log-likelihood of the truth less that of a model that predicts this thrust (rows,) N and speed (rows,) rpm, on so many
    records of these commands. For a right model it is half a nat, on average, for each fitted parameter."""
    speed, pitch = record["omega_ref"], record["beta_ref"]
    found = rig.run(speed, pitch, STEP)
    speed_error = _blocks(rig, omega / rig.size.speed - _speed_reading(rig, found)) / _speed_noise(rig, found)
    away = np.concatenate([_over_noise(rig, thrust - rig.force(found, speed, pitch)), speed_error])
    return records * 0.5 * float(away @ away)


def _white(
    one: Rig,
    found: Run,
    speed: np.ndarray,
    pitch: np.ndarray,
    uncertain: np.ndarray,
    read: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """Thrust and speed readings, whitened to unit variance. `read` s: offset of both readings, delay and filter of speed."""
    offset, delay, time_constant = read
    omega = _speed_reading(one, found)
    if time_constant:
        keep = np.exp(-1.0 / (one.rate * time_constant))
        omega = lfilter([1.0 - keep], [1.0, -keep], omega, zi=keep * omega[:1])[0]
    thrust, omega = _later(one, one.force(found, speed, pitch), offset), _later(one, omega, offset + delay)
    return np.concatenate([_over_noise(one, thrust), _blocks(one, omega) / uncertain])


def _later(one: Rig, rows: np.ndarray, delay: float) -> np.ndarray:
    """(rows,) delayed by `delay` s, to first order: it is small at the optimum, and linear interpolation would have kinks."""
    return rows - delay * one.rate * np.gradient(rows) if delay else rows


def _speed_reading(one: Rig, found: Run) -> np.ndarray:
    """Normalised speed (rows,) with the delay of the tachometer."""
    late = one.settings.get("speed_late", 0.0) * one.rate
    rows = np.arange(len(found.omega))
    return np.interp(rows - late, rows, found.omega) if late else found.omega


def _speed_noise(one: Rig, found: Run) -> np.ndarray:
    """Normalised standard deviation (blocks,) of a block's mean speed, from the jitter of the two pulses that end it and from
    the instant of a pulse within a row."""
    seconds = _block(one) / one.rate
    change = np.gradient(_blocks(one, found.omega), seconds)
    full = one.size.speed / 60.0
    return np.hypot(np.sqrt(2.0) * JITTER / seconds / full, change / one.rate / np.sqrt(8.0))


def _block(one: Rig) -> int:
    """Rows of a block."""
    return max(1, round(max(BLOCK * one.size.slow, 60.0 / one.size.speed) * one.rate))


def _blocks(one: Rig, rows: np.ndarray) -> np.ndarray:
    size = _block(one)
    return rows[: len(rows) // size * size].reshape(-1, size).mean(axis=1)


def _over_noise(one: Rig, thrust: np.ndarray) -> np.ndarray:
    n = len(thrust)
    turns = np.fft.rfftfreq(n)
    turns[0] = turns[1]  # the mean is known about as well as the slowest wave
    white = np.fft.rfft(thrust) / np.sqrt(0.5 * n * one.noise.power(turns))
    white[0] /= np.sqrt(2.0)
    return np.concatenate([white.real, white.imag])
