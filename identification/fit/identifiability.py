"""Which parameters the data identify, and which must be held fixed."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.fit.problem import Problem
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from vpp_fmu.digits import number

DEPENDENT = 1e-4
"""A column is linearly dependent if its part orthogonal to the other columns is below this share of its length."""

PARTNER = 0.01
"""Minimum share of a column that another must contribute to be named as its partner."""

UNKNOWN = 1.0
"""Standard deviation from which a normalised coefficient is not identifiable: the typical size of coefficients."""

ORDER = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2", "c20", "c30", "c21", "c11", "c12")
"""Of linearly dependent parameters, those named first are fitted and the others held."""


def held(problem: Problem, x: np.ndarray, jacobian: np.ndarray, names: Sequence[str]) -> dict[str, str]:
    """Parameters among `names` that the data do not identify at coordinates `x`: name -> reason, in words. `jacobian`: of the
    problem's rows there, in the parameters."""
    columns = _columns(problem, x, jacobian[: problem.size])
    largest = max(np.linalg.norm(columns, axis=0).max(), 1e-300)
    columns = np.vstack([columns, _known(problem, columns)])
    reasons, basis, taken = {}, np.zeros((len(columns), 0)), {}
    for name in sorted(names, key=lambda n: ORDER.index(n) if n in ORDER else len(ORDER)):
        column = columns[:, problem.coordinates.names.index(name)]
        length = float(np.linalg.norm(column))
        if length <= 1e-9 * largest:
            reasons[name] = "the records do not depend on it"
            continue
        own = column - basis @ (basis.T @ column)
        own -= basis @ (basis.T @ own)  # a second projection removes the rounding errors of the first
        if np.linalg.norm(own) <= DEPENDENT * length:
            reasons[name] = f"the data identify only its combination with {', '.join(_partners(column, taken))}"
            continue
        taken[name] = column
        if np.linalg.norm(own) > 0:
            basis = np.column_stack([basis, own / np.linalg.norm(own)])
    return reasons


def weakly_identified(found: Uncertainty) -> dict[str, str]:
    """Fitted parameters that are weakly identified: name -> accuracy, in words.

    These are coefficients with a standard deviation of at least UNKNOWN, and time constants with one at least as large as
    their value.
    """
    known = zip(found.names, found.values.tolist(), found.std.tolist(), strict=True)
    worst = {n: s for n, v, s in known if s >= (abs(v) if n.startswith("tau_") else UNKNOWN)}
    return {n: f"the data identify it only to ± {number(NORMAL_95 * s, 2)}" for n, s in worst.items()}


def _columns(problem: Problem, x: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """(n, n): the square root of the normal matrix of the data rows (rows, n); its columns have the same lengths and angles."""
    tangent = problem.coordinates.jacobian(x)
    normal, inner = tangent.T @ (jacobian.T @ jacobian) @ tangent, np.linalg.pinv(tangent)
    power, axes = np.linalg.eigh(normal)
    root = np.sqrt(np.maximum(power, 0.0))[:, None] * axes.T @ inner
    # The root of a zero eigenvalue is rounding error, so the lengths are taken from the normal matrix.
    length, rounded = np.sqrt(np.maximum(np.diag(inner.T @ normal @ inner), 0.0)), np.linalg.norm(root, axis=0)
    return root * np.divide(length, rounded, out=np.zeros(len(length)), where=rounded > 0.0)


def _partners(column: np.ndarray, taken: Mapping[str, np.ndarray]) -> list[str]:
    """Names of the columns in the linear combination that gives `column`."""
    parts, *_ = np.linalg.lstsq(np.column_stack(list(taken.values())), column, rcond=None)
    size = np.abs(parts) * [np.linalg.norm(c) for c in taken.values()]
    return [name for name, part in zip(taken, size, strict=True) if part > PARTNER * np.linalg.norm(column)]


def _known(problem: Problem, columns: np.ndarray) -> np.ndarray:
    """Rows (k, names): directions in which the prior determines the problem's parameters, scaled as `columns` (rows, names)."""
    names, prior = problem.coordinates.names, problem.prior
    if prior is None:
        return np.zeros((0, len(names)))
    variance, axes = np.linalg.eigh(prior.covariance)
    rows = np.zeros((int(np.sum(variance < UNKNOWN**2)), len(names)))
    for name, parts in zip(prior.names, axes[:, variance < UNKNOWN**2], strict=True):
        if name in names:
            rows[:, names.index(name)] = parts
    return rows * max((np.linalg.norm(columns[:, k]) for k, name in enumerate(names) if name in prior.names), default=1.0)
