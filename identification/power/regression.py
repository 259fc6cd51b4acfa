"""Regression of a reading in time on effects of the power, beside a base whose coefficients are free.

Block means are whitened by an autoregression, and the base is projected out. The remaining problem is nonlinear least squares
in the few parameters of the effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from identification.diagnose.command_shapes import regress_out
from identification.diagnose.crossval import folds, predicted, rms
from identification.diagnose.judgement import ACCURACY
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.score_test import tested
from identification.fit.noise import Blocks, colour_of
from identification.fit.uncertainty import NORMAL_95
from identification.power.effects import PowerEffect, Signals
from identification.power.fit import EXACT
from vpp_fmu.record import Record

STARTS = 7
"""Values of a time constant from which an effect is fitted."""

STEP = 1e-4
"""Relative step of a derivative."""

RANK = 1e-6
"""Relative singular value below which columns of the base count as collinear."""

NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Part:
    """One reading of one record: `measured` (rows,) and `base` (rows, k), whose coefficients are free; block means `shapes`
    (blocks, m) that span the residual of a missing effect, for the noise and the lack of fit; `largest`: the sensor's largest
    reading. Block means are compared."""

    name: str
    record: Record
    at: Blocks
    measured: np.ndarray
    base: np.ndarray
    signals: Signals
    shapes: np.ndarray
    largest: float

    @cached_property
    def means(self) -> tuple[np.ndarray, np.ndarray]:
        """Block means of the reading (blocks,) and of the base (blocks, k)."""
        return self.at.mean(self.measured), self.at.mean(self.base)

    def response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Change (rows,) of the reading by effects with parameters `x`."""
        total, values = np.zeros(len(self.measured)), iter(x.tolist())
        for effect in effects:
            total = total + effect.response(self.signals, {p.name: next(values) for p in effect.parameters})
        return total


