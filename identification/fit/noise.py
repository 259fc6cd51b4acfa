"""The colour of noise: what a model can't be blamed for.

Neighbouring readings share part of their noise. Taken as independent they count too often, and any flexible candidate then
finds "evidence"; so residuals are whitened before they are judged. Rows are averaged to blocks first, far shorter than
anything the rig's actuators do, and an autoregressive filter takes out the rest of the colour. Noise that wanders (1/f) is
remembered for longer than a few readings: beyond the first lags the filter has means over ever longer pasts, as many as
the BIC finds worth their price (Corsi, 2009, for long memory by few terms). Flicker noise (1/f) and a random walk (1/f^2) rise
towards rest beyond any past that a record affords: where records of the same commands tell them, they are evened out first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import dct, idct

from identification.fit.ar_filter import ar_residuals
from identification.fit.converter import grid
from vpp_fmu.record import Record

BLOCKS_A_TIME = 30.0
"""Blocks in the rig's time scale: a lag of a tenth of it still spans three."""

LAGS = (0, 1, 2, 4, 6)
PASTS = ((7, 12), (13, 24), (25, 48), (49, 96))
"""Orders of the filter that are tried, and the longer pasts, one after the other, whose means join the longest of them."""

RESTORED, ALIKE = 10, 0.002
"""Rounds in which what a fit took out is put back, at most, and the change of the innovation's logarithm that ends them."""

CORNERS = tuple((2.0 ** -np.arange(3, 15)).tolist())
POWERS, APART = (1, 2), 3
"""Cycles a row below which noise that rises towards rest is more than the rest (what is faster is the lags'), and powers of the
frequency with which it does: of flicker noise and of a random walk. Every third corner is tried, then those beside the best."""

LOST = 0.1
"""Share of the rows that a filter's memory may cost: each gap in a record costs it once."""


@dataclass(frozen=True)
class Blocks:
    """How a record's rows are averaged: `edges` (blocks + 1,) row numbers, `time` (blocks,) s of the blocks' middles."""

    edges: np.ndarray
    time: np.ndarray

    def part(self, rows: slice) -> "Blocks":
        """The whole blocks in a slice of the rows, which starts with one; their rows counted from there."""
        inside = (self.edges >= rows.start) & (self.edges <= rows.stop)
        return Blocks(self.edges[inside] - rows.start, self.time[inside[:-1] & inside[1:]])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Block means of (rows,) or (rows, k), rows that are NaN left out; NaN where a block has none."""
        rows = int(self.edges[1] - self.edges[0])
        values = values[: self.edges[-1]]
        # Slices of every rows-th row: numpy's mean over a short axis takes ten times as long.
        total = sum((values[k::rows] for k in range(1, rows)), values[::rows].copy())
        if np.isfinite(total).all():
            return total / rows
        values = values.reshape(-1, rows, *values.shape[1:])
        seen = np.isfinite(values)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(seen, values, 0.0).sum(axis=1) / seen.sum(axis=1)

    def spread(self, weights: np.ndarray, there: np.ndarray) -> np.ndarray:
        """The transpose of `mean`: (rows,) whose product with values is that of `weights` (blocks,) with their means. `there`
        (rows,): whether a row has a value."""
        rows = int(self.edges[1] - self.edges[0])
        kept = there[: self.edges[-1]].reshape(-1, rows)
        found = np.zeros(len(there))
        found[: self.edges[-1]] = (kept * (weights / np.maximum(kept.sum(axis=1), 1))[:, None]).ravel()
        return found


def blocks(record: Record, length: float) -> Blocks:
    """Blocks of equal numbers of rows, about `length` seconds each; a rest at the end is left out.

    Where thrust renews more slowly than that, blocks are long enough to hold a reading each. 0: the rows as they are.
    """
    renewed = record.time[np.isfinite(record["thrust"])] if "thrust" in record else record.time
    between = float(np.median(np.diff(renewed))) if len(renewed) > 1 else 0.0
    if length and between > 1.5 * record.period:
        length = max(length, 1.5 * between)
    rows = max(1, round(length / record.period))
    edges = np.arange(0, len(record) - rows + 1, rows)
    edges = np.append(edges, edges[-1] + rows)
    time = record.time
    return Blocks(edges, 0.5 * (time[edges[:-1]] + time[np.minimum(edges[1:], len(time)) - 1]))


@dataclass(frozen=True)
class Colour:
    """A whitening filter: from each value, `shares` of the means over `spans` of lags (first, last) before it are taken off.

    `innovation`: standard deviation of what it leaves. Where there is a `corner` [cycles a row], noise of the power (corner /
    frequency)^`power` of the rest's is evened out first.
    """

    spans: tuple[tuple[int, int], ...]
    shares: tuple[float, ...]
    innovation: float
    corner: float = 0.0
    power: int = 1

    @property
    def order(self) -> int:
        """Rows that the filter looks back."""
        return max((last for _, last in self.spans), default=0)

    @property
    def weights(self) -> np.ndarray:
        """(order + 1,) the filter's impulse response; the first is 1."""
        weights = np.zeros(self.order + 1)
        weights[0] = 1.0
        for (first, last), share in zip(self.spans, self.shares, strict=True):
            weights[first : last + 1] -= share / (last - first + 1)
        return weights

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Filter (rows,) or (rows, k): (rows - order, ...) in units of the innovation; NaN spreads over the filter's length."""
        order, n = self.order, len(values)
        if n <= order:
            return values[:0] / self.innovation
        values = _evened(values, self.corner, self.power)
        missing = ~np.isfinite(values)
        whole = not missing.any()
        known = values if whole else np.where(missing, 0.0, values)
        shares = [
            share / (last - first + 1) / self.innovation for (first, last), share in zip(self.spans, self.shares, strict=True)
        ]
        left = ar_residuals(known, self.spans, shares, self.innovation)
        if whole:
            return left
        gone = np.concatenate([np.zeros_like(missing[:1], int), np.cumsum(missing, axis=0)])
        return np.where(gone[order + 1 :] > gone[: n - order], np.nan, left)


