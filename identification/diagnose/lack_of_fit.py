"""Lack of fit: is the residual more than noise? Four checks, none of which needs a hypothesis about the missing effect.

1. Pure error: an analysis of variance of repeated records, in bands below 10 Hz. The repeatable part is an error of the model.
2. Score test (score_test.py) of the residual on regressors made of the commands and of time.
   Tests 1 and 2 report lack of fit if they reject at their level and the residual exceeds the minimum size of interest.
3. Structured residuals: more than MAJORITY of the speed residual's power follows the commands or is absent at rest; or, for a
   model with effects and without a repeat, MAJORITY of the thrust residual's power is absent at rest.
4. Rotor order: a line at the rotor frequency has a random phase, so it does not repeat. It counts if it has more than MAJORITY
   of the noise power, because every rig has some imbalance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import norm

from identification.assessment.reading_noise import SETTLED, last_thirds
from identification.diagnose.command_shapes import map_slopes
from identification.diagnose.judgement import ALPHA, ALPHA_BASE, FORM, MAJORITY, SLOW
from identification.diagnose.score_test import (
    ScoreTest,
    channel_rows,
    orthonormal_scores,
    predicted_rows,
    score_test,
    shape_columns,
)
from identification.diagnose.search.fits import Fit
from identification.fit.coordinates import slowest
from identification.fit.experiment import Experiment
from identification.fit.noise import blocks
from identification.fit.tachometer import Tachometer
from vpp_fmu.record import Record

EDGES = (0.0, 0.1, 0.3, 1.0, 3.0, SLOW)
"""Hz: bands of half a decade."""

FEWEST = 12
"""Minimum number of ordinates in a band."""


@dataclass(frozen=True)
class Band:
    """Pure error in one band [Hz]: repeatable `power` [N^2], its standard `error`, p-value of the hypothesis of none."""

    low: float
    high: float
    power: float
    error: float
    p: float


@dataclass(frozen=True)
class RotorOrderTest:
    """A line at the rotor frequency: its `size` [N] rms, and the p-value of none; 1 where the records do not identify it."""

    size: float
    p: float


NO_ROTOR_ORDER = RotorOrderTest(0.0, 1.0)
"""Result if the test was not run or is not possible."""


@dataclass(frozen=True)
class LackOfFit:
    """Result of the checks on one fit.

    `bands`: pure error, empty without a repeat. `score`: the score test; both without what the forms of effects may leave. `p`:
    p-value of both together. `size` [N]: rms of the significant residual below 10 Hz. `least` [N]: minimum size of interest.
    `has_effects`: whether the fit has effects, which determines the level. `speed`: structured share of the speed residual;
    `thrust_equivalent` [N]: its equivalent in thrust, 0 below MAJORITY; `speed_rpm`: its rms, compared with `least_speed`
    [rpm]. `moving`, `transient_size` [N]: share and rms of the thrust residual that is absent at rest. `turning`: the rotor
    order, compared with `most` [N] rms."""

    bands: tuple[Band, ...]
    score: ScoreTest
    p: float
    size: float
    least: float
    has_effects: bool
    speed: float = 0.0
    thrust_equivalent: float = 0.0
    speed_rpm: float = 0.0
    least_speed: float = 0.0
    moving: float = 0.0
    transient_size: float = 0.0
    turning: RotorOrderTest = NO_ROTOR_ORDER
    most: float = 0.0

    @property
    def level(self) -> float:
        """Significance level of the tests."""
        return ALPHA if self.has_effects else ALPHA_BASE

    @property
    def certain(self) -> bool:
        """Whether a test rejects at its level."""
        return self.p < self.level

    @property
    def missing(self) -> float:
        """What is missing, to compare fits of one stage: power that repeats, else what the score test finds; of the speed."""
        if self.bands:
            return max(sum(band.power for band in self.bands), 0.0)
        return max(self.score.gain, 0.0) if self.score.count else self.speed_rpm**2

    @property
    def significant(self) -> bool:
        """Whether any check finds lack of fit above the minimum size."""
        return (self.certain and self.size > self.least) or self.speed_lack_of_fit or self.transient_lack_of_fit

    @property
    def speed_lack_of_fit(self) -> bool:
        """Whether the speed residual is structured and above the minimum size."""
        return self.speed > MAJORITY and self.thrust_equivalent > self.least and self.speed_rpm > self.least_speed

    @property
    def only_speed(self) -> bool:
        """Whether the measured speed alone shows lack of fit."""
        return self.speed_lack_of_fit and not (self.certain and self.size > self.least) and not self.transient_lack_of_fit

    @property
    def transient_lack_of_fit(self) -> bool:
        """Whether most of the thrust residual appears only while commands move."""
        return self.has_effects and self.moving > MAJORITY and self.transient_size > self.least

    @property
    def turns(self) -> bool:
        """Whether most of the noise power is at the rotor frequency."""
        return self.turning.p < self.level and self.turning.size > self.most

    def summary(self) -> dict:
        """For diagnosis.json."""
        return {
            "p": self.p,
            "size": {"value": self.size, "unit": "N"},
            "least_size": {"value": self.least, "unit": "N"},
            "speed": {
                "share": self.speed,
                "least_share": MAJORITY,
                "size": {"value": self.thrust_equivalent, "unit": "N"},
                "structured": {"value": self.speed_rpm, "unit": "rpm"},
                "least_structured": {"value": self.least_speed, "unit": "rpm"} if np.isfinite(self.least_speed) else None,
            },
            "moving": {
                "share": self.moving,
                "least_share": MAJORITY,
                "size": {"value": self.transient_size, "unit": "N"},
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


def lack_of_fit(fit: Fit, least: float, least_speed: float = 0.0, base: Fit | None = None) -> LackOfFit:
    """Run the checks on a fit. The smallest p-value counts, corrected for the number of tests (Sidak, 1967). Of what effects
    explain beside a `base`, their forms leave the share FORM: it is no lack of fit."""
    bands, score = pure_error(fit, base), score_test(fit)
    if base is not None and fit.effects and score.count:
        explained = fit.score.gain_over(base.score)["thrust"]
        score = replace(score, gain=score.gain - FORM * max(explained, 0.0))
    tests = [b.p for b in bands] + ([score.p] if score.count else [])
    smallest = min(tests, default=1.0)
    p = -float(np.expm1(len(tests) * np.log1p(-smallest))) if smallest < 1.0 else 1.0
    sizes = [np.sqrt(max(sum(b.power for b in bands), 0.0)) if bands else 0.0, _score_size(fit, score)]
    share = structured_speed_share(fit)
    equivalent, rpm = thrust_equivalent(fit, share) if share > 0.0 else (0.0, 0.0)
    moving = transient_power_share(fit, "thrust")
    return LackOfFit(bands, score, p, float(max(sizes)), least, bool(fit.effects), share, equivalent, rpm, least_speed, *moving)


def with_rotor_order(lack: LackOfFit, fit: Fit) -> LackOfFit:
    """The same with the test of the rotor order."""
    if "thrust" not in fit.problem.experiments[0].channels:
        return lack
    floor = max(e.noise.floor for e in fit.problem.experiments)
    return replace(lack, turning=rotor_order_test(fit), most=float(np.sqrt(MAJORITY)) * floor)


def _score_size(fit: Fit, score: ScoreTest) -> float:
    """N: rms that the regressors explain. Half a nat is the noise power of one slow sample, of which a second has 2 SLOW."""
    seconds = sum(float(e.record.time[-1]) for e in fit.problem.experiments)
    slow = max(e.noise.slow for e in fit.problem.experiments)
    return float(np.sqrt(max(2.0 * score.gain, 0.0) / (2.0 * SLOW * seconds) * slow))


def pure_error(fit: Fit, base: Fit | None = None) -> tuple[Band, ...]:
    """Pure error of the thrust by band, over all experiments with a repeat, without the share FORM of what the fit explains
    beside a `base`."""
    found = _powers(fit)
    if base is not None and fit.effects:
        for key, before in _powers(base).items():
            found[key][[BETWEEN, FLAT]] -= FORM * np.maximum(before - found[key], 0.0)[[BETWEEN, FLAT]]
    return tuple(_band(low, high, count, *total) for (low, high, count), total in found.items())


BETWEEN, FLAT = 0, 2
"""Places of the power of the mean of records, and of the same with slow noise flattened, among the sums of a band."""


def _powers(fit: Fit) -> dict[tuple[float, float, int], np.ndarray]:
    """By (low, high, records) the sums of a band: power of the mean of records and about it, as measured, then both with slow
    noise flattened, and degrees of freedom of one record."""
    simulator, found = fit.problem.simulator, {}
    for e in fit.problem.experiments:
        if len(e.records) < 2 or "thrust" not in e.channels:
            continue
        shown = e.converter.reads(simulator.simulate(fit.values, *e.record.run)[:, 0])
        at = blocks(e.record, 0.5 / SLOW)
        errors = np.stack([_filled(at.mean(shown - r.record["thrust"])) for r in e.records])
        between, within = spectra(errors)
        step = float(np.median(np.diff(at.time)))
        # The test assumes a flat spectrum in a band: slow noise is flattened first.
        flat, level = spectra(e.noise.evened(errors.T, step).T)
        for low, high, inside in bands_of(np.fft.rfftfreq(errors.shape[1], step)):
            count = len(errors)
            total = found.setdefault((low, high, count), np.zeros(5))
            total += *(power[inside].sum() for power in (between, within, flat, level)), 2.0 * inside.sum()
    return found


def _band(
    low: float, high: float, count: int, between: float, within: float, flat: float, level: float, degrees: float
) -> Band:
    """From powers of the mean and about it, as measured and with slow noise flattened, and degrees of freedom of one record."""
    power, error = (between - within) / count, within * np.sqrt(2.0 / degrees + 2.0 / (degrees * (count - 1))) / count
    p = float(f_distribution.sf(flat / level, degrees, degrees * (count - 1))) if level > 0.0 else 1.0
    return Band(low, high, float(power), float(error), p)


def _filled(means: np.ndarray) -> np.ndarray:
    """Means minus their average; zero for blocks without a reading."""
    return np.where(np.isfinite(means), means - np.nanmean(means), 0.0)


def spectra(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(power of the mean of records times their number, power about the mean), each (frequencies,) N^2, of `errors` (records,
    n).

    An analysis of variance at each frequency. For noise alone both are independent estimates of its power, and sums over M
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


def bands_of(frequency: np.ndarray):
    """(low, high, mask) of bands without frequency 0, the map's, each joined with the next until it has FEWEST ordinates."""
    found, low = [], EDGES[0]
    for high in EDGES[1:]:
        inside = (frequency >= low) & (frequency < high) & (frequency > 0.0)
        if inside.sum() >= FEWEST:
            found.append((low, high, inside))
            low = high
    return found