class Regression:
    """A reading of all records, one after the other. Each is whitened by its noise beside `effects` with parameters `x`."""

    def __init__(self, parts: Sequence[Part], effects: Sequence[PowerEffect] = (), x: np.ndarray = NONE):
        self.parts, largest = parts, max(p.largest for p in parts)
        ends = np.cumsum([len(p.at.time) for p in parts]).tolist()
        self.rows = [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]
        self.measured, base = (np.concatenate(means) for means in zip(*(p.means for p in parts), strict=True))
        self.shapes, residual = np.concatenate([p.shapes for p in parts]), self.measured - self.response(effects, x)
        columns, self.colours = np.hstack([self.shapes, base]).T, []
        for rows in self.rows:
            own, none = columns[:, rows], np.zeros((rows.stop - rows.start, 0))
            rest, removed = regress_out(partial(iter, own), np.asarray, residual[rows], none)
            colour = colour_of([rest], removed)
            self.colours.append(replace(colour, innovation=max(colour.innovation, EXACT * largest)))  # readings without noise
        self.seen: slice | np.ndarray = slice(None)
        self.seen = np.isfinite(self.whitened(self.measured))
        size = np.linalg.norm(self.whitened(base), axis=0)
        self.size = np.where(size > 0.0, size, 1.0)
        self.columns, self.base = base / self.size, self.whitened(base / self.size)
        turned, power, _ = np.linalg.svd(self.base, full_matrices=False)
        self.basis = turned[:, power > RANK * power[0]]
        self.least = ACCURACY * largest

    def response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Block means (blocks,) of the response to effects."""
        return np.concatenate([p.at.mean(p.response(effects, x)) for p in self.parts])

    def whitened(self, columns: np.ndarray) -> np.ndarray:
        """(n, ...) of block means (blocks, ...), where the reading exists."""
        found = np.full(columns.shape, np.nan)
        for colour, rows in zip(self.colours, self.rows, strict=True):
            white = colour.whiten(columns[rows])
            found[rows.stop - len(white) : rows.stop] = white
        return found[self.seen]

    def orthogonal(self, columns: np.ndarray) -> np.ndarray:
        """Part of columns (n, ...) that the base does not span."""
        return columns - self.basis @ (self.basis.T @ columns)

    def residual(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Whitened reading (n,) minus the response to effects, orthogonal to the base."""
        return self.orthogonal(self.whitened(self.measured - self.response(effects, x)))

    def fit(self, effects: Sequence[PowerEffect] = (), start: np.ndarray = NONE) -> "RegressionFit":
        """Least squares of effects beside the base, from a `start` of their parameters."""
        first = RegressionFit(self, tuple(effects), start)
        if not effects:
            return first
        limits = {"bounds": first.bounds, "x_scale": np.abs(start)}
        return replace(first, x=least_squares(lambda x: self.residual(effects, x), np.clip(start, *first.bounds), **limits).x)


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """Effects with parameters `x` beside the base of a problem."""

    problem: Regression
    effects: tuple[PowerEffect, ...]
    x: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(e.name for e in self.effects)

    @property
    def bounds(self) -> np.ndarray:
        """(2, k) of the parameters."""
        return np.array([(p.minimum, p.maximum) for e in self.effects for p in e.parameters]).T

    @cached_property
    def residual(self) -> np.ndarray:
        """Whitened (n,), orthogonal to the base."""
        return self.problem.residual(self.effects, self.x)

    def with_effect(self, effect: PowerEffect) -> "RegressionFit | None":
        """One more effect, fitted beside the others; None if its best size is not a possible one."""
        tiny, declared, starts = STEP * self.problem.least, effect.parameters[0], []
        for shape in product(*(np.geomspace(p.minimum, p.maximum, STARTS).tolist() for p in effect.parameters[1:])):
            column = self.problem.whitened(self.problem.response([effect], np.array([tiny, *shape]))) / tiny
            column -= self.basis @ (self.basis.T @ column)
            power, along = float(column @ column), float(column @ self.residual)
            if power > 0.0 and declared.minimum < along / power < declared.maximum:
                starts.append((along**2 / power, along / power, *shape))
        return self.problem.fit((*self.effects, effect), np.append(self.x, max(starts)[1:])) if starts else None

    @cached_property
    def slopes(self) -> np.ndarray:
        """Derivatives (blocks, k) of the response by the effects' parameters."""
        found, response = np.empty((len(self.problem.measured), len(self.x))), self.problem.response
        for k, step in enumerate(np.diag(STEP * np.maximum(np.abs(self.x), STEP))):
            found[:, k] = (response(self.effects, self.x + step) - response(self.effects, self.x - step)) / (2.0 * step[k])
        return found

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives (n, k) by the effects' parameters, orthogonal to the base."""
        return self.problem.orthogonal(self.problem.whitened(self.slopes))

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
        return np.linalg.qr(np.hstack([self.problem.basis, self.jacobian]))[0]

    def channel_orthogonal_gram(self, rows: np.ndarray, at: slice) -> np.ndarray:
        """Subtract from `rows` (k, n), in place, their part in these directions. Returns their products (k, k)."""
        rows -= (rows @ self.basis) @ self.basis.T
        return rows @ rows.T

    def directions(self, at: slice) -> np.ndarray:
        """(m, rows): these directions in some rows."""
        return self.basis[at].T

    @cached_property
    def std(self) -> np.ndarray:
        """(k,) standard errors."""
        return np.sqrt(np.diag(np.linalg.pinv(self.jacobian.T @ self.jacobian, hermitian=True)))

    @cached_property
    def intervals(self) -> np.ndarray:
        """(k, 2) 95 % intervals, by the standard errors. Those of an effect with a time constant are of the logarithms: its
        parameters are positive, and their likelihood is skewed."""
        reach, skewed = NORMAL_95 * self.std, [len(e.parameters) > 1 for e in self.effects for _ in e.parameters]
        share = np.exp(np.minimum(reach / np.abs(self.x), 50.0))  # must not overflow
        ends = np.where(skewed, [self.x / share, self.x * share], [self.x - reach, self.x + reach])
        return np.clip(ends, *self.bounds).T

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(k,) of the base."""
        p = self.problem
        rest = p.whitened(p.measured - p.response(self.effects, self.x))
        return np.linalg.lstsq(p.base, rest, rcond=RANK)[0] / p.size

    def error(self, part: Part) -> np.ndarray:
        """Block means (blocks,) measured minus model, of any record."""
        measured, base = part.means
        return measured - base @ self.coefficients - part.at.mean(part.response(self.effects, self.x))

    @cached_property
    def errors(self) -> np.ndarray:
        """(blocks,) of `error` of all records."""
        return np.concatenate([self.error(part) for part in self.problem.parts])

    @cached_property
    def held_out(self) -> tuple[float, float]:
        """(sum of squares of the whitened residual, rms error of the block means) of folds predicted from the others."""
        p, columns = self.problem, np.hstack([self.problem.columns, self.slopes])
        fold = np.concatenate([folds(part.at.time, float(part.record.time[-1])) for part in p.parts])
        held, moves = predicted([self.residual], -p.whitened(columns), fold[p.seen])
        return float(held @ held), rms([self.errors - np.einsum("bk,bk->b", columns, moves[fold])])

    @cached_property
    def lack(self) -> LackOfFit:
        """Score test of the shapes, as of the thrust; `size`: rms that they explain, in the unit of the reading."""
        p, ends = self.problem, np.cumsum([self.problem.seen[rows].sum() for rows in self.problem.rows]).tolist()
        slices = [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]
        test = tested(self, np.ascontiguousarray(p.whitened(p.shapes).T), slices, [None] * len(slices))
        size = float(np.sqrt(max(2.0 * test.gain, 0.0) / len(self.residual))) * rms([self.errors])
        return LackOfFit((), test, test.p, size, p.least, bool(self.effects))