def _evened(values: np.ndarray, corner: float, power: int) -> np.ndarray:
    """(rows,) or (rows, k) as they would be without noise that rises below a corner [cycles a row]; NaN stay."""
    missing = ~np.isfinite(values)
    if not corner or missing.all():
        return values
    if missing.any():
        columns, rows = values.reshape(len(values), -1).T, np.arange(len(values))
        there = [np.isfinite(column) for column in columns]
        known = np.array([np.interp(rows, rows[t], c[t]) if t.any() else c for c, t in zip(columns, there, strict=True)])
        return np.where(missing, np.nan, _evened(known.T.reshape(values.shape), corner, power))
    gain = _evening(len(values), corner, power)
    return idct((dct(values, axis=0, norm="ortho").T * gain).T, axis=0, norm="ortho")


@lru_cache(maxsize=64)
def _evening(count: int, corner: float, power: int) -> np.ndarray:
    """(count,) what evens out noise that rises, ordinate by ordinate of a cosine transform."""
    return 1.0 / np.sqrt(_rise(count, corner, power))


def _rise(count: int, corner: float, power: int) -> np.ndarray:
    """(count,) power with noise that rises over that without, at each ordinate of a cosine transform. The first, the mean,
    counts as half way to the second."""
    frequency = 0.5 * np.arange(count) / count
    frequency[0] = 0.25 / count
    return 1.0 + (corner / frequency) ** power


def colour_of(parts: Sequence[np.ndarray], taken: np.ndarray | None = None) -> Colour:
    """The filter for evenly spaced noise in `parts`, each (rows,), NaN where it is not known; what it is by the BIC.

    `taken` (rows, k): directions that a fit has taken out of the only part, orthonormal. A residual lacks the noise that its
    fit took up, which is slow, and passes for bluer than the noise is: so what is gone is put back as it is to be expected,
    until both agree (expectation and maximisation of the restricted likelihood; Patterson and Thompson, Biometrika, 1971).
    """
    if taken is not None and taken.size:
        return _restricted(parts[0], taken)
    rows, tried = sum(map(np.size, parts)), {}

    def at(corner: float, power: int) -> float:
        """BIC of the filter for what is left of noise that rises below a corner."""
        if (corner, power) not in tried:
            price = sum(float(np.sum(np.log(_rise(len(p), corner, power)))) for p in parts) + np.log(rows) if corner else 0.0
            found, bic = _judged([_evened(p, corner, power) for p in parts])
            tried[corner, power] = replace(found, corner=corner, power=power), bic + price
        return tried[corner, power][1]

    for power in POWERS if np.isfinite(at(0.0, 1)) else ():
        here, best = None, min(range(1, len(CORNERS), APART), key=lambda k, power=power: at(CORNERS[k], power))
        while best != here:
            here = best
            near = range(max(here - 1, 0), min(here + 2, len(CORNERS)))
            best = min(near, key=lambda k, power=power: at(CORNERS[k], power))
    return min(tried.values(), key=lambda pair: pair[1])[0]