FEWEST_AT_REST = 12
"""Minimum number of readings at rest: with fewer the 95 % interval of their power is wider than a factor of two."""


def structured_speed_share(fit: Fit) -> float:
    """Share of the speed residual's power that is structured, 0 to 1; 0 where no speed was measured.

    It is the adjusted coefficient of determination (Ezekiel, 1930) of a regression on shapes of the commands. For a fit with
    effects it is the share that is absent at rest (`transient_power_share`), if that is larger.

    It is not a significance test: the errors of a tachometer have no constant variance or spectrum, and repeat in part. They
    depend on the rate of the speed, because a pulse may occur anywhere between two rows.
    """
    parts = channel_rows(fit, "omega")
    if not parts:
        return 0.0
    return max(_followed_share(fit, parts), transient_power_share(fit, "omega")[0] if fit.effects else 0.0)


def _followed_share(fit: Fit, parts: Sequence[slice]) -> float:
    about, at = fit.linearised(), slice(parts[0].start, parts[-1].stop)
    _, score = orthonormal_scores(about, shape_columns(fit, "omega", parts), at)
    whole, rows = float(np.sum(about.residual[at] ** 2)), at.stop - at.start
    if not len(score) or rows <= len(score) or whole == 0.0:
        return 0.0
    left = (1.0 - float(score @ score) / whole) * rows / (rows - len(score))
    return min(max(1.0 - left, 0.0), 1.0)


