"""Cross-validation with interleaved blocks, each predicted from the others.

For each fold the parameters make one Gauss-Newton step from the full fit. This is exact for a linear model, and one fold of
five changes them little. Thresholds are not differentiable: predictions are averaged over their values, weighted by the
likelihood on the other folds.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import permutation_test

from identification.assessment.prediction import Prediction
from identification.diagnose.judgement import ALPHA_HELD_OUT, FOLD_BLOCK, FOLDS
from identification.diagnose.search.fits import Fit
from identification.fit.noise import Noise, blocks
from identification.fit.tachometer import Tachometer
from vpp_fmu.native import Simulator

FEWEST_BLOCKS = 2
"""Minimum number of blocks of each fold; the blocks of a short record are shorter."""

THRESHOLDS = 25
"""Number of values of a threshold in the average."""

ESTIMABLE = 0.1
"""Share of the information of all data about a direction that the other folds must have to refit it."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Cross-validation residuals: sum of `squares` of the whitened residual by channel, of `counts` rows.

    `thrust` [N], `omega` [rpm]: errors (rows,) by experiment; NaN where nothing was measured.
    """

    squares: Mapping[str, float]
    counts: Mapping[str, int]
    thrust: tuple[np.ndarray, ...]
    omega: tuple[np.ndarray, ...]

    def gain(self, other: "HeldOut") -> dict[str, float]:
        """Log-likelihood ratio of this to `other` by channel, with unknown noise variances."""
        return {c: 0.5 * n * float(np.log(other.squares[c] / self.squares[c])) for c, n in self.counts.items()}

    @property
    def rmse_thrust(self) -> float:
        """N, over the rows, not averaged or whitened."""
        return rms(self.thrust)

    @property
    def rmse_omega(self) -> float | None:
        """rpm, over the rows at which the tachometer renewed; None where speed was not measured."""
        return rms(self.omega) if sum(map(len, self.omega)) else None


def folds(time: np.ndarray, seconds: float) -> np.ndarray:
    """(n,) the fold of each time [s] of a record that lasts so many `seconds`."""
    return _block(time, seconds) % FOLDS


def _block(time: np.ndarray, seconds: float) -> np.ndarray:
    """(n,) number of the block of each time [s]."""
    return (time / min(FOLD_BLOCK, seconds / (FEWEST_BLOCKS * FOLDS))).astype(int)


def contiguous_folds(time: np.ndarray, seconds: float) -> np.ndarray:
    """Fold (n,) of each time [s] if whole thirds of a record are left out."""
    return np.minimum((3.0 * time / seconds).astype(int), 2)


def cross_validated(
    fit: Fit,
    split: Callable[[np.ndarray, float], np.ndarray] = folds,
    moving: Callable[[str], bool] | None = None,
) -> HeldOut:
    """The fit's residuals in each fold, predicted from the other folds.

    `split(time, seconds)`: the fold of each time. `moving(name)`: whether a parameter is refitted; None: all are. A fold that
    alone tells a parameter (the only one in which the pitch reaches its limit) tests the model with its value. LinAlgError: the
    sensitivities diverge, so the fit is no minimum.
    """
    problem = fit.problem
    if fit.parts:
        moves = _moves_of_parts(fit, split)
        residual, jacobian = problem.rows(fit.values)
        held = residual[: problem.size] + np.einsum("rn,rn->r", jacobian[: problem.size], moves[_fold_of(fit, split)])
    else:
        residual, jacobian = fit.tangent()
        if not np.isfinite(jacobian).all():
            raise np.linalg.LinAlgError("the sensitivities diverge")
        if moving is not None:
            jacobian = jacobian * [float(moving(name)) for name in problem.coordinates.names]
        held, steps = predicted([residual, *_alternatives(fit)], jacobian, _fold_of(fit, split))
        moves = steps @ problem.coordinates.jacobian(fit.solution.value).T
    score = problem.score_of(held)
    return HeldOut(score.squares, score.counts, *_errors(fit, moves, split))


def by_thirds(fit: Fit, moving: Callable[[str], bool] | None = None) -> HeldOut:
    """Cross-validation with whole thirds of each record left out: whether a model carries over to other commands."""
    return cross_validated(fit, contiguous_folds, moving)


def _fold_of(fit: Fit, split: Callable[[np.ndarray, float], np.ndarray]) -> np.ndarray:
    """(rows,): the fold of each row of the residual."""
    return np.concatenate([split(time, seconds) for time, seconds in fit.problem.times])


def predicted(residuals: Sequence[np.ndarray], jacobian: np.ndarray, fold_of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(residual (n,) in each fold, predicted from the others; step (folds, coordinates) of the fit to them).

    `residuals`: of the fit and of its alternatives, (rows,) each; `fold_of` (n,): the fold of each row. Further rows, of a
    prior, are always kept."""
    size = len(fold_of)
    held, moves = np.empty(size), []
    for fold in range(int(fold_of.max()) + 1):
        out = np.flatnonzero(fold_of == fold)
        kept = np.append(np.flatnonzero(fold_of != fold), np.arange(size, len(jacobian)))
        j = jacobian[kept]
        inverse = informed_inverse(j.T @ j, jacobian.T @ jacobian)
        steps = [-inverse @ (j.T @ r[kept]) for r in residuals]
        costs = np.array([0.5 * float(np.sum((r[kept] + j @ s) ** 2)) for r, s in zip(residuals, steps, strict=True)])
        likely = np.exp(costs.min() - costs)
        likely /= likely.sum()
        held[out] = sum(p * (r[out] + jacobian[out] @ s) for p, r, s in zip(likely, residuals, steps, strict=True))
        moves.append(sum(p * s for p, s in zip(likely, steps, strict=True)))
    return held, np.array(moves)


