"""Page's cumulative sum (CUSUM) for independent normal variables z of variance 1, and its average run length.

    S = max(0, S + z - reference),   alarm if it exceeds the threshold;   a second sum, of -z, makes the test two-sided

The average run length L(0) at the mean m follows from Page's integral equation (E. S. Page, Biometrika 41, 1954)

    L(s) = 1 + L(0) Phi(reference - m - s) + integral from 0 to threshold of L(x) phi(x - s + reference - m) dx

solved by Gauss-Legendre quadrature.
"""

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.special import ndtr

NODES = 80
"""Sufficient for thresholds up to 40: with twice as many the run length changes by less than 1e-6 of itself."""

LONGEST = 1e13
"""Largest run length; above it rounding errors dominate."""


def run_length(threshold: float, reference: float, mean: float) -> float:
    """Average number of z's of this mean until the sum exceeds the threshold, from 0; LONGEST at most."""
    x, weight = leggauss(NODES)
    x, weight = 0.5 * threshold * (x + 1.0), 0.5 * threshold * weight
    at = np.concatenate([[0.0], x])
    kernel = np.empty((NODES + 1, NODES + 1))
    kernel[:, 0] = ndtr(reference - mean - at)
    kernel[:, 1:] = weight * _density(x[None, :] - at[:, None] + reference - mean)
    try:
        length = float(np.linalg.solve(np.eye(NODES + 1) - kernel, np.ones(NODES + 1))[0])
    except np.linalg.LinAlgError:
        return LONGEST
    return length if 0.0 < length < LONGEST else LONGEST


def _density(z: np.ndarray) -> np.ndarray:
    """Density of the standard normal distribution. It is in scipy.stats, which takes a second to import."""
    return np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)


def threshold_for(run: float, reference: float, mean: float, two_sided: bool = True) -> float:
    """Threshold of the sum of z, and of that of -z if `two_sided`, for an average of one alarm in `run` z's of this mean."""

    def log_run_length(threshold):
        rate = 1.0 / run_length(threshold, reference, mean)
        if two_sided:
            rate += 1.0 / run_length(threshold, reference, -mean)
        return -np.log(rate * run)

    enough = 1.0
    while log_run_length(enough) < 0.0:
        enough *= 1.5
    return float(brentq(log_run_length, 1e-3, enough, xtol=1e-6))


class Cusum:
    """The sum, and the number of z's since it was last 0 (`age`): the likeliest time of a change."""

    def __init__(self, threshold: float, reference: float):
        self.threshold, self.reference = threshold, reference
        self.reset()

    def reset(self) -> None:
        """Set the sum to 0."""
        self.sum, self.age = 0.0, 0

    def update(self, z: float) -> bool:
        """Add z; whether the sum exceeds the threshold."""
        self.sum += z - self.reference
        if self.sum > 0.0:
            self.age += 1
        else:
            self.reset()
        return self.sum > self.threshold
