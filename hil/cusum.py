"""Page's cumulative sum, two-sided, for independent normal numbers of variance 1; and how long it runs.

    S+ = max(0, S+ + z - reference),   S- = max(0, S- - z - reference),   alarm when one exceeds the threshold

Its mean run length L from S+ = 0 under the mean m follows from Page's integral equation (E. S. Page, Biometrika 41, 1954)

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
    """Mean number of z's until the upper sum, from 0, exceeds the threshold, while they have this mean; LONGEST at most."""
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


def threshold_for(run: float, reference: float, mean: float) -> float:
    """The threshold at which the two sums together alarm once in `run` z's, in the mean, if the z's mean is +-`mean`."""

    def lacking(threshold):
        upper, lower = run_length(threshold, reference, mean), run_length(threshold, reference, -mean)
        return -np.log((1.0 / upper + 1.0 / lower) * run)

    enough = 1.0
    while lacking(enough) < 0.0:
        enough *= 1.5
    return float(brentq(lacking, 1e-3, enough, xtol=1e-6))


class Cusum:
    """The two sums, and for each how many z's ago it last stood at 0: the likeliest beginning of what it then found."""

    def __init__(self, threshold: float, reference: float):
        self.threshold, self.reference = threshold, reference
        self.reset()

    def reset(self) -> None:
        """Both sums at 0."""
        self.upper = self.lower = 0.0
        self._upper_age = self._lower_age = 0

    def update(self, z: float) -> bool:
        """Whether one of the sums is above the threshold now."""
        self.upper, self._upper_age = _summed(self.upper + z - self.reference, self._upper_age)
        self.lower, self._lower_age = _summed(self.lower - z - self.reference, self._lower_age)
        return self.upper > self.threshold or self.lower > self.threshold

    @property
    def age(self) -> int:
        """z's since the larger sum left 0."""
        return self._upper_age if self.upper > self.lower else self._lower_age


def _summed(total: float, age: int) -> tuple[float, int]:
    return (total, age + 1) if total > 0.0 else (0.0, 0)
