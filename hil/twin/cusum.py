"""Page's cumulative sum for independent normal numbers of variance 1, and how long it runs.

    S = max(0, S + z - reference),   alarm when it exceeds the threshold;   a second one, of -z, makes the test two-sided

Its mean run length L from S = 0 under the mean m follows from Page's integral equation (E. S. Page, Biometrika 41, 1954)

    L(s) = 1 + L(0) Phi(reference - m - s) + integral from 0 to threshold of L(x) phi(x - s + reference - m) dx

solved here by Gauss-Legendre quadrature.
"""

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.stats import norm

NODES = 80
"""Enough for thresholds to 40: doubled, the run length moves by less than 1e-6 of itself."""

LONGEST = 1e13
"""Run lengths above it are lost in rounding, and as good as endless."""


def run_length(threshold: float, reference: float, mean: float) -> float:
    """Mean number of z's until the sum, from 0, exceeds the threshold, while they have this mean; LONGEST at most."""
    x, weight = leggauss(NODES)
    x, weight = 0.5 * threshold * (x + 1.0), 0.5 * threshold * weight
    at = np.concatenate([[0.0], x])
    kernel = np.empty((NODES + 1, NODES + 1))
    kernel[:, 0] = norm.cdf(reference - mean - at)
    kernel[:, 1:] = weight * norm.pdf(x[None, :] - at[:, None] + reference - mean)
    try:
        length = float(np.linalg.solve(np.eye(NODES + 1) - kernel, np.ones(NODES + 1))[0])
    except np.linalg.LinAlgError:
        return LONGEST
    return length if 0.0 < length < LONGEST else LONGEST


def threshold_for(run: float, reference: float, mean: float, two_sided: bool = True) -> float:
    """The threshold at which the sum of z, with that of -z if `two_sided`, alarms once in `run` z's of this mean."""

    def lacking(threshold):
        rate = 1.0 / run_length(threshold, reference, mean)
        if two_sided:
            rate += 1.0 / run_length(threshold, reference, -mean)
        return -np.log(rate * run)

    enough = 1.0
    while lacking(enough) < 0.0:
        enough *= 1.5
    return float(brentq(lacking, 1e-3, enough, xtol=1e-6))


class Cusum:
    """The sum, and how many z's ago it last stood at 0 (`age`): the likeliest beginning of what it then found."""

    def __init__(self, threshold: float, reference: float):
        self.threshold, self.reference = threshold, reference
        self.reset()

    def reset(self) -> None:
        """The sum at 0."""
        self.sum, self.age = 0.0, 0

    def update(self, z: float) -> bool:
        """Whether the sum is above the threshold now."""
        self.sum += z - self.reference
        if self.sum > 0.0:
            self.age += 1
        else:
            self.reset()
        return self.sum > self.threshold
