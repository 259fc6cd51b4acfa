"""Which step responses tell nothing of the lags: by themselves, or because they are unlike the others of their channel."""

from collections.abc import Sequence

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.steps.run import UNSETTLED, StepRun
from vpp_fmu.digits import number

NOISY = 0.2
"""Noise over step from which a run tells nothing that the others don't tell better."""

SEEN = 5.0
"""A step shows if it is this many times its standard deviation."""

OTHER_GAIN = 0.25
"""By how much a run's thrust may differ from what the map says of the step, against the others of its channel."""

FAR = 5.0
"""Robust standard deviations (1.4826 MAD) above the median from which a run is none of the others' kind."""

FEWEST = 5
"""Runs of a channel that are needed to tell one from the others."""

CLEARLY = 1.25
"""Residual over noise from which a fit misses something: in 750 rows chance gives 1.1."""

SLIGHT = 0.01
"""Share of a step that a fit may leave, whatever the others leave."""


def reasons(runs: Sequence[StepRun]) -> list[str]:
    """Why each run is left out, "" for those that are not: first by itself, then against the others of its channel."""
    found = [run.reason or _unfit(run) for run in runs]
    for channel in CHANNELS:
        there = [k for k, run in enumerate(runs) if run.channel == channel and not found[k]]
        if len(there) < FEWEST:
            continue
        fits = [runs[k].fits["thrust"].delayed for k in there]
        noise = np.array([runs[k].noise for k in there])
        rms, gain = (np.array([getattr(fit, name) for fit in fits]) for name in ("rms", "gain"))
        left = np.sqrt(np.maximum(rms**2 - noise**2, 0.0)) / np.abs(gain)
        for k in np.flatnonzero(_far(left) & (left > SLIGHT) & (rms > CLEARLY * noise)):
            found[there[k]] = f"the fit leaves {left[k]:.1%} of the step, the others' {np.median(left):.1%}"
        share = gain / np.array([np.nan if runs[k].expected is None else runs[k].expected for k in there])
        if np.isfinite(share).any():
            apart = np.abs(share - np.nanmedian(share))
            for k in np.flatnonzero(_far(apart) & (apart > OTHER_GAIN)):
                told = f"thrust moves by {share[k]:.0%} of what the map says, the others' by {np.nanmedian(share):.0%}"
                found[there[k]] = f"command not reached, or not passed: {told}"
    return found


def _unfit(run: StepRun) -> str:
    """Why a run tells nothing by itself."""
    fit = run.fits["thrust"].plain
    size = abs(fit.gain)
    if size <= SEEN * fit.std["gain"]:
        return f"step too small: the thrust moves by {number(size, 2)} N, known to {number(fit.std['gain'], 2)} N"
    if run.noise > NOISY * size:
        return f"noise is {run.noise / size:.0%} of the step"
    missing = 1.0 - (fit.predicted[-1] - fit.offset) / fit.gain
    return f"not settled: {missing:.0%} of the step is missing where the run ends" if abs(missing) > UNSETTLED else ""


def _far(values: np.ndarray) -> np.ndarray:
    """(n,) which values are far above the others; NaN is not."""
    middle = np.nanmedian(values)
    return values > middle + FAR * 1.4826 * np.nanmedian(np.abs(values - middle))