def _restricted(part: np.ndarray, taken: np.ndarray) -> Colour:
    """The filter of the noise that a part and directions `taken` out of it are of. No corner is looked for: what rises towards
    rest in a single record may be what the model lacks, and evened out it would hide."""
    colour = Colour((), (), _spread([part], None))  # not the residual's own: far from the noise's, it would not come back
    for _ in range(RESTORED):
        before = colour
        colour, _ = _judged(*_restored(part, taken, before))
        if abs(np.log(colour.innovation / before.innovation)) < ALIKE and colour.spans == before.spans:
            break
    return colour


def _restored(part: np.ndarray, taken: np.ndarray, colour: Colour) -> tuple[list[np.ndarray], np.ndarray]:
    """([the part with what its directions hold in all likelihood], products (lags, lags) of how uncertain that is with itself,
    so many rows later)."""
    known = np.isfinite(part)
    columns = np.where(known[:, None], taken, 0.0)
    white, target = colour.whiten(columns), colour.whiten(part)
    seen = np.isfinite(target)
    covariance = np.linalg.pinv(white[seen].T @ white[seen], hermitian=True)
    found = part - columns @ (covariance @ (white[seen].T @ target[seen]))
    size, turned = np.linalg.eigh(covariance)
    return [found], _with_later(columns @ (turned * np.sqrt(np.maximum(size, 0.0))), _reach(_spans(LAGS[-1], PASTS)))


def _with_later(columns: np.ndarray, reach: int) -> np.ndarray:
    """(reach + 1, reach + 1): products of columns (rows, k) i rows before with the same j rows before, summed over columns and
    over the rows that have `reach` before them.

    Over just these: a level that a filter near a random walk leaves all but open would enter by its ends.
    """
    rows = len(columns)
    spectrum = np.abs(np.fft.rfft(columns, 2 * rows, axis=0)) ** 2
    found, lags = np.zeros((reach + 1, reach + 1)), np.arange(min(reach, rows - 1) + 1)
    first = columns[:reach] @ columns[:reach].T
    found[0, lags] = np.fft.irfft(spectrum.sum(axis=1))[lags] - [np.trace(first, -lag) for lag in lags]
    last = columns[rows - reach :] @ columns[rows - reach :].T  # one row on, the rows before the first are in, the last are out
    for i in range(reach if rows > 2 * reach else 0):
        entering, leaving = first[reach - 1 - i, : reach - i][::-1], last[reach - 1 - i, : reach - i][::-1]
        found[i + 1, i + 1 :] = found[i, i:reach] + entering - leaving
    return np.triu(found) + np.triu(found, 1).T


def _judged(parts: Sequence[np.ndarray], more: np.ndarray | None = None) -> tuple[Colour, float]:
    """(the filter of the least BIC, that). `more` (lags, lags): products with later rows, to add to those of the parts."""
    count = sum(map(np.size, parts))
    best, least = Colour((), (), _spread(parts, more)), np.inf
    options = [(n, ()) for n in LAGS] + [(LAGS[-1], PASTS[:k]) for k in range(1, len(PASTS) + 1)]
    whole = max(1, sum(int(np.isfinite(p).sum()) for p in parts))
    for lags, pasts in reversed(options):
        spans = _spans(lags, pasts)
        rows = [_lagged(p, spans) for p in parts if len(p) > _reach(spans)]
        table = np.concatenate([r[np.isfinite(r).all(axis=1)] for r in rows]) if rows else np.zeros((0, 1))
        if len(table) < max((1.0 - LOST) * whole, 20 * (len(spans) + 1)):
            continue
        # One triangle holds the products of the longest filter's columns, of which the shorter ones have the first.
        triangle = np.linalg.qr(table, mode="r")
        if more is not None:
            triangle = np.linalg.qr(np.vstack([triangle, _root(_products(more, spans))]), mode="r")
        for shorter, fewer in options:
            taps = len(_spans(shorter, fewer))
            if taps > len(spans):
                continue
            shares, *_ = np.linalg.lstsq(triangle[:, 1 : taps + 1], triangle[:, 0], rcond=None)
            left = float(np.sum((triangle[:, 0] - triangle[:, 1 : taps + 1] @ shares) ** 2)) / len(table)
            criterion = count * np.log(max(left, 1e-300)) + taps * np.log(count)
            if criterion < least:
                best = Colour(tuple(spans[:taps]), tuple(shares.tolist()), float(np.sqrt(left)) or 1.0)
                least = criterion
        break
    return best, least


