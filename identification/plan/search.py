"""Search an A-optimal plan: select segments by their separate information matrices, then exchange them by that of the plan.

    minimise  trace (F_known + F_plan + 1)^-1,   in relative units: the sum of the parameters' relative variances

The weakest direction has the largest part of the trace, so it decreases first, as in an E-optimal design. But the trace stays
smooth if two directions become equally weak, and it includes all other directions. The 1 is a prior: each parameter is known to
within its own size. Without it the search would favour parameters that no experiment of this length can identify.
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
"""Length of a segment, in time scales: several times the settling time. 4 and 20 give equally good plans."""

GRID = 0.04
"""Grid of targets and of the search, in time scales. 0.016 and 0.08 give equally good plans."""

POOL, ROUNDS = 400, 3
"""Number of candidate segments; number of rounds over the segments of the plan."""

FLAT = 1e3
"""A relative standard deviation above this means that the response's sensitivity to the parameter is zero."""


def criterion(information: np.ndarray) -> np.ndarray:
    """Sum of relative variances for relative information matrices (..., n, n)."""
    return np.trace(np.linalg.inv(information + np.eye(information.shape[-1])), axis1=-2, axis2=-1)


class PlanSearch:
    """Search of a plan of `seconds`: `targets` (rows, 2) on a grid of `step` seconds, for the parameters of `information`.
    Commands have a period of `fine` seconds."""

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
        """Prior information matrix (n, n)."""
        return self.information.known(self.knowledge)

    def of(self, targets: np.ndarray) -> np.ndarray:
        """Information matrix (n, n) of the prior and these targets (any rows, 2)."""
        return self.known + self.information.of(commanded(self.rig, targets, self.step), self.step)

    def assemble(self) -> None:
        """Select segments from a pool greedily, then exchange until no exchange improves; as if segments were independent."""
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
        """Remove parameters, the worst first, whose standard deviation exceeds their own size: name -> reason."""
        reasons = {}
        while True:
            names, relative = self.information.names, self.information.forecast(self.of(self.targets)).relative
            worst = int(np.argmax(relative))
            if relative[worst] <= 1.0:
                return reasons
            reasons[names[worst]] = (
                "to first order the response does not depend on it"
                if relative[worst] > FLAT
                else f"after such an experiment its standard deviation is {relative[worst]:.1f} times its size"
            )
            if len(names) == 1:
                raise NotIdentifiable(
                    f"{self.information.model.name}: with commands in these ranges and this time no parameter is identifiable"
                )
            self.information = self.information.only([n for n in names if n != names[worst]])

    def improve(self, evaluations: int) -> None:
        """Try new segments and variants for each segment in turn; keep those that improve the whole plan."""
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
        """The plan as commands (rows, 2), one row per sample."""
        return commanded(self.rig, self.targets.repeat(self._fold, axis=0)[: self._fine_rows], self._fine)
