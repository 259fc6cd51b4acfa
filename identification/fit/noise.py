"""The colour of noise, and filters that whiten residuals.

Neighbouring readings share part of their noise. If they are taken as independent, any flexible candidate finds false evidence,
so residuals are whitened before a test. Rows are first averaged to blocks, much shorter than the rig's lags. An autoregressive
filter then removes the colour. Slow noise is correlated over many readings. So, after the first lags, the filter has means over
longer and longer spans of lags. The BIC selects their number (Corsi, 2009, for long memory by few terms). The power of flicker
noise (1/f) and of a random walk (1/f^2) increases towards zero frequency beyond any filter length. If records of the same
commands identify such noise, a gain in the frequency domain flattens it first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import dct, idct, next_fast_len

from identification.fit.ar_filter import ar_residuals
from identification.fit.converter import grid
from vpp_fmu.record import Record

BLOCKS_A_TIME = 30.0
"""Blocks in the rig's time scale: a lag of a tenth of it spans three."""

LAGS = (0, 1, 2, 4, 6)
PASTS = ((7, 12), (13, 24), (25, 48), (49, 96))
"""Candidate orders of the filter, and spans of longer lags whose means are added to the largest order, one after the other."""

RESTORED, ALIKE = 10, 0.002
"""Maximum number of iterations of the restricted likelihood, and the change of the innovation's logarithm that ends them."""

CORNERS = tuple((2.0 ** -np.arange(3, 15)).tolist())
POWERS, APART = (1, 2), 3
"""Corner frequencies [cycles a row] below which slow noise dominates (faster colour belongs to the lags), and its powers of the
inverse frequency: flicker noise and random walk. Every third corner is tried, then the neighbours of the best."""

LOST = 0.1
"""Maximum share of the rows that a filter may lose; it loses its length at each gap in a record."""


