"""A cheap look at what each candidate could explain beside a fitted model, to choose which are worth a full refit.

The fitted parameters may move along their sensitivities. Where an effect's trace is proportional to its sizes, one run with
tangents tells the best ones; elsewhere a grid of sizes is tried, all combinations of two, or one after the other of more.

A large missing effect bends the fit so far that nothing can be seen from there. Then the same look is taken from a second
place too: the start of the fit, where the static map and the steps had put the parameters, in both orders of the pitch lags.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.rounding import Rounding
from identification.diagnose.search.threshold import divided
from identification.fit.linearised import Linearised
from identification.fit.problem import Problem
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.tracer import LANES

STRETCH = (0.7, 1.4)
"""How far a trace may be scaled between the sizes of the grid, which are a factor of 2 apart."""

PROPORTIONAL = 0.03
"""Share of an effect's trace by which it may depart from its tangent and still pass for proportional."""

SHARP = 0.7
"""Squared cosine of the traces of two sizes a factor of 2 apart below which a grid of such steps may miss the right one."""

ROUNDING = 1e-9
"""Share of the speed by which it may change and still be the same: it is compiled another way, and rounds another way."""

COMPARED = slice(2)
"""Of a model's outputs, thrust and speed."""

CLOSER = 3
"""Steps along the tangents from the best point of a grid of several sizes: what binds in one corner only is between points."""


@dataclass(frozen=True)
class ScreeningResult:
    """What a candidate promises: fall of the half sum of squares, and where: `values` of all that is free, `slow_first`.

    `points`: how many were looked at for it.
    """

    fall: float
    values: Mapping[str, float]
    points: int
    slow_first: Mapping[str, bool]


class Screening:
    """The looks beside one fit. `start`: where the parameters stood before any fit; `biased`: look from there, too."""

    def __init__(self, fit: Fit, start: Mapping[str, float], library: Iterable[Effect], biased: bool):
        library, problem = tuple(library), fit.problem
        about = fit.linearised()
        cost = 0.5 * float(about.residual @ about.residual)
        self._screened = [(_Screened(about, cost, fit.effects, library), fit.slow_first)]
        if biased:
            for order in (True, False):
                slow_first = {**fit.slow_first, "beta": order}
                there = Problem(problem.model, problem.experiments, fit.values, problem.coordinates.names, None, slow_first)
                there.scale = problem.scale
                x = there.coordinates.vector({**fit.values, **start})
                self._screened.append(
                    (_Screened(Linearised(there, x, *there.evaluate(x)), cost, fit.effects, library), slow_first)
                )

    def at(self, candidate: Candidate) -> ScreeningResult:
        """The best of the looks at a candidate."""
        found = [ScreeningResult(*look.at(candidate), order) for look, order in self._screened]
        return replace(max(found, key=lambda seen: seen.fall), points=sum(seen.points for seen in found))