def _spans(lags: int, pasts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    return [(k, k) for k in range(1, lags + 1)] + list(pasts)


def _products(more: np.ndarray, spans: Sequence[tuple[int, int]]) -> np.ndarray:
    """(1 + spans, 1 + spans): products, summed over rows, of the columns of `_lagged` of what has the products `more` with rows
    later."""
    means = np.zeros((len(spans) + 1, len(more)))
    means[0, 0] = 1.0
    for row, (first, last) in zip(means[1:], spans, strict=True):
        row[first : last + 1] = 1.0 / (last - first + 1)
    return means @ more @ means.T


def _root(products: np.ndarray) -> np.ndarray:
    """R with R.T @ R the products."""
    size, turned = np.linalg.eigh(products)
    return (turned * np.sqrt(np.maximum(size, 0.0))).T


def _reach(spans: Sequence[tuple[int, int]]) -> int:
    return max((last for _, last in spans), default=0)


def _lagged(values: np.ndarray, spans: Sequence[tuple[int, int]]) -> np.ndarray:
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
    """Noise of one record's readings: the thrust's standard deviation `floor` [N] of a reading, the `colour` of its block means
    [N], and their power below 10 Hz, `slow` [N^2]; the colour of speed's readings, in units of what a tachometer can tell.

    `block` [s]: how long a block is. `verified`: colour and power are from repeated records; else from a model's residual,
    which may hold model error too."""

    floor: float
    colour: Colour
    slow: float
    speed: Colour
    block: float
    verified: bool

    def clearer_than(self, other: "Noise") -> bool:
        """Whether its thrust's innovations are less, by more than two estimates of one noise differ."""
        return float(np.log(other.colour.innovation / self.colour.innovation)) > ALIKE

    def evened(self, values: np.ndarray, period: float) -> np.ndarray:
        """Thrust (rows,) or (rows, k), a row each `period` s, as it would be if its noise did not rise towards rest."""
        return _evened(values, self.colour.corner * period / self.block, self.colour.power) if self.colour.corner else values


def independent(thrust: float) -> Noise:
    """Readings that are independent of each other, of a standard deviation `thrust` [N], row by row: what a fit supposes that
    must hold up where the model lacks something. Its floor is without end: no converter is too coarse beside it."""
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
    """From samples of thrust's noise, each (rows,) N on the record's rows, and of speed's (readings,) as the tachometer's
    residual.

    `slow` [Hz]: what is below it counts as slow. `std` [N]: of one thrust reading. `taken`: directions, orthonormal, that are
    gone from the only sample of thrust's block means (blocks, k), and of speed (readings, k): all of them slow.
    """
    means = [blocks(record, block).mean(e) for e in error]
    means = [m - np.nanmean(m) for m in means]
    below = np.concatenate([blocks(record, 0.5 / slow).mean(e - np.nanmean(e)) for e in error])
    gone = 0 if taken[0] is None else taken[0].shape[1]
    least = grid(record["thrust"])[0] / np.sqrt(12.0)  # what rounding leaves uncertain: noise is never less
    power = max(_power(below, gone), least**2)
    colour = colour_of(means, taken[0])
    colour = replace(colour, innovation=max(colour.innovation, least))
    heard = colour_of([s - s.mean() for s in speed if len(s)], taken[1])
    return Noise(std, colour, power, heard, block, verified)


def _power(values: np.ndarray, gone: int) -> float:
    """Mean square of values, NaN left out, from which `gone` degrees of freedom are gone."""
    seen = values[np.isfinite(values)]
    return float(np.sum(seen**2)) / max(len(seen) - gone, 1)
