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
    names, model = list(std), parameters.model
    correlation = np.eye(len(names))
    if knowledge is not None:
        rows = [k for k, name in enumerate(knowledge.names) if name in std]
        at = [names.index(knowledge.names[k]) for k in rows]
        own = knowledge.covariance[np.ix_(rows, rows)]
        size = np.sqrt(np.diag(own))
        correlation[np.ix_(at, at)] = own / np.outer(size, size)
    covariance = correlation * np.outer(list(std.values()), list(std.values()))
    values = parameters.values
    mean = np.array([values[name] for name in names])
    drawn = np.random.default_rng(seed).multivariate_normal(mean, covariance, count, method="eigh")
    columns = [p.name for p in model.parameters]
    found = np.tile(np.array(list(values.values())), (count, 1))
    for k, name in enumerate(names):
        p = model.parameters[columns.index(name)]
        found[:, columns.index(name)] = np.clip(drawn[:, k], p.minimum, p.maximum)
    return found