class _Screened:
    """The look from one place. `cost`: half sum of squares of the fit that is to be improved on."""

    def __init__(self, about: Linearised, cost: float, effects: Iterable[str], library: tuple[Effect, ...]):
        self._about, self._cost, self._effects, self._library = about, cost, tuple(effects), library
        self._nothing = cost - 0.5 * float(about.residual @ about.residual)  # the fall where a candidate adds nothing

    def at(self, candidate: Candidate) -> tuple[float, dict[str, float], int]:
        """Fall of the half sum of squares at the best point found; the values there, the fitted ones having followed;
        points."""
        simulator = Simulator(plant([*self._effects, candidate.name], self._library), candidate.sizes)
        trace = _Trace(self._about, simulator, candidate)
        found = [self._proportional(trace, shape) or self._grid(trace, shape) for shape in candidate.shapes()]
        fall, point = max(found, key=lambda pair: pair[0])
        return fall, trace.followed(point) | point, trace.points

    def _proportional(self, trace: "_Trace", shape) -> tuple[float, dict[str, float]] | None:
        """The best sizes of a trace that goes with them; None where it does not."""
        candidate, columns = trace.candidate, trace.tangents(shape | trace.candidate.off)
        (shown,), off = trace.at([shape | candidate.probe]).T, candidate.off
        straight = columns @ np.array([candidate.probe[n] - off[n] for n in candidate.sizes])
        if not np.any(shown) or np.linalg.norm(shown - straight) > PROPORTIONAL * np.linalg.norm(shown):
            return None
        free, *_ = np.linalg.lstsq(columns, -self._about.residual, rcond=1e-9)
        sizes = candidate.within({n: off[n] + v for n, v in zip(candidate.sizes, free, strict=True)})
        return self._fall(columns @ np.array([sizes[n] - off[n] for n in candidate.sizes])), shape | sizes

    def _grid(self, trace: "_Trace", shape) -> tuple[float, dict[str, float]]:
        candidate = trace.candidate
        if candidate.effect.rounds:
            return self._rounded(trace)
        axes = {n: candidate.axis(n) for n in candidate.sizes}
        if len(axes) == 1 and trace.sharp(shape, axes):
            if trace.stepwise(shape):
                return self._divided(trace, shape)
            axes = {n: candidate.fine_axis(n) for n in axes}
        if len(axes) == 2:  # a limit on speed is sharp, for speed is measured well
            axes |= {n: candidate.fine_axis(n) for n in axes if trace.limited(shape, n)}
        if len(axes) <= 2:
            points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
            best = self._best(trace, [shape | point for point in points])
            return best if len(axes) == 1 else self._closer(trace, best)
        best = -np.inf, shape | candidate.off
        for _ in range(2):
            for name, values in axes.items():
                best = max(best, self._best(trace, [best[1] | {name: v} for v in values]), key=lambda pair: pair[0])
        return self._closer(trace, best)

    def _rounded(self, trace: "_Trace") -> tuple[float, dict[str, float]]:
        """The best step of an effect that rounds a command."""
        look = trace.rounding()
        points = [{look.name: step} for step in look.best()]
        return max(((self._fall(trace.at([point])[:, 0]), point) for point in points), key=lambda pair: pair[0])

    def _divided(self, trace: "_Trace", shape) -> tuple[float, dict[str, float]]:
        """The best value of a threshold."""
        (name,) = trace.candidate.sizes
        residual = self._about.residual[:, None]
        costs = divided(
            lambda values: residual + trace.at([shape | {name: v} for v in values]), trace.candidate.fine_axis(name)
        )
        best = min(costs, key=costs.__getitem__)
        return self._cost - costs[best], shape | {name: best}

    def _closer(self, trace: "_Trace", best: tuple[float, dict[str, float]]) -> tuple[float, dict[str, float]]:
        """From the best point of a grid of several sizes, some way down along their tangents."""
        candidate, (fall, point) = trace.candidate, best
        for _ in range(CLOSER):
            left = self._about.residual + trace.at([point])[:, 0]
            step, *_ = np.linalg.lstsq(trace.tangents(point), -left, rcond=1e-9)
            there = point | candidate.within({n: point[n] + d for n, d in zip(candidate.sizes, step, strict=True)})
            if (gained := self._fall(trace.at([there])[:, 0])) <= fall:
                break
            fall, point = gained, there
        return fall, point

    def _best(self, trace: "_Trace", points: Sequence) -> tuple[float, dict[str, float]]:
        """The best of the points and the fall there, the sizes stretched a little where that helps."""
        best = -np.inf, {}
        for point, (along, power) in zip(points, trace.products(points), strict=True):
            stretch = float(np.clip(-along / power, *STRETCH)) if power else 1.0
            fall = self._nothing - stretch * (along + 0.5 * stretch * power)
            if fall > best[0]:
                sizes = {n: point[n] * stretch for n, v in trace.candidate.off.items() if v == 0.0}
                best = fall, point | trace.candidate.within(sizes)
        return best

    def _fall(self, shown: np.ndarray) -> float:
        left = self._about.residual + shown
        return self._cost - 0.5 * float(left @ left)


