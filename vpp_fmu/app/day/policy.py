"""Sources of a controller's next gains: tuned on the model, or searched on the rig with a few flights per round.

The model-free search is the covariance matrix adaptation of Hansen and Ostermeier (Evolutionary Computation 9, 2001), pycma's,
in the logarithms of the gains about the present ones. Gains that the model rejects are not flown (`Referee`).
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import exp

import numpy as np

from identification.tune.controllers import controllers
from identification.tune.operating import operating_points
from identification.tune.tune import TuningTask, chain_of, tune
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

with warnings.catch_warnings():  # its optional plots
    warnings.simplefilter("ignore")
    import cma

FARTHEST = 0.5
"""Maximum change of a gain's logarithm in a search. A sensitivity of 2 is a gain margin of 2 or more, half of which remains."""

STEP = FARTHEST / 3.0
"""Initial standard deviation of a gain's logarithm. The optimum should lie within three of them."""

TRIES = 8
"""Flights of a round's search: a generation of four to six gains has 8 or 9 (Hansen's default)."""

SENSITIVITY = 3.0
"""Maximum sensitivity of the model's loop with gains to be flown: a gain margin of 3/(3-1) = 1.5 and a phase margin of
2 asin(1/6) = 19 degrees; tuning requires 2."""

COSTLIER = 1.5
"""Maximum ratio of the predicted cost to that of the present gains: a search also needs worse gains."""


def task(parameters: ParameterSet, profile: Record, noise: float, period: float, seed: int) -> TuningTask:
    """The tuning task: the model with the rig's measurement chain, `noise` [N] of a reading."""
    chain = chain_of(parameters, period)
    return TuningTask(parameters, profile, chain=chain, noise_std=noise, reference="what flies", seed=seed)


def retuned(wanted: TuningTask, settings: Mapping[str, float]) -> dict[str, float]:
    """A controller's values with gains tuned on the model, from its `settings` on; unchanged if none are better."""
    known = {p.name for p in CONTROLLER.parameters}
    given = ParameterSet(CONTROLLER).replaced({n: v for n, v in settings.items() if n in known})
    starts = controllers(wanted.parameters, given).settings
    found = tune(wanted, {"dual": starts["dual"]}).tuned["dual"]
    return found.objective.with_gains(found.final)


class Referee:
    """The model's check of gains before a flight: it rejects a cost ratio above COSTLIER, and a sensitivity above both
    SENSITIVITY and that of the present gains."""

    def __init__(self, wanted: TuningTask, settings: Mapping[str, float]):
        objective = wanted.objective(settings)
        self._objective = replace(objective, points=operating_points(objective, objective.gains))
        self._flies = self._objective.cost(objective.gains)
        self._most = max(SENSITIVITY, self.sensitivity(settings))

    def sensitivity(self, settings: Mapping[str, float]) -> float:
        """Maximum sensitivity of the model's loop."""
        return self._objective.largest_sensitivity(np.array([settings[name] for name in self._objective.names]))

    def predicted(self, settings: Mapping[str, float]) -> tuple[float, bool]:
        """(predicted cost over that of the present gains; whether the gains may be flown)."""
        gains = np.array([settings[name] for name in self._objective.names])
        costs = self._objective.cost(gains) / self._flies
        return costs, bool(costs <= COSTLIER and self.sensitivity(settings) <= self._most)


class GainSearch:
    """Search around the gains in use at its start: `asked` returns the next generation, `tell` takes its costs."""

    def __init__(self, settings: Mapping[str, float], names: Iterable[str], seed: int):
        self._settings = dict(settings)
        self._names = [name for name in names if settings[name] > 0.0]  # in the logarithm: zero gains stay zero
        options = {"popsize": TRIES, "bounds": [-FARTHEST, FARTHEST], "seed": seed + 1, "verbose": -9}
        self._search = cma.CMAEvolutionStrategy(len(self._names) * [0.0], STEP, options)
        self._asked: list[np.ndarray] = []

    def asked(self) -> list[dict[str, float]]:
        """The next generation's settings."""
        self._asked = self._search.ask()
        return [self._at(each) for each in self._asked]

    @property
    def favourite(self) -> dict[str, float]:
        """The search's present mean, a noisy average of the better halves of its generations."""
        return self._at(self._search.result.xfavorite)

    def _at(self, logarithms: np.ndarray) -> dict[str, float]:
        changed = {n: self._settings[n] * exp(x) for n, x in zip(self._names, logarithms, strict=True)}
        return {**self._settings, **changed}

    def tell(self, costs: Sequence[float]) -> None:
        """Costs of the generation, in its order."""
        self._search.tell(self._asked, list(costs))
