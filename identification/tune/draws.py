"""Draw plants from the uncertainty of the identified parameters."""

from collections.abc import Collection, Mapping

import numpy as np

from identification.fit.problem import Prior
from identification.plan.plan import free_parameters
from vpp_fmu.parameters import ParameterSet


def standard_deviations(parameters: ParameterSet, assumed: Collection[str], spread: float) -> dict[str, float]:
    """Standard deviation of each free parameter: from the file, else `spread` as a share of the value.

    The share applies to `assumed` values, files without standard deviations, and thresholds.
    """
    values, found = parameters.values, {}
    for name in free_parameters(parameters.model):
        estimate = parameters.estimates.get(name)
        known = estimate is not None and estimate.std is not None and name not in assumed
        found[name] = estimate.std if known else spread * abs(values[name])
    return found


class Posterior:
    """Normally distributed parameters with standard deviations `std` by name, clipped to the parameters' bounds; others keep
    their values. `knowledge`: covariance of a fit; only its correlation is used, because a diagnosis may have changed standard
    deviations."""

    def __init__(self, parameters: ParameterSet, std: Mapping[str, float], knowledge: Prior | None = None):
        names, model = list(std), parameters.model
        correlation = np.eye(len(names))
        if knowledge is not None:
            rows = [k for k, name in enumerate(knowledge.names) if name in std]
            at = [names.index(knowledge.names[k]) for k in rows]
            own = knowledge.covariance[np.ix_(rows, rows)]
            size = np.sqrt(np.diag(own))
            correlation[np.ix_(at, at)] = own / np.outer(size, size)
        size, directions = np.linalg.eigh(correlation * np.outer(list(std.values()), list(std.values())))
        self._factor = directions * np.sqrt(np.maximum(size, 0.0))
        columns = [p.name for p in model.parameters]
        self._at = np.array([columns.index(name) for name in names], int)
        self._mean = np.array(list(parameters.values.values()))
        self._low, self._high = np.array([(p.minimum, p.maximum) for p in model.parameters]).T[:, self._at]

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, parameters) values of the whole model, in its order."""
        found = np.tile(self._mean, (count, 1))
        moved = self._mean[self._at] + rng.standard_normal((count, len(self._at))) @ self._factor.T
        found[:, self._at] = np.clip(moved, self._low, self._high)
        return found
