"""Figures of merit of a closed loop's step responses."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vpp_fmu.digits import number
from vpp_fmu.record import Record

BAND = 0.02
"""Settling band, as a share of the step."""

TAIL = 0.1
"""A set-point is out of reach if the commands are at their limits and the thrust is constant over this last share of the
step's duration."""

UNITS = {"time": "s", "end": "s", "before": "N", "after": "N", "settling": "s", "overshoot": "%", "ringing": "%"}
"""Of the numbers of a `Step`."""


@dataclass(frozen=True)
class Step:
    """One change of the wanted thrust, from `before` to `after` [N] at `time` [s], evaluated until `end` [s].

    `last`: whether it is the last step of the run. `settling` [s]: settling time; None if it never settles. `stuck`: thrust
    [N] and commands of speed [rpm] and pitch [deg] at its end if the set-point is out of reach. `overshoot`: largest thrust
    beyond the set-point, and `ringing`: its largest deviation to either side after the overshoot, both in % of the step.
    """

    time: float
    end: float
    before: float
    after: float
    settling: float | None
    overshoot: float
    ringing: float
    last: bool = False
    stuck: tuple[float, float, float] | None = None

    @property
    def reached(self) -> str:
        """Thrust and commands that are reached if the set-point is out of reach, in words."""
        thrust, omega, beta = self.stuck or 3 * (float("nan"),)
        return f"{number(thrust)} N at {number(omega)} rpm, {number(beta)} deg"


def steps(run: Record, band: float = BAND, limits: Mapping[str, tuple[float, float]] | None = None) -> list[Step]:
    """Every change of `thrust_set` in a run, evaluated on `thrust` until the next change; `band`: share of the step; `limits`:
    (least, greatest) of each command by its name, if known."""
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
        stuck = None if settled or not limits else _stuck(run, slice(start, end), band * abs(size), limits)
        ends = float(time[start]), until, float(before), float(after)
        found.append(Step(*ends, settling, overshoot, ringing, bool(end == len(wanted)), stuck))
    return found


def _stuck(
    run: Record, rows: slice, band: float, limits: Mapping[str, tuple[float, float]]
) -> tuple[float, float, float] | None:
    """Thrust and commands at the end of a step whose commands are at their limits while the thrust changes by less than `band`
    [N]; None otherwise."""
    tail = slice(rows.stop - max(2, round(TAIL * (rows.stop - rows.start))), rows.stop)
    thrust, ends = run["thrust"][tail], []
    for name, (low, high) in limits.items():
        command = run[name][tail]
        room = 1e-6 * max(abs(low), abs(high))
        if not any(np.all(np.abs(command - end) <= room) for end in (low, high)):
            return None
        ends.append(float(command[-1]))
    return (float(thrust[-1]), *ends) if float(np.ptp(thrust)) < band else None


def swing(missing: np.ndarray) -> float:
    """The largest |error| (n,) of a step response after it has reached the set-point and first returns behind it; 0 if it
    never does."""
    reached = int(np.argmax(missing <= 0.0)) if (missing <= 0.0).any() else len(missing)
    behind = missing[reached:] > 0.0
    return float(np.max(np.abs(missing[reached + int(np.argmax(behind)) :]))) if behind.any() else 0.0


def smoothed(run: Record, span: float) -> Record:
    """The run with its thrust as a centred mean over `span` s."""
    rows = max(1, round(span / float(np.median(run.steps)))) // 2 * 2 + 1
    total = np.concatenate([[0.0], np.cumsum(run["thrust"])])
    low = np.clip(np.arange(len(run)) - rows // 2, 0, len(run))
    high = np.clip(np.arange(len(run)) + rows // 2 + 1, 0, len(run))
    return run.with_columns(thrust=(total[high] - total[low]) / (high - low))
