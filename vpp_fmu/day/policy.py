"""Where a controller's next gains may come from: retuned on the model, or searched on the rig, a few flights at a time.

The model-free search is the covariance matrix adaptation of Hansen and Ostermeier (Evolutionary Computation 9, 2001), pycma's,
in the logarithms of the gains about what flies. No gains fly that the model refuses (`Referee`).
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import exp

import numpy as np

from identification.tune.controllers import controllers
from identification.tune.operating import operating_points
from identification.tune.tune import Task, tune
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

with warnings.catch_warnings():  # of plots that nobody asks it for
    warnings.simplefilter("ignore")
    import cma

FARTHEST = 0.5
"""Of a gain's logarithm: how far a search may go from where it began. A sensitivity of 2 is a gain margin of 2 at least, half
of which is left."""

STEP = FARTHEST / 3.0
"""The same: its first standard deviation. What is looked for is to lie within three of them."""

TRIES = 8
"""Flights of a round's search: a generation of four to six gains has 8 or 9 (Hansen's default)."""

SENSITIVITY = 3.0
"""Largest amplification of a disturbance that the model may have under gains that fly. It leaves a gain margin of 3/(3-1) = 1.5
and a phase margin of 2 asin(1/6) = 19 degrees; tuning asks for 2."""

COSTLIER = 1.5
"""By how much the model may have gains cost more than those that fly: a search that finds its way needs worse ones, too."""


def task(parameters: ParameterSet, profile: Record, noise: float, period: float, seed: int) -> Task:
    """What gains are wanted for: the model behind the rig's measurement chain, `noise` [N] of a reading."""
    resolution = RESOLUTION / PAPER.thrust_scale * parameters.values["thrust_scale"]
    chain = {"time_constant": 0.0, "delay": 1.0 / CONVERSIONS / period, "resolution": resolution}
    return Task(parameters, profile, chain=chain, noise_std=noise, reference="what flies", seed=seed)


def retuned(wanted: Task, settings: Mapping[str, float]) -> dict[str, float]:
    """A controller's values with gains tuned on the model, from its `settings` on; these where none are better."""
    known = {p.name for p in CONTROLLER.parameters}
    given = ParameterSet(CONTROLLER).replaced({n: v for n, v in settings.items() if n in known})
    starts = controllers(wanted.parameters, given).settings
    found = tune(wanted, {"dual": starts["dual"]}).tuned["dual"]
    return found.objective.with_gains(found.final)


class Referee:
    """The model's word on gains before they fly: it refuses what leaves less margin than SENSITIVITY, and than what flies."""

    def __init__(self, wanted: Task, settings: Mapping[str, float]):
        objective = wanted.objective(settings)
        self._objective = replace(objective, points=operating_points(objective, objective.gains))
        self._flies = self._objective.cost(objective.gains)
        self._most = max(SENSITIVITY, self.sensitivity(settings))

    def sensitivity(self, settings: Mapping[str, float]) -> float:
        """The largest amplification of a disturbance in the model's loop."""
        return self._objective.largest_sensitivity(np.array([settings[name] for name in self._objective.names]))

    def predicted(self, settings: Mapping[str, float]) -> tuple[float, bool]:
        """(cost over that of what flies, as the model has it; whether they may fly)."""
        gains = np.array([settings[name] for name in self._objective.names])
        costs = self._objective.cost(gains) / self._flies
        return costs, bool(costs <= COSTLIER and self.sensitivity(settings) <= self._most)


class Search:
    """Gains about those that flew when it began: `asked` gives the next generation, `tell` takes what it cost."""

    def __init__(self, settings: Mapping[str, float], names: Iterable[str], seed: int):
        self._settings = dict(settings)
        self._names = [name for name in names if settings[name] > 0.0]  # by logarithm: what is 0 stays so
        options = {"popsize": TRIES, "bounds": [-FARTHEST, FARTHEST], "seed": seed + 1, "verbose": -9}
        self._search = cma.CMAEvolutionStrategy(len(self._names) * [0.0], STEP, options)
        self._asked: list[np.ndarray] = []

    def asked(self) -> list[dict[str, float]]:
        """The next generation's settings."""
        self._asked = self._search.ask()
        return [self._at(each) for each in self._asked]

    @property
    def favourite(self) -> dict[str, float]:
        """The settings that it is about by now: the mean of the better half of each generation, its noise with it."""
        return self._at(self._search.result.xfavorite)

    def _at(self, logarithms: np.ndarray) -> dict[str, float]:
        changed = {n: self._settings[n] * exp(x) for n, x in zip(self._names, logarithms, strict=True)}
        return {**self._settings, **changed}

    def tell(self, costs: Sequence[float]) -> None:
        """What the generation cost, in its order."""
        self._search.tell(self._asked, list(costs))
