"""Whether what a set leaves still follows the commands, or time, in a way that no candidate has.

Forms that differ little (a play, a dead zone, a stop) leave little beside each other, spread over a whole record: too little to
show in the power of the repeatable error, and with the right form not among the candidates no further name takes it up. But any
hysteresis that does not depend on rate is a sum of plays (Prandtl and Ishlinskii; Brokate and Sprekels, Hysteresis and Phase
Transitions, 1996, chapter 2), and what a drive does late or not at all is a function of the way still to go. A few of each,
as they are and lagged, the decaying waves of loops that swing (Kautz, IRE Trans. Circuit Theory, 1954), a map's higher powers,
and a warming rig's trends span what such forms leave.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.signal import lfilter
from scipy.stats import f as f_distribution

from identification.assessment.reading_noise import SETTLED, last_thirds
from identification.diagnose.judgement import SLOW
from identification.diagnose.search.fits import Fit
from identification.fit.bands import ORDINATES, banded, starts
from identification.fit.coordinates import slowest
from identification.fit.experiment import CHANNELS, Experiment
from identification.fit.linearised import Linearised
from identification.fit.noise import blocks
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.record import Record

WIDTHS = (0.012, 0.03, 0.08, 0.2)
"""Half widths of plays and of bounds on the way still to go, as shares of the range that the output goes through."""

LAGS = (0.0, 0.1, 0.35)
"""Lags of the shapes, as shares of the time that the slower channel takes: about those of the actuators."""

WAVES = (0.25, 0.5, 1.0, 2.0)
"""Swings of decaying waves in the time that the slower channel takes: octaves about what a loop or a mount may swing with."""

DECAY = 0.35
"""Damping ratio of the waves: octaves meet where each has half its power."""

POWER = 4
"""Of polynomials over speed and pitch, for a map of another form at rest: one more than the map's own."""

FEWEST = 12
"""Degrees of freedom of what is left at rest, at least: fewer tell its power to worse than a factor of two."""

TINY = 1e-3
"""Degrees of freedom that are none."""

DEPENDENT = 0.05
"""Size of a direction, over that of the strongest, below which columns count as the same one."""


DRAWS = 4000
"""Of the sums over bands: a p-value is then known to a few per cent, whatever it is."""


@dataclass(frozen=True)
class Following:
    """Log-likelihood that `count` columns gain beside a fit, less the half each that noise alone would give them.

    `bands`: of the frequencies, (how many of the columns' degrees of freedom lie there, with how many the noise's power there
    is known).
    """

    gain: float
    count: int
    bands: tuple[tuple[float, float], ...]

    @cached_property
    def p(self) -> float:
        """p-value: how often noise alone would give as much: a score test, a sum over bands of F distributed terms.

        Slow bands hold most of the columns and tell least of the noise: one F with their mean degrees of freedom has too light
        a tail. Conditional Monte Carlo, from the term that is largest (Asmussen and Kroese, Adv. Appl. Probab., 2006).
        """
        if not self.count:
            return 1.0
        statistic = 2.0 * self.gain + self.count
        own, known = np.array([band for band in self.bands if band[0] > TINY]).T
        terms = own * f_distribution.rvs(own, known, size=(DRAWS, len(own)), random_state=0)
        largest = np.sort(terms, axis=1)
        others = np.where(terms == largest[:, -1:], largest[:, -2:-1] if len(own) > 1 else 0.0, largest[:, -1:])
        least = np.maximum(others, statistic - (terms.sum(axis=1, keepdims=True) - terms))
        return float(min(f_distribution.sf(least / own, own, known).mean(axis=0).sum(), 1.0))


