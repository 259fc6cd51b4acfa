"""Figures of merit of a closed loop's steps."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vpp_fmu.record import Record

BAND = 0.02
"""A step has settled once the thrust stays within this share of the step."""


@dataclass(frozen=True)
class Step:
    """One change of the wanted thrust, from `before` to `after` [N] at `time` [s], judged until `end` [s].

    `settling` s to stay within the band around it; None where it never does. `overshoot`: how far the thrust goes beyond what
    is wanted, and `ringing`: its largest swing to either side once it has come back from there, both in % of the step.
    """

    time: float
    end: float
    before: float
    after: float
    settling: float | None
    overshoot: float
    ringing: float


def steps(run: Record, band: float = BAND) -> list[Step]:
    """Every change of `thrust_set` in a run, judged on `thrust` until the next change; `band`: share of the step."""
    wanted, time, thrust = run["thrust_set"], run.time, run["thrust"]
    changes = [*(np.flatnonzero(np.diff(wanted)) + 1), len(wanted)]
    found = []
    for start, end in pairwise(changes):
        before, after = wanted[start - 1], wanted[start]
        size = after - before
        missing = (after - thrust[start:end]) / size
        outside = np.flatnonzero(np.abs(missing) > band)
        settled = len(outside) == 0 or outside[-1] + 1 < end - start
        after_last = start + (outside[-1] + 1 if len(outside) else 0)
        settling = float(time[after_last] - time[start]) if settled else None
        overshoot = 100.0 * max(0.0, float(np.max(-missing)))
        ringing, until = 100.0 * swing(missing), float(time[min(end, len(time) - 1)])
        found.append(Step(float(time[start]), until, float(before), float(after), settling, overshoot, ringing))
    return found


def swing(missing: np.ndarray) -> float:
    """The largest |error| (n,) of a step's response from where, having reached what is wanted, it first falls back behind it;
    0 where it never does."""
    reached = int(np.argmax(missing <= 0.0)) if (missing <= 0.0).any() else len(missing)
    behind = missing[reached:] > 0.0
    return float(np.max(np.abs(missing[reached + int(np.argmax(behind)) :]))) if behind.any() else 0.0
