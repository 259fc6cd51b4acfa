"""Group score tests beside a fit: what a group of columns could gain if the fitted parameters follow, in all and held out.

With C the group's columns less what the parameters can follow, r the residual: the fall is r'C (C'C)^-1 C'r / 2, under noise
alone half a chi^2 of as many degrees of freedom as C has directions. Held out, the shares of each third of the records come
from the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identification.diagnose.crossval import contiguous_folds, informed_inverse
from identification.diagnose.learned.columns import Course
from identification.fit.linearised import Linearised

DEPENDENT = 1e-3
"""Size of a direction over that of the strongest below which columns count as the same one."""


TOLD = 0.1
"""Share of what all data tell of a direction that two thirds must tell for it to be learned from them."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A group's outcome. `fall` of half the sum of squares; `held_out`: log-likelihood gained on folds left out; `rank`;
    `shares` (k,) of the columns as given."""

    fall: float
    held_out: float
    rank: int
    shares: np.ndarray


class Scores:
    """Score tests beside a linearised fit, on the experiments' courses."""

    def __init__(self, about: Linearised, columns: np.ndarray, courses: Sequence[Course], scale: Mapping[str, float], times):
        """`columns` (rows, n): the fitted parameters' sensitivities; `scale` divides each channel's; `times`: as of
        a Problem."""
        self.courses, self._scale = courses, scale
        fold = np.concatenate([contiguous_folds(time, seconds) for time, seconds in times])
        self._folds = range(int(fold.max()) + 1)
        sizes = [c.experiment.sizes["thrust"] for c in courses]
        sizes += [len(c.experiment.omega_time) for c in courses if len(c.experiment.omega_time)]
        self._slices = np.split(np.arange(len(fold)), np.cumsum(sizes)[:-1])
        self._fold, self._columns, self._residual = fold, columns, about.residual
        self._inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True)
        both = [np.column_stack([columns[fold == k], about.residual[fold == k]]) for k in self._folds]
        products = [each.T @ each for each in both]
        self._squares = [float(p[-1, -1]) for p in products]
        self._inner, self._against = [p[:-1, :-1] for p in products], [p[:-1, -1] for p in products]
        self._parts = {heard: self._part(heard) for heard in (False, True)}

    def _part(self, heard: bool):
        """Of the rows that a response reaches, fold by fold: (order, ends of the folds, sensitivities beside the residual)."""
        places = np.concatenate(self._slices if heard else self._slices[: len(self.courses)])
        order = np.argsort(self._fold[places], kind="stable")
        ends = np.searchsorted(self._fold[places][order], np.arange(len(self._folds) + 1))
        own = places[order]
        return order, ends, np.column_stack([self._columns[own], self._residual[own]])

    def products(self, responses: Sequence[tuple[np.ndarray, np.ndarray | None]]) -> tuple[np.ndarray, np.ndarray]:
        """(Gram (folds, k, k), products with the residual (folds, k)) of columns less what the parameters can follow, for the
        courses' responses: (thrust (blocks, k), speed (blocks, k) or None)."""
        pairs = list(zip(self.courses, responses, strict=True))
        rows = [c.experiment.white_thrust(thrust) / self._scale["thrust"] for c, (thrust, _) in pairs]
        heard = responses[0][1] is not None and len(self._slices) > len(self.courses)
        if heard:
            rows += [c.speed_rows(speed) / self._scale["omega"] for c, (_, speed) in pairs if len(c.experiment.omega_time)]
        order, ends, known = self._parts[heard]
        rows = np.concatenate(rows)[order]
        folds = [slice(first, last) for first, last in pairwise(ends)]
        against = [rows[at].T @ known[at] for at in folds]  # (k, parameters + 1) of each fold
        follow = self._inverse @ sum(against)[:, :-1].T
        gram, product = [], []
        for k, at in enumerate(folds):
            cross = against[k][:, :-1] @ follow
            gram.append(rows[at].T @ rows[at] - cross - cross.T + follow.T @ self._inner[k] @ follow)
            product.append(against[k][:, -1] - follow.T @ self._against[k])
        return np.array(gram), np.array(product)

    def group(self, gram: np.ndarray, product: np.ndarray) -> Scored:
        """The test of a group by its products."""
        whole = gram.sum(axis=0)
        size = np.sqrt(np.maximum(np.diag(whole), 0.0))
        if not size.max(initial=0.0) > 0.0:
            return Scored(0.0, 0.0, 0, np.zeros(len(size)))
        size = np.where(size > 1e-9 * size.max(), size, np.inf)
        gram, product = gram / np.outer(size, size), product / size
        whole = gram.sum(axis=0)
        shares, rank = _solved(whole, -product.sum(axis=0))
        left, total = 0.0, sum(self._squares)
        for k in self._folds:
            other = informed_inverse(whole - gram[k], whole, TOLD) @ (product[k] - product.sum(axis=0))
            left += self._squares[k] + 2.0 * float(other @ product[k]) + float(other @ gram[k] @ other)
        held = 0.5 * len(self._fold) * float(np.log(total / max(left, 1e-300)))
        return Scored(-0.5 * float(shares @ product.sum(axis=0)), held, rank, shares / size)


def _solved(gram: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, int]:
    """(least-squares solution, rank) without the directions that are hardly there."""
    power, axes = np.linalg.eigh(gram)
    kept = power > DEPENDENT * power[-1]
    return axes[:, kept] @ ((axes[:, kept].T @ right) / power[kept]), int(kept.sum())
