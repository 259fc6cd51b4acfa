"""Regression of a reading in time on effects of the power, beside a base whose coefficients are free.

Block means are whitened by an autoregression, and the base is projected out. The remaining problem is nonlinear least squares
in the few parameters of the effects.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from identification.diagnose.command_shapes import regress_out
from identification.diagnose.crossval import ESTIMABLE, folds, predicted, rms
from identification.diagnose.judgement import ACCURACY
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.score_test import tested
from identification.fit.noise import Blocks, Colour, colour_of
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
    """One reading of one record: `measured` (rows,) and `base` (rows, k), whose coefficients are free; `shapes` that span the
    residual of a missing effect, for the noise and the lack of fit; `largest`: the sensor's largest reading. Block means are
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

    def response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Change (rows,) of the reading by effects with parameters `x`."""
        total, values = np.zeros(len(self.measured)), iter(x.tolist())
        for effect in effects:
            total = total + effect.response(self.signals, {p.name: next(values) for p in effect.parameters})
        return total

    def mean_response(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Block means (blocks,) of `response`."""
        return self.at.mean(self.response(effects, x))

    def noise(self, effects: Sequence[PowerEffect], x: np.ndarray) -> Colour:
        """Noise of the residual beside effects, after a regression on base and shapes."""
        residual, fitted = self.measured - self.response(effects, x), np.zeros((len(self.at.time), 0))
        rest, removed = regress_out(lambda: (*self.shapes(), *self.base.T), self.at.mean, residual, fitted)
        colour = colour_of([self.at.mean(rest)], removed)
        return replace(colour, innovation=max(colour.innovation, EXACT * self.largest))  # readings without noise


class Regression:
    """A reading of all records, whitened by the noise of each beside `effects` with parameters `x`."""

    def __init__(self, parts: Sequence[Part], effects: Sequence[PowerEffect] = (), x: np.ndarray = NONE):
        self.parts, self.colours = parts, [p.noise(effects, x) for p in parts]
        self.seen = [np.isfinite(c.whiten(p.means[0])) for p, c in zip(parts, self.colours, strict=True)]
        base = self.whitened([p.means[1] for p in parts])
        size = np.linalg.norm(base, axis=0)
        self.size = np.where(size > 0.0, size, 1.0)
        self.base = base / self.size
        turned, power, _ = np.linalg.svd(self.base, full_matrices=False)
        self.basis = turned[:, power > RANK * power[0]]
        self.least = ACCURACY * max(p.largest for p in parts)

    def whitened(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """(n, ...) of block means of each record, where the reading exists."""
        white = [c.whiten(column) for column, c in zip(columns, self.colours, strict=True)]
        return np.concatenate([w[seen] for w, seen in zip(white, self.seen, strict=True)])

    def orthogonal(self, columns: np.ndarray) -> np.ndarray:
        """Part of columns (n, ...) that the base does not span."""
        return columns - self.basis @ (self.basis.T @ columns)

    def residual(self, effects: Sequence[PowerEffect], x: np.ndarray) -> np.ndarray:
        """Whitened reading (n,) minus the response to effects."""
        return self.whitened([p.means[0] - p.mean_response(effects, x) for p in self.parts])

    def fit(self, effects: Sequence[PowerEffect] = (), start: np.ndarray = NONE) -> "RegressionFit":
        """Least squares of effects beside the base, from a `start` of their parameters."""
        first = RegressionFit(self, tuple(effects), start)
        if not effects:
            return first
        bounds, scale = first.bounds, np.abs(start)
        found = least_squares(
            lambda x: self.orthogonal(self.residual(effects, x)), np.clip(start, *bounds), bounds=bounds, x_scale=scale
        )
        return replace(first, x=found.x)


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """Effects with parameters `x` beside the base of a problem."""

    problem: Regression
    effects: tuple[PowerEffect, ...]
    x: np.ndarray

    @property
    def bounds(self) -> np.ndarray:
        """(2, k) of the parameters."""
        return np.array([(p.minimum, p.maximum) for e in self.effects for p in e.parameters]).T

    @cached_property
    def residual(self) -> np.ndarray:
        """Whitened (n,), orthogonal to the base."""
        return self.problem.orthogonal(self.problem.residual(self.effects, self.x))

    def with_effect(self, effect: PowerEffect) -> "RegressionFit | None":
        """One more effect, fitted beside the others; None if its best size is not a possible one."""
        parts, tiny, declared, starts = self.problem.parts, STEP * self.problem.least, effect.parameters[0], []
        for shape in product(*(np.geomspace(p.minimum, p.maximum, STARTS).tolist() for p in effect.parameters[1:])):
            column = self.problem.whitened([p.mean_response([effect], np.array([tiny, *shape])) for p in parts]) / tiny
            column -= self.basis @ (self.basis.T @ column)
            power, along = float(column @ column), float(column @ self.residual)
            if power > 0.0 and declared.minimum < along / power < declared.maximum:
                starts.append((along**2 / power, along / power, *shape))
        return self.problem.fit((*self.effects, effect), np.append(self.x, max(starts)[1:])) if starts else None

    @cached_property
    def slopes(self) -> list[np.ndarray]:
        """Derivatives (blocks, k) of the effects' block means by their parameters, for each record."""

        def slope(part: Part, step: np.ndarray) -> np.ndarray:
            low, high = (part.mean_response(self.effects, self.x + way * step) for way in (-1.0, 1.0))
            return (high - low) / (2.0 * step.sum())

        steps = np.diag(STEP * np.maximum(np.abs(self.x), STEP))
        return [np.array([slope(p, step) for step in steps]).reshape(len(steps), len(p.at.time)).T for p in self.problem.parts]

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
        return np.linalg.lstsq(p.base, p.residual(self.effects, self.x), rcond=RANK)[0] / p.size

    def error(self, part: Part) -> np.ndarray:
        """Block means (blocks,) measured minus model, of any record."""
        measured, base = part.means
        return measured - base @ self.coefficients - part.mean_response(self.effects, self.x)

    @cached_property
    def held_out(self) -> tuple[float, float]:
        """(sum of squares of the whitened residual, rms error of the block means) of folds predicted from the others."""
        p = self.problem
        own = [folds(part.at.time, float(part.record.time[-1])) for part in p.parts]
        rows = np.concatenate([fold[-len(seen) :][seen] for fold, seen in zip(own, p.seen, strict=True)])
        jacobian = np.hstack([p.base, p.whitened(self.slopes)])
        held, moves = predicted([self.residual], -jacobian, rows, ESTIMABLE)
        errors = []
        for part, slopes, fold in zip(p.parts, self.slopes, own, strict=True):
            columns = np.hstack([part.means[1] / p.size, slopes])
            errors.append(self.error(part) - np.einsum("bk,bk->b", columns, moves[fold]))
        return float(held @ held), rms(errors)

    @cached_property
    def lack(self) -> LackOfFit:
        """Score test of the shapes, as of the thrust; `size`: rms that they explain, in the unit of the reading."""
        p = self.problem
        each = [np.stack([part.at.mean(shape) for shape in part.shapes()], axis=1) for part in p.parts]
        ends = np.cumsum([seen.sum() for seen in p.seen]).tolist()
        slices = [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]
        test = tested(self, np.ascontiguousarray(p.whitened(each).T), slices, [None] * len(p.parts))
        explained = max(2.0 * test.gain, 0.0) / len(self.residual)
        size = float(np.sqrt(explained)) * rms([self.error(part) for part in p.parts])
        return LackOfFit((), test, test.p, size, p.least, bool(self.effects))
