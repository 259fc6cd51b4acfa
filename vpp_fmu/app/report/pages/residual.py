"""Report section: correlations, spectrum and transients of the residual, before and after the effects are added."""

import numpy as np

from identification.assessment.residual_tests import NORMAL_95, lagged_correlation
from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.locate import RATE, cross_spectrum
from identification.fit.noise import Noise, blocks
from vpp_fmu.app.report.figures.residual import correlations, residual_by_move, residual_spectrum
from vpp_fmu.app.report.page import Page
from vpp_fmu.digits import chance, number, signed
from vpp_fmu.record import Record

LAGS = 100
"""Maximum number of lags of RATE seconds; at most a quarter of the record."""

BINS = np.geomspace(0.1, 25.0, 25)
"""Edges of the frequency bins of a spectrum, Hz."""

TOGETHER, LONGEST, SHORTEST, FEWEST = 0.1, 1.5, 0.15, 8
"""Seconds between changes of a command that form one move; maximum and minimum seconds after a move that are averaged; minimum
number of moves for a figure."""

WORDS = {"omega_ref": ("speed", "rpm"), "beta_ref": ("pitch", "deg")}


def add_residual(page: Page, found: Diagnosis) -> None:
    """Add correlations, spectrum, and the residual after each move to a page."""
    _add_correlations(page, found)
    _add_spectrum(page, found)
    for name in WORDS:
        _add_moves(page, found, name)


def _records(found: Diagnosis) -> list[Record]:
    """The fitted records that have the commands of the first one."""
    return [one.record for one in found.base.problem.experiments[0].records]


def _residuals(found: Diagnosis, record: Record) -> dict[str, np.ndarray]:
    """Measured minus predicted thrust (rows,) N, by fit."""
    return {name: record["thrust"] - found.prediction(fit, record).thrust for name, fit in found.fits.items()}


def _add_correlations(page: Page, found: Diagnosis) -> None:
    record = _records(found)[0]
    at = blocks(record, RATE)
    count = max(1, min(LAGS, len(at.time) // 4))
    lags = np.arange(1, count + 1) * float(np.median(np.diff(at.time)))
    errors = {name: at.mean(error) for name, error in _residuals(found, record).items()}
    rows = {"itself": {name: lagged_correlation(e, e, count) for name, e in errors.items()}}
    for command, (word, _) in WORDS.items():
        level = at.mean(record[command])
        if np.ptp(level) > 0.0:
            rows[f"{word} command"] = {name: lagged_correlation(e, level, count) for name, e in errors.items()}
            rows[f"rate of {word} command"] = {
                name: lagged_correlation(e, np.gradient(level), count) for name, e in errors.items()
            }
    band = NORMAL_95 / np.sqrt(np.isfinite(next(iter(errors.values()))).sum())
    outside = {row: [100.0 * np.mean(np.abs(v) > band) for v in lines.values()] for row, lines in rows.items()}
    worst = max(outside, key=lambda row: outside[row][0])
    first, last = outside[worst][0], outside[worst][-1]
    now = f", after the effects at {last:.0f} %" if len(errors) > 1 else ""
    what = "itself" if worst == "itself" else f"the {worst}"
    title = f"The residual correlates with {what} at {first:.0f} % of the lags{now}; chance gives 5 %"
    caption = f"Correlation of the open-loop thrust residual with earlier values, means over {1000 * RATE:.0f} ms."
    page.figure(correlations(lags, rows, band, title), caption)


def _add_spectrum(page: Page, found: Diagnosis) -> None:
    record, repeat = _records(found)[0], next(iter(_records(found)[1:]), None)
    at = blocks(record, RATE)
    first = _residuals(found, record)
    second = _residuals(found, repeat) if repeat is not None else first
    power = {name: _binned(at.mean(first[name]), at.mean(second[name]), float(np.median(np.diff(at.time)))) for name in first}
    centres = np.sqrt(BINS[1:] * BINS[:-1])
    before, after = found.before, found.after
    now = f", after the effects {number(after.size, 2)} N (p {chance(after.p, '= ')})" if len(first) > 1 else ""
    title = f"Lack of fit below 10 Hz: {number(before.size, 2)} N rms (p {chance(before.p, '= ')}){now}"
    how = "Cross-spectrum of both records' residuals" if repeat is not None else "Spectrum of the residual, noise included"
    noise = _noise_density(found.noise, centres, float(np.median(np.diff(blocks(record, found.noise.block).time))))
    page.figure(residual_spectrum(centres, power, noise, title), f"{how}, averaged over bins; gaps: no positive power.")


def _binned(one: np.ndarray, other: np.ndarray, step: float) -> np.ndarray:
    """Real cross-spectral density (bins,) N^2/Hz of two errors (n,) N; NaN where it is not positive."""
    frequency, shared = cross_spectrum(one, other, step)
    inside = np.digitize(frequency, BINS) - 1
    means = [shared[inside == k].mean() if np.any(inside == k) else np.nan for k in range(len(BINS) - 1)]
    return np.where(np.array(means) > 0.0, means, np.nan)


def _noise_density(noise: Noise, frequency: np.ndarray, step: float) -> np.ndarray:
    """Power density [N^2/Hz] of the noise autoregression, on blocks of `step` s, at frequencies [Hz]."""
    colour = noise.colour
    turns = np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(colour.weights))) * step)
    return 2.0 * step * colour.innovation**2 / np.abs(turns @ colour.weights) ** 2


