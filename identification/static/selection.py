"""Selection of terms of the static map: every subset of the candidates, and the rank of the paper's five."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from identification.static.static_map import TERMS, Regression, check_enough, regression
from vpp_fmu.campaign import StaticMap

CANDIDATES = tuple((i, j) for degree in range(1, 5) for j in range(degree) for i in (degree - j,))
"""Powers (i, j) of w and b up to degree four together; i >= 1, because thrust is 0 at standstill."""

PAPER = tuple(sorted(TERMS.values()))

CRITERIA = ("bic", "r2_adjusted", "loo")


@dataclass(frozen=True)
class Choice:
    """A fitted subset of the candidates: powers and normalised coefficients (k,), with its criteria.

    `bic`; `loo`: leave-one-out root mean square error [N]; `r2_adjusted`. Small `bic` and `loo` and large `r2_adjusted` are
    better.
    """

    terms: tuple[tuple[int, int], ...]
    coefficients: tuple[float, ...]
    bic: float
    r2_adjusted: float
    loo: float

    @property
    def name(self) -> str:
        """The terms as the paper names their coefficients: c20 c11 ..."""
        return " ".join(f"c{i}{j}" for i, j in self.terms)

    def score(self, criterion: str) -> float:
        """Value to minimise for the criterion, one of CRITERIA."""
        value = getattr(self, criterion)
        return -value if criterion == "r2_adjusted" else value


@dataclass(frozen=True)
class Selection:
    """Every subset that `points` steady points identify; `criterion` is one of CRITERIA."""

    tried: tuple[Choice, ...]
    points: int

    def best(self, criterion: str = "bic") -> Choice:
        """The best of all."""
        return min(self.tried, key=lambda c: c.score(criterion))

    def best_of_each_size(self, criterion: str = "bic") -> tuple[Choice, ...]:
        """The best subset of one term, of two, ..."""
        sizes = sorted({len(c.terms) for c in self.tried})
        return tuple(min((c for c in self.tried if len(c.terms) == size), key=lambda c: c.score(criterion)) for size in sizes)

    def of(self, terms=PAPER) -> Choice | None:
        """The subset of these terms, by default the paper's; None if the points do not identify it."""
        return next((c for c in self.tried if set(c.terms) == set(terms)), None)

    def rank(self, choice: Choice, criterion: str = "bic", same_size: bool = True) -> int:
        """Rank of a subset, from 1, among those of its size or among all."""
        rivals = (c for c in self.tried if not same_size or len(c.terms) == len(choice.terms))
        return 1 + sum(c.score(criterion) < choice.score(criterion) for c in rivals)

    def rows(self, criterion: str = "bic") -> list[tuple[int, str, float, float, float]]:
        """(size, terms, BIC, adjusted R^2, leave-one-out rmse [N]): a table of the best of each size, then the paper's."""
        shown = [(c, c.name) for c in self.best_of_each_size(criterion)]
        paper = self.of()
        if paper is not None:
            shown.append((paper, f"{paper.name} (the paper's)"))
        return [(len(c.terms), name, c.bic, c.r2_adjusted, c.loo) for c, name in shown]


def select_terms(static: StaticMap, scales: Mapping[str, float], pitch: tuple[float, float] | None = None) -> Selection:
    """Fit every subset of CANDIDATES to the steady points inside `pitch` [deg] (None: all), weighted as `fit_static_map` does.

    BIC = n ln(S / n) + k ln n, S the weighted residual sum of squares (Schwarz, 1978; variance unknown); adjusted R^2 as in
    `StaticFit`; leave-one-out errors are exactly e / (1 - h), with h the point's leverage (Allen's PRESS, 1974). A shift of b
    mixes powers, so the result is valid only for the `beta_offset` in `scales`. The paper's five in degrees (offset 0) also
    need c10 if b starts at -5 deg. BadInput if the points identify no subset of the paper's size.
    """
    whole = regression(static, scales, pitch, CANDIDATES)
    points = len(whole.thrust)
    sizes = range(1, min(len(CANDIDATES), points - 1) + 1)
    tried = [
        choice
        for size in sizes
        for columns in combinations(range(len(CANDIDATES)), size)
        if (choice := _fitted(whole, list(columns), scales["thrust_scale"])) is not None
    ]
    largest = max((len(c.terms) for c in tried), default=0)
    check_enough(static, points, len(PAPER), largest)
    return Selection(tuple(tried), points)


def _fitted(whole: Regression, columns: list[int], newton: float) -> Choice | None:
    """The fit of some of the columns; None if the points do not identify them."""
    a, n, k = whole.terms[:, columns], len(whole.thrust), len(columns)
    q, r = np.linalg.qr(a * whole.weight[:, None])
    steps = np.abs(np.diag(r))
    if steps.min() <= 1e-9 * steps.max():
        return None
    target = whole.thrust * whole.weight
    c = np.linalg.solve(r, q.T @ target)
    residual = whole.thrust - a @ c
    kept = 1.0 - np.sum(q**2, axis=1)
    alone = kept < 1e-9  # a point that alone determines a term has no leave-one-out prediction
    loo = np.where(alone, np.inf, residual / np.where(alone, 1.0, kept))
    # Without noise the residual is rounding error, which further terms would decrease.
    squares = max(float(np.sum((residual * whole.weight) ** 2)), 1e-24 * float(target @ target), 1e-300)
    return Choice(
        terms=tuple(CANDIDATES[column] for column in columns),
        coefficients=tuple(c.tolist()),
        bic=float(n * np.log(squares / n) + k * np.log(n)),
        r2_adjusted=1.0 - float(residual @ residual) / (n - k) / whole.total,
        loo=float(np.sqrt(np.mean(loo**2))) * newton,
    )
