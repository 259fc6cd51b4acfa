"""The search for a plan: segments put together by what each tells alone, then exchanged by what the whole tells.

    minimise  trace (F_known + F_plan + 1)^-1,   in relative units: the sum of the parameters' relative variances

A-optimal rather than E-optimal: the weakest direction holds the largest part of the trace, so it is what shrinks first; but
the trace stays smooth where two directions become equally weak, and goes on with all others once the weakest is as good as
it gets. The 1 says that no parameter is worse known than by its own size: without it the search would spend itself on what no
experiment of this length tells.
"""

from itertools import pairwise

import numpy as np
from tqdm import tqdm

from identification.assessment.information import Information
from identification.fit.problem import Prior
from identification.plan.excitation import candidate, variant
from vpp_fmu.commands import commanded
from vpp_fmu.errors import NotIdentifiable
from vpp_fmu.rig import Rig

SEGMENT = 10.0
"""Length of the pieces that a plan is put together from, in time scales: several times the plant's memory. 4 and 20 do as
well."""

GRID = 0.04
"""Targets change on this grid, in time scales, and the search looks at it only. 0.016 and 0.08 give plans as good."""

POOL, ROUNDS = 400, 3
"""Segments to choose from; times that each segment of the plan is tried anew."""

FLAT = 1e3
"""A relative standard deviation above this means that the response has no slope in the parameter."""


def criterion(information: np.ndarray) -> np.ndarray:
    """The sum of relative variances for matrices of relative information (..., n, n)."""
    return np.trace(np.linalg.inv(information + np.eye(information.shape[-1])), axis1=-2, axis2=-1)


class Search:
    """A plan of `seconds` in the making: `targets` (rows, 2) on a grid of `step` seconds, for what `information` covers.
    Commands will come every `fine` seconds."""

    def __init__(
        self,
        information: Information,
        rig: Rig,
        fine: float,
        seconds: float,
        knowledge: Prior | None,
        rng: np.random.Generator,
    ):
        self.information, self.rig, self.knowledge, self.rng = information, rig, knowledge, rng
        self._fold, self._fine = max(1, round(GRID * rig.scales.time_scale / fine)), fine
        self.step = self._fold * fine
        self._fine_rows = round(seconds / fine) + 1
        rows = -(-self._fine_rows // self._fold)
        segments = max(3, round(seconds / (SEGMENT * rig.scales.time_scale)))
        self._edges = np.linspace(0, rows, segments + 1).round().astype(int)
        self.targets = np.empty((rows, 2))

    @property
    def known(self) -> np.ndarray:
        """Information (n, n) there is beforehand."""
        return self.information.known(self.knowledge)

    def of(self, targets: np.ndarray) -> np.ndarray:
        """Information (n, n) with these targets (any rows, 2) carried out."""
        return self.known + self.information.of(commanded(self.rig, targets, self.step), self.step)

    def assemble(self) -> None:
        """Take segments from a pool greedily, then exchange until no exchange helps: as if they did not touch in time."""
        length, count = int(np.diff(self._edges).max()), len(self._edges) - 1
        pool = [candidate(self.rng, length, self.step, self.rig) for _ in range(POOL)]
        alone = np.array([self.of(segment) for segment in tqdm(pool, desc="segments", disable=None, leave=False)]) - self.known
        chosen, total = [], self.known
        for _ in range(count):
            chosen.append(int(np.argmin(criterion(total + alone))))
            total = total + alone[chosen[-1]]
        moved = True
        while moved:
            moved = False
            for k in range(count):
                rest = total - alone[chosen[k]]
                tried = criterion(rest + alone)
                best = int(np.argmin(tried))
                if tried[best] < tried[chosen[k]] * (1.0 - 1e-6):
                    chosen[k], total, moved = best, rest + alone[best], True
        for k, (start, end) in enumerate(pairwise(self._edges)):
            self.targets[start:end] = pool[chosen[k]][: end - start]

    def give_up(self) -> dict[str, str]:
        """Leave out, the worst first, what the plan would not tell to within its own size: name -> why."""
        reasons = {}
        while True:
            names, relative = self.information.names, self.information.forecast(self.of(self.targets)).relative
            worst = int(np.argmax(relative))
            if relative[worst] <= 1.0:
                return reasons
            reasons[names[worst]] = (
                "to first order the response does not change with it"
                if relative[worst] > FLAT
                else f"such an experiment would leave it uncertain by {relative[worst]:.1f} times its size"
            )
            if len(names) == 1:
                raise NotIdentifiable(
                    f"{self.information.model.name}: no commands within these ranges and this time tell anything"
                )
            self.information = self.information.only([n for n in names if n != names[worst]])

    def improve(self, evaluations: int) -> None:
        """Segment after segment: try others, and small changes, and keep what makes the whole plan better."""
        best = criterion(self.of(self.targets))
        tries = max(1, evaluations // (ROUNDS * (len(self._edges) - 1)))
        places = [at for _ in range(ROUNDS) for at in pairwise(self._edges) for _ in range(tries)]
        for start, end in tqdm(places, desc="plan", disable=None, leave=False):
            new = self.targets.copy()
            if self.rng.random() < 0.5:
                new[start:end] = candidate(self.rng, end - start, self.step, self.rig)
            else:
                new[start:end] = variant(self.rng, self.targets[start:end], self.step, self.rig)
            value = criterion(self.of(new))
            if value < best:
                best, self.targets = value, new

    def commands(self) -> np.ndarray:
        """The plan as commands (rows, 2), one row every sample."""
        return commanded(self.rig, self.targets.repeat(self._fold, axis=0)[: self._fine_rows], self._fine)
