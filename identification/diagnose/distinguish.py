"""What these commands can show at all, and what they can tell apart: computed before anything is attributed.

Each candidate is switched on at its plausible size over the identified model, on the user's own commands. What of its trace
the base parameters can't follow is what could be seen; two candidates whose such traces are parallel can't be told apart.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator

PARALLEL = 0.9
"""Squared cosine above which one trace passes for the other."""


@dataclass(frozen=True)
class Distinguishability:
    """`labels` (n,): candidates; `visibility` (n,): log-likelihood that each would gain at its plausible size;
    `overlap` (n, n): squared cosine of what the base can't follow of each."""

    labels: tuple[str, ...]
    visibility: np.ndarray
    overlap: np.ndarray

    def invisible(self, enough: float = 10.0) -> list[str]:
        """Candidates that would not show at their plausible size."""
        return [name for name, v in zip(self.labels, self.visibility, strict=True) if v < enough]

    def alike(self, enough: float = 10.0) -> list[tuple[str, str, float]]:
        """Pairs of visible candidates of different name that can't be told apart, the closest first."""
        pairs = []
        for i, a in enumerate(self.labels):
            for j in range(i):
                b = self.labels[j]
                visible = min(self.visibility[i], self.visibility[j]) >= enough
                if visible and self.overlap[i, j] >= PARALLEL and a.split(" ")[0] != b.split(" ")[0]:
                    pairs.append((b, a, float(self.overlap[i, j])))
        return sorted(pairs, key=lambda pair: -pair[2])


def distinguishability(
    base: Fit, options: Sequence[Candidate], library: Iterable[Effect], spread: Callable = map
) -> Distinguishability:
    """Traces of all candidates at their probe sizes. `spread` maps a function over candidates, as `map` does."""
    about, library = base.linearised(), tuple(library)

    def trace(candidate: Candidate) -> np.ndarray:
        effect = candidate.effect
        # The looks ask for the same tangents: compiled once.
        simulator = Simulator(plant([*base.effects, effect.name], library), candidate.sizes)
        off = {effect.full(n): v for n, v in effect.off.items()}
        on = {effect.full(n): v for n, v in effect.probe.items()}
        there, without = about.rows(simulator, [{**candidate.form, **on}, {**candidate.form, **off}]).T
        return about.orthogonal_part(there - without)

    traces = np.empty((len(options), base.problem.size))
    for row, shown in zip(traces, spread(trace, options), strict=True):
        row[:] = shown
    gram = traces @ traces.T
    size = np.sqrt(np.diag(gram))
    overlap = (gram / np.where(np.outer(size, size) > 0, np.outer(size, size), np.inf)) ** 2
    return Distinguishability(tuple(c.label for c in options), 0.5 * np.diag(gram), overlap)