@dataclass(frozen=True)
class Blocks:
    """How a record's rows are averaged: `edges` (blocks + 1,) row numbers, `time` (blocks,) s of the blocks' centres."""

    edges: np.ndarray
    time: np.ndarray

    def part(self, rows: slice) -> "Blocks":
        """The whole blocks in a slice of rows that starts with a block; row numbers count from the slice's start."""
        first, end = np.searchsorted(self.edges, [rows.start, rows.stop + 1])
        return Blocks(self.edges[first:end] - rows.start, self.time[first : max(first, end - 1)])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Block means of (rows,) or (rows, k) without NaN rows; NaN for a block without values."""
        rows = int(self.edges[1] - self.edges[0])
        values = values[: self.edges[-1]]
        if rows == 1:
            return values
        # Slices of every rows-th row: ten times as fast as numpy's mean over a short axis.
        total = sum((values[k::rows] for k in range(1, rows)), values[::rows].copy())
        if np.isfinite(total).all():
            return total / rows
        values = values.reshape(-1, rows, *values.shape[1:])
        seen = np.isfinite(values)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(seen, values, 0.0).sum(axis=1) / seen.sum(axis=1)

    def spread(self, weights: np.ndarray, there: np.ndarray) -> np.ndarray:
        """The transpose of `mean`: (rows,) whose product with values equals that of `weights` (blocks,) with their means.
        `there` (rows,): whether a row has a value."""
        rows = int(self.edges[1] - self.edges[0])
        kept = there[: self.edges[-1]].reshape(-1, rows)
        found = np.zeros(len(there))
        found[: self.edges[-1]] = (kept * (weights / np.maximum(kept.sum(axis=1), 1))[:, None]).ravel()
        return found


def blocks(record: Record, length: float) -> Blocks:
    """Blocks of equal numbers of rows, about `length` seconds each; remaining rows at the end are omitted.

    If thrust is renewed more slowly, blocks are long enough for one reading each. 0: one row a block.
    """
    if length:
        renewed = record.time[np.isfinite(record["thrust"])] if "thrust" in record else record.time
        between = float(np.median(np.diff(renewed))) if len(renewed) > 1 else 0.0
        length = max(length, 1.5 * between) if between > 1.5 * record.period else length
    rows = max(1, round(length / record.period)) if length else 1
    edges = np.arange(0, len(record) - rows + 1, rows)
    edges = np.append(edges, edges[-1] + rows)
    time = record.time
    return Blocks(edges, 0.5 * (time[edges[:-1]] + time[np.minimum(edges[1:], len(time)) - 1]))


@dataclass(frozen=True)
class Colour:
    """A whitening filter: it subtracts from each value `shares` of the means over `spans` of lags (first, last).

    `innovation`: standard deviation of the filtered noise. `corner` [cycles a row], unless 0: noise with (corner /
    frequency)^`power` times the power of the other noise is flattened first.
    """

    spans: tuple[tuple[int, int], ...]
    shares: tuple[float, ...]
    innovation: float
    corner: float = 0.0
    power: int = 1

    @property
    def order(self) -> int:
        """The filter's longest lag, rows."""
        return max((last for _, last in self.spans), default=0)

    @property
    def is_white(self) -> bool:
        """Whether the filter only divides by the innovation."""
        return not self.order and not self.corner

    @property
    def weights(self) -> np.ndarray:
        """(order + 1,): the filter's impulse response; the first value is 1."""
        weights = np.zeros(self.order + 1)
        weights[0] = 1.0
        for (first, last), share in zip(self.spans, self.shares, strict=True):
            weights[first : last + 1] -= share / (last - first + 1)
        return weights

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Filter (rows,) or (rows, k): (rows - order, ...) in units of the innovation; NaN within a filter's length of a
        NaN."""
        order, n = self.order, len(values)
        if self.is_white:
            return values / self.innovation
        if n <= order:
            return values[:0] / self.innovation
        values = _flattened(values, self.corner, self.power)
        missing = ~np.isfinite(values)
        whole = not missing.any()
        known = values if whole else np.where(missing, 0.0, values)
        shares = [
            share / (last - first + 1) / self.innovation for (first, last), share in zip(self.spans, self.shares, strict=True)
        ]
        residuals = ar_residuals(known, self.spans, shares, self.innovation)
        if whole:
            return residuals
        gaps = np.concatenate([np.zeros_like(missing[:1], int), np.cumsum(missing, axis=0)])
        return np.where(gaps[order + 1 :] > gaps[: n - order], np.nan, residuals)


def _flattened(values: np.ndarray, corner: float, power: int) -> np.ndarray:
    """Values (rows,) or (rows, k) with the slow noise below a corner [cycles a row] flattened; NaN stay NaN."""
    missing = ~np.isfinite(values)
    if not corner or missing.all():
        return values
    if missing.any():
        columns, rows = values.reshape(len(values), -1).T, np.arange(len(values))
        there = [np.isfinite(column) for column in columns]
        known = np.array([np.interp(rows, rows[t], c[t]) if t.any() else c for c, t in zip(columns, there, strict=True)])
        return np.where(missing, np.nan, _flattened(known.T.reshape(values.shape), corner, power))
    gain = _flattening_gain(len(values), corner, power)
    return idct((dct(values, axis=0, norm="ortho").T * gain).T, axis=0, norm="ortho")


@lru_cache(maxsize=64)
def _flattening_gain(count: int, corner: float, power: int) -> np.ndarray:
    """(count,): gain that flattens slow noise, at each ordinate of a cosine transform."""
    return 1.0 / np.sqrt(_slow_noise_ratio(count, corner, power))


def _slow_noise_ratio(count: int, corner: float, power: int) -> np.ndarray:
    """(count,): ratio of the power with slow noise to that without, at each ordinate of a cosine transform. The first, the
    mean, is taken at half the frequency of the second."""
    frequency = 0.5 * np.arange(count) / count
    frequency[0] = 0.25 / count
    return 1.0 + (corner / frequency) ** power


def colour_of(parts: Sequence[np.ndarray], taken: np.ndarray | None = None) -> Colour:
    """The whitening filter of evenly spaced noise in `parts`, each (rows,), NaN if not known. The BIC selects it.

    `taken` (rows, k): orthonormal directions that a fit removed from the only part. A fit absorbs slow noise, so its residual
    has less slow power than the noise. The expectation of the removed part is therefore added until the filter converges
    (expectation and maximisation of the restricted likelihood; Patterson and Thompson, Biometrika, 1971).
    """
    if taken is not None and taken.size:
        return _restricted_likelihood(parts[0], taken)
    rows, tried = sum(map(np.size, parts)), {}

    def at(corner: float, power: int) -> float:
        """BIC of the filter after slow noise below a corner is flattened."""
        if (corner, power) not in tried:
            penalty = (
                sum(float(np.sum(np.log(_slow_noise_ratio(len(p), corner, power)))) for p in parts) + np.log(rows)
                if corner
                else 0.0
            )
            found, bic = _selected_by_bic([_flattened(p, corner, power) for p in parts])
            tried[corner, power] = replace(found, corner=corner, power=power), bic + penalty
        return tried[corner, power][1]

    for power in POWERS if np.isfinite(at(0.0, 1)) else ():
        here, best = None, min(range(1, len(CORNERS), APART), key=lambda k, power=power: at(CORNERS[k], power))
        while best != here:
            here = best
            near = range(max(here - 1, 0), min(here + 2, len(CORNERS)))
            best = min(near, key=lambda k, power=power: at(CORNERS[k], power))
    return min(tried.values(), key=lambda pair: pair[1])[0]


def _restricted_likelihood(part: np.ndarray, taken: np.ndarray) -> Colour:
    """The filter of the noise of a part and of the directions `taken` from it. No corner is searched: slow power in a single
    record may be model error, and flattening would hide it."""
    colour = Colour((), (), _spread([part], None))  # starts white: the residual's colour is too far from the noise's
    for _ in range(RESTORED):
        before = colour
        colour, _ = _selected_by_bic(*_expected_part(part, taken, before))
        if abs(np.log(colour.innovation / before.innovation)) < ALIKE and colour.spans == before.spans:
            break
    return colour


def _expected_part(part: np.ndarray, taken: np.ndarray, colour: Colour) -> tuple[list[np.ndarray], np.ndarray]:
    """([the part plus its expected value in the removed directions], autocovariance (lags, lags) of the error of that
    expectation)."""
    known = np.isfinite(part)
    columns = np.where(known[:, None], taken, 0.0)
    white, target = colour.whiten(columns), colour.whiten(part)
    seen = np.isfinite(target)
    covariance = np.linalg.pinv(white[seen].T @ white[seen], hermitian=True)
    found = part - columns @ (covariance @ (white[seen].T @ target[seen]))
    size, turned = np.linalg.eigh(covariance)
    return [found], _with_later(columns @ (turned * np.sqrt(np.maximum(size, 0.0))), _reach(_spans(LAGS[-1], PASTS)))


def _with_later(columns: np.ndarray, reach: int) -> np.ndarray:
    """(reach + 1, reach + 1): products of columns (rows, k) at lag i with the same at lag j, summed over columns and over the
    rows that have `reach` rows before them.

    Other rows are excluded: with a filter near a random walk the level is almost free, and the ends would add it.
    """
    rows = len(columns)
    size = next_fast_len(rows + reach, real=True)  # the circular correlation of padded columns is a linear one up to this lag
    spectrum = np.abs(np.fft.rfft(columns, size, axis=0)) ** 2
    found, lags = np.zeros((reach + 1, reach + 1)), np.arange(min(reach, rows - 1) + 1)
    first = columns[:reach] @ columns[:reach].T
    found[0, lags] = np.fft.irfft(spectrum.sum(axis=1), size)[lags] - [np.trace(first, -lag) for lag in lags]
    # Each further lag adds a row at the start and removes one at the end.
    last = columns[rows - reach :] @ columns[rows - reach :].T
    for i in range(reach if rows > 2 * reach else 0):
        entering, leaving = first[reach - 1 - i, : reach - i][::-1], last[reach - 1 - i, : reach - i][::-1]
        found[i + 1, i + 1 :] = found[i, i:reach] + entering - leaving
    return np.triu(found) + np.triu(found, 1).T


def _selected_by_bic(parts: Sequence[np.ndarray], more: np.ndarray | None = None) -> tuple[Colour, float]:
    """(the filter of least BIC, its BIC). `more` (lags, lags): autocovariance to add to that of the parts."""
    count = sum(map(np.size, parts))
    best, least = Colour((), (), _spread(parts, more)), np.inf
    options = [(n, ()) for n in LAGS] + [(LAGS[-1], PASTS[:k]) for k in range(1, len(PASTS) + 1)]
    whole = max(1, sum(int(np.isfinite(p).sum()) for p in parts))
    for lags, longer in reversed(options):
        spans = _spans(lags, longer)
        rows = [_lagged_means(p, spans) for p in parts if len(p) > _reach(spans)]
        table = np.concatenate([r[np.isfinite(r).all(axis=1)] for r in rows]) if rows else np.zeros((0, 1))
        if len(table) < max((1.0 - LOST) * whole, 20 * (len(spans) + 1)):
            continue
        # The first columns of the longest filter's triangle serve the shorter filters.
        triangle = np.linalg.qr(table, mode="r")
        if more is not None:
            triangle = np.linalg.qr(np.vstack([triangle, _root(_products(more, spans))]), mode="r")
        for shorter, fewer in options:
            taps = len(_spans(shorter, fewer))
            if taps > len(spans):
                continue
            shares, *_ = np.linalg.lstsq(triangle[:, 1 : taps + 1], triangle[:, 0], rcond=None)
            variance = float(np.sum((triangle[:, 0] - triangle[:, 1 : taps + 1] @ shares) ** 2)) / len(table)
            criterion = count * np.log(max(variance, 1e-300)) + taps * np.log(count)
            if criterion < least:
                best = Colour(tuple(spans[:taps]), tuple(shares.tolist()), float(np.sqrt(variance)) or 1.0)
                least = criterion
        break
    return best, least


def _spans(lags: int, longer: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    return [(k, k) for k in range(1, lags + 1)] + list(longer)


def _products(more: np.ndarray, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """(1 + spans, 1 + spans): products of the columns of `_lagged_means`, from the autocovariance `more` (lags, lags)."""
    means = np.zeros((len(spans) + 1, len(more)))
    means[0, 0] = 1.0
    for row, (first, last) in zip(means[1:], spans, strict=True):
        row[first : last + 1] = 1.0 / (last - first + 1)
    return means @ more @ means.T


def _root(products: np.ndarray) -> np.ndarray:
    """R such that R.T @ R is `products`."""
    size, turned = np.linalg.eigh(products)
    return (turned * np.sqrt(np.maximum(size, 0.0))).T


def _reach(spans: Sequence[tuple[int, int]]) -> int:
    return max((last for _, last in spans), default=0)


def _lagged_means(values: np.ndarray, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """(rows, 1 + spans): the values, and their means over each span of lags (first, last)."""
    reach, n = _reach(spans), len(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(values), values, 0.0))])
    missing = np.concatenate([[0], np.cumsum(~np.isfinite(values))])
    at = np.arange(reach, n)
    columns = [values[reach:]]
    for first, last in spans:
        mean = (sums[at - first + 1] - sums[at - last]) / (last - first + 1)
        columns.append(np.where(missing[at - first + 1] > missing[at - last], np.nan, mean))
    return np.column_stack(columns)


def _spread(parts: Sequence[np.ndarray], more: np.ndarray | None) -> float:
    seen = np.concatenate([np.asarray(p, float)[np.isfinite(p)] for p in parts]) if parts else np.zeros(0)
    added = 0.0 if more is None else float(more[0, 0])
    return (float(np.sqrt((np.sum(seen**2) + added) / len(seen))) if len(seen) else 0.0) or 1.0


@dataclass(frozen=True)
class Noise:
    """Noise of one record's readings. Thrust: standard deviation `floor` [N] of a reading, `colour` of block means [N], power
    `slow` [N^2] below 10 Hz. Speed: colour of the readings in units of the tachometer's standard deviation, `speed`.

    `block` [s]: length of a block. `verified`: colour and power are from repeated records; else from a model's residual, which
    may include model error."""

    floor: float
    colour: Colour
    slow: float
    speed: Colour
    block: float
    verified: bool

    def clearer_than(self, other: "Noise", channels: Sequence[str]) -> bool:
        """Whether its innovation in the first of the `channels` is smaller by more than the tolerance ALIKE of an estimate."""
        old, new = ((n.colour if channels[0] == "thrust" else n.speed).innovation for n in (other, self))
        return float(np.log(old / new)) > ALIKE

    def evened(self, values: np.ndarray, period: float) -> np.ndarray:
        """Thrust (rows,) or (rows, k), a row each `period` s, with its slow noise flattened."""
        return _flattened(values, self.colour.corner * period / self.block, self.colour.power) if self.colour.corner else values


def independent(thrust: float) -> Noise:
    """White noise of standard deviation `thrust` [N] in each row: the assumption of a fit that must be robust against model
    error. Its `floor` is infinite, so that no converter counts as coarse."""
    return Noise(np.inf, Colour((), (), thrust), thrust**2, Colour((), (), 1.0), 0.0, False)


def noise_from(
    record: Record,
    error: Sequence[np.ndarray],
    speed: Sequence[np.ndarray],
    block: float,
    slow: float,
    std: float,
    verified: bool,
    taken: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
) -> Noise:
    """Noise from samples of the thrust's noise, each (rows,) N, and of the speed's (readings,), in the tachometer's units.

    `slow` [Hz]: upper limit of slow noise. `std` [N]: of one thrust reading. `taken`: orthonormal directions, all slow, that a
    fit removed from the only sample: of the thrust's block means (blocks, k), and of the speed (readings, k).
    """
    means = [blocks(record, block).mean(e) for e in error]
    means = [m - np.nanmean(m) for m in means]
    below = np.concatenate([blocks(record, 0.5 / slow).mean(e - np.nanmean(e)) for e in error])
    removed = 0 if taken[0] is None else taken[0].shape[1]
    least = grid(record["thrust"])[0] / np.sqrt(12.0)  # rounding alone causes this much noise
    power = max(_power(below, removed), least**2)
    colour = colour_of(means, taken[0])
    colour = replace(colour, innovation=max(colour.innovation, least))
    speed_colour = colour_of([s - s.mean() for s in speed if len(s)], taken[1])
    return Noise(std, colour, power, speed_colour, block, verified)


def _power(values: np.ndarray, removed: int) -> float:
    """Mean square of values without NaN, corrected for `removed` degrees of freedom."""
    seen = values[np.isfinite(values)]
    return float(np.sum(seen**2)) / max(len(seen) - removed, 1)
