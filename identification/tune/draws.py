"""Draw plants from the uncertainty of the identified parameters."""

from collections.abc import Collection

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


def draws(
    parameters: ParameterSet, std: dict[str, float], knowledge: Prior | None, count: int, seed: int | tuple[int, ...]
) -> np.ndarray:
    """(count, parameters) values of the whole model, normally distributed and clipped to the parameters' bounds.

    `knowledge`: covariance of a fit; only its correlation is used, because a diagnosis may have changed standard deviations.
    """
    names, mean, covariance = covariance_of(parameters, std, knowledge)
    drawn = np.random.default_rng(seed).multivariate_normal(mean, covariance, count, method="eigh")
    model = parameters.model
    columns = [p.name for p in model.parameters]
    found = np.tile(np.array(list(parameters.values.values())), (count, 1))
    for k, name in enumerate(names):
        p = model.parameters[columns.index(name)]
        found[:, columns.index(name)] = np.clip(drawn[:, k], p.minimum, p.maximum)
    return found


def covariance_of(
    parameters: ParameterSet, std: dict[str, float], knowledge: Prior | None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """(names, mean (n,), covariance (n, n)) of the parameters of `std`, in their units."""
    names = list(std)
    correlation = np.eye(len(names))
    if knowledge is not None:
        rows = [k for k, name in enumerate(knowledge.names) if name in std]
        at = [names.index(knowledge.names[k]) for k in rows]
        own = knowledge.covariance[np.ix_(rows, rows)]
        size = np.sqrt(np.diag(own))
        correlation[np.ix_(at, at)] = own / np.outer(size, size)
    covariance = correlation * np.outer(list(std.values()), list(std.values()))
    values = parameters.values
    return names, np.array([values[name] for name in names]), covariance


class Posterior:
    """Draws of the whole model from the covariance of a fit, one at a time: the matrix is factored once.

    Parameters without a standard deviation keep their values; so do all of a set that was never fitted. Values outside of the
    parameters' bounds are set to the nearest bound, as in `draws`.
    """

    def __init__(self, parameters: ParameterSet, knowledge: Prior | None = None):
        std = {n: s for n, s in standard_deviations(parameters, (), 0.0).items() if s > 0.0}
        self.names, _, self.covariance = covariance_of(parameters, std, knowledge)
        size, directions = np.linalg.eigh(self.covariance)
        self._factor = directions * np.sqrt(np.maximum(size, 0.0))
        columns = [p.name for p in parameters.model.parameters]
        self._at = np.array([columns.index(name) for name in self.names], int)
        self.mean = np.array(list(parameters.values.values()))
        bounds = np.array([(p.minimum, p.maximum) for p in parameters.model.parameters]).T
        self._low, self._high = bounds[:, self._at]

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """(parameters,) values of the whole model, in its order."""
        found = self.mean.copy()
        moved = found[self._at] + self._factor @ rng.standard_normal(len(self.names))
        found[self._at] = np.clip(moved, self._low, self._high)
        return found
