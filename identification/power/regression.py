"""Regression of a reading in time on effects of the power, beside a base whose coefficients are free.

Block means are whitened by an autoregression, and the base is projected out. The remaining problem is nonlinear least squares
in the few parameters of the effects.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2

from identification.diagnose.command_shapes import regress_out
from identification.diagnose.crossval import folds, informed_inverse
from identification.diagnose.judgement import ACCURACY
from identification.diagnose.learned.score import ESTIMABLE
from identification.fit.noise import Blocks, Colour, colour_of
from identification.fit.uncertainty import NORMAL_95
from identification.power.effects import PowerEffect, Signals
from identification.power.fit import EXACT
from vpp_fmu.record import Record

SCAN = 1.6
"""Ratio of neighbouring time constants of a scan: a lag loses less than 2 % of its power between two of them."""

STEP = 1e-4
"""Relative step of a derivative."""

RANK = 1e-6
"""Relative singular value below which columns of the base count as collinear."""

NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Part:
    """One reading of one record: `measured` (rows,) and `base` (rows, k), whose coefficients are free; `shapes` that span the
    residual of a missing effect, for the noise and the lack of fit. `largest`: the sensor's largest reading. Block means are
    compared."""

    name: str
    record: Record
    at: Blocks
    measured: np.ndarray
    base: np.ndarray
    signals: Signals
    shapes: Callable[[], Iterator[np.ndarray]]
    largest: float

    @cached_property
    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Block means of the reading (blocks,) and of the base (blocks, k)."""
        return self.at.mean(self.measured), self.at.mean(self.base)

    def mean_response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Block means (blocks,) of `response`."""
        return self.at.mean(self.response(effects, x))

    def response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Change (rows,) of the reading by effects with parameters `x`."""
        total, first = np.zeros(len(self.measured)), 0
        for effect in effects:
            names = [p.name for p in effect.parameters]
            own = dict(zip(names, x[first : first + len(names)].tolist(), strict=True))
            total, first = total + effect.response(self.signals, own), first + len(names)
        return total


