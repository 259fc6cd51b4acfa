"""Regressors made of the commands and of time, which span the residual of a missing effect of any form.

Any rate-independent hysteresis is a sum of play operators (Prandtl and Ishlinskii; Brokate and Sprekels, Hysteresis and Phase
Transitions, 1996, chapter 2). Rate limits and dead bands are functions of the tracking error. The regressors are a few plays
and bounded tracking errors, unfiltered and lagged; the damped oscillations of resonant loops (Kautz, IRE Trans. Circuit Theory,
1954); higher powers of the static map; and trends in time.
"""

from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.signal import lfilter

from identification.fit.coordinates import slowest
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.record import Record

WIDTHS = (0.012, 0.03, 0.08, 0.2)
"""Half widths of plays, and bounds of the tracking error, as shares of the range of the output."""

LAGS = (0.0, 0.1, 0.35)
"""Time constants of the lags, as shares of the slowest time constant of the model: about those of the actuators."""

WAVES = (0.25, 0.5, 1.0, 2.0)
"""Oscillations of a damped wave in the slowest time constant: octaves about the resonance of a loop or a mount."""

DECAY = 0.35
"""Damping ratio of the waves: neighbouring octaves meet at half of their power."""

POWER = 4
"""Degree of the polynomials in speed and pitch, for a static map of another form: one more than that of the map."""


def thrust_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Regressors of the thrust, (rows,) N each: changes of pitch and of speed of these shapes, times the slope of the map;
    polynomials of speed and pitch; trends in time.

    `outputs` (rows, 3): thrust, speed and pitch of a model at `values`.
    """
    yield from output_shapes(record, outputs, map_slopes(values, *outputs.T[1:]), slowest(values, values))


def output_shapes(
    record: Record, outputs: np.ndarray, slopes: tuple[np.ndarray, np.ndarray], takes: float
) -> Iterator[np.ndarray]:
    """Regressors of any output of speed and pitch, in its unit. `outputs` (rows, 3): the output, speed and pitch; `slopes`: its
    derivatives by pitch and speed (rows,); `takes` [s]: the slowest time constant."""
    output, speed, pitch = outputs.T
    to_pitch, to_speed = slopes
    step = float(np.median(record.steps))
    lags = [share * takes for share in LAGS]
    for slope, u, moved in ((to_pitch, "beta", pitch), (to_speed, "omega", speed)):
        for shape in _shapes(record[f"{u}_ref"], moved, step):
            yield from (slope * lagged(shape, lag, step) for lag in lags)
        yield from (slope * wave for wave in _waves(record[f"{u}_ref"], moved, step, takes))
    over_speed, over_pitch = _polynomials(speed), _polynomials(pitch)
    yield from (over_speed[i] * over_pitch[j] for i in range(POWER + 1) for j in range(POWER + 1 - i) if i + j)
    since = record.time / record.time[-1]
    yield from (since, since**2, since * output)


def map_slopes(values: Mapping[str, float], speed: np.ndarray, pitch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (N/deg, N/rpm) of the static map at speeds and pitches (rows,)."""
    base = SimpleNamespace(**{n: v for n, v in values.items() if "." not in n})
    w, b = speed / base.omega_scale, (pitch + base.beta_offset) / base.beta_scale
    tiny = 1e-30  # by complex step: exact
    to_pitch, to_speed = (
        normalised_thrust(base, w + tiny * 1j * (1 - of_b), b + tiny * 1j * of_b).imag / tiny for of_b in (1, 0)
    )
    return base.thrust_scale / base.beta_scale * to_pitch, base.thrust_scale / base.omega_scale * to_speed


