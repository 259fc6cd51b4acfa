"""Which parameters the data can tell, and which must be held."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.fit.problem import Problem
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from vpp_fmu.digits import number

DEPENDENT = 1e-4
"""A column counts as a combination of others when less than this share of it is its own."""

PARTNER = 0.01
"""Part of a column that one of its combination must make up to be named."""

UNKNOWN = 1.0
"""Standard deviation of a normalised coefficient from which nothing is known of it: coefficients are of this size."""

ORDER = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2", "c20", "c30", "c21", "c11", "c12")
"""Of parameters that only a combination tells, those named first are fitted, the others held."""


def held(problem: Problem, x: np.ndarray, names: Sequence[str]) -> dict[str, str]:
    """Parameters (of the problem's) that its data do not determine at coordinates `x`: name -> why, in words."""
    columns = _columns(problem, x)
    largest = max(np.linalg.norm(columns, axis=0).max(), 1e-300)
    columns = np.vstack([columns, _known(problem, columns)])
    reasons, basis, taken = {}, np.zeros((len(columns), 0)), {}
    for name in sorted(names, key=lambda n: ORDER.index(n) if n in ORDER else len(ORDER)):
        column = columns[:, problem.coordinates.names.index(name)]
        length = float(np.linalg.norm(column))
        if length <= 1e-9 * largest:
            reasons[name] = "nothing in the records depends on it"
            continue
        own = column - basis @ (basis.T @ column)
        own -= basis @ (basis.T @ own)  # once more: rounding of the first projection
        if np.linalg.norm(own) <= DEPENDENT * length:
            reasons[name] = f"the data tell only its combination with {', '.join(_partners(column, taken))}"
            continue
        taken[name] = column
        if np.linalg.norm(own) > 0:
            basis = np.column_stack([basis, own / np.linalg.norm(own)])
    return reasons


def weakly_identified(found: Uncertainty) -> dict[str, str]:
    """Fitted parameters that are known no better than nothing: name -> how well, in words.

    A coefficient with a standard deviation of UNKNOWN, a time constant with one as large as itself.
    """
    known = zip(found.names, found.values.tolist(), found.std.tolist(), strict=True)
    worst = {n: s for n, v, s in known if s >= (abs(v) if n.startswith("tau_") else UNKNOWN)}
    return {n: f"these data tell it to no better than ± {number(NORMAL_95 * s, 2)}" for n, s in worst.items()}


def _columns(problem: Problem, x: np.ndarray) -> np.ndarray:
    """(n, n) in place of the data's rows (rows, n): the root of their normal matrix has the same lengths and angles."""
    _, jacobian = problem.evaluate(x)
    normal, inner = jacobian[: problem.size].T @ jacobian[: problem.size], np.linalg.pinv(problem.coordinates.jacobian(x))
    power, axes = np.linalg.eigh(normal)
    root = np.sqrt(np.maximum(power, 0.0))[:, None] * axes.T @ inner
    # The root of what is nothing is rounding's root: lengths are those of the normal matrix.
    length, rounded = np.sqrt(np.maximum(np.diag(inner.T @ normal @ inner), 0.0)), np.linalg.norm(root, axis=0)
    return root * np.divide(length, rounded, out=np.zeros(len(length)), where=rounded > 0.0)


def _partners(column: np.ndarray, taken: Mapping[str, np.ndarray]) -> list[str]:
    """Names of the columns that another is made of."""
    parts, *_ = np.linalg.lstsq(np.column_stack(list(taken.values())), column, rcond=None)
    size = np.abs(parts) * [np.linalg.norm(c) for c in taken.values()]
    return [name for name, part in zip(taken, size, strict=True) if part > PARTNER * np.linalg.norm(column)]


def _known(problem: Problem, columns: np.ndarray) -> np.ndarray:
    """Rows (k, names): directions in which the prior tells the problem's parameters, weighing as `columns` (rows, names)."""
    names, prior = problem.coordinates.names, problem.prior
    if prior is None:
        return np.zeros((0, len(names)))
    variance, axes = np.linalg.eigh(prior.covariance)
    rows = np.zeros((int(np.sum(variance < UNKNOWN**2)), len(names)))
    for name, parts in zip(prior.names, axes[:, variance < UNKNOWN**2], strict=True):
        if name in names:
            rows[:, names.index(name)] = parts
    return rows * max((np.linalg.norm(columns[:, k]) for k, name in enumerate(names) if name in prior.names), default=1.0)