def following(fit: Fit) -> Following:
    """How far the thrust residual of a fit follows the commands still, beyond what its parameters could take up."""
    about, parts = fit.linearised(), _places(fit, "thrust")
    columns, at = _columns(fit, "thrust", parts), slice(parts[0].start, parts[-1].stop)
    turned, score = _scores(about, columns, at)
    if not len(score):
        return Following(0.0, 0, ())
    left, fitted, scale = about.residual[at] - columns.T @ (turned.T @ score), about.directions(at), fit.problem.scale["thrust"]

    def noise_of(e: Experiment, i: slice, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(samples of its noise, the directions in which they have none left)."""
        if len(e.records) > 1:
            return e.differences() / scale, directions[:0]
        return left[None, i], np.vstack([directions, fitted[:, i]])

    own = [turned @ columns[:, i] for i in parts]
    told = [noise_of(e, i, d) for e, i, d in zip(fit.problem.experiments, parts, own, strict=True)]
    covariance, bands = scores_covariance([(d, *noise) for d, noise in zip(own, told, strict=True)])
    return Following(0.5 * float(score @ np.linalg.solve(covariance, score) - len(score)), len(score), bands)


def speed_share(fit: Fit) -> float:
    """Share of the speed residual's power, 1 at most, that is no noise; 0 where no speed was measured.

    It follows the commands still, beyond what the fit's parameters could take up (adjusted for the number of shapes, Ezekiel,
    1930). Or, where the fit's effects claim to know what was missing, rest has it not (`moving_share`).

    It is no test: a tachometer's errors go with the speed's rate, for a pulse may fall anywhere between two rows, so that they
    are neither of one size nor of one colour, and repeat in part.
    """
    parts = _places(fit, "omega")
    if not parts:
        return 0.0
    return max(_followed_share(fit, parts), moving_share(fit, "omega")[0] if fit.effects else 0.0)


def _followed_share(fit: Fit, parts: Sequence[slice]) -> float:
    about, at = fit.linearised(), slice(parts[0].start, parts[-1].stop)
    _, score = _scores(about, _columns(fit, "omega", parts), at)
    whole, rows = float(np.sum(about.residual[at] ** 2)), at.stop - at.start
    if not len(score) or rows <= len(score) or whole == 0.0:
        return 0.0
    left = (1.0 - float(score @ score) / whole) * rows / (rows - len(score))
    return min(max(1.0 - left, 0.0), 1.0)


def moving_share(fit: Fit, channel: str) -> tuple[float, float]:
    """(share of a residual's power that rest has not, what it is, rms) of "thrust" below 10 Hz [N], or of "omega" in units of
    its uncertainty, which grows with the speed's rate.

    What is beyond the scatter of the last thirds of holds about their own means, and beyond what the sensor leaves uncertain at
    best. Where no repeat has told the noise, what is missing may have lent it its colour, and whitening hides it then. (0, 0)
    where one has, and where too few holds are long enough to tell.
    """
    whole, count, scatter, free, least = 0.0, 0, 0.0, 0, 0.0
    for e in fit.problem.experiments:
        if e.noise.verified:
            return 0.0, 0.0
        at_rest = last_thirds(e.record, SETTLED * slowest(fit.values, fit.values))  # of all: they have the same commands
        for times, all_left, best in _unwhitened(e, _outputs(fit, e), channel):
            kept = np.isfinite(all_left)
            left, time, least = all_left[kept], times[kept], max(least, best**2)
            whole, count = whole + float(left @ left), count + len(left)
            for part in (left[(time >= start) & (time < end)] for start, end in at_rest):
                if len(part) > 1:
                    scatter, free = scatter + float(np.sum((part - part.mean()) ** 2)), free + len(part) - 1
    if free < FEWEST or whole == 0.0:
        return 0.0, 0.0
    beyond_rest = max(whole / count - max(scatter / free, least), 0.0)
    return beyond_rest / (whole / count), float(np.sqrt(beyond_rest))


def _unwhitened(e: Experiment, outputs: np.ndarray, channel: str) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """(times [s], residual, its least standard deviation that a sensor leaves) of each record's reading."""
    if channel == "omega":
        for sensor in e.tachometers:
            yield e.record.time[sensor.rows], (sensor.shows(outputs[:, 1]) - sensor.measured) / sensor.std, 1.0
        return
    slow, shown = blocks(e.record, 0.5 / SLOW), e.converter.reads(outputs[:, 0])
    for one in e.records:
        yield slow.time, slow.mean(shown - one.record["thrust"]), e.converter.count / np.sqrt(12.0)


def speed_size(fit: Fit, share: float) -> tuple[float, float]:
    """(N, rms below 10 Hz: what such a share of the speed's error is worth as thrust, by the map's slope at rest; rpm, rms of
    that share)."""
    power, count, own, readings = 0.0, 0, 0.0, 0
    for e in fit.problem.experiments:
        outputs = _outputs(fit, e)
        _, to_speed = _slopes(fit.values, outputs[:, 1], outputs[:, 2])
        for sensor in e.tachometers:
            error = sensor.shows(outputs[:, 1]) - sensor.measured
            own, readings = own + float(error @ error), readings + len(error)
            wrong = np.interp(e.record.time, e.record.time[sensor.rows], error)
            worth = e.slow_thrust(to_speed * wrong)
            power, count = power + float(worth @ worth), count + len(worth)
    return float(np.sqrt(share * power / max(count, 1))), float(np.sqrt(share * own / max(readings, 1)))


def _outputs(fit: Fit, e: Experiment) -> np.ndarray:
    return fit.problem.simulator.simulate(fit.values, *e.record.run)


def _places(fit: Fit, channel: str) -> list[slice]:
    """Where a channel of each experiment stands in the residual; none where nothing was measured of it."""
    experiments = fit.problem.experiments
    sizes = [e.sizes.get(c, 0) for c in CHANNELS for e in experiments]
    ends = np.cumsum(sizes).tolist()
    first = CHANNELS.index(channel) * len(experiments)
    places = [slice(end - n, end) for end, n in zip(ends, sizes, strict=True)][first : first + len(experiments)]
    return places if places[-1].stop > places[0].start else []


def _columns(fit: Fit, channel: str, parts: Sequence[slice]) -> np.ndarray:
    """(k, n) what the shapes would do to the whitened residual of a channel in all experiments."""
    first, found = parts[0].start, np.empty((0, 0))
    for e, at in zip(fit.problem.experiments, parts, strict=True):
        outputs = _outputs(fit, e)
        # One after the other: side by side and unwhitened the shapes of a long record would be the largest thing in memory.
        if channel == "thrust":
            own = [e.thrust_columns(shape) for shape in thrust_shapes(fit.values, e.record, outputs)]
        else:
            own = [e.omega_columns(shape) for shape in speed_shapes(fit.values, e.record, outputs)]
        if not len(found):
            found = np.empty((len(own), parts[-1].stop - first))
        while own:
            found[len(own) - 1, at.start - first : at.stop - first] = own.pop()
    found /= fit.problem.scale[channel]
    return found


def _scores(about: Linearised, columns: np.ndarray, at: slice) -> tuple[np.ndarray, np.ndarray]:
    """(`turned` (m, k): turned @ columns are orthonormal directions that no parameter can follow; the residual's share (m,) in
    each). `columns` (k, n), of the rows `at`, are made apart from the parameters, and of one length, in place."""
    followed, whole = columns @ about.residual[at], np.einsum("kn,kn->k", columns, columns)
    gram = about.channel_apart(columns, at)
    told = np.diag(gram) > np.finfo(float).eps * whole  # of a rotor that stands, nothing but rounding
    if not told.any():
        return np.zeros((0, len(columns))), np.zeros(0)
    size = np.sqrt(np.where(told, np.diag(gram), 1.0))
    columns /= size[:, None]
    columns[~told] = 0.0
    power, directions = np.linalg.eigh(np.where(np.outer(told, told), gram, 0.0) / np.outer(size, size))
    kept = power > DEPENDENT**2 * power[-1]
    turned = (directions[:, kept] / np.sqrt(power[kept])).T
    return turned, turned @ (followed / size)  # what the parameters follow has no share in the residual


def scores_covariance(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, tuple[tuple[float, float], ...]]:
    """(covariance (k, k) of the products of directions with noise, the bands as of a `Following`).

    `parts`: directions (k, n), rows orthonormal over all parts, samples (c, n) of the noise, and the directions (m, n),
    orthonormal, in which nothing is left of those. Noise has been whitened by a colour that was estimated from it, of a record
    or of a few, and its power is not 1 where the colour fits badly, or where there was little to tell it, and slow noise most
    of all: it is taken from the samples, in bands of a third of an octave, for the share of a band that can be left.
    """
    count = len(parts[0][0])
    covariance, shares, degrees = np.zeros((count, count)), [], []
    for directions, samples, gone in parts:
        n = samples.shape[1]
        spectrum, shapes = _powers(samples) / len(samples), np.fft.rfft(directions, axis=1)
        twice = np.full(len(spectrum), 2.0)  # ordinates of a real signal but for the ends
        twice[0], twice[-1] = 1.0, 2.0 if n % 2 else 1.0
        taken = np.sum(np.abs(shapes) ** 2, axis=0) / n
        level, free = _levels(spectrum, _powers(gone))
        shapes *= np.sqrt(twice * level)  # in place: it is large
        covariance += (shapes @ shapes.conj().T).real / n
        first = starts(len(spectrum))
        shares.append(np.add.reduceat(twice * taken, first))
        degrees.append(len(samples) * np.add.reduceat(twice * free, first))
    return covariance, tuple(zip(np.concatenate(shares).tolist(), np.concatenate(degrees).tolist(), strict=True))


def _powers(rows: np.ndarray) -> np.ndarray:
    """(frequencies,) power of `rows` (m, n) at each ordinate: of orthonormal directions, the share that they hold."""
    return np.sum(np.abs(np.fft.rfft(rows, axis=1)) ** 2, axis=0) / rows.shape[1]


def _levels(spectrum: np.ndarray, taken: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(power of the noise, the share of it that could be left), by band, of what is left after shares were `taken` of it."""
    free = np.maximum(1.0 - banded(taken), 1.0 / ORDINATES)
    return banded(spectrum) / free, free


def falls_in_bands(fits: Sequence[Fit], channel: str) -> tuple[np.ndarray, np.ndarray]:
    """(`falls` (fits - 1, bands), `level` (bands,)): by how much half of a channel's sum of squares falls from each fit to the
    next, in bands of a third of an octave of each record; and the power that whitened noise has in a band, over the power it
    was taken for.

    A repeat verifies the noise: the level is then 1. The colour of a single record's noise is estimated from that record. Noise
    that wanders more slowly than any past of the filter exceeds it, and would pass for a drift. Then the level is what the last
    fit leaves in the band, and 1 at least.
    """
    last = fits[-1].problem
    residuals = [f.problem.residual_at(f.values) * (f.problem.scale[channel] / last.scale[channel]) for f in fits]
    known = channel != "thrust" or all(e.noise.verified for e in last.experiments)
    about = None if known else fits[-1].linearised()
    parts = [
        banded_falls([rows[b.at] for rows in residuals], about and about.directions(b.at))
        for b in last.blocks
        if b.channel == channel
    ]
    falls, levels = zip(*parts, strict=True)
    return np.hstack(falls), np.concatenate(levels)


def banded_falls(rows: Sequence[np.ndarray], fitted: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The same of whitened rows (n,) of one record. `fitted` (m, n): orthonormal directions that the last fit has taken out of
    the last rows; None: the noise's power is known."""
    powers = [_powers(each[None]) for each in rows]
    first = starts(len(powers[0]))
    falls = np.array([np.add.reduceat(old - new, first) for old, new in pairwise(powers)])
    level = np.ones(len(first)) if fitted is None else np.maximum(_levels(powers[-1], _powers(fitted))[0][first], 1.0)
    return falls, level


def thrust_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Each (rows,) N: what a change of pitch or of speed in these forms would do to the thrust, maps of another form at rest,
    and trends in time.

    `outputs` (rows, 3): thrust, speed and pitch of a model at `values`.
    """
    thrust, speed, pitch = outputs.T
    to_pitch, to_speed = _slopes(values, speed, pitch)
    step, takes = float(np.median(record.steps)), slowest(values, values)
    lags = [share * takes for share in LAGS]
    for slope, u, output in ((to_pitch, "beta", pitch), (to_speed, "omega", speed)):
        for shape in _shapes(record[f"{u}_ref"], output, step):
            yield from (slope * _lagged(shape, lag, step) for lag in lags)
        yield from (slope * wave for wave in _waves(record[f"{u}_ref"], output, step, takes))
    over_speed, over_pitch = _polynomials(speed), _polynomials(pitch)
    yield from (over_speed[i] * over_pitch[j] for i in range(POWER + 1) for j in range(POWER + 1 - i) if i + j)
    since = record.time / record.time[-1]
    yield from (since, since**2, since * thrust)


def _slopes(values: Mapping[str, float], speed: np.ndarray, pitch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N/deg, N/rpm) of the map at rest at speeds and pitches, each (rows,)."""
    base = SimpleNamespace(**{n: v for n, v in values.items() if "." not in n})
    w, b = speed / base.omega_scale, (pitch + base.beta_offset) / base.beta_scale
    tiny = 1e-30  # by complex step: exact
    to_pitch, to_speed = (
        normalised_thrust(base, w + tiny * 1j * (1 - of_b), b + tiny * 1j * of_b).imag / tiny for of_b in (1, 0)
    )
    return base.thrust_scale / base.beta_scale * to_pitch, base.thrust_scale / base.omega_scale * to_speed


def speed_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Each (rows,) rpm: the same for the speed: its own forms, what pitch and its rate do to it, levels and trends."""
    _, speed, pitch = outputs.T
    step, takes = float(np.median(record.steps)), slowest(values, values)
    rate, since = np.gradient(pitch, step), record.time / record.time[-1]
    for shape in (*_shapes(record["omega_ref"], speed, step), rate, np.abs(rate)):
        yield from (_lagged(shape, share * takes, step) for share in LAGS)
    yield from _waves(record["omega_ref"], speed, step, takes)
    yield from (np.ones(len(speed)), speed, speed**2, pitch, pitch * speed, np.maximum(speed, np.quantile(speed, 0.8)))
    yield from (since, since**2, since * speed)


def beyond(
    shapes: Callable[[], Iterator[np.ndarray]],
    mean: Callable[[np.ndarray], np.ndarray],
    residual: np.ndarray,
    others: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(what of a residual (rows,) shapes, each (rows,), do not take up, NaN where it was not measured; directions (n, k),
    orthonormal, in which shapes and `others` (n, m), which have been fitted before, leave nothing).

    Their shares are fitted to what `mean` makes of rows: block means (n,), in which a long record's shapes are small.
    """
    target = mean(residual)
    seen = np.isfinite(target)
    columns = np.stack([mean(shape)[seen] for shape in shapes()], axis=1)
    size = _lengths(columns)
    shares, *_ = np.linalg.lstsq(columns / size, target[seen], rcond=1e-6)
    left = residual - sum(share * shape for share, shape in zip(shares / size, shapes(), strict=True))
    gone = np.zeros((len(target), columns.shape[1] + others.shape[1] + 1))
    gone[seen] = np.hstack([columns / size, others[seen] / _lengths(others[seen]), np.ones((len(columns), 1))])
    turned, power, _ = np.linalg.svd(gone, full_matrices=False)
    return left, turned[:, power > 1e-6 * power[0]]


def _lengths(columns: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(columns, axis=0)
    return np.where(size > 0.0, size, 1.0)


def _shapes(command: np.ndarray, output: np.ndarray, step: float) -> list[np.ndarray]:
    """The forms (rows,) of one channel."""
    rate, to_go = np.gradient(output, step), command - output
    widths = [share * np.ptp(output) for share in WIDTHS]
    bounded, plays = [np.clip(to_go, -w, w) for w in widths], [output - _play(output, w) for w in widths[:-1]]
    return [*bounded, *plays, rate, np.abs(rate)]


def _waves(command: np.ndarray, output: np.ndarray, step: float, takes: float) -> Iterator[np.ndarray]:
    """Waves (rows,) that a command excites, one by one as far as they are from the output, and their rates: none at rest."""
    for swings in WAVES:
        turn = 2.0 * np.pi * swings * step / takes
        kept = np.exp(-DECAY * turn)
        sway = 2.0 * kept * np.cos(np.sqrt(1.0 - DECAY**2) * turn)
        wave = command[0] + lfilter([0.0, 1.0 - sway + kept**2], [1.0, -sway, kept**2], command - command[0])
        yield wave - output
        yield np.gradient(wave) / turn


def _polynomials(signal: np.ndarray) -> np.ndarray:
    """(POWER + 1, rows) Legendre polynomials over the range of a signal (rows,)."""
    middle, half = 0.5 * (signal.max() + signal.min()), 0.5 * np.ptp(signal)
    return legvander((signal - middle) / half if half > 0.0 else np.zeros(len(signal)), POWER).T


def _play(signal: np.ndarray, width: float) -> np.ndarray:
    """What follows (rows,) a signal with play of `width` to each side."""
    lowest, highest = (signal - width).tolist(), (signal + width).tolist()
    at, followed = float(signal[0]), []
    for low, high in zip(lowest, highest, strict=True):  # conditions, not min and max: calls are most of the time
        at = low if at < low else high if at > high else at
        followed.append(at)
    return np.array(followed)


def _lagged(signal: np.ndarray, time_constant: float, step: float) -> np.ndarray:
    if time_constant == 0.0:
        return signal
    kept = np.exp(-step / time_constant)
    return lfilter([1.0 - kept], [1.0, -kept], signal, zi=[kept * signal[0]])[0]