class Regression:
    """A reading of all records, whitened by the colour of the noise of each."""

    def __init__(self, parts: Sequence[Part], colours: Sequence[Colour]):
        self.parts, self.colours = parts, colours
        self._seen = [np.isfinite(c.whiten(p.means[0])) for p, c in zip(parts, colours, strict=True)]
        base = self.whitened([p.means[1] for p in parts])
        self.size = np.linalg.norm(base, axis=0)
        self.size[self.size == 0.0] = 1.0
        self.base, self.measured = base / self.size, self.whitened([p.means[0] for p in parts])
        turned, power, _ = np.linalg.svd(self.base, full_matrices=False)
        self.basis = turned[:, power > RANK * power[0]]

    @classmethod
    def of(cls, parts: Sequence[Part], effects: Sequence[PowerEffect] = (), x: np.ndarray = NONE) -> "Regression":
        """With the noise of the residual beside `effects`, after a regression on base and shapes."""
        found = []
        for p in parts:
            residual, fitted = p.measured - p.response(effects, x), np.zeros((len(p.at.time), 0))
            rest, removed = regress_out(lambda p=p: (*p.shapes(), *p.base.T), p.at.mean, residual, fitted)
            colour = colour_of([p.at.mean(rest)], removed)
            found.append(replace(colour, innovation=max(colour.innovation, EXACT * p.largest)))  # readings without noise
        return cls(parts, found)

    @cached_property
    def largest(self) -> float:
        """The largest reading."""
        return max(p.largest for p in self.parts)

    def whitened(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """(n, ...) of block means of each record, where the reading exists."""
        white = [c.whiten(column) for column, c in zip(columns, self.colours, strict=True)]
        return np.concatenate([w[seen] for w, seen in zip(white, self._seen, strict=True)])

    def rows_of(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """(n,) of the blocks of each record, at the whitened rows."""
        return np.concatenate([v[len(v) - len(seen) :][seen] for v, seen in zip(values, self._seen, strict=True)])

    def orthogonal(self, columns: np.ndarray) -> np.ndarray:
        """Part of columns (n, ...) that the base does not span."""
        return columns - self.basis @ (self.basis.T @ columns)

    def fit(self, effects: Sequence[PowerEffect] = (), start: np.ndarray = NONE) -> "RegressionFit":
        """Least squares of effects beside the base, from a `start` of their parameters."""
        declared = [p for e in effects for p in e.parameters]
        if not declared:
            return RegressionFit(self, (), start)
        bounds = np.array([(p.minimum, p.maximum) for p in declared]).T
        found = least_squares(partial(self.residual, effects), np.clip(start, *bounds), bounds=bounds, x_scale=np.abs(start))
        return RegressionFit(self, tuple(effects), found.x)

    def residual(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Whitened residual (n,), orthogonal to the base."""
        return self.orthogonal(self.measured - self.whitened([p.mean_response(effects, x) for p in self.parts]))

    def started(self, fit: "RegressionFit", effect: PowerEffect) -> np.ndarray:
        """Start of the parameters of an effect beside a fit: the best of a scan; a size of 0 if no possible one fits."""
        tiny, best = STEP * ACCURACY * self.largest, (0.0, np.zeros(1))
        for further in scan(effect):
            column = self.whitened([p.mean_response([effect], np.array([tiny, *further])) for p in self.parts]) / tiny
            column -= fit.basis @ (fit.basis.T @ column)
            power = float(column @ column)
            size = float(column @ fit.residual) / power if power > 0.0 else 0.0
            if effect.possible(size) and size**2 * power > best[0]:
                best = size**2 * power, np.array([size, *further])
        return best[1]


def scan(effect: PowerEffect) -> list[tuple[float, ...]]:
    """Values of the parameters of an effect beside its size, at which a search tries it."""
    further = effect.parameters[1:]
    if not further:
        return [()]
    (p,) = further
    return [(float(v),) for v in np.geomspace(p.minimum, p.maximum, round(np.log(p.maximum / p.minimum) / np.log(SCAN)) + 1)]


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """Effects with parameters `x` beside the base of a problem."""

    problem: Regression
    effects: tuple[PowerEffect, ...]
    x: np.ndarray

    @cached_property
    def residual(self) -> np.ndarray:
        """Whitened (n,), orthogonal to the base."""
        return self.problem.residual(self.effects, self.x)

    @cached_property
    def slopes(self) -> list[np.ndarray]:
        """Derivatives (blocks, k) of the effects' block means by their parameters, for each record."""
        found = []
        for p in self.problem.parts:
            columns = []
            for k, step in enumerate(STEP * np.maximum(np.abs(self.x), STEP)):
                ends = [p.mean_response(self.effects, self.x + s * step * (np.arange(len(self.x)) == k)) for s in (1.0, -1.0)]
                columns.append((ends[0] - ends[1]) / (2.0 * step))
            found.append(np.stack(columns, axis=1) if columns else np.zeros((len(p.at.time), 0)))
        return found

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives (n, k)."""
        return self.problem.whitened(self.slopes)

    @cached_property
    def squares(self) -> float:
        """Sum of squares: twice the negative log-likelihood."""
        return float(self.residual @ self.residual)

    @property
    def evidence(self) -> float:
        """Penalised log-likelihood: minus half the BIC, up to a constant."""
        return -0.5 * (self.squares + len(self.x) * float(np.log(len(self.residual))))

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal directions (n, m) of all that was fitted."""
        return np.linalg.qr(np.hstack([self.problem.basis, self.problem.orthogonal(self.jacobian)]))[0]

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray:
        """Subtract from `rows` (k, n), in place, their part in these directions. Returns their products (k, k)."""
        rows -= (rows @ self.basis) @ self.basis.T
        return rows @ rows.T

    @cached_property
    def std(self) -> np.ndarray:
        """(k,) standard errors."""
        j = self.problem.orthogonal(self.jacobian)
        return np.sqrt(np.diag(np.linalg.pinv(j.T @ j, hermitian=True)))

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(k,) of the base."""
        p = self.problem
        rest = p.measured - p.whitened([part.mean_response(self.effects, self.x) for part in p.parts])
        return np.linalg.lstsq(p.base, rest, rcond=RANK)[0] / p.size

    def error(self, part: Part) -> np.ndarray:
        """Block means (blocks,) measured minus model, of any record."""
        measured, base = part.means
        return measured - base @ self.coefficients - part.mean_response(self.effects, self.x)

    @cached_property
    def held_out(self) -> tuple[float, float]:
        """(sum of squares of the whitened residual, rms error of the block means) of folds predicted from the others, each
        after a Gauss-Newton step from this fit."""
        p = self.problem
        white = np.hstack([p.base, self.jacobian])
        raw = [np.hstack([part.means[1] / p.size, s]) for part, s in zip(p.parts, self.slopes, strict=True)]
        own = [folds(part.at.time, float(part.record.time[-1])) for part in p.parts]
        fold, whole = p.rows_of(own), white.T @ white
        squares, errors = 0.0, []
        for k in range(int(fold.max()) + 1):
            out = fold == k
            inverse = informed_inverse(white[~out].T @ white[~out], whole, ESTIMABLE)
            move = inverse @ (white[~out].T @ self.residual[~out])
            squares += float(np.sum((self.residual[out] - white[out] @ move) ** 2))
            errors += [(self.error(part) - r @ move)[f == k] for part, r, f in zip(p.parts, raw, own, strict=True)]
        return squares, float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))

    def interval(self, k: int) -> tuple[float, float]:
        """95 % interval of a parameter: by its standard error if its effect is linear, else by the profile likelihood."""
        effect, declared = [(e, p) for e in self.effects for p in e.parameters][k]
        if len(effect.parameters) == 1:
            half = NORMAL_95 * float(self.std[k])
            return float(self.x[k]) - half, float(self.x[k]) + half
        others, most = np.delete(np.arange(len(self.x)), k), float(chi2.ppf(0.95, 1))
        bounds = np.array([(p.minimum, p.maximum) for e in self.effects for p in e.parameters])[others].T

        def beyond(logarithm: float) -> float:
            def residual(rest: np.ndarray) -> np.ndarray:
                return self.problem.residual(self.effects, np.insert(rest, k, self.x[k] * np.exp(logarithm)))

            start = self.x[others]
            return 2.0 * least_squares(residual, start, bounds=bounds, x_scale=np.abs(start)).cost - self.squares - most

        ends = []
        for bound in (declared.minimum, declared.maximum):
            reach = float(np.log(max(bound / self.x[k], STEP)))
            steps = np.sign(reach) * np.minimum(0.1 * 2.0 ** np.arange(8), abs(reach))
            end = next((float(s) for s in steps if beyond(float(s)) > 0.0), None)
            ends.append(bound if end is None else float(self.x[k]) * np.exp(brentq(beyond, 0.0, end, xtol=1e-2)))
        return ends[0], ends[1]
