"""Test whether a parameter explains the readings: cumulative sums of log-likelihood ratios, and the action after an alarm.

For each monitored parameter, two sums test a plausible change up and down against no change, and a Bayes factor tests whether
it has left its earlier value, at first the identified one. Two more sums test a larger variance of the innovations and of the
slow noise. After an alarm the parameters adapt, and Wald's test of the ratio of the innovations decides whether they explain
the readings.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import log
from typing import Any

from vpp_fmu.kernel.duals import TINY
from vpp_fmu.kernel.twin.noises import AT_NODES, PLACE, TOLERATED, pairs
from vpp_fmu.kernel.twin.prediction import settled_ones
from vpp_fmu.kernel.types import BOOLEAN, Effect, Model, Parameter, Signal, State

ACKNOWLEDGE = Signal("acknowledge", "1", "somebody has seen the alarm: adapt again", 0.0, 1.0, kind=BOOLEAN)

UP, DOWN = "up", "down"
NOISES = "fading", "between", "map"
WATCHING, ADAPTING, STOPPED = 0.0, 1.0, 2.0

SUSPECT = log(100.0)
"""Threshold of a log-likelihood sum: without a change one in a hundred exceeds it (Ville, 1939). While the largest sum is above
it, the readings may come from a change, and the estimates from before are kept."""


FAR, MOST = 8.0, 3.0
"""Ratio of the slow noise's variance that is tested, and standard deviations beyond which more does not count: a sum of these
ratios decreases up to 1.5, and needs a second at MOST, longer than a single move."""

LATELY = 120.0
"""s. A parameter is tested against its value one to two times this ago, at first the identified one; the errors of a model in
its moves add up over longer times. The test has one independent result in this time, and so needs less evidence than one at
every sample."""


def threshold(false_alarms: float, count: int, sample_time: float) -> float:
    """Threshold of the log-likelihood sums, two for each of `count` monitored parameters and two more, for at most
    `false_alarms` false alarms an hour: a sum takes at least e^threshold samples on average (Lorden, Annals of Mathematical
    Statistics 42, 1971)."""
    return log((2 * count + 2) * 3600.0 / (false_alarms * sample_time))


def watched(plant: Model, adapted: Sequence[str]) -> tuple[str, ...]:
    """Parameters that a twin monitors for changes: those with an effect on static outputs. A lag adapts without monitoring: if
    it is 1.5 times as slow, the error is 0.5 / e = 0.18 of a move, while a correct model already has 0.15."""
    return tuple(name for name, one in zip(adapted, settled_ones(plant, tuple(adapted)), strict=True) if one)


def watch(adapted: tuple[str, ...], names: tuple[str, ...], sample_time: float) -> Effect:
    m, places = len(adapted), [adapted.index(name) for name in names]
    kept = (*adapted, *AT_NODES)

    def taken(ops, s, x, p, dt):
        watching = ops.where(x.mode < 0.5, 1.0, 0.0)
        found, departed, ahead = _heights(ops, s, x, dt, places, names, watching)

        # Innovations with twice the predicted variance against those with the predicted one.
        unlike = s.standing * (0.25 * s.pulls * s.pulls / s.S - 0.5 * log(2.0))
        nothing_else = watching * ops.maximum(x.unlike + unlike, 0.0)
        # The same of the slow noise, whose estimate takes up a sudden change at first; one value in `slow_time` is new.
        size = ops.minimum(s.noises[0] * s.noises[0] / (s.stationary[0] + TINY), MOST * MOST)
        wide = 0.5 * (1.0 - 1.0 / FAR) * size - 0.5 * log(FAR)
        wandering = watching * ops.maximum(x.wandering + dt / s.noise_model.slow_time * wide, 0.0)
        largest = ops.maximum(nothing_else, wandering)
        for height in found:
            largest = ops.maximum(largest, height)
        enough = ops.maximum(p.threshold - log(LATELY / sample_time), SUSPECT)
        starts = ops.where(largest > p.threshold, watching, ops.where(departed > enough, watching, 0.0))
        calm = ops.where(largest < SUSPECT, watching, 0.0) > 0.5
        present = zip(kept, (*s.theta, *s.noises[2:]), strict=True)
        known = {name: ops.where(calm, now, getattr(x, f"kept.{name}")) for name, now in present}
        points, best = 0.0, 0.0
        for i, height in zip(places, found, strict=True):
            points, best = ops.where(height > best, float(i + 1), points), ops.maximum(height, best)

        # After an alarm: Wald's test of the same ratio. It accepts only after a place for each parameter.
        adapting = ops.where(x.mode > 0.5, ops.where(x.mode < 1.5, 1.0, 0.0), 0.0)
        doubt = adapting * ops.maximum(x.doubt + unlike, -p.threshold)
        seen = adapting * (x.seen + s.moved)
        explained = ops.where(doubt < 1e-9 - p.threshold, ops.where(seen > m * PLACE, adapting, 0.0), 0.0)
        stops = ops.where(doubt > p.threshold, adapting, 0.0)
        stopped = ops.where(x.mode > 1.5, 1.0, 0.0)
        goes_on = ops.where(s.acknowledge > 0.5, stopped, 0.0)

        moved = _moved_most(ops, s, x, known.values())
        direction = ops.where(starts > 0.5, points, ops.where(explained > 0.5, moved, x.direction))
        mode = ops.where(stops > 0.5, STOPPED, ops.where(explained + goes_on > 0.5, WATCHING, x.mode))
        mode = ops.where(starts > 0.5, ADAPTING, mode)
        changes = x.changes + explained
        ahead |= {
            "unlike": nothing_else,
            "wandering": wandering,
            "doubt": ops.where(starts > 0.5, 0.0, doubt),
            "seen": ops.where(starts > 0.5, 0.0, seen),
            "mode": mode,
            "direction": direction,
            "changes": changes,
            **{f"kept.{name}": value for name, value in known.items()},
        }
        said = {
            "alarm": ops.where(mode > 0.5, 1.0, 0.0),
            "direction": direction,
            "changes": changes,
            "learning": ops.where(mode > 1.5, 0.0, 1.0),
            "starts": starts,
            "opens": starts + goes_on,
            "returns": stops,
            "learns": ops.where(mode > 1.5, 0.0, ops.where(x.mode > 1.5, 0.0, 1.0)),
            "kept": list(known.values()),
        }
        return said, ahead

    def states() -> Iterable[State]:
        for name in names:
            for what in ("before", "lately"):
                yield State(f"{what}.{name}", "1", f"{name} {what}, in plausible changes", 0.0)
            for way in (UP, DOWN):
                yield State(f"sum.{name}.{way}", "1", f"log-likelihood ratio of a change of {name}, {way}", 0.0)
                for k in range(len(NOISES)):
                    said = "what of such a change the noises' estimates have taken up"
                    yield State(f"absorbed.{name}.{way}.{NOISES[k]}", "N", said, 0.0)
        yield State("clock", "s", "time since the values before were renewed", 0.0)
        yield State("wandering", "1", f"log-likelihood ratio of {FAR:g} times the variance of the slow noise", 0.0)
        yield State("unlike", "1", "log-likelihood ratio of twice the variance", 0.0)
        yield State("doubt", "1", "the same since an alarm", 0.0)
        yield State("seen", "1", "how far the operating point has gone since an alarm", 0.0)
        yield State("mode", "1", "0 watches, 1 follows a change, 2 has stopped", 0.0)
        yield State("direction", "1", "what the last alarm points to", 0.0)
        yield State("changes", "1", "changes that were followed", 0.0)
        for name in kept:
            yield State(f"kept.{name}", "1", f"{name} when no sum was suspicious, parameters in plausible changes", 0.0)

    usual = threshold(0.01, len(names), sample_time)
    said = "log-likelihood ratio at which a change counts as one: ln(sums x samples between false alarms)"
    parameters = (Parameter("threshold", "1", usual, 1.0, 1000.0, said, 20.0),)
    return Effect(
        "watch", "whether a parameter explains what is read", taken, parameters, tuple(states()), inputs=(ACKNOWLEDGE,)
    )


def _heights(ops: Any, s: Any, x: Any, dt: Any, places: Sequence[int], names: Sequence[str], watching: Any) -> tuple:
    """(for each monitored parameter the largest evidence of a change; the largest evidence of a departure from earlier
    values; next values of the states)."""
    before = {i: getattr(x, f"before.{name}") for i, name in zip(places, names, strict=True)}
    turns = x.clock + dt > LATELY
    found, departed, ahead = [], 0.0, {"clock": ops.where(turns, 0.0, x.clock + dt)}
    for i, name in zip(places, names, strict=True):
        heights = [watching * _departure(ops, s, before, (*(k for k in places if k != i), i))]
        departed = ops.maximum(departed, heights[0])
        for sign, way in ((1.0, UP), (-1.0, DOWN)):
            more, shape, absorbed = _ratio(s, x, i, sign, f"{name}.{way}")
            height = watching * ops.maximum(getattr(x, f"sum.{name}.{way}") + more, 0.0)
            ahead[f"sum.{name}.{way}"] = height
            heights.append(height)
            for k, a in enumerate(absorbed):
                after = a if shape is None else a + s.takes[k] * shape
                ahead[f"absorbed.{name}.{way}.{NOISES[k]}"] = ops.where(height > 0.0, after, 0.0)
        lately = getattr(x, f"lately.{name}")
        for what, held, new in (("before", before[i], lately), ("lately", lately, s.theta[i])):
            ahead[f"{what}.{name}"] = ops.where(watching > 0.5, ops.where(turns, new, held), s.theta[i])
        found.append(ops.maximum(*heights))
    return found, departed, ahead


def _moved_most(ops: Any, s: Any, x: Any, before: Iterable) -> Any:
    """Number, from 1, of the parameter with the largest significant move in plausible changes."""
    which, most = x.direction, 0.0
    for i, (now, was) in enumerate(zip(s.theta, before, strict=False)):
        sure = (now - was) * (now - was) * (1.0 - s.P[i, i])
        which, most = ops.where(sure > most, float(i + 1), which), ops.maximum(sure, most)
    return which


def _departure(ops: Any, s: Any, before: Mapping, places: Sequence[int]) -> Any:
    """Logarithm of the Bayes factor that the last of these parameters, and no other, differs from its value before, at first
    the identified one.

    With its mean v above that value and its variance C, given that the others have theirs, and its variance R at the start,
    the Savage-Dickey ratio is (v^2 / C + ln(C / R)) / 2.
    """
    v = [s.theta[i] - before[i] for i in places]
    C = {at: s.P[tuple(sorted(places[k] for k in at))] for at in pairs(len(places))}
    for k in range(len(v) - 1):
        for i in range(k + 1, len(v)):
            share = C[k, i] / (C[k, k] + TINY)
            v[i] = v[i] - share * v[k]
            for j in range(i, len(v)):
                C[i, j] = C[i, j] - share * C[k, j]
    left = C[len(v) - 1, len(v) - 1] + TINY
    return 0.5 * (v[-1] * v[-1] / left + ops.log(left / (s.prior[places[-1]] + TINY)))


def _ratio(s: Any, x: Any, i: int, sign: float, name: str) -> tuple[Any, Any, list]:
    """(increment of the log-likelihood ratio of a change of theta_i by `sign`, effect of the change on the innovation, parts of
    it that the noises' estimates have already absorbed).

    The ratio is that of normal innovations, without the absorbed part of the change. Its power below 1 allows for dependent
    innovations, and is not larger on average (Jensen).
    """
    keeps = (*s.keeps, s.keeps[1])  # at another place the map has not absorbed the change yet
    absorbed = [a * getattr(x, f"absorbed.{name}.{noise}") for noise, a in zip(NOISES, keeps, strict=True)]
    more, shape, by_thrust = 0.0, None, s.thrust_slopes[i]
    if by_thrust is not None:
        looked_for = by_thrust * by_thrust
        counts = looked_for / (looked_for + (2.0 * TOLERATED) * (2.0 * TOLERATED) * s.on_the_way + TINY)
        shape = by_thrust - sum(absorbed[1:], absorbed[0])
        more = counts * (sign * s.pulls - 0.5 * shape) * shape / s.S
    by_speed = s.speed_slopes[i]
    if by_speed is not None:
        more = more + s.speed.fresh * (sign * s.speed.misses - 0.5 * by_speed) * by_speed / s.speed.variance
    return more, shape, absorbed
