"""Whether records could show an effect at all, without the project's own fits.

The noise-free signals of the rig with the effect are fitted by the same rig without it, all nine base settings free; half of
what is left, over the noise, is the log-likelihood that the truth has over the best base model.
"""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

from . import rig
from .physics import BASE, ROW
from .rig import FULL_SPEED, Rig

BLOCK = 4
"""Rows that are averaged: 16 ms."""

SPEED_NOISE = 6.0
"""rpm, of a block's speed, from the jitter of about one pulse in it; the instant of the pulse within a row adds to it."""

LIMIT = 20.0
"""Log-likelihood from which on an effect counts as detectable: a BIC difference of 10 asks for about 10 on the fitted records,
and the gain of 3 on 60 s of unseen ones for about 18."""


def evidence(
    with_it: Rig, base: Mapping[str, float], speed: np.ndarray, pitch: np.ndarray, known: Mapping[str, float] | None = None
) -> float:
    """Log-likelihood over the best base model, of two records of these commands (rpm, deg).

    `known`: settings that the base model has too.
    """
    names = list(BASE)
    found = with_it.run(speed, pitch)
    change = np.gradient(_blocks(FULL_SPEED * found.omega), BLOCK * ROW)
    doubt = np.hypot(SPEED_NOISE, change * ROW / np.sqrt(8.0))
    true = _white(with_it, speed, pitch, doubt)
    scale = np.array([base[n] for n in names])

    def error(x):
        # Time constants must stay positive whatever the fit tries: their logarithm is free, the map's own values are.
        factors = np.where([n.startswith("tau") for n in names], np.exp(x), 1.0 + x)
        return _white(Rig(dict(zip(names, scale * factors, strict=True)) | dict(known or {})), speed, pitch, doubt) - true

    best = least_squares(error, np.zeros(len(names)), diff_step=1e-4, bounds=(-4.0, 4.0), max_nfev=8)
    return 2.0 * float(best.cost)


def _white(one: Rig, speed: np.ndarray, pitch: np.ndarray, doubt: np.ndarray) -> np.ndarray:
    """Thrust and speed in units of the noise, all directions alike."""
    found = one.run(speed, pitch)
    thrust, omega = _blocks(one.force(found, speed, pitch)), _blocks(FULL_SPEED * found.omega)
    return np.concatenate([_over_noise(thrust), omega / doubt])


def _blocks(rows: np.ndarray) -> np.ndarray:
    return rows[: len(rows) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)


def _over_noise(thrust: np.ndarray) -> np.ndarray:
    n = len(thrust)
    rho = np.exp(-BLOCK * ROW / rig.MEMORY)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(n))
    power = rig.WHITE**2 / BLOCK + rig.SLOW**2 * (1.0 - rho**2) / np.abs(1.0 - rho * turn) ** 2
    white = np.fft.rfft(thrust) / np.sqrt(0.5 * n * power)
    white[0] /= np.sqrt(2.0)
    return np.concatenate([white.real, white.imag])