def _moves_of_parts(fit: Fit, split: Callable[[np.ndarray, float], np.ndarray]) -> np.ndarray:
    """(folds, parameters): changes of the parameters when each part is fitted to the other folds."""
    found: dict[str, np.ndarray] = {}
    for part in fit.parts:
        residual, jacobian = part.tangent()
        _, steps = predicted([residual, *_alternatives(part)], jacobian, _fold_of(part, split))
        moves = steps @ part.problem.coordinates.jacobian(part.solution.value).T
        found |= zip(part.problem.coordinates.names, moves.T, strict=True)
    names = fit.problem.coordinates.names
    return np.array([found.get(n, np.zeros(len(moves))) for n in names]).T


def p_no_decrease(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], further: Sequence[float] = ()) -> float:
    """p-value of the hypothesis that a held-out mean square error does not decrease, by a permutation test of the loss
    differences of Diebold and Mariano (1995): if neither model is better, their signs are exchangeable. The differences of a
    drift grow with time and are too unequal for a t test.

    `parts`: (time [s], errors before, errors after), (rows,) each; differences of squares are averaged in blocks as long as
    those of the folds. `further`: more such differences.
    """
    found = list(further)
    for time, old, new in parts:
        block, seen = _block(time, float(time[-1])), np.isfinite(new) & np.isfinite(old)
        count = np.bincount(block[seen])
        sums = np.bincount(block[seen], weights=old[seen] ** 2 - new[seen] ** 2)
        found += (sums[count > 0] / count[count > 0]).tolist()
    if len(found) < 2:
        return 1.0
    random = {"random_state": np.random.default_rng(0)}  # the name that every scipy knows; `rng` came with 1.15
    test = permutation_test((found,), np.mean, permutation_type="samples", alternative="greater", vectorized=True, **random)
    return float(test.pvalue)


def error_increases(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], further: Sequence[float] = ()) -> bool:
    """Whether a held-out error increases significantly; `parts` as in `p_no_decrease`, `further`: increases of mean squares."""
    return p_no_decrease([(time, new, old) for time, old, new in parts], further) < ALPHA_HELD_OUT


