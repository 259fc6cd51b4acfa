"""Report section: spectrum and correlations of the residual, before and after the effects are added."""

import numpy as np

from identification.assessment.residual_tests import NORMAL_95, lagged_correlation
from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.locate import RATE, cross_spectrum
from identification.fit.noise import Noise, blocks
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import figure, panels
from vpp_fmu.app.report.page import Page
from vpp_fmu.digits import chance, number
from vpp_fmu.record import Record

LAGS = 100
"""Maximum number of lags of RATE seconds; at most a quarter of the record."""

BINS = np.geomspace(0.1, 25.0, 25)
"""Edges of the frequency bins of a spectrum, Hz."""

WORDS = {"omega_ref": "speed", "beta_ref": "pitch"}


def _records(found: Diagnosis) -> list[Record]:
    """The fitted records that have the commands of the first one."""
    return [one.record for one in found.base.problem.experiments[0].records]


def _residuals(found: Diagnosis, record: Record) -> dict[str, np.ndarray]:
    """Measured minus predicted thrust (rows,) N, by fit."""
    return {name: record["thrust"] - found.prediction(fit, record).thrust for name, fit in found.fits.items()}


def add_correlations(page: Page, found: Diagnosis) -> None:
    """Add the correlation of the residual with itself, the commands and their rates."""
    record = _records(found)[0]
    at = blocks(record, RATE)
    count = max(1, min(LAGS, len(at.time) // 4))
    lags = np.arange(1, count + 1) * float(np.median(np.diff(at.time)))
    errors = {name: at.mean(error) for name, error in _residuals(found, record).items()}
    rows = {"itself": {name: lagged_correlation(e, e, count) for name, e in errors.items()}}
    for command, word in WORDS.items():
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
    fig = panels(title, [f"{name} [-]" for name in rows], [110] * len(rows), "lag [s]")
    colours = style.colours(errors)
    for panel, lines in enumerate(rows.values()):
        for name, values in lines.items():
            fig.line(lags, values, name, colours[name], 1.6, panel)
        fig.band(panel, band, f"± {band:.2g}: no evidence")
    fig.axes["x"]["format"] = ".2f"
    page.figure(fig, f"Correlation of the open-loop thrust residual with earlier values, means over {1000 * RATE:.0f} ms.")


def add_spectrum(page: Page, found: Diagnosis) -> None:
    """Add the spectrum of the residual beside that of the noise."""
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
    fig = figure(title, 300, "frequency [Hz]", "power density [N²/Hz]")
    fig.line(centres, noise, "noise of one reading", style.MEASURED, 1.6, dash="dash")
    colours = style.colours(power)
    for name, values in power.items():
        fig.line(centres, values, name, colours[name], size=6)
    fig.axes["x"] |= {"kind": "log", "format": ".2f"}
    fig.axes["y0"] |= {"kind": "log", "format": ".2e"}
    page.figure(fig, f"{how}, averaged over bins; gaps: no positive power.")


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
