"""Lack of fit: whether a model leaves more than noise, tested in four ways that need no name for what is missing.

Pure error: what records of the same commands share beyond the model is the model's error, whatever the noise is. Their
mean's power is held against that of their differences in bands below 10 Hz (analysis of variance). Score test: generic
shapes of the commands (`following`) must gain no more than chance. It counts as lack of fit if a test is certain and what is
left is larger than the least size of interest. A thrust may come out right of a wrong speed: where speed is measured, it counts
if more than HALF of what is left of it follows the commands, or is missing at rest, and what that is worth as thrust is larger
than the least size. So does what a model with effects leaves of the thrust without a repeat, if rest has not HALF of it.
And a line that turns with the rotor (`turning`) is no noise, though no repeat shares its phase: every rig has a little of it,
so it counts where it is more than HALF of what passes for noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_distribution

from identification.diagnose.following import Following, following, moving_share, speed_share, speed_size
from identification.diagnose.judgement import CERTAIN, HALF, LEVEL, SLOW
from identification.diagnose.search.fits import Fit
from identification.diagnose.turning import UNTURNED, Turning, turning
from identification.fit.noise import blocks

EDGES = (0.0, 0.1, 0.3, 1.0, 3.0, SLOW)
"""Hz: bands of half a decade."""

FEWEST = 12
"""Ordinates of a band, at least: a band with less says little."""


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
    """What a fit leaves. `bands`: pure error, empty without a repeat; `score`: the test on generic shapes; `p` of both.

    `size` [N]: rms of what is left below 10 Hz, as the tests see it, 0 where they see nothing; `least`: the least size of
    interest. `speed`: the share of what is left of the speed that is no noise (`following.speed_share`), and `speed_size` [N]
    what that is worth as thrust, 0 where it is less than HALF, `speed_rpm` its rms, which counts from `least_speed` [rpm] on.
    `level`: of the tests. `turning`: a line at once a revolution, which counts from `most` [N] rms on."""

    bands: tuple[Band, ...]
    score: Following
    p: float
    size: float
    least: float
    claims: bool
    speed: float = 0.0
    speed_size: float = 0.0
    speed_rpm: float = 0.0
    least_speed: float = 0.0
    moving: float = 0.0
    moving_size: float = 0.0
    turning: Turning = UNTURNED
    most: float = 0.0

    @property
    def level(self) -> float:
        """Of the tests."""
        return LEVEL if self.claims else CERTAIN

    @property
    def certain(self) -> bool:
        """Whether a test says that more than noise is left."""
        return self.p < self.level

    @property
    def found(self) -> bool:
        """Whether something is lacking that is worth a name."""
        return (self.certain and self.size > self.least) or self.lacks_speed or self.lacks_moving

    @property
    def lacks_speed(self) -> bool:
        """Whether it is the speed that something worth a name is lacking of."""
        return self.speed > HALF and self.speed_size > self.least and self.speed_rpm > self.least_speed

    @property
    def only_speed(self) -> bool:
        """Whether nothing but the measured speed says that something is missing."""
        return self.lacks_speed and not (self.certain and self.size > self.least) and not self.lacks_moving

    @property
    def lacks_moving(self) -> bool:
        """Whether most of what passes for noise of the thrust is missing at rest."""
        return self.claims and self.moving > HALF and self.moving_size > self.least

    @property
    def turns(self) -> bool:
        """Whether most of what passes for noise turns with the rotor."""
        return self.turning.p < self.level and self.turning.size > self.most

    def summary(self) -> dict:
        """For diagnosis.json."""
        return {
            "p": self.p,
            "size": {"value": self.size, "unit": "N"},
            "least_size": {"value": self.least, "unit": "N"},
            "speed": {
                "share": self.speed,
                "least_share": HALF,
                "size": {"value": self.speed_size, "unit": "N"},
                "structured": {"value": self.speed_rpm, "unit": "rpm"},
                "least_structured": {"value": self.least_speed, "unit": "rpm"} if np.isfinite(self.least_speed) else None,
            },
            "moving": {
                "share": self.moving,
                "least_share": HALF,
                "size": {"value": self.moving_size, "unit": "N"},
            },
            "turning": {
                "p": self.turning.p,
                "size": {"value": self.turning.size, "unit": "N"},
                "least_size": {"value": self.most, "unit": "N"},
            },
            "score_test": {"p": self.score.p, "log_likelihood": self.score.gain, "shapes": self.score.count},
            "pure_error": [
                {"from": b.low, "to": b.high, "unit": "Hz", "power": b.power, "std": b.error, "p": b.p} for b in self.bands
            ],
        }


def lack_of_fit(fit: Fit, least: float, least_speed: float = 0.0) -> Lack:
    """The tests on a fit, stricter with one that has effects: it claims to know what was missing. Of the p-values the smallest
    counts, for as many independent ones (Sidak, 1967)."""
    bands, score = pure_error(fit), following(fit)
    tests = [b.p for b in bands] + ([score.p] if score.count else [])
    smallest = min(tests, default=1.0)
    p = -float(np.expm1(len(tests) * np.log1p(-smallest))) if smallest < 1.0 else 1.0
    sizes = [np.sqrt(max(sum(b.power for b in bands), 0.0)) if bands else 0.0, _score_size(fit, score)]
    share = speed_share(fit)
    worth, rpm = speed_size(fit, share) if share > HALF else (0.0, 0.0)
    moving = moving_share(fit, "thrust")
    return Lack(bands, score, p, float(max(sizes)), least, bool(fit.effects), share, worth, rpm, least_speed, *moving)


def with_turning(lack: Lack, fit: Fit) -> Lack:
    """The same with the test for a line."""
    floor = max(e.noise.floor for e in fit.problem.experiments)
    return replace(lack, turning=turning(fit), most=float(np.sqrt(HALF)) * floor)


def _score_size(fit: Fit, score: Following) -> float:
    """N: what the generic shapes take up. A nat a slow sample is worth its noise's power; a second has 2 SLOW of them."""
    seconds = sum(float(np.ptp(e.thrust_time)) for e in fit.problem.experiments)
    slow = max(e.noise.slow for e in fit.problem.experiments)
    return float(np.sqrt(max(2.0 * score.gain, 0.0) / (2.0 * SLOW * seconds) * slow))


