"""Group score tests beside a fit: predicted gain of a group of columns with the fitted parameters re-estimated, on all data and
cross-validated.

Let C be the group's columns, orthogonal to the sensitivities of the parameters, and r the residual. The gain is
r'C (C'C)^-1 C'r / 2; under noise it is half a chi-square with rank(C) degrees of freedom. For cross-validation, the
coefficients on each third of the records are estimated from the other two.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from identification.diagnose.crossval import contiguous_folds, informed_inverse
from identification.diagnose.learned.columns import Course
from identification.fit.linearised import Linearised

DEPENDENT = 1e-3
"""Eigenvalue relative to the largest below which columns count as linearly dependent."""


@dataclass(frozen=True, eq=False)
class Scored:
    """Result of a group's test. `likelihood_gain`: decrease of half the sum of squares; `held_out`: cross-validated
    log-likelihood gain; `rank`; `shares` (k,): coefficients of the columns."""

    likelihood_gain: float
    held_out: float
    rank: int
    shares: np.ndarray


class Scores:
    """Score tests beside a linearised fit, on the courses of the experiments."""

    def __init__(self, about: Linearised, columns: np.ndarray, courses: Sequence[Course], scale, times, ports: Sequence[str]):
        """`columns` (rows, n): sensitivities of the fitted parameters; `scale`: divisor of each channel; `times`: as in
        Problem; `ports`: names of those that may have a term."""
        self.courses, self._scale, self.ports = courses, scale, ports
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
        self._parts = {with_speed: self._part(with_speed) for with_speed in (False, True)}

    def _part(self, with_speed: bool):
        """Rows that a response changes, sorted by fold: (order, ends of the folds, sensitivities and residual)."""
        places = np.concatenate(self._slices if with_speed else self._slices[: len(self.courses)])
        order = np.argsort(self._fold[places], kind="stable")
        ends = np.searchsorted(self._fold[places][order], np.arange(len(self._folds) + 1))
        own = places[order]
        return order, ends, np.column_stack([self._columns[own], self._residual[own]])

    def products(self, responses: Sequence[tuple[np.ndarray, np.ndarray | None]]) -> tuple[np.ndarray, np.ndarray]:
        """(Gram (folds, k, k), products with the residual (folds, k)) of columns orthogonal to the sensitivities.

        `responses`, one per course: (thrust (blocks, k), speed (blocks, k) or None)."""
        pairs = list(zip(self.courses, responses, strict=True))
        rows = [c.experiment.white_thrust(thrust) / self._scale["thrust"] for c, (thrust, _) in pairs]
        with_speed = responses[0][1] is not None and len(self._slices) > len(self.courses)
        if with_speed:
            rows += [c.speed_rows(speed) / self._scale["omega"] for c, (_, speed) in pairs if len(c.experiment.omega_time)]
        order, ends, known = self._parts[with_speed]
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
        """Test a group from its products."""
        whole = gram.sum(axis=0)
        size = np.sqrt(np.maximum(np.diag(whole), 0.0))
        if not size.max(initial=0.0) > 0.0:
            return Scored(0.0, 0.0, 0, np.zeros(len(size)))
        size = np.where(size > 1e-9 * size.max(), size, np.inf)
        gram, product = gram / np.outer(size, size), product / size
        whole = gram.sum(axis=0)
        shares, rank = _solved(whole, -product.sum(axis=0))
        error, total = 0.0, sum(self._squares)
        for k in self._folds:
            other = informed_inverse(whole - gram[k], whole) @ (product[k] - product.sum(axis=0))
            error += self._squares[k] + 2.0 * float(other @ product[k]) + float(other @ gram[k] @ other)
        gain = 0.5 * len(self._fold) * float(np.log(total / max(error, 1e-300)))
        return Scored(-0.5 * float(shares @ product.sum(axis=0)), gain, rank, shares / size)


def _solved(gram: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, int]:
    """(least-squares solution, rank), without the directions of small eigenvalues."""
    power, axes = np.linalg.eigh(gram)
    kept = power > DEPENDENT * power[-1]
    return axes[:, kept] @ ((axes[:, kept].T @ right) / power[kept]), int(kept.sum())
