"""A discriminating experiment of 90 s, as a record of commands.

Each part asks what another can't answer: small stairs and reversals for dead bands and play, two amplitudes of the same
spectrum for anything nonlinear in size, full steps for limits, slow sections for drift, holds at rest for offsets.
"""

import numpy as np

from vpp_fmu.record import Record

STEP = 0.004


def discriminating_experiment(
    seed: int = 0, speed: tuple[float, float] = (2000.0, 6000.0), pitch: tuple[float, float] = (-5.0, 10.0)
) -> Record:
    """Commands `time` [s], `omega_ref` [rpm], `beta_ref` [deg] within the given ranges; run it twice."""
    rng = np.random.default_rng(seed)
    low, high = speed
    middle, span = 0.5 * sum(pitch), 0.5 * (pitch[1] - pitch[0])
    parts = [_rest(3.0, low, middle)]
    parts.append(_random_steps(rng, 20.0, speed, pitch))
    parts.append(_stairs(24.0, high, middle, span))
    parts += [_multisine(rng, 8.0, 0.5 * (low + high), 0.0, middle, a * span) for a in (0.15, 0.6)]
    parts.append(_multisine(rng, 8.0, 0.5 * (low + high), 0.4 * (high - low), middle, 0.0))
    parts.append(_full_steps(8.0, speed, pitch[1]))
    parts += [_doublets(7.0, w, middle, 0.4 * span) for w in (low + 0.25 * (high - low), high)]
    parts.append(_rest(3.0, low, middle))
    omega, beta = (np.concatenate(column) for column in zip(*parts, strict=True))
    time = np.arange(len(omega)) * STEP
    return Record({"time": time, "omega_ref": np.round(omega, 1), "beta_ref": np.round(beta, 3)}, "discriminating experiment")


def _count(seconds):
    return round(seconds / STEP)


def _rest(seconds, omega, beta):
    return np.full(_count(seconds), omega), np.full(_count(seconds), beta)


def _random_steps(rng, seconds, speed, pitch):
    omega, beta = [], []
    while len(omega) < _count(seconds):
        hold = _count(rng.uniform(0.3, 1.2))
        omega += [rng.uniform(*speed)] * hold
        beta += [rng.uniform(*pitch)] * hold
    return np.array(omega[: _count(seconds)]), np.array(beta[: _count(seconds)])


def _stairs(seconds, omega, middle, span):
    """Pitch up and down by 0.02, 0.05, 0.1 and 0.2 of its range."""
    offsets = [0.0]
    for size in (0.02, 0.05, 0.1, 0.2):
        offsets += [size, 2 * size, size, 0.0, -size, 0.0]
    hold = _count(seconds) // len(offsets)
    beta = np.repeat(middle + 2 * span * np.array(offsets), hold)
    return np.full(len(beta), omega), beta


def _multisine(rng, seconds, omega, omega_size, beta, beta_size):
    """0.15 to 6 Hz, equal power a line, random phases, peak at the given size."""
    t = np.arange(_count(seconds)) * STEP
    lines = np.geomspace(0.15, 6.0, 14)
    wave = np.sin(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, len(lines))).sum(axis=1)
    wave /= np.max(np.abs(wave))
    return omega + omega_size * wave, beta + beta_size * wave


def _full_steps(seconds, speed, pitch):
    hold = _count(seconds / 4)
    return np.repeat([speed[0], speed[1], speed[0], speed[1]], hold), np.full(4 * hold, pitch)


def _doublets(seconds, omega, middle, size):
    """Pitch reversed after 0.35, 0.8 and 1.5 s: before, about, and after it has settled."""
    beta = []
    for hold in (0.35, 0.8, 1.5):
        beta += [middle + size] * _count(hold) + [middle - size] * _count(hold) + [middle] * _count(0.5)
    beta += [middle] * max(0, _count(seconds) - len(beta))
    beta = np.array(beta[: _count(seconds)])
    return np.full(len(beta), omega), beta
