"""Locate an unexplained error: frequency band, section, input, and the signal of strongest correlation."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import csd

from identification.assessment.sections import sections
from identification.fit.noise import blocks
from vpp_fmu.record import Record

RATE = 0.02
"""Seconds of the block means, whose Nyquist frequency is not below the bands."""

BANDS = ((0.0, 0.2), (0.2, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 25.0))

WEAK = 0.2
"""Correlation below which an error is assigned to neither command."""


def locate(records: Sequence[Record], thrust: np.ndarray, omega: np.ndarray, beta: np.ndarray) -> dict:
    """Describe the repeatable error of a prediction (rows,) [N], [rpm], [deg], of records of the same commands."""
    record, repeat = records[0], records[1] if len(records) > 1 else None
    at = blocks(record, RATE)
    error = at.mean(record["thrust"] - thrust)
    other = at.mean(repeat["thrust"] - thrust) if repeat is not None else error
    both = 0.5 * (error + other)
    worst = int(np.nanargmax(np.abs(both)))
    by_section = {}
    for name, mask in sections(record).items():
        chosen = (at.mean(mask.astype(float)) > 0.5) & np.isfinite(both)
        if chosen.any():
            by_section[name] = float(np.mean((error * other)[chosen]))
    signals = _signals(record, thrust, omega, beta)
    correlates = {name: _correlation(both, at.mean(signal)) for name, signal in signals.items()}
    ranked = sorted(correlates.items(), key=lambda item: -abs(item[1]))
    strongest = ranked[0]
    speed, pitch = (max(abs(correlates[n]) for n in names) for names in (SPEED, PITCH))
    return {
        "share_by_band_hz": _bands(error, other, float(np.median(np.diff(at.time)))),
        "mean_square_by_section": by_section,
        "largest": {"time": float(at.time[worst]), "thrust": float(both[worst])},
        "strongest_correlate": {"signal": strongest[0], "correlation": strongest[1]},
        "correlates": dict(ranked),
        "input": _input(speed, pitch),
    }


def _correlation(error: np.ndarray, signal: np.ndarray) -> float:
    """Correlation over the rows that have an error; 0 with a constant signal."""
    seen = np.isfinite(error)
    error, signal = error[seen], signal[seen]
    return float(np.corrcoef(error, signal)[0, 1]) if np.ptp(signal) > 0.0 and np.ptp(error) > 0.0 else 0.0


def _input(speed: float, pitch: float) -> str:
    """The command to which the error is assigned, by the strongest correlation with the signals of each command."""
    if max(speed, pitch) < WEAK:
        return "neither"
    return "pitch" if pitch > 1.2 * speed else "speed" if speed > 1.2 * pitch else "both"


SPEED = ("speed", "rate of speed", "speed still to go")
PITCH = ("pitch", "rate of pitch", "pitch still to go")


def _signals(record, thrust, omega, beta) -> Mapping[str, np.ndarray]:
    time = record.time
    return {
        "time since the start": time,
        "thrust": thrust,
        "rate of thrust": _rate(thrust, time),
        "speed": omega,
        "rate of speed": _rate(omega, time),
        "speed still to go": record["omega_ref"] - omega,
        "pitch": beta,
        "rate of pitch": _rate(beta, time),
        "pitch still to go": record["beta_ref"] - beta,
    }


def _rate(signal: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.gradient(signal - signal[0], time)  # exactly 0 for a constant signal


def cross_spectrum(error: np.ndarray, other: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """(frequency [Hz], real cross-spectral density [N^2/Hz]) of two records' errors (n,) N, a value per `step` s; NaN is 0."""
    seen = np.isfinite(error) & np.isfinite(other)
    error, other = (np.where(seen, e, 0.0) for e in (error, other))
    frequency, shared = csd(error, other, fs=1.0 / step, nperseg=min(1024, len(error)), detrend=False)
    return frequency, shared.real


def _bands(error: np.ndarray, other: np.ndarray, step: float) -> dict[str, float]:
    """Share of the cross-spectral power of two records' errors, one value per `step` s, by frequency band."""
    frequency, shared = cross_spectrum(error, other, step)
    power = np.maximum(shared, 0.0)
    total = power.sum() or 1.0
    return {f"{a:g}-{b:g}": float(power[(frequency >= a) & (frequency < b)].sum() / total) for a, b in BANDS}