class _Trace:
    """What a candidate adds to the residual that the fitted parameters can't follow, as a function of its parameters."""

    def __init__(self, about: Linearised, simulator: Simulator, candidate: Candidate):
        self.candidate, self._about, self._simulator = candidate, about, simulator
        quiet = about.outputs(simulator, [{**candidate.form, **candidate.off}])
        self._quiet = [shown[:, COMPARED] for shown in quiet]
        self._speed = [np.abs(shown[:, 1]).max() for shown in quiet]
        self._known: dict[tuple[float, ...], np.ndarray] = {}
        self.points = 0

    def at(self, points: Sequence) -> np.ndarray:
        """(rows, points)"""
        return np.hstack([self._about.orthogonal_part(changed) for changed in self._changed(points)])

    def products(self, points: Sequence) -> list[tuple[float, float]]:
        """Of what is added at each point, with the residual and with itself."""
        pairs = [self._about.products(changed) for changed in self._changed(points)]
        return [pair for along, power in pairs for pair in zip(along.tolist(), power.tolist(), strict=True)]

    def _changed(self, points: Sequence) -> Iterator[np.ndarray]:
        """(rows, LANES at most): the scaled residual's change from where the candidate is off; it is linear in the outputs'."""
        for first in range(0, len(points), LANES):
            part = points[first : first + LANES]
            new = [point for point in part if tuple(point.values()) not in self._known]
            run = self._run(new) if new else None
            if len(new) == len(part):
                yield run
                continue
            found = dict(zip((tuple(point.values()) for point in new), run.T if new else (), strict=True)) | self._known
            yield np.column_stack([found[tuple(point.values())] for point in part])

    def _run(self, points: Sequence) -> np.ndarray:
        self.points += len(points)
        shown = self._about.outputs(self._simulator, [{**self.candidate.form, **point} for point in points])
        changes = [y[:, COMPARED] - quiet for y, quiet in zip(shown, self._quiet, strict=True)]
        for change, speed in zip(changes, self._speed, strict=True):
            change[:, 1, np.abs(change[:, 1]).max(axis=0) <= ROUNDING * speed] = 0.0
        return self._about.change(changes)

    def sharp(self, shape, axes: Mapping[str, list[float]]) -> bool:
        """Whether neighbours on the axis of the only size look different: a resonance, or a threshold, shows where it is.

        What they change is kept until the next shape's: the grid is of the same points.
        """
        ((name, values),) = axes.items()
        points = [shape | {name: v} for v in sorted(values) if v * self.candidate.probe[name] > 0.0]
        self._known = {}
        places = (tuple(point.values()) for point in points)
        rows = (row for changed in self._changed(points) for row in np.ascontiguousarray(changed.T))
        self._known = dict(zip(places, rows, strict=True))
        traces = list(self.at(points).T.copy())
        powers = [float(t @ t) for t in traces]
        alike = [(t @ u) ** 2 > SHARP * p * q for t, u, p, q in zip(traces, traces[1:], powers, powers[1:], strict=False)]
        return not all(alike)

    def stepwise(self, shape) -> bool:
        """Whether what is shown has no tangent in the sizes, wherever they stand: a threshold."""
        return not any(self.tangents(shape | {n: v}).any() for n in self.candidate.sizes for v in self.candidate.axis(n))

    def limited(self, shape, name: str) -> bool:
        """Whether a size is a level that these records reach, in this form."""
        levels, others, off = self.candidate.levels.get(name), shape | self.candidate.probe, self.candidate.off[name]
        if levels is None:
            return False
        least, none = self.at([others | {name: min(levels)}, others | {name: off}]).T
        return not np.array_equal(least, none)

    def followed(self, point) -> dict[str, float]:
        """Where the fitted parameters go with the candidate at `point`."""
        return self._about.followed(self._about.rows(self._simulator, [{**self.candidate.form, **point}])[:, 0])

    def rounding(self) -> Rounding:
        """What goes with the step of a candidate that rounds a command."""
        look = Rounding(self._about, self._simulator, self.candidate.effect, self._about.records)
        self.points += look.points
        return look

    def tangents(self, point) -> np.ndarray:
        """(rows, sizes)"""
        return self._about.orthogonal_part(self._about.columns(self._simulator, {**self.candidate.form, **point}))
