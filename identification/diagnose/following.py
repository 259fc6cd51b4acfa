"""Whether what a set leaves still follows the commands, or time, in a way that no candidate has.

Forms that differ little (a play, a dead zone, a stop) leave little beside each other, spread over a whole record: too little to
show in the power of the repeatable error, and with the right form not among the candidates no further name takes it up. But any
hysteresis that does not depend on rate is a sum of plays (Prandtl and Ishlinskii; Brokate and Sprekels, Hysteresis and Phase
Transitions, 1996, chapter 2), and what a drive does late or not at all is a function of the way still to go. A few of each,
as they are and lagged, a map's higher powers, and a warming rig's trends span what such forms leave.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from identification.diagnose.search.fits import Fit
from identification.fit.bands import ORDINATES, banded, starts
from identification.fit.coordinates import slowest
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.record import Record

WIDTHS = (0.012, 0.03, 0.08, 0.2)
"""Half widths of plays and of bounds on the way still to go, as shares of the range that the output goes through."""

LAGS = (0.0, 0.1, 0.35)
"""Lags of the shapes, as shares of the time that the slower channel takes: about those of the actuators."""

POWER = 4
"""Of polynomials over speed and pitch, for a map of another form at rest: one more than the map's own."""

DEPENDENT = 0.05
"""Size of a direction, over that of the strongest, below which columns count as the same one."""


@dataclass(frozen=True)
class Following:
    """Log-likelihood that `count` columns gain beside a fit, less the half each that noise alone would give them.

    `degrees`: of freedom with which the noise's power is known where the columns are; infinite where repeats tell it.
    """

    gain: float
    count: int
    degrees: float = np.inf

    @property
    def p(self) -> float:
        """p-value: how often noise alone would give as much (a score test: chi^2, or F where the noise is estimated)."""
        if not self.count:
            return 1.0
        statistic = 2.0 * self.gain + self.count
        if np.isinf(self.degrees):
            return float(chi2.sf(statistic, self.count))
        return float(f_distribution.sf(statistic / self.count, self.count, self.degrees))


def following(fit: Fit) -> Following:
    """How far the thrust residual of a fit follows the commands still, beyond what its parameters could take up."""
    about, (columns, parts) = fit.linearised(), _columns(fit)
    residual = about.residual[: columns.shape[1]]
    followed, whole = columns @ residual, np.einsum("kn,kn->k", columns, columns)
    gram = about.thrust_apart(columns)
    told = np.diag(gram) > np.finfo(float).eps * whole  # of a rotor that stands, nothing but rounding
    if not told.any():
        return Following(0.0, 0)
    size = np.sqrt(np.where(told, np.diag(gram), 1.0))
    columns /= size[:, None]
    columns[~told] = 0.0
    power, directions = np.linalg.eigh(np.where(np.outer(told, told), gram, 0.0) / np.outer(size, size))
    kept = power > DEPENDENT**2 * power[-1]
    turned = (directions[:, kept] / np.sqrt(power[kept])).T
    score = turned @ (followed / size)  # what the parameters follow has no share in the residual
    if all(e.noise.verified for e in fit.problem.experiments):
        return Following(0.5 * float(np.sum(score**2 - 1.0)), int(kept.sum()))
    left = residual - columns.T @ (turned.T @ score)
    fitted = about.thrust_directions(columns.shape[1])
    covariance, degrees = scores_covariance([(turned @ columns[:, at], left[at], fitted[:, at]) for at in parts])
    return Following(0.5 * float(score @ np.linalg.solve(covariance, score) - len(score)), int(kept.sum()), degrees)


def _columns(fit: Fit) -> tuple[np.ndarray, list[slice]]:
    """((k, n) what the shapes would do to the whitened thrust of all experiments, the columns of each experiment)."""
    experiments, simulator = fit.problem.experiments, fit.problem.simulator
    ends = np.cumsum([e.sizes["thrust"] for e in experiments]).tolist()
    parts, found = [slice(end - e.sizes["thrust"], end) for e, end in zip(experiments, ends, strict=True)], np.empty((0, 0))
    for e, at in zip(experiments, parts, strict=True):
        outputs = simulator.simulate(fit.values, e.record.columns, e.record.steps)
        # One after the other: side by side and unwhitened the shapes of a long record would be the largest thing in memory.
        own = [e.thrust_columns(shape) for shape in thrust_shapes(fit.values, e.record, outputs)]
        if not len(found):
            found = np.empty((len(own), ends[-1]))
        while own:
            found[len(own) - 1, at] = own.pop()
    found /= fit.problem.scale["thrust"]
    return found, parts


def scores_covariance(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, float]:
    """(covariance (k, k) of the products of directions with noise, degrees of freedom with which it is known).

    `parts`: directions (k, n), rows orthonormal over all parts, what they and a fit leave of the noise (n,), and the directions
    (m, n) that the fit had taken before. Where the noise has been whitened by a colour that was estimated from it, its power is
    not 1 where the colour fits badly, and slow noise most of all: it is taken from what is left, in bands of a third of an
    octave, for the share of a band that can be left.
    """
    count = len(parts[0][0])
    covariance, shares, degrees = np.zeros((count, count)), [], []
    for directions, left, fitted in parts:
        n = len(left)
        spectrum, shapes = np.abs(np.fft.rfft(left)) ** 2 / n, np.fft.rfft(directions, axis=1)
        twice = np.full(len(spectrum), 2.0)  # ordinates of a real signal but for the ends
        twice[0], twice[-1] = 1.0, 2.0 if n % 2 else 1.0
        taken = np.sum(np.abs(shapes) ** 2, axis=0) / n
        before = np.sum(np.abs(np.fft.rfft(fitted, axis=1)) ** 2, axis=0) / n
        free = np.maximum(1.0 - banded(taken + before), 1.0 / ORDINATES)
        level = banded(spectrum) / free
        shapes *= np.sqrt(twice * level)  # in place: it is large
        covariance += (shapes @ shapes.conj().T).real / n
        first = starts(len(spectrum))
        shares.append(np.add.reduceat(twice * taken, first))
        degrees.append(np.add.reduceat(twice * free, first))
    share, known = np.concatenate(shares), np.concatenate(degrees)
    return covariance, float(share.sum() ** 2 / np.sum(share**2 / known))  # Satterthwaite (1946)


def thrust_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Each (rows,) N: what a change of pitch or of speed in these forms would do to the thrust, maps of another form at rest,
    and trends in time.

    `outputs` (rows, 3): thrust, speed and pitch of a model at `values`.
    """
    thrust, speed, pitch = outputs.T
    base = SimpleNamespace(**{n: v for n, v in values.items() if "." not in n})
    w, b = speed / base.omega_scale, (pitch + base.beta_offset) / base.beta_scale
    tiny = 1e-30  # the map's slopes by complex step: exact
    to_pitch, to_speed = (
        normalised_thrust(base, w + tiny * 1j * (1 - of_b), b + tiny * 1j * of_b).imag / tiny for of_b in (1, 0)
    )
    step, takes = float(np.median(record.steps)), slowest(values, values)
    lags = [share * takes for share in LAGS]
    for slope, u, output in ((to_pitch, "beta", pitch), (to_speed, "omega", speed)):
        for shape in _shapes(record[f"{u}_ref"], output, step):
            yield from (slope * _lagged(shape, lag, step) for lag in lags)
    over_speed, over_pitch = _polynomials(speed), _polynomials(pitch)
    yield from (over_speed[i] * over_pitch[j] for i in range(POWER + 1) for j in range(POWER + 1 - i) if i + j)
    since = record.time / record.time[-1]
    yield from (since, since**2, since * thrust)


def speed_shapes(values: Mapping[str, float], record: Record, outputs: np.ndarray) -> Iterator[np.ndarray]:
    """Each (rows,) rpm: the same for the speed: its own forms, what pitch and its rate do to it, levels and trends."""
    _, speed, pitch = outputs.T
    step, takes = float(np.median(record.steps)), slowest(values, values)
    rate, since = np.gradient(pitch, step), record.time / record.time[-1]
    for shape in (*_shapes(record["omega_ref"], speed, step), rate, np.abs(rate)):
        yield from (_lagged(shape, share * takes, step) for share in LAGS)
    yield from (np.ones(len(speed)), speed, speed**2, pitch, pitch * speed, np.maximum(speed, np.quantile(speed, 0.8)), since)


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