def transient_power_share(fit: Fit, channel: str) -> tuple[float, float]:
    """(share of a residual's power that is absent during steady holds, its rms): "thrust" below 10 Hz [N], or "omega" in units
    of its uncertainty.

    The reference is the power in the last thirds of holds, and the resolution of the sensor. Noise slower than a hold is in it;
    a variance about each hold's mean would miss that. Without a repeat record the noise colour is estimated from the residual,
    and whitening may hide a missing effect: this check uses unwhitened residuals.
    (0, 0) with a repeat record, or if too few holds are long enough.
    """
    whole, count, scatter, free, least = 0.0, 0, 0.0, 0, 0.0
    for e in fit.problem.experiments:
        if e.noise.verified or channel not in e.channels:
            return 0.0, 0.0
        at_rest = last_thirds(e.record, SETTLED * slowest(fit.values, fit.values))  # the same for all records of the experiment
        for times, all_left, best in _unwhitened(e, predicted_rows(fit, e), channel):
            kept = np.isfinite(all_left)
            left, time, least = all_left[kept], times[kept], max(least, best**2)
            whole, count = whole + float(left @ left), count + len(left)
            for part in (left[(time >= start) & (time < end)] for start, end in at_rest):
                scatter, free = scatter + float(part @ part), free + len(part)
    if free < FEWEST_AT_REST or whole == 0.0:
        return 0.0, 0.0
    beyond_rest = max(whole / count - max(scatter / free, least), 0.0)
    return beyond_rest / (whole / count), float(np.sqrt(beyond_rest))