def error_decreases(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], further: Sequence[float] = ()) -> bool:
    """Whether it decreases significantly; `further`: decreases of mean squares."""
    return p_no_decrease(parts, further) < ALPHA_HELD_OUT


def held_out_gain(noise: Noise, before: Prediction, after: Prediction) -> dict[str, float]:
    """Log-likelihood ratio of two predictions of a record that was not fitted, by channel, of whitened errors with unknown
    variances."""
    found = {}
    was, now = _whitened(noise, before), _whitened(noise, after)
    for channel in was:
        squares = (max(float(np.nansum(each[channel] ** 2)), 1e-300) for each in (was, now))
        found[channel] = 0.5 * int(np.isfinite(was[channel]).sum()) * float(np.log(next(squares) / next(squares)))
    return found


def _whitened(noise: Noise, shown: Prediction) -> dict[str, np.ndarray]:
    """Errors of a prediction by channel."""
    record = shown.record
    found = {"thrust": noise.colour.whiten(blocks(record, noise.block).mean(shown.thrust - record["thrust"]))}
    if "omega" in record and len(sensor := Tachometer(record)):
        found["omega"] = noise.speed.whiten((sensor.shows(shown.omega) - sensor.measured) / sensor.std)
    return found


def informed_inverse(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of the information matrix (k, k) of part of the data, in the directions in which the part has more than
    the share ESTIMABLE of the information of the `whole`."""
    size = np.sqrt(np.diag(whole))
    size = np.where(size > 0.0, size, 1.0)
    power, axes = np.linalg.eigh(whole / np.outer(size, size))
    known = power > 1e-12 * power[-1]
    unit = (axes[:, known] / np.sqrt(power[known])) / size[:, None]
    share, turned = np.linalg.eigh(unit.T @ part @ unit)
    estimable = unit @ turned[:, share > ESTIMABLE]
    return (estimable / share[share > ESTIMABLE]) @ estimable.T


def _alternatives(fit: Fit) -> list[np.ndarray]:
    """Residuals (rows,) of the fit with each threshold varied in and around its interval."""
    bounds = {p.name: (p.minimum, p.maximum) for p in fit.problem.model.parameters}
    found = []
    for name, (low, high) in fit.thresholds.items():
        wide = max(high - low, 0.1 * abs(fit.values[name]))
        ends = np.clip([low - wide, high + wide], *bounds[name])
        found += [fit.problem.residual_at({**fit.values, name: v}) for v in np.linspace(*ends, THRESHOLDS).tolist()]
    return found


def _errors(
    fit: Fit, moves: np.ndarray, split: Callable[[np.ndarray, float], np.ndarray]
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Errors (thrust [N], speed [rpm]) by experiment; the parameters of each fold moved by `moves` (folds, parameters)."""
    problem = fit.problem
    simulator = Simulator(problem.model, problem.coordinates.names)
    thrust, omega = [], []
    for e in problem.experiments:
        fold, predicted = split(e.record.time, e.record.time[-1]), np.empty((len(e.record), 2))
        for at, shown, tangents in simulator.pieces(fit.values, *e.record.run):
            predicted[at] = shown[:, :2] + np.einsum("rcn,nr->rc", tangents[:, :2], moves.T[:, fold[at]])
        thrust.append(predicted[:, 0] - e.thrust_rows)
        shown = [t.shows(predicted[:, 1]) - t.measured for t in e.tachometers]
        omega.append(np.concatenate(shown) if shown else np.zeros(0))
    return tuple(thrust), tuple(omega)


def rms(parts: Sequence[np.ndarray]) -> float:
    """Root mean square of the finite numbers of all parts; NaN without any."""
    every = np.concatenate(parts)
    seen = every[np.isfinite(every)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan
