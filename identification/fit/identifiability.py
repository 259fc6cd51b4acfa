"""Which parameters the data can tell, and which must be held."""

from collections.abc import Sequence

import numpy as np

from identification.fit.problem import Problem

DEPENDENT = 1e-4
"""A column counts as a combination of others when less than this share of it is its own."""

ORDER = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2", "c20", "c30", "c21", "c11", "c12")
"""Of parameters that only a combination tells, those named first are fitted, the others held."""


def held(problem: Problem, x: np.ndarray, names: Sequence[str]) -> dict[str, str]:
    """Parameters (of the problem's) that its data do not determine at coordinates `x`: name -> why, in words."""
    _, jacobian = problem.evaluate(x)
    columns = jacobian[: problem.size] @ np.linalg.pinv(problem.coordinates.jacobian(x))
    known = set() if problem.prior is None else set(problem.prior.names)
    reasons, basis, taken = {}, np.zeros((problem.size, 0)), []
    largest = max(np.linalg.norm(columns, axis=0).max(), 1e-300)
    for name in sorted(names, key=lambda n: ORDER.index(n) if n in ORDER else len(ORDER)):
        column = columns[:, problem.coordinates.names.index(name)]
        length = float(np.linalg.norm(column))
        if length <= 1e-9 * largest:
            reasons[name] = "nothing in the records depends on it"
            continue
        own = column - basis @ (basis.T @ column)
        own -= basis @ (basis.T @ own)  # once more: rounding of the first projection
        if np.linalg.norm(own) <= DEPENDENT * length and name not in known:
            reasons[name] = f"the records tell only its combination with {', '.join(taken)}"
            continue
        taken.append(name)
        if np.linalg.norm(own) > 0:
            basis = np.column_stack([basis, own / np.linalg.norm(own)])
    return reasons
