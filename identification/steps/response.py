"""Start values from step responses: every run is fitted, and the usable ones are averaged (paper, sections 3.2 and 4.2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.steps.outliers import reasons
from identification.steps.run import StepRun, fit_run, one_step
from vpp_fmu.record import Record

EVIDENCE = 10.0
"""Minimum BIC difference, summed over the runs of a channel, to include a delay."""


@dataclass(frozen=True)
class Average:
    """Weighted mean of the fits to `signal`, over the runs of a channel and direction ("up", "down", "both").

    The weight of a run is (gain / rms)^2, its inverse variance. `spread`: weighted standard deviation from run to run.
    `delayed`: whether the fits have a delay. `covariance` (2, 2) of the means (slow, fast): variance within runs, plus the
    excess variance between runs (random effects: DerSimonian and Laird, 1986). `apart`: whether any run identifies the two
    lags separately.
    """

    channel: str
    signal: str
    direction: str
    delayed: bool
    slow: float
    fast: float
    delay: float
    spread: Mapping[str, float]
    runs: int
    double_poles: int
    covariance: tuple[tuple[float, float], tuple[float, float]]
    apart: bool

    @property
    def std(self) -> dict[str, float | None]:
        """Standard deviations of the means and of their sum; None if only the sum is identifiable."""
        (slow, both), (_, fast) = self.covariance
        known = {"slow": float(np.sqrt(slow)), "fast": float(np.sqrt(fast))} if self.apart else {"slow": None, "fast": None}
        return known | {"sum": float(np.sqrt(max(slow + fast + 2.0 * both, 0.0)))}

    def summary(self) -> dict:
        """For identification.json."""
        names = ("channel", "signal", "direction", "delayed", "slow", "fast", "delay", "runs", "double_poles")
        return {name: getattr(self, name) for name in names} | {"spread": dict(self.spread), "std": self.std}


@dataclass(frozen=True, eq=False)
class StepSummary:
    """All runs, and their averages; `lags`: by channel, the average without delay, from which a model starts; `unreadable`:
    runs that are not a single step, by source, with the reason."""

    runs: tuple[StepRun, ...]
    averages: tuple[Average, ...]
    lags: Mapping[str, Average]
    unreadable: Mapping[str, str]

    @property
    def start(self) -> dict[str, float]:
        """Time constants by name of each channel that has a usable run."""
        return {name: value for u, a in self.lags.items() for name, value in zip(pair(u), (a.slow, a.fast), strict=True)}

    def used(self, channel: str) -> list[StepRun]:
        """Runs of a channel that are used."""
        return [run for run in self.runs if run.channel == channel and not run.reason]

    @property
    def outliers(self) -> tuple[StepRun, ...]:
        """Runs that are excluded."""
        return tuple(run for run in self.runs if run.reason)

    def delayed(self, channel: str) -> bool:
        """Whether the runs of a channel show a delay in the thrust."""
        return any(a.delayed for a in self.averages if a.channel == channel and a.signal == "thrust")

    def summary(self) -> dict:
        """The content of `steps` in identification.json."""
        return {
            "runs": [run.summary() for run in self.runs],
            "unreadable": dict(self.unreadable),
            "averages": [average.summary() for average in self.averages],
            "start": dict(self.start),
        }


def fit_steps(steps: Sequence[Record], scales: Mapping, coefficients: Mapping | None = None) -> StepSummary:
    """Fit every run and average the time constants, slow first.

    `scales`: the parameters of the normalisation, `coefficients`: the static map's, both by name. `lags` are without delay,
    because the model that starts from them has none. Those of the speed channel are from the measured speed, if there is one.
    """
    runs, unreadable = [], {}
    for record in steps:
        found = one_step(record)
        if isinstance(found, str):
            unreadable[record.source] = found
        else:
            runs.append(fit_run(record, *found, scales, coefficients))
    runs = [replace(run, reason=reason) for run, reason in zip(runs, reasons(runs), strict=True)]
    averages, lags = [], {}
    for channel in CHANNELS:
        for signal in ("thrust", "omega"):
            used = [run for run in runs if run.channel == channel and not run.reason and signal in run.fits]
            if used:
                delayed = sum(run.fits[signal].evidence for run in used) > EVIDENCE
                averages += _averages(used, channel, signal, delayed)
                lags[channel] = _average(used, channel, signal, "both", False)
    return StepSummary(tuple(runs), tuple(averages), lags, unreadable)


def pair(channel: str) -> tuple[str, str]:
    """Names of a channel's time constants."""
    return f"tau_{channel}_1", f"tau_{channel}_2"


def _averages(used: Sequence[StepRun], channel: str, signal: str, delayed: bool) -> list[Average]:
    parts = {way: [run for run in used if way in (run.direction, "both")] for way in ("up", "down", "both")}
    return [_average(part, channel, signal, way, delayed) for way, part in parts.items() if part]


def _average(used: Sequence[StepRun], channel: str, signal: str, direction: str, delayed: bool) -> Average:
    fits = [run.fits[signal].chosen(delayed) for run in used]
    weight = np.array([(fit.gain / fit.rms) ** 2 for fit in fits])
    values = np.array([(fit.slow, fit.fast, fit.delay) for fit in fits])
    mean = np.average(values, axis=0, weights=weight)
    spread = np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weight))
    return Average(
        *(channel, signal, direction, delayed),
        *mean.tolist(),
        spread=dict(zip(("slow", "fast", "delay"), spread.tolist(), strict=True)),
        runs=len(fits),
        double_poles=sum(fit.double_pole for fit in fits),
        covariance=covariance(values[:, :2], np.array([fit.covariance for fit in fits]), weight / weight.sum()),
        apart=any(fit.std["slow"] is not None for fit in fits),
    )


def covariance(values: np.ndarray, own: np.ndarray, share: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Covariance of the mean, weighted by `share` (runs,), of values (runs, 2) with covariances `own` (runs, 2, 2)."""
    expected = np.einsum("n,nij->ij", share * (1.0 - share), own)
    away = values - share @ values
    # Scatter beyond the expectation from the runs' own covariances is variance between runs.
    excess, axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", share, away, away) - expected)
    between = (axes * np.maximum(excess, 0.0)) @ axes.T / max(1.0 - share @ share, 1e-12)
    return tuple(map(tuple, (np.einsum("n,nij->ij", share**2, own) + (share @ share) * between).tolist()))
