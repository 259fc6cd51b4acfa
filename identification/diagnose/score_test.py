"""Score test for lack of fit: does the residual still depend on the commands, or on time?

The alternative is a linear combination of the regressors of command_shapes.py. An effect of slightly wrong form leaves a small
residual that is spread over the whole record. The pure-error test has little power against it; this test has more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.stats import f as f_distribution

from identification.diagnose.command_shapes import speed_shapes, thrust_shapes
from identification.diagnose.search.fits import Fit
from identification.fit.bands import ORDINATES, banded, starts
from identification.fit.experiment import CHANNELS, Experiment

TINY = 1e-3
"""Degrees of freedom that count as none."""

DEPENDENT = 0.05
"""Relative singular value below which columns count as collinear."""

DRAWS = 4000
"""Draws of the conditional Monte Carlo: the relative error of a p-value is then a few per cent."""


@dataclass(frozen=True)
class ScoreTest:
    """Log-likelihood `gain` of `count` regressors beside a fit, minus its expectation under noise, half a nat each.

    `bands`: for each frequency band (degrees of freedom of the regressors, degrees of freedom of the noise power).
    """

    gain: float
    count: int
    bands: tuple[tuple[float, float], ...]

    @cached_property
    def p(self) -> float:
        """p-value under noise alone. The statistic is a sum of F distributed terms, one a frequency band.

        A single F distribution has too light a tail: slow bands have most regressors, and the least accurate noise power.
        Computed by conditional Monte Carlo on the largest term (Asmussen and Kroese, Adv. Appl. Probab., 2006).
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


def score_test(fit: Fit) -> ScoreTest:
    """Score test of the thrust residual of a fit; directions that its parameters can follow are projected out."""
    parts, scale = channel_rows(fit, "thrust"), fit.problem.scale["thrust"]
    if not parts:
        return ScoreTest(0.0, 0, ())
    repeats = [e.differences() / scale if len(e.records) > 1 else None for e in fit.problem.experiments]
    return tested(fit.linearised(), shape_columns(fit, "thrust", parts), parts, repeats)


def tested(about: "Projected", columns: np.ndarray, parts: Sequence[slice], repeats: Sequence[np.ndarray | None]) -> ScoreTest:
    """Score test of columns (k, n), overwritten, beside a fit. `parts`: the rows of each experiment; `repeats`: samples (c,
    rows) of its noise; None: the residual has the noise."""
    at = slice(parts[0].start, parts[-1].stop)
    turned, score = orthonormal_scores(about, columns, at)
    if not len(score):
        return ScoreTest(0.0, 0, ())
    left, fitted, found = about.residual[at] - columns.T @ (turned.T @ score), about.directions(at), []
    for i, noise in zip(parts, repeats, strict=True):
        own = turned @ columns[:, i]
        found.append((own, left[None, i], np.vstack([own, fitted[:, i]])) if noise is None else (own, noise, own[:0]))
    covariance, bands = scores_covariance(found)
    return ScoreTest(0.5 * float(score @ np.linalg.solve(covariance, score) - len(score)), len(score), bands)


def predicted_rows(fit: Fit, e: Experiment) -> np.ndarray:
    return fit.problem.simulator.simulate(fit.values, *e.record.run)


def channel_rows(fit: Fit, channel: str) -> list[slice]:
    """Rows of the residual that belong to a channel, for each experiment; empty where it was not measured."""
    experiments = fit.problem.experiments
    sizes = [e.sizes.get(c, 0) for c in CHANNELS for e in experiments]
    ends = np.cumsum(sizes).tolist()
    first = CHANNELS.index(channel) * len(experiments)
    places = [slice(end - n, end) for end, n in zip(ends, sizes, strict=True)][first : first + len(experiments)]
    return places if places[-1].stop > places[0].start else []


