"""Outliers among step responses: unusable runs, and runs that differ from the others of their channel."""

from collections.abc import Sequence

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.steps.run import UNSETTLED, StepRun
from vpp_fmu.digits import number

NOISY = 0.2
"""Maximum ratio of the noise to the step."""

SEEN = 5.0
"""Minimum ratio of a step to its standard deviation."""

OTHER_GAIN = 0.25
"""Maximum difference of a run's ratio of step to map prediction from the median of its channel."""

FAR = 5.0
"""Robust standard deviations (1.4826 MAD) above the median at which a run is an outlier."""

FEWEST = 5
"""Minimum number of runs of a channel to detect outliers."""

CLEARLY = 1.25
"""Ratio of residual to noise above which a fit has model error: in 750 rows chance reaches 1.1."""

SLIGHT = 0.01
"""Ratio of residual to step up to which a run is never an outlier."""


def reasons(runs: Sequence[StepRun]) -> list[str]:
    """Reason to exclude each run, "" if it is used: first of each run alone, then compared with the others of its channel."""
    found = [run.reason or _unusable(run) for run in runs]
    for channel in CHANNELS:
        there = [k for k, run in enumerate(runs) if run.channel == channel and not found[k]]
        if len(there) < FEWEST:
            continue
        fits = [runs[k].fits["thrust"].delayed for k in there]
        noise = np.array([runs[k].noise for k in there])
        rms, gain = (np.array([getattr(fit, name) for fit in fits]) for name in ("rms", "gain"))
        relative = np.sqrt(np.maximum(rms**2 - noise**2, 0.0)) / np.abs(gain)
        for k in np.flatnonzero(_far_above(relative) & (relative > SLIGHT) & (rms > CLEARLY * noise)):
            found[there[k]] = f"the residual is {relative[k]:.1%} of the step, that of the others {np.median(relative):.1%}"
        share = gain / np.array([np.nan if runs[k].expected is None else runs[k].expected for k in there])
        if np.isfinite(share).any():
            difference = np.abs(share - np.nanmedian(share))
            for k in np.flatnonzero(_far_above(difference) & (difference > OTHER_GAIN)):
                change = f"thrust changes by {share[k]:.0%} of the map's step, that of the others by {np.nanmedian(share):.0%}"
                found[there[k]] = f"command not reached, or not passed on: {change}"
    return found


def _unusable(run: StepRun) -> str:
    """Reason to exclude a run alone; "" if it is used."""
    fit = run.fits["thrust"].plain
    size = abs(fit.gain)
    if size <= SEEN * fit.std["gain"]:
        return f"step too small: the thrust changes by {number(size, 2)} N, standard deviation {number(fit.std['gain'], 2)} N"
    if run.noise > NOISY * size:
        return f"noise is {run.noise / size:.0%} of the step"
    remaining = 1.0 - (fit.predicted[-1] - fit.offset) / fit.gain
    return f"not settled: {remaining:.0%} of the step remains at the end of the run" if abs(remaining) > UNSETTLED else ""


def _far_above(values: np.ndarray) -> np.ndarray:
    """(n,): whether a value is an outlier above the others; NaN is not."""
    middle = np.nanmedian(values)
    return values > middle + FAR * 1.4826 * np.nanmedian(np.abs(values - middle))
