"""Lack of fit: whether a model leaves more than noise, tested in two ways that need no name for what is missing.

Pure error: what two records of the same commands share beyond the model is the model's error, whatever the noise is. Their
cross-spectrum is summed in bands below 10 Hz; the sum's variance follows from their own periodograms. Score test: generic
shapes of the commands (`following`) must gain no more than chance. It counts as lack of fit if a test is certain and what is
left is larger than the least size of interest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from identification.diagnose.evidence.noise import blocks
from identification.diagnose.following import Following, following
from identification.diagnose.judgement import CERTAIN, SLOW
from identification.diagnose.search.fits import Fit
from vpp_fmu.native import Simulator

EDGES = (0.0, 0.1, 0.3, 1.0, 3.0, SLOW)
"""Hz: bands of half a decade."""

FEWEST = 12
"""Ordinates of a band, at least: their sum is then near enough to normal."""


@dataclass(frozen=True)
class Band:
    """Pure error in one band [Hz]: the repeatable `power` [N^2], its `error` by chance, and the p-value of none."""

    low: float
    high: float
    power: float
    error: float
    p: float


@dataclass(frozen=True)
class Lack:
    """What a fit leaves. `bands`: pure error, empty without a repeat; `score`: the test on generic shapes, with its `p`.

    `size` [N]: rms of what is left below 10 Hz, as the tests see it, 0 where they see nothing; `least`: the least size of interest.
    """

    bands: tuple[Band, ...]
    score: Following
    p: float
    size: float
    least: float

    @property
    def certain(self) -> bool:
        """Whether a test says that more than noise is left."""
        return self.p < CERTAIN

    @property
    def found(self) -> bool:
        """Whether something is lacking that is worth a name."""
        return self.certain and self.size > self.least

    def summary(self) -> dict:
        """For diagnosis.json."""
        return {
            "p": self.p,
            "size": {"value": self.size, "unit": "N"},
            "least_size": {"value": self.least, "unit": "N"},
            "score_test": {"p": self.score.p, "log_likelihood": self.score.gain, "shapes": self.score.count},
            "pure_error": [
                {"from": b.low, "to": b.high, "unit": "Hz", "power": b.power, "std": b.error, "p": b.p} for b in self.bands
            ],
        }


def lack_of_fit(fit: Fit, least: float) -> Lack:
    """Both tests on a fit. The smallest p-value counts, times the number of tests (Bonferroni)."""
    bands, score = pure_error(fit), following(fit)
    tests = [b.p for b in bands] + ([score.p] if score.count else [])
    p = min(1.0, len(tests) * min(tests, default=1.0))
    sizes = [np.sqrt(max(sum(b.power for b in bands), 0.0)) if bands else 0.0, _score_size(fit, score)]
    return Lack(bands, score, p, float(max(sizes)), least)


def _score_size(fit: Fit, score: Following) -> float:
    """N: what the generic shapes take up. A nat a slow sample is worth its noise's power; a second has 2 SLOW of them."""
    seconds = sum(float(e.record.time[-1]) - e.skip for e in fit.evidence.experiments)
    slow = max(e.noise.slow for e in fit.evidence.experiments)
    return float(np.sqrt(max(2.0 * score.gain, 0.0) / (2.0 * SLOW * seconds) * slow))


def pure_error(fit: Fit) -> tuple[Band, ...]:
    """Pure error of the thrust in bands, over all experiments with a repeat; of more than two records every pair counts."""
    simulator, found = Simulator(fit.evidence.model), {}
    for e in fit.evidence.experiments:
        if len(e.records) < 2:
            continue
        shown = simulator.simulate(fit.values, e.record.columns, e.record.steps)[:, 0]
        at = blocks(e.record, 0.5 / SLOW)
        kept = at.time >= e.skip
        errors = [_filled(at.mean(shown - r.record["thrust"])[kept]) for r in e.records]
        step = float(np.median(np.diff(at.time)))
        for first, second in _pairs(errors):
            products, powers = _cross(first, second)
            frequency = np.fft.rfftfreq(len(first), step)
            for low, high, inside in _bands(frequency):
                total = found.setdefault((low, high), [0.0, 0.0])
                total[0] += float(products[inside].sum())
                total[1] += float(powers[inside].sum())
    return tuple(
        Band(low, high, power, float(np.sqrt(variance)), float(norm.sf(power / np.sqrt(variance))) if variance > 0.0 else 1.0)
        for (low, high), (power, variance) in found.items()
    )


def _pairs(errors: Sequence[np.ndarray]):
    return [(errors[i], errors[k]) for i in range(len(errors)) for k in range(i)]


def _filled(means: np.ndarray) -> np.ndarray:
    """Blocks without a reading hold nothing."""
    return np.where(np.isfinite(means), means - np.nanmean(means), 0.0)


def _cross(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(power [N^2] that two residuals share, its variance where they share none), by frequency; they sum to the mean product."""
    one, other, n = np.fft.rfft(first), np.fft.rfft(second), len(first)
    twice = np.full(len(one), 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    products = twice * (one * other.conj()).real / n**2
    return products, (twice / n**2) ** 2 * np.abs(one) ** 2 * np.abs(other) ** 2 / np.where(twice == 1.0, 1.0, 2.0)


def _bands(frequency: np.ndarray):
    """(low, high, mask) of the bands, each joined with the next until it has FEWEST ordinates; the mean is the map's own."""
    found, low = [], EDGES[0]
    for high in EDGES[1:]:
        inside = (frequency >= low) & (frequency < high) & (frequency > 0.0)
        if inside.sum() >= FEWEST:
            found.append((low, high, inside))
            low = high
    return found
