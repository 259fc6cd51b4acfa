"""A cheap look from a fitted model at what each candidate could explain, to choose which are worth a full refit.

The fitted parameters may move along their sensitivities. Where an effect's trace is proportional to its sizes, one run with
tangents tells the best ones; elsewhere a grid of sizes is tried, all combinations of two, or one after the other of more.
"""

from collections.abc import Iterable
from itertools import product

import numpy as np

from identification.diagnose.candidates import Candidate
from identification.diagnose.linearised import Linearised
from identification.diagnose.search import Fit
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator

STRETCH = (0.7, 1.4)
"""How far a trace may be scaled between the sizes of the grid, which are a factor of 2 apart."""

PROPORTIONAL = 0.03
"""Share of an effect's trace by which it may depart from its tangent and still pass for proportional."""


class Look:
    """The look from one fit."""

    def __init__(self, base: Fit, library: Iterable[Effect]):
        self._base, self._library = base, tuple(library)
        self._about = Linearised(base.evidence, base.solution, base.values)

    def at(self, candidate: Candidate) -> tuple[float, dict[str, float]]:
        """Fall of the half sum of squares at the best point found, and where: the candidate's free parameters, and the fitted
        ones once they have followed."""
        model = plant([*self._base.effects, candidate.name], self._library)
        trace = _Trace(self._about, Simulator(model), Simulator(model, candidate.sizes), candidate)
        found = [self._proportional(trace, shape) or self._grid(trace, shape) for shape in candidate.shapes()]
        fall, point = max(found, key=lambda pair: pair[0])
        return fall, trace.followed(point) | point

    def _proportional(self, trace: "_Trace", shape) -> tuple[float, dict[str, float]] | None:
        """The best sizes of a trace that goes with them; None where it does not."""
        columns, probe = trace.tangents(shape), trace.candidate.probe
        shown = trace.at(shape | probe)
        off = trace.candidate.off
        straight = columns @ np.array([probe[n] - off[n] for n in trace.candidate.sizes])
        if not np.any(shown) or np.linalg.norm(shown - straight) > PROPORTIONAL * np.linalg.norm(shown):
            return None
        free, *_ = np.linalg.lstsq(columns, -self._about.residual, rcond=1e-9)
        sizes = trace.candidate.within({n: off[n] + v for n, v in zip(trace.candidate.sizes, free, strict=True)})
        left = self._about.residual + columns @ np.array([sizes[n] - off[n] for n in trace.candidate.sizes])
        fall = 0.5 * float(self._about.residual @ self._about.residual - left @ left)
        return max(fall, 0.0), shape | sizes

    def _grid(self, trace: "_Trace", shape) -> tuple[float, dict[str, float]]:
        axes = {n: trace.candidate.axis(n) for n in trace.candidate.sizes}
        if len(axes) <= 2:
            points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
            return max((self._fall(trace, shape | point) for point in points), key=lambda pair: pair[0])
        best = 0.0, shape | trace.candidate.off
        for _ in range(2):
            for name, values in axes.items():
                tries = [self._fall(trace, best[1] | {name: v}) for v in values]
                best = max([best, *tries], key=lambda pair: pair[0])
        return best if best[0] > 0.0 else (0.0, shape | trace.candidate.probe)

    def _fall(self, trace: "_Trace", point) -> tuple[float, dict[str, float]]:
        shown = trace.at(point)
        power = float(shown @ shown)
        if power == 0.0:
            return 0.0, point
        shared = -float(self._about.residual @ shown)
        stretch = float(np.clip(shared / power, *STRETCH))
        sizes = trace.candidate.within({n: point[n] * stretch for n, v in trace.candidate.off.items() if v == 0.0})
        return stretch * shared - 0.5 * stretch**2 * power, point | sizes


class _Trace:
    """What a candidate adds to the residual that the fitted parameters can't follow, as a function of its parameters."""

    def __init__(self, about: Linearised, simulator: Simulator, tangents: Simulator, candidate: Candidate):
        self.candidate, self._about, self._simulator, self._tangents = candidate, about, simulator, tangents
        self._quiet = about.rows(simulator, {**candidate.form, **candidate.off})

    def at(self, point) -> np.ndarray:
        """(rows,)"""
        return self._about.apart(self._about.rows(self._simulator, {**self.candidate.form, **point}) - self._quiet)

    def followed(self, point) -> dict[str, float]:
        """Where the fitted parameters go with the candidate at `point`."""
        return self._about.followed(self._about.rows(self._simulator, {**self.candidate.form, **point}))

    def tangents(self, shape) -> np.ndarray:
        """(rows, sizes) at the point where the effect is off."""
        return self._about.apart(self._about.columns(self._tangents, {**self.candidate.form, **shape, **self.candidate.off}))