def _unwhitened(e: Experiment, outputs: np.ndarray, channel: str) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """(times [s], residual, standard deviation due to the sensor's resolution) of each record."""
    if channel == "omega":
        for sensor in e.tachometers:
            yield e.record.time[sensor.rows], (sensor.shows(outputs[:, 1]) - sensor.measured) / sensor.std, 1.0
        return
    slow, shown = blocks(e.record, 0.5 / SLOW), e.converter.reads(outputs[:, 0])
    for one in e.records:
        yield slow.time, slow.mean(shown - one.record["thrust"]), e.converter.count / np.sqrt(12.0)


def thrust_equivalent(fit: Fit, share: float) -> tuple[float, float]:
    """(N, rms below 10 Hz of the thrust that a `share` of the speed residual is equivalent to, by the slope of the static map;
    rpm, rms of that share)."""
    power, count, own, readings = 0.0, 0, 0.0, 0
    for e in fit.problem.experiments:
        outputs = predicted_rows(fit, e)
        _, to_speed = map_slopes(fit.values, outputs[:, 1], outputs[:, 2])
        for sensor in e.tachometers:
            error = sensor.shows(outputs[:, 1]) - sensor.measured
            own, readings = own + float(error @ error), readings + len(error)
            wrong = np.interp(e.record.time, e.record.time[sensor.rows], error)
            equivalent = e.slow_thrust(to_speed * wrong)
            power, count = power + float(equivalent @ equivalent), count + len(equivalent)
    return float(np.sqrt(share * power / max(count, 1))), float(np.sqrt(share * own / max(readings, 1)))


TURNS = 40
"""Revolutions of a window: orders are 1 / 40 apart, and an error of 1 % in speed stays within one order."""

BESIDE = np.array([-8, -7, -6, -5, -4, -3, 3, 4, 5, 6, 7, 8])
"""Neighbouring orders in steps of 1 / TURNS: near enough for a flat spectrum, far enough not to contain the line itself."""

VARIED = 0.05
"""Minimum relative standard deviation of the rotor frequency over the windows: else a hum may coincide with it."""


def rotor_order_test(fit: Fit) -> RotorOrderTest:
    """Test the residual of a fit for a line at the rotor frequency, over all windows of all records.

    The rank of the line's power among neighbouring orders is uniform under noise of any colour. A mains hum meets the rotor
    frequency in few windows. So the rank sum over windows tests for a line without assuming a noise model.
    """
    lines, ranks, speeds = [], [], []
    for e, outputs in zip(fit.problem.experiments, fit.problem.outputs(fit.values), strict=True):
        for one in e.records:
            residual = one.record["thrust"] - e.converter.reads(outputs[:, 0])
            for window, frequency in _windows(one.record, outputs[:, 1], residual):
                own, beside = window[0], window[1:]
                lines.append(own - beside.mean())
                ranks.append(float(np.sum(own > beside)) / len(beside))
                speeds.append(frequency)
    if len(ranks) < 2 or np.std(speeds) < VARIED * np.mean(speeds):
        return NO_ROTOR_ORDER
    count, places = len(ranks), len(BESIDE) + 1
    # Ranks 0 to n of n + 1 places, as shares of n: variance ((n + 1)^2 - 1) / 12 n^2.
    std = np.sqrt((places**2 - 1.0) / 12.0) / (places - 1) / np.sqrt(count)
    return RotorOrderTest(float(np.sqrt(max(2.0 * np.mean(lines), 0.0))), float(norm.sf((np.mean(ranks) - 0.5) / std)))


def _windows(record: Record, predicted: np.ndarray, residual: np.ndarray):
    """(power [N^2] of the residual's coefficients at order 1 and BESIDE it, the rotor's frequency [Hz]) of each window."""
    speed = _speed(record, predicted)
    turns = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 60.0 * record.steps))
    seen = np.isfinite(residual)
    number = (turns / TURNS).astype(int)
    edges = np.searchsorted(number, np.arange(number[-1] + 1))
    for first, last in pairwise(edges):
        rows = np.arange(first, last)[seen[first:last]]
        if len(rows) < 2 * (len(BESIDE) + 1):
            continue
        orders = 1.0 + np.append(0, BESIDE) / TURNS
        own = residual[rows] - residual[rows].mean()
        found = np.exp(-2.0j * np.pi * np.outer(orders, turns[rows])) @ own / len(rows)
        yield np.abs(found) ** 2, TURNS / float(record.time[last] - record.time[first])


def _speed(record: Record, predicted: np.ndarray) -> np.ndarray:
    """rpm (rows,): as measured between the instants at which it renewed, else as predicted."""
    if "omega" not in record:
        return predicted
    sensor = Tachometer(record)
    if len(sensor) < 2:
        return predicted
    off = sensor.measured - sensor.shows(predicted)
    return predicted + np.interp(record.time, record.time[sensor.rows], off)
