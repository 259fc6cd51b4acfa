"""Whether gains that a search found are better than those that it started from, whatever the cost says.

Every step of the course is judged under both: how long the thrust takes to settle, how far it overshoots, how much it rings
(`vpp_fmu.response.Step`). A figure is worse where it has grown by more than chance or the clock explains:

- settling by more than one sample; overshoot and ringing beyond the limit on overshoot, by more than that limit's slack;
- where the reading is noisy, by more than noise makes of it besides: both loops run under the same noise, REPEATS times, and
  the mean difference must pass a t-test on the level ALIKE.

A loop must also stay stable, and within the limit on its sensitivity if it was.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import t as t_distribution

from identification.tune.margins import Margins, least
from identification.tune.objective import SLACK, Objective
from identification.tune.search import RESOLVED
from vpp_fmu.response import Step

REPEATS = 20
"""Runs of a loop whose reading is noisy."""

ALIKE = 0.01
"""Level of the t-test: so often noise alone makes a figure worse."""

UNITS = {"settling": "s", "overshoot": "%", "ringing": "%"}
"""The figures of a step."""


@dataclass(frozen=True)
class Change:
    """A figure of a step under the first gains and under others, means over the runs; None: settled in none of them.

    `grown`: by how much of what counts; `tolerance`: what that must exceed, either way.
    """

    name: str
    first: float | None
    other: float | None
    grown: float
    tolerance: float

    @property
    def worse(self) -> bool:
        """Whether it has grown."""
        return self.grown > self.tolerance

    @property
    def better(self) -> bool:
        """Whether it has shrunk."""
        return -self.grown > self.tolerance

    def told(self) -> str:
        """Both values with their unit."""
        digits = ".3g" if self.name == "settling" else ".2f"
        first, other = ("not settled" if v is None else f"{v:{digits}}" for v in (self.first, self.other))
        return f"{first} → {other}{'' if self.other is None else f' {UNITS[self.name]}'}"


@dataclass(frozen=True)
class StepChanges:
    """A step of the wanted thrust from `before` to `after` [N] at `time` [s], and how its figures changed."""

    time: float
    before: float
    after: float
    changes: tuple[Change, ...]

    @property
    def name(self) -> str:
        """As the reader knows it."""
        return f"{self.before:.3g} → {self.after:.3g} N at {self.time:.3g} s"


@dataclass(frozen=True)
class Verdict:
    """What became of every step, of the least margins and of the cost with its limits, (first, other).

    `worse`: what forbids the other gains, in words; `overshoot`: the limit, share of a step.
    """

    steps: tuple[StepChanges, ...]
    margins: tuple[Margins | None, Margins | None]
    penalised: tuple[float, float]
    worse: tuple[str, ...]
    overshoot: float

    @property
    def better(self) -> bool:
        """Whether the gains are handed out: nothing is worse, and the cost is lower by what a search resolves, or lower at all
        and a figure of a step better."""
        first, other = self.penalised
        gain = other < first * (1.0 - RESOLVED) or (other < first and bool(self.gains()))
        return gain and not self.worse

    def gains(self) -> list[str]:
        """The figures that are better, in words."""
        return [f"{c.name} {c.told()} on the step {s.name}" for s in self.steps for c in s.changes if c.better]

    def words(self) -> str:
        """The verdict with its reason."""
        if self.worse:
            return f"no better: kept the gains it started from; {'; '.join(self.worse)}"
        if not self.better:
            first, other = self.penalised
            return (
                "no better: kept the gains it started from; no figure of any step is better, and the cost with its limits "
                f"changes by {100.0 * (other / first - 1.0):+.2g} %, where a search resolves {100.0 * RESOLVED:g} %"
            )
        none = f"overshoot and ringing within the limit of {100.0 * self.overshoot:g} % count as none"
        return f"better: {'; '.join(self.gains()) or 'less cost'}; no step is worse ({none})"

    def summary(self) -> dict:
        """As tuning.json has it."""
        return {
            "better": self.better,
            "words": self.words(),
            "steps": [{**asdict(s), "changes": [asdict(c) | {"worse": c.worse} for c in s.changes]} for s in self.steps],
            "least_margins": [m and m.summary() for m in self.margins],
            "cost_with_limits": list(self.penalised),
        }


def verdict(
    objective: Objective,
    other: np.ndarray,
    margins: Sequence[Sequence[Margins]],
    penalised: tuple[float, float],
    noises: np.ndarray,
) -> Verdict:
    """Judge the gains `other` (n,) against the objective's own.

    `margins`: at the operating points of both; `penalised`: the costs with their limits; `noises` (runs, points) N: of the
    reading, one run where there is none.
    """
    runs = [[objective.steps(gains, noise) for noise in noises] for gains in (objective.gains, other)]
    limit = 100.0 * objective.overshoot
    changed = tuple(
        StepChanges(first.time, first.before, first.after, tuple(_changes(k, runs, limit, objective.course.dt)))
        for k, first in enumerate(runs[0][0])
    )
    ends = least(margins[0]), least(margins[1])
    worse = [f"{c.name} {c.told()} on the step {s.name}" for s in changed for c in s.changes if c.worse]
    worse += _worse_margins(*ends, objective.sensitivity)
    return Verdict(changed, ends, penalised, tuple(worse), objective.overshoot)


def _changes(k: int, runs: Sequence[Sequence[Sequence[Step]]], limit: float, dt: float) -> Iterator[Change]:
    """Of the k-th step; `runs`: steps of each run under both gains; `limit` %."""
    first, other = ([steps[k] for steps in each] for each in runs)
    spent = [np.array([s.end - s.time if s.settling is None else s.settling for s in each]) for each in (first, other)]
    told = [
        None if all(s.settling is None for s in each) else float(v.mean())
        for each, v in zip((first, other), spent, strict=True)
    ]
    yield _change("settling", told, spent, dt)
    for name in ("overshoot", "ringing"):
        sizes = [np.array([getattr(s, name) for s in each]) for each in (first, other)]
        beyond = [np.maximum(size, limit) for size in sizes]
        yield _change(name, [float(size.mean()) for size in sizes], beyond, (SLACK - 1.0) * limit)


def _change(name: str, told: Sequence[float | None], counted: Sequence[np.ndarray], floor: float) -> Change:
    grown = counted[1] - counted[0]
    runs = len(grown)
    chance = t_distribution.isf(ALIKE, runs - 1) * grown.std(ddof=1) / np.sqrt(runs) if runs > 1 else 0.0
    return Change(name, *told, float(grown.mean()), float(floor * (1.0 + 1e-9) + chance))


def _worse_margins(first: Margins | None, other: Margins | None, limit: float) -> list[str]:
    if first is None or other is None:
        return []
    if first.stable and not other.stable:
        return ["a loop that was stable at every operating point is not at one of them"]
    if other.sensitivity > SLACK * max(limit, first.sensitivity):
        return [f"sensitivity {first.sensitivity:.3g} → {other.sensitivity:.3g}, limit {limit:g}"]
    return []
