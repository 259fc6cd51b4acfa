"""Decide whether the gains of a search are better than the initial gains, by more criteria than the cost.

Settling time, overshoot and ringing of each step (`vpp_fmu.response.Step`) are compared, on one plant without measurement
noise. Settling is worse if it is longer by more than one sample. Overshoot and ringing up to the limit of overshoot count as
none; beyond it they are worse if they increase by more than the slack of that limit. A stable loop must stay stable, and a loop
within the limit on sensitivity must stay within it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from identification.tune.margins import Margins, least
from identification.tune.objective import SLACK, Objective
from identification.tune.search import RESOLVED
from vpp_fmu.response import Step

UNITS = {"settling": "s", "overshoot": "%", "ringing": "%"}
"""The figures of a step and their units."""


@dataclass(frozen=True)
class Change:
    """A figure of a step under the initial and under other gains. A settling of None: not before the next step.

    `grown`: increase of the part that counts; `tolerance`: least change in either direction that counts.
    """

    name: str
    first: float | None
    other: float | None
    grown: float
    tolerance: float

    @property
    def worse(self) -> bool:
        return self.grown > self.tolerance

    @property
    def better(self) -> bool:
        return -self.grown > self.tolerance

    def text(self) -> str:
        """Both values with their unit."""
        digits = ".3g" if self.name == "settling" else ".2f"
        first, other = ("not settled" if v is None else f"{v:{digits}}" for v in (self.first, self.other))
        return f"{first} → {other}{'' if self.other is None else f' {UNITS[self.name]}'}"


@dataclass(frozen=True)
class StepChanges:
    """A step of the wanted thrust from `before` to `after` [N] at `time` [s], and the changes of its figures."""

    time: float
    before: float
    after: float
    changes: tuple[Change, ...]

    @property
    def name(self) -> str:
        """Label of the step for reports."""
        return f"{self.before:.3g} → {self.after:.3g} N at {self.time:.3g} s"


@dataclass(frozen=True)
class Verdict:
    """Changes of each step, of the smallest margins and of the cost with penalties, (initial, other).

    `worse`: reasons against the other gains, in words; `overshoot` (share of a step), `sensitivity`: the limits.
    """

    steps: tuple[StepChanges, ...]
    margins: tuple[Margins | None, Margins | None]
    penalised: tuple[float, float]
    worse: tuple[str, ...]
    overshoot: float
    sensitivity: float

    @property
    def better(self) -> bool:
        """Whether the gains are accepted: nothing is worse, and the cost is lower by RESOLVED, or lower with a figure of a step
        that is better."""
        first, other = self.penalised
        gain = other < first * (1.0 - RESOLVED) or (other < first and bool(self.gains()))
        return gain and not self.worse

    def gains(self) -> list[str]:
        """Figures that are better, in words."""
        found = [f"{c.name} {c.text()} on the step {s.name}" for s in self.steps for c in s.changes if c.better]
        first, other = (m and m.sensitivity for m in self.margins)
        if first and other and other <= SLACK * self.sensitivity < first:
            found.append(f"sensitivity {first:.3g} → {other:.3g}, limit {self.sensitivity:g}")
        return found

    def words(self) -> str:
        if not self.better:
            return f"no better: kept the gains it started from{self._broken()}; {'; '.join(self.worse) or self._no_gain()}"
        none = f"overshoot and ringing within the limit of {100.0 * self.overshoot:g} % count as none"
        return f"better: {'; '.join(self.gains()) or 'less cost'}; no step is worse ({none})"

    def _broken(self) -> str:
        """A note if the initial gains exceed the limit on sensitivity, else empty."""
        first = self.margins[0]
        if first is None or first.sensitivity <= SLACK * self.sensitivity:
            return ""
        return f", though their sensitivity is {first.sensitivity:.3g}, limit {self.sensitivity:g}"

    def _no_gain(self) -> str:
        first, other = self.penalised
        change = f"the cost with its limits changes by {100.0 * (other / first - 1.0):+.2g} %"
        if other >= first:
            return change
        return f"no figure of any step is better, and {change}; a search resolves {100.0 * RESOLVED:g} %"

    def summary(self) -> dict:
        """The verdict for tuning.json."""
        return {
            "better": self.better,
            "words": self.words(),
            "steps": [{**asdict(s), "changes": [asdict(c) | {"worse": c.worse} for c in s.changes]} for s in self.steps],
            "least_margins": [m and asdict(m) for m in self.margins],
            "cost_with_limits": list(self.penalised),
        }


def verdict(
    objective: Objective, other: np.ndarray, margins: Sequence[Sequence[Margins]], penalised: tuple[float, float]
) -> Verdict:
    """Compare the gains `other` (n,) with the initial gains of the objective.

    `margins`: at the operating points of both; `penalised`: the costs of both with penalties.
    """
    pairs = zip(objective.steps(objective.gains), objective.steps(other), strict=True)
    changed = tuple(
        StepChanges(first.time, first.before, first.after, _changes(first, own, objective.overshoot, objective.course.dt))
        for first, own in pairs
    )
    ends = least(margins[0]), least(margins[1])
    worse = [f"{c.name} {c.text()} on the step {s.name}" for s in changed for c in s.changes if c.worse]
    worse += _worse_margins(*ends, objective.sensitivity)
    return Verdict(changed, ends, penalised, tuple(worse), objective.overshoot, objective.sensitivity)


def _changes(first: Step, other: Step, limit: float, dt: float) -> tuple[Change, ...]:
    """Changes of a step's figures; `limit`: share of a step; `dt` s. The tolerance is 1.5 samples, because of rounding."""
    spent = [s.end - s.time if s.settling is None else s.settling for s in (first, other)]
    found = [Change("settling", first.settling, other.settling, spent[1] - spent[0], 1.5 * dt)]
    for name in ("overshoot", "ringing"):
        sizes = getattr(first, name), getattr(other, name)
        beyond = [max(size, 100.0 * limit) for size in sizes]
        found.append(Change(name, *sizes, beyond[1] - beyond[0], 100.0 * (SLACK - 1.0) * limit))
    return tuple(found)


def _worse_margins(first: Margins | None, other: Margins | None, limit: float) -> list[str]:
    if first is None or other is None:
        return []
    if first.stable and not other.stable:
        return ["a loop that was stable at each operating point is unstable at one of them"]
    if other.sensitivity > SLACK * max(limit, first.sensitivity):
        return [f"sensitivity {first.sensitivity:.3g} → {other.sensitivity:.3g}, limit {limit:g}"]
    return []
