"""Screening: predict the gain of each candidate beside a fitted model, to choose the candidates for a refit.

The fitted parameters are linearised. If an effect's response is proportional to its sizes, one simulation with sensitivities
gives the best sizes. Else a grid is searched: all combinations of two sizes, or one size after the other.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.rounding import Rounding
from identification.diagnose.search.threshold import divided
from identification.fit.linearised import Linearised
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.tracer import LANES

STRETCH = (0.7, 1.4)
"""Range of the factor by which a response is scaled between grid sizes, whose ratio is 2."""

PROPORTIONAL = 0.03
"""Relative deviation of a response from its tangent up to which it counts as proportional."""

SHARP = 0.7
"""Minimum squared cosine of the responses to two sizes of ratio 2. Below it a grid of this ratio is too coarse."""

ROUNDING = 1e-9
"""Relative difference of speeds that counts as equal: two compiled models round differently."""

COMPARED = slice(2)
"""Outputs of a model that are compared: thrust and speed."""

CLOSER = 3
"""Gauss-Newton steps from the best point of a grid of several sizes. The optimum of an effect that acts in one corner only lies
between points."""


@dataclass(frozen=True)
class ScreeningResult:
    """Predicted gain of a candidate: decrease `likelihood_gain` of half the sum of squares, at `values` of all free parameters;
    `points`: number of computed points."""

    likelihood_gain: float
    values: Mapping[str, float]
    points: int


class Screening:
    """Screens candidates beside one fit."""

    def __init__(self, fit: Fit, library: Iterable[Effect]):
        self._about, self._effects, self._library = fit.linearised(), fit.effects, tuple(library)
        self._cost = 0.5 * float(self._about.residual @ self._about.residual)

    def at(self, candidate: Candidate) -> ScreeningResult:
        """The best result for a candidate, with the fitted parameters re-estimated."""
        model = plant([*self._effects, candidate.name], self._library)
        simulator = Simulator(model, [*self._about.names, *candidate.free])  # a first look at the candidate uses the same one
        response = _Response(self._about, simulator, candidate)
        found = [self._proportional(response, shape) or self._grid(response, shape) for shape in candidate.shapes()]
        gain, point = max(found, key=lambda pair: pair[0])
        return ScreeningResult(gain, response.re_estimated(point) | point, response.points)

    def _proportional(self, response: "_Response", shape) -> tuple[float, dict[str, float]] | None:
        """The best sizes of a proportional response; None if it is not proportional."""
        candidate, columns = response.candidate, response.tangents(shape | response.candidate.off)
        (shown,), off = response.at([shape | candidate.probe]).T, candidate.off
        straight = columns @ np.array([candidate.probe[n] - off[n] for n in candidate.sizes])
        if not np.any(shown) or np.linalg.norm(shown - straight) > PROPORTIONAL * np.linalg.norm(shown):
            return None
        free, *_ = np.linalg.lstsq(columns, -self._about.residual, rcond=1e-9)
        sizes = candidate.within({n: off[n] + v for n, v in zip(candidate.sizes, free, strict=True)})
        return self._gain(columns @ np.array([sizes[n] - off[n] for n in candidate.sizes])), shape | sizes

    def _grid(self, response: "_Response", shape) -> tuple[float, dict[str, float]]:
        candidate = response.candidate
        if candidate.effect.rounds:
            return self._rounded(response)
        axes = {n: candidate.axis(n) for n in candidate.sizes}
        if len(axes) == 1 and response.sharp(shape, axes):
            if response.stepwise(shape):
                return self._divided(response, shape)
            axes = {n: candidate.fine_axis(n) for n in axes}
        if len(axes) == 2:  # a speed limit is sharp: the speed is measured precisely
            axes |= {n: candidate.fine_axis(n) for n in axes if response.limited(shape, n)}
        if len(axes) <= 2:
            points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
            best = self._best(response, [shape | point for point in points])
            return best if len(axes) == 1 else self._closer(response, best)
        best = -np.inf, shape | candidate.off
        for _ in range(2):
            for name, values in axes.items():
                best = max(best, self._best(response, [best[1] | {name: v} for v in values]), key=lambda pair: pair[0])
        return self._closer(response, best)

    def _rounded(self, response: "_Response") -> tuple[float, dict[str, float]]:
        """The best step of an effect that rounds a command."""
        rounding = response.rounding()
        points = [{rounding.name: step} for step in rounding.best()]
        return max(((self._gain(response.at([point])[:, 0]), point) for point in points), key=lambda pair: pair[0])

    def _divided(self, response: "_Response", shape) -> tuple[float, dict[str, float]]:
        """The best value of a threshold."""
        (name,) = response.candidate.sizes
        residual = self._about.residual[:, None]
        costs = divided(
            lambda values: residual + response.at([shape | {name: v} for v in values]), response.candidate.fine_axis(name)
        )
        best = min(costs, key=costs.__getitem__)
        return self._cost - costs[best], shape | {name: best}

    def _closer(self, response: "_Response", best: tuple[float, dict[str, float]]) -> tuple[float, dict[str, float]]:
        """A few Gauss-Newton steps from the best point of a grid of several sizes."""
        candidate, (gain, point) = response.candidate, best
        for _ in range(CLOSER):
            residual = self._about.residual + response.at([point])[:, 0]
            step, *_ = np.linalg.lstsq(response.tangents(point), -residual, rcond=1e-9)
            new = point | candidate.within({n: point[n] + d for n, d in zip(candidate.sizes, step, strict=True)})
            if (new_gain := self._gain(response.at([new])[:, 0])) <= gain:
                break
            gain, point = new_gain, new
        return gain, point

    def _best(self, response: "_Response", points: Sequence) -> tuple[float, dict[str, float]]:
        """(gain, point) of the best point, its sizes scaled within STRETCH."""
        best = -np.inf, {}
        for point, (along, power) in zip(points, response.products(points), strict=True):
            stretch = float(np.clip(-along / power, *STRETCH)) if power else 1.0
            gain = -stretch * (along + 0.5 * stretch * power)
            if gain > best[0]:
                sizes = {n: point[n] * stretch for n, v in response.candidate.off.items() if v == 0.0}
                best = gain, point | response.candidate.within(sizes)
        return best

    def _gain(self, shown: np.ndarray) -> float:
        residual = self._about.residual + shown
        return self._cost - 0.5 * float(residual @ residual)


class _Response:
    """Response of the residual to a candidate's parameters, orthogonal to the sensitivities of the fitted parameters."""

    def __init__(self, about: Linearised, simulator: Simulator, candidate: Candidate):
        self.candidate, self._about, self._simulator = candidate, about, simulator
        baseline = about.outputs(simulator, [{**candidate.form, **candidate.off}])
        self._baseline = [shown[:, COMPARED] for shown in baseline]
        self._speed = [np.abs(shown[:, 1]).max() for shown in baseline]
        self._products: dict[tuple[float, ...], tuple[float, float]] = {}
        self.points = 0

    def at(self, points: Sequence) -> np.ndarray:
        """(rows, points)"""
        return np.hstack([self._about.orthogonal_part(changed) for _, changed in self._changed(points)])

    def products(self, points: Sequence) -> list[tuple[float, float]]:
        """Inner products of the response at each point with the residual and with itself."""
        for part, changed in self._changed([p for p in points if tuple(p.values()) not in self._products]):
            self._keep(part, *self._about.products(changed))
        return [self._products[tuple(point.values())] for point in points]

    def _keep(self, points: Sequence, along: np.ndarray, power: np.ndarray) -> None:
        keys = (tuple(point.values()) for point in points)
        self._products |= zip(keys, zip(along.tolist(), power.tolist(), strict=True), strict=True)

    def _changed(self, points: Sequence) -> Iterator[tuple[Sequence, np.ndarray]]:
        """Up to LANES points, and the change (rows, points) of the scaled residual against the candidate switched off."""
        for first in range(0, len(points), LANES):
            part = points[first : first + LANES]
            self.points += len(part)
            shown = self._about.outputs(self._simulator, [{**self.candidate.form, **point} for point in part])
            changes = [y[:, COMPARED] - baseline for y, baseline in zip(shown, self._baseline, strict=True)]
            for change, speed in zip(changes, self._speed, strict=True):
                change[:, 1, np.einsum("ij,ij->j", change[:, 1], change[:, 1]) <= (ROUNDING * speed) ** 2] = 0.0
            yield part, self._about.change(changes)

    def sharp(self, shape, axes: Mapping[str, list[float]]) -> bool:
        """Whether responses of neighbours on the axis of the only size differ in shape, as of a resonance or a threshold."""
        ((name, values),) = axes.items()
        points = [shape | {name: v} for v in sorted(values) if v * self.candidate.probe[name] > 0.0]
        traces = np.ascontiguousarray(self.at(points).T)
        powers = np.einsum("ij,ij->i", traces, traces)
        self._keep(points, traces @ self._about.residual, powers)
        along = np.einsum("ij,ij->i", traces[1:], traces[:-1])
        return not bool(np.all(along**2 > SHARP * powers[1:] * powers[:-1]))

    def stepwise(self, shape) -> bool:
        """Whether the response has no sensitivity to the sizes at any value: a threshold."""
        return not any(self.tangents(shape | {n: v}).any() for n in self.candidate.sizes for v in self.candidate.axis(n))

    def limited(self, shape, name: str) -> bool:
        """Whether a size is a limit that these records reach, in this form."""
        levels, others, off = self.candidate.levels.get(name), shape | self.candidate.probe, self.candidate.off[name]
        if levels is None:
            return False
        least, none = self.at([others | {name: min(levels)}, others | {name: off}]).T
        return not np.array_equal(least, none)

    def re_estimated(self, point) -> dict[str, float]:
        """Fitted parameters, re-estimated with the candidate at `point`."""
        return self._about.followed(self._about.rows(self._simulator, [{**self.candidate.form, **point}])[:, 0])

    def rounding(self) -> Rounding:
        """Cost as a function of the step, of a candidate that rounds a command."""
        rounding = Rounding(self._about, self._simulator, self.candidate.effect, self._about.records)
        self.points += rounding.points
        return rounding

    def tangents(self, point) -> np.ndarray:
        """(rows, sizes)"""
        columns = self._about.columns(self._simulator, {**self.candidate.form, **point}, self.candidate.sizes)
        return self._about.orthogonal_part(columns)