def _add_moves(page: Page, found: Diagnosis, command: str) -> None:
    records = _records(found)
    starts, sizes = moves(records[0].time, records[0][command])
    spans = _spans(records[0].time, starts)
    each = [_residuals(found, r) for r in records]
    means = {name: np.mean([_after(e[name], spans) for e in each], axis=0) for name in each[0]}
    kept = np.isfinite(next(iter(means.values())))
    if kept.sum() < FEWEST:
        return
    means = {name: values[kept] for name, values in means.items()}
    noise = None
    if len(each) > 1:
        one, other = (_after(next(iter(e.values())), spans)[kept] for e in each)
        noise = float(np.nanstd(0.5 * (one - other)))
    turned = np.append(False, sizes[1:] * sizes[:-1] < 0.0)[kept]
    word, unit = WORDS[command]
    title = _worst_moves(sizes[kept], means, word, unit)
    figure = residual_by_move(sizes[kept], turned, means, title, f"move of the {word} command [{unit}]", noise)
    page.figure(figure, f"Mean of measured minus predicted thrust up to {LONGEST:g} s after each move, or until the next.")


def moves(time: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first row, size) of each move of a command: changes of the same sign, at most TOGETHER s apart, form one."""
    change = np.diff(command)
    at = np.flatnonzero(change) + 1
    if not len(at):
        return at, np.array([])
    separate = (np.diff(time[at]) > TOGETHER) | (np.sign(change[at[1:] - 1]) != np.sign(change[at[:-1] - 1]))
    group = np.append(0, np.cumsum(separate))
    first = at[np.append(True, separate)]
    return first, np.bincount(group, change[at - 1])


def _spans(time: np.ndarray, starts: np.ndarray) -> list[tuple[int, int]]:
    """Rows from each move to the next, at most LONGEST s; empty if less than SHORTEST s."""
    ends = [*starts, len(time)][1:]
    reach = np.searchsorted(time, time[starts] + LONGEST)
    found = [(int(a), int(min(b, c))) for a, b, c in zip(starts, ends, reach, strict=True)]
    return [(a, b if time[b - 1] - time[a] >= SHORTEST else a) for a, b in found]


def _after(error: np.ndarray, spans: list[tuple[int, int]]) -> np.ndarray:
    return np.array([np.nanmean(error[a:b]) if b > a and np.isfinite(error[a:b]).any() else np.nan for a, b in spans])


def _worst_moves(size: np.ndarray, means, word: str, unit: str) -> str:
    """Title: the kind of move (small or large, up or down) with the largest mean residual before."""
    middle = float(np.median(np.abs(size)))
    kinds = {}
    for large, extent in ((False, f"less than {number(middle, 3)} {unit}"), (True, f"{number(middle, 3)} {unit} or more")):
        for sign, way in ((1.0, "up"), (-1.0, "down")):
            chosen = ((np.abs(size) >= middle) == large) & (np.sign(size) == sign)
            if chosen.any():
                kinds[f"{word} moves {way} of {extent}"] = [float(np.nanmean(values[chosen])) for values in means.values()]
    worst = max(kinds, key=lambda kind: abs(kinds[kind][0]))
    before, after = kinds[worst][0], kinds[worst][-1]
    now = f", after the effects {signed(after, 3)} N" if len(means) > 1 else ""
    return f"Mean thrust residual after {worst}: {signed(before, 3)} N{now}"