def shape_columns(fit: Fit, channel: str, parts: Sequence[slice]) -> np.ndarray:
    """Whitened regressors (k, n) of a channel over all experiments."""
    first, found = parts[0].start, np.empty((0, 0))
    for e, at in zip(fit.problem.experiments, parts, strict=True):
        outputs = predicted_rows(fit, e)
        # Each shape is whitened before the next: unwhitened, all shapes of a long record would use most of the memory.
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


class Projected(Protocol):
    """Residual of a fit, and inner products of rows orthogonal to its sensitivities, as `Linearised`."""

    @property
    def residual(self) -> np.ndarray: ...

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray: ...

    def directions(self, at: slice) -> np.ndarray: ...


def orthonormal_scores(about: Projected, columns: np.ndarray, at: slice) -> tuple[np.ndarray, np.ndarray]:
    """(`turned` (m, k): turned @ columns are orthonormal directions orthogonal to all parameters; the residual's component (m,)
    in each). `columns` (k, n), of the rows `at`, are orthogonalised and normalised in place."""
    followed, whole = columns @ about.residual[at], np.einsum("kn,kn->k", columns, columns)
    gram = about.channel_orthogonal_gram(columns, at)
    informative = np.diag(gram) > np.finfo(float).eps * whole  # with a rotor at rest only rounding remains
    if not informative.any():
        return np.zeros((0, len(columns))), np.zeros(0)
    size = np.sqrt(np.where(informative, np.diag(gram), 1.0))
    columns /= size[:, None]
    columns[~informative] = 0.0
    power, directions = np.linalg.eigh(np.where(np.outer(informative, informative), gram, 0.0) / np.outer(size, size))
    kept = power > DEPENDENT**2 * power[-1]
    turned = (directions[:, kept] / np.sqrt(power[kept])).T
    return turned, turned @ (followed / size)  # a fitted residual is orthogonal to the parameters


def scores_covariance(
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, tuple[tuple[float, float], ...]]:
    """(covariance (k, k) of the products of directions with noise, the bands of a `ScoreTest`).

    `parts`: directions (k, n), orthonormal over all parts; samples (c, n) of the noise; orthonormal directions (m, n) that were
    fitted out of the samples. Whitening uses an estimated noise colour, so the whitened power is not exactly 1, least of all in
    slow bands. The power is therefore estimated from the samples, in bands of a third of an octave, corrected for the share of
    a band that was fitted out.
    """
    count = len(parts[0][0])
    covariance, shares, degrees = np.zeros((count, count)), [], []
    for directions, samples, gone in parts:
        n = samples.shape[1]
        spectrum, shapes = mean_powers(samples) / len(samples), np.fft.rfft(directions, axis=1)
        twice = np.full(len(spectrum), 2.0)  # ordinates of a real signal count twice, except the ends
        twice[0], twice[-1] = 1.0, 2.0 if n % 2 else 1.0
        taken = np.sum(np.abs(shapes) ** 2, axis=0) / n
        level, free = noise_levels(spectrum, mean_powers(gone))
        shapes *= np.sqrt(twice * level)  # in place: it is large
        covariance += (shapes @ shapes.conj().T).real / n
        first = starts(len(spectrum))
        shares.append(np.add.reduceat(twice * taken, first))
        degrees.append(len(samples) * np.add.reduceat(twice * free, first))
    return covariance, tuple(zip(np.concatenate(shares).tolist(), np.concatenate(degrees).tolist(), strict=True))


def mean_powers(rows: np.ndarray) -> np.ndarray:
    """(frequencies,) summed power of `rows` (m, n) at each ordinate; of orthonormal directions: the share that they span."""
    return np.sum(np.abs(np.fft.rfft(rows, axis=1)) ** 2, axis=0) / rows.shape[1]


def noise_levels(spectrum: np.ndarray, taken: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(power of the noise, remaining share), by band, of a residual from which the shares `taken` were fitted out."""
    free = np.maximum(1.0 - banded(taken), 1.0 / ORDINATES)
    return banded(spectrum) / free, free
