"""Visible and distinguishable effects under the commands of the records, computed before any effect is accepted.

Each candidate is simulated at its plausible size. The part of its response that is orthogonal to the sensitivities of the base
parameters is visible. Two candidates with parallel visible responses are not distinguishable.
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
"""Squared cosine from which two responses count as not distinguishable."""


@dataclass(frozen=True)
class Distinguishability:
    """`labels` (n,): candidates; `visibility` (n,): log-likelihood gain of each at its plausible size; `overlap` (n, n):
    squared cosines of the visible responses."""

    labels: tuple[str, ...]
    visibility: np.ndarray
    overlap: np.ndarray

    def invisible(self, enough: float = 10.0) -> list[str]:
        """Candidates that are not visible at their plausible size."""
        return [name for name, v in zip(self.labels, self.visibility, strict=True) if v < enough]

    def alike(self, enough: float = 10.0) -> list[tuple[str, str, float]]:
        """Pairs of visible candidates of different names that are not distinguishable, the most similar first."""
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
    """Compare the responses of all candidates at their probe sizes. `spread` maps a function over candidates, as `map` does."""
    about, library = base.linearised(), tuple(library)

    def response(candidate: Candidate) -> np.ndarray:
        effect = candidate.effect
        simulator = Simulator(plant([*base.effects, effect.name], library))
        off = {effect.full(n): v for n, v in effect.off.items()}
        on = {effect.full(n): v for n, v in effect.probe.items()}
        there, without = about.rows(simulator, [{**candidate.form, **on}, {**candidate.form, **off}]).T
        return about.orthogonal_part(there - without)

    responses = np.empty((len(options), base.problem.size))
    for row, shown in zip(responses, spread(response, options), strict=True):
        row[:] = shown
    gram = responses @ responses.T
    size = np.sqrt(np.diag(gram))
    overlap = (gram / np.where(np.outer(size, size) > 0, np.outer(size, size), np.inf)) ** 2
    return Distinguishability(tuple(c.label for c in options), 0.5 * np.diag(gram), overlap)
