"""Records with a known truth: the paper's fine-tuned model under commands like the paper's, with noise on the thrust."""

import numpy as np
from scipy.signal import lfilter

from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

STEP = 0.004
"""Period of the paper's 250 Hz, s."""

SECTION = 20.0
"""Length of each section (speed only, pitch only, both), s."""

SPEED, PITCH, HOLD = (2000.0, 6000.0), (-5.0, 10.0), (1.0, 2.5)
"""Ranges of levels in rpm and deg, and of their hold, s; all uniform."""

NOISE = 0.3
"""Standard deviation of a thrust reading, N: 0.02 of the paper's scale."""

TRUTH = FINE_TUNED | {"tau_beta_1": FINE_TUNED["tau_beta_2"], "tau_beta_2": FINE_TUNED["tau_beta_1"]}
"""The fine-tuned set, each channel's slower constant first, as a fit reports them; the response is the same."""


def commands(rng: np.random.Generator, section: float = SECTION, step: float = STEP) -> Record:
    """Three sections of `section` s, a row every `step` s; a channel that does not move is in the middle of its range."""
    rows = round(section / step)
    speed = [_levels(rng, rows, step, *SPEED), np.full(rows, np.mean(SPEED)), _levels(rng, rows, step, *SPEED)]
    pitch = [np.full(rows, np.mean(PITCH)), _levels(rng, rows, step, *PITCH), _levels(rng, rows, step, *PITCH)]
    columns = {"time": np.arange(3 * rows) * step, "omega_ref": np.concatenate(speed), "beta_ref": np.concatenate(pitch)}
    return Record(columns, "synthetic")


def _levels(rng: np.random.Generator, rows: int, step: float, low: float, high: float) -> np.ndarray:
    """A command (rows,) that jumps to a new level after each hold."""
    most = int(rows * step / HOLD[0]) + 2
    holds = np.round(rng.uniform(*HOLD, most) / step).astype(int)
    return np.repeat(rng.uniform(low, high, most), holds)[:rows]


def measured(record: Record, rng: np.random.Generator, std: float = NOISE, memory: float = 0.0) -> Record:
    """The record with the true model's thrust and Gaussian noise of `std` N on it.

    White, or first-order autoregressive with a correlation that falls to 1 / e in `memory` s.
    """
    thrust = Simulator(BASE).simulate(TRUTH, *record.run)[:, 0]
    drive = rng.standard_normal(len(record)) * np.sqrt(_innovation(len(record), memory))
    return record.with_columns(thrust=thrust + std * lfilter([1.0], [1.0, -_rho(memory)], drive))


def covariance(jacobian: np.ndarray, std: float, memory: float = 0.0) -> np.ndarray:
    """Covariance (n, n) of least squares by linear theory, for thrust's Jacobian (rows, n) [N] and noise as in `measured`.

    For white noise this is the Cramer-Rao bound.
    """
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    driven = lfilter([1.0], [1.0, -_rho(memory)], jacobian[::-1], axis=0)[::-1]
    scores = driven.T @ (driven * _innovation(len(jacobian), memory)[:, None])
    return std**2 * inverse @ scores @ inverse


def _rho(memory: float) -> float:
    return float(np.exp(-STEP / memory)) if memory > 0 else 0.0


def _innovation(rows: int, memory: float) -> np.ndarray:
    """Variance (rows,) of the noise's innovations; the first row is drawn from the stationary noise."""
    variance = np.full(rows, 1.0 - _rho(memory) ** 2)
    variance[0] = 1.0
    return variance
