"""Figures of merit of a closed loop's step responses."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vpp_fmu.digits import number
from vpp_fmu.record import Record

BAND = 0.02
"""Settling band, as a share of the step."""

QUIET = 5
"""A step has settled once the thrust stays in the band this many times as long as it took; departures after that have other
causes. A loop's own next swing comes within one settling time."""

LEAST_QUIET = 1.0
"""s for which the thrust stays in the band at least: noise can enter the band early for a sample."""

TAIL = 0.1
"""A set-point is out of reach if the commands are at their limits and the thrust is constant over this last share of the
step's duration."""

UNITS = {"time": "s", "end": "s", "before": "N", "after": "N", "settling": "s", "overshoot": "%", "ringing": "%"}
UNITS |= {"duration": "s", "largest": "%"}
"""Of the numbers of a `Step` and of its departures."""


@dataclass(frozen=True)
class Departure:
    """A disturbance: thrust outside the settling band after it has settled, from `time` [s] for `duration` s, by at most
    `largest` % of the step."""

    time: float
    duration: float
    largest: float


@dataclass(frozen=True)
class Step:
    """One change of the wanted thrust, from `before` to `after` [N] at `time` [s], evaluated until `end` [s].

    `last`: whether it is the last step of the run. `settling` [s]: settling time; None if it never settles. `stuck`: thrust
    [N] and commands of speed [rpm] and pitch [deg] at its end if the set-point is out of reach. `overshoot`: largest thrust
    beyond the set-point before the first of the `departures`, and `ringing`: largest deviation to either side after the
    overshoot until the end, departures included, both in % of the step.
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
    departures: tuple[Departure, ...] = ()

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
        outside, clock = np.abs(missing) > band, time[start:end] - time[start]
        settled, departed = _settled(outside, clock)
        settling = None if settled is None else float(clock[settled])
        own = missing[: departed[0].start] if departed else missing
        overshoot = 100.0 * max(0.0, float(np.max(-own)))
        departures = tuple(
            Departure(
                float(time[start + rows.start]),
                float(clock[rows.stop] - clock[rows.start]),
                100.0 * float(np.max(np.abs(missing[rows]))),
            )
            for rows in departed
        )
        ringing, until = 100.0 * swing(missing), float(time[min(end, len(time) - 1)])
        stuck = None if settling is not None or not limits else _stuck(run, slice(start, end), band * abs(size), limits)
        ends = float(time[start]), until, float(before), float(after)
        found.append(Step(*ends, settling, overshoot, ringing, bool(end == len(wanted)), stuck, departures))
    return found


def _settled(outside: np.ndarray, clock: np.ndarray) -> tuple[int | None, list[slice]]:
    """The row at which a step has settled, None if it ends outside the band, and the rows of each later departure.

    `outside`: (n,) whether the thrust is outside the band; `clock`: (n,) time since the step [s].
    """
    edges = np.flatnonzero(np.diff(outside, prepend=True))
    entries, exits = edges[::2], edges[1::2]
    if len(entries) == len(exits):
        return None, []
    quiet = clock[exits] - clock[entries[:-1]]
    long = np.flatnonzero(quiet >= np.maximum(QUIET * clock[entries[:-1]], LEAST_QUIET))
    first = int(long[0]) if len(long) else len(exits)
    return int(entries[first]), [slice(a, b) for a, b in zip(exits[first:], entries[first + 1 :], strict=True)]


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