def speed_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Regressors of the speed, (rows,) rpm each: shapes of its command, pitch and its rate, levels and trends."""
    _, speed, pitch = outputs.T
    step, takes = float(np.median(record.steps)), slowest(values, values)
    rate, since = np.gradient(pitch, step), record.time / record.time[-1]
    for shape in (*_shapes(record["omega_ref"], speed, step), rate, np.abs(rate)):
        yield from (lagged(shape, share * takes, step) for share in LAGS)
    yield from _waves(record["omega_ref"], speed, step, takes)
    yield from (np.ones(len(speed)), speed, speed**2, pitch, pitch * speed, np.maximum(speed, np.quantile(speed, 0.8)))
    yield from (since, since**2, since * speed)


def regress_out(
    shapes: Callable[[], Iterator[np.ndarray]],
    mean: Callable[[np.ndarray], np.ndarray],
    residual: np.ndarray,
    others: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Regress a residual (rows,) on shapes (rows,): (the new residual, NaN where nothing was measured; orthonormal directions
    (n, k) removed by the shapes and by `others` (n, m), the sensitivities of parameters fitted before).

    The regression uses block means (n,), computed by `mean` from rows, to save memory for a long record.
    """
    target = mean(residual)
    seen = np.isfinite(target)
    columns = np.stack([mean(shape)[seen] for shape in shapes()], axis=1)
    size = _lengths(columns)
    shares, *_ = np.linalg.lstsq(columns / size, target[seen], rcond=1e-6)
    left = residual - sum(share * shape for share, shape in zip(shares / size, shapes(), strict=True))
    gone = np.zeros((len(target), columns.shape[1] + others.shape[1] + 1))
    gone[seen] = np.hstack([columns / size, others[seen] / _lengths(others[seen]), np.ones((len(columns), 1))])
    turned, power, _ = np.linalg.svd(gone, full_matrices=False)
    return left, turned[:, power > 1e-6 * power[0]]


def _lengths(columns: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(columns, axis=0)
    return np.where(size > 0.0, size, 1.0)


def _shapes(command: np.ndarray, output: np.ndarray, step: float) -> list[np.ndarray]:
    """Bounded tracking errors, plays, rate and absolute rate (rows,) of one channel."""
    rate, to_go = np.gradient(output, step), command - output
    widths = [share * np.ptp(output) for share in WIDTHS]
    bounded, plays = [np.clip(to_go, -w, w) for w in widths], [output - _play(output, w) for w in widths[:-1]]
    return [*bounded, *plays, rate, np.abs(rate)]


def _waves(command: np.ndarray, output: np.ndarray, step: float, takes: float) -> Iterator[np.ndarray]:
    """Responses (rows,) of damped oscillators to a command, minus the output; and their rates. Both are zero at rest."""
    for swings in WAVES:
        turn = 2.0 * np.pi * swings * step / takes
        kept = np.exp(-DECAY * turn)
        sway = 2.0 * kept * np.cos(np.sqrt(1.0 - DECAY**2) * turn)
        wave = command[0] + lfilter([0.0, 1.0 - sway + kept**2], [1.0, -sway, kept**2], command - command[0])
        yield wave - output
        yield np.gradient(wave) / turn


def _polynomials(signal: np.ndarray) -> np.ndarray:
    """(POWER + 1, rows) Legendre polynomials over the range of a signal (rows,)."""
    middle, half = 0.5 * (signal.max() + signal.min()), 0.5 * np.ptp(signal)
    return legvander((signal - middle) / half if half > 0.0 else np.zeros(len(signal)), POWER).T


def _play(signal: np.ndarray, width: float) -> np.ndarray:
    """Output (rows,) of a play operator of half width `width`."""
    lowest, highest = (signal - width).tolist(), (signal + width).tolist()
    at, followed = float(signal[0]), []
    for low, high in zip(lowest, highest, strict=True):  # conditions are faster than calls of min and max
        at = low if at < low else high if at > high else at
        followed.append(at)
    return np.array(followed)


def lagged(signal: np.ndarray, time_constant: float, step: float) -> np.ndarray:
    """A signal (n, ...) filtered by a first-order lag that starts settled at the first value."""
    if time_constant <= 0.0:
        return signal
    kept = np.exp(-step / time_constant)
    return lfilter([1.0 - kept], [1.0, -kept], signal, axis=0, zi=kept * signal[:1])[0]