def pure_error(fit: Fit) -> tuple[Band, ...]:
    """Pure error of the thrust in bands, over all experiments with a repeat."""
    simulator, found = fit.problem.simulator, {}
    for e in fit.problem.experiments:
        if len(e.records) < 2:
            continue
        shown = e.converter.reads(simulator.simulate(fit.values, *e.record.run)[:, 0])
        at = blocks(e.record, 0.5 / SLOW)
        errors = np.stack([_filled(at.mean(shown - r.record["thrust"])) for r in e.records])
        between, within = spectra(errors)
        step = float(np.median(np.diff(at.time)))
        # The test takes noise in a band for flat, which it is once what rises towards rest is evened out.
        flat, level = spectra(e.noise.evened(errors.T, step).T)
        for low, high, inside in _bands(np.fft.rfftfreq(errors.shape[1], step)):
            count = len(errors)
            total = found.setdefault((low, high, count), np.zeros(5))
            total += *(power[inside].sum() for power in (between, within, flat, level)), 2.0 * inside.sum()
    return tuple(_band(low, high, count, *total) for (low, high, count), total in found.items())


def _band(
    low: float, high: float, count: int, between: float, within: float, flat: float, level: float, degrees: float
) -> Band:
    """From the powers of the mean and about it, as they are and evened, and the degrees of freedom of one record."""
    power, error = (between - within) / count, within * np.sqrt(2.0 / degrees + 2.0 / (degrees * (count - 1))) / count
    p = float(f_distribution.sf(flat / level, degrees, degrees * (count - 1))) if level > 0.0 else 1.0
    return Band(low, high, float(power), float(error), p)


def _filled(means: np.ndarray) -> np.ndarray:
    """Blocks without a reading hold nothing."""
    return np.where(np.isfinite(means), means - np.nanmean(means), 0.0)


def spectra(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(power of the mean of records times their number, power about the mean), each (frequencies,) N^2, of `errors` (records,
    n).

    The analysis of variance, frequency by frequency: of noise alone both are the noise's power, and independent; sums over M
    ordinates have a ratio with the distribution F(2 M, 2 M (records - 1)). Over all frequencies they sum to mean squares.
    """
    count, n = errors.shape
    x = np.fft.rfft(errors, axis=1)
    twice = np.full(x.shape[1], 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    mean = x.mean(axis=0)
    within = np.sum(np.abs(x - mean) ** 2, axis=0) / (count - 1)
    return twice * count * np.abs(mean) ** 2 / n**2, twice * within / n**2


def _bands(frequency: np.ndarray):
    """(low, high, mask) of the bands, each joined with the next until it has FEWEST ordinates; the mean is the map's own."""
    found, low = [], EDGES[0]
    for high in EDGES[1:]:
        inside = (frequency >= low) & (frequency < high) & (frequency > 0.0)
        if inside.sum() >= FEWEST:
            found.append((low, high, inside))
            low = high
    return found
