"""Tune gains for a plant, of both actuators and of speed alone at fixed pitch, nominal and robust; accept or reject them."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from identification.fit.problem import Prior
from identification.tune.check import largest_difference, through_fmus
from identification.tune.draws import Posterior, standard_deviations
from identification.tune.margins import Margins, least
from identification.tune.objective import ALPHA, Objective, Point
from identification.tune.operating import margins_at, operating_points
from identification.tune.search import SearchResult, rounds
from identification.tune.verdict import Verdict, verdict
from vpp_fmu.commands import idle
from vpp_fmu.kernel.controller import CONTROLLER, speed_alone
from vpp_fmu.kernel.effects.thrust_reading import LONGEST
from vpp_fmu.kernel.measurement import CONVERSIONS, MEASUREMENT, RESOLUTION
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.closed_loop import Course
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

STARTS = (1.0, 0.3)
"""Factors on the initial gains, one search each."""

SHAKES = (4, 2)
"""Final searches from perturbed best gains: on the nominal plant, on many."""

LOWER, LOWEST = 0.8, 20
"""Factor by which initial gains are lowered, and maximum number of repetitions: down to a hundredth."""

HARDEST = 12
"""Plants in the first round of a worst-case search: those of largest cost under the nominal gains."""

JUDGED = 200
"""Hold-out plants on which robust gains are evaluated; the search uses none of them."""


def chain_of(parameters: ParameterSet, period: float) -> dict[str, float]:
    """The rig's measurement chain for a controller with a sample time `period` [s]: delay of its converter, at most the longest
    possible one, and step of its converter scaled to the thrust of the plant."""
    delay = min(1.0 / CONVERSIONS / period, float(LONGEST))
    scale = parameters.values["thrust_scale"] / PAPER.thrust_scale
    return {"time_constant": 0.0, "delay": delay, "resolution": RESOLUTION * scale}


@dataclass(frozen=True, eq=False)
class TuningTask:
    """A tuning task. `parameters`: the plant's; `assumed`: names of those set by hand for the design.

    `chain`: changes to the measurement chain; `noise_std` N: of a reading. `overshoot` (share of a step) and `sensitivity` are
    limits on the nominal loop. `reference`: label of the initial gains. `robust`: None, "worst" or "mean" over `draws` plants;
    `spread`: standard deviation, as a share of the value, of parameters without one. `left_out`: controllers that are not
    possible on the rig, with the reason. `lowered`: whether initial gains are lowered by a common factor until they keep the
    limit on sensitivity; published or given gains are not. `effects_from`: files of user-defined effects.
    """

    parameters: ParameterSet
    profile: Record
    assumed: tuple[str, ...] = ()
    chain: Mapping[str, float] | None = None
    noise_std: float = 0.0
    alpha: float = ALPHA
    overshoot: float = 0.01
    sensitivity: float = 2.0
    reference: str = "published"
    robust: str | None = None
    draws: int = 200
    spread: float = 0.1
    knowledge: Prior | None = None
    seed: int = 0
    left_out: Mapping[str, str] = field(default_factory=dict)
    lowered: bool = False
    effects_from: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", self.parameters.without_power)  # the loop is closed over thrust only

    @property
    def controller(self) -> Model:
        return CONTROLLER.sized(self.parameters.rig.scales)

    def objective(self, settings: Mapping[str, float]) -> Objective:
        """The objective for a controller with these settings, on the nominal plant."""
        settings, values = self.controller.values(settings), self.parameters.values
        dt, speed_only = settings["sample_time"], speed_alone(settings)
        rest = (settings["omega_min"], settings["beta_fixed"]) if speed_only else idle(self.parameters.rig)
        course = Course.of(self.profile, dt, values["thrust_scale"], rest=rest)
        noise = self.noise_std * np.random.default_rng([self.seed, 2]).standard_normal(len(course.wanted))
        return Objective(
            effects=self.parameters.model.optional,
            effects_from=self.effects_from,
            plants=np.array([list(values.values())]),
            settings=settings,
            chain=MEASUREMENT.values({**(self.chain or {}), "sample_time": dt}),
            course=replace(course, noise=noise),
            time_scale=self.parameters.rig.scales.time_scale,
            alpha=self.alpha,
            over=self.robust or "worst",
            overshoot=self.overshoot,
            sensitivity=self.sensitivity,
        )

    def plants(self, count: int, stream: int) -> np.ndarray:
        """Plants (count, parameters) drawn from the parameters' uncertainty; `stream` selects independent draws."""
        std = standard_deviations(self.parameters, self.assumed, self.spread)
        return Posterior(self.parameters, std, self.knowledge).draw(np.random.default_rng((self.seed, stream)), count)


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result for one controller. `gains`: "start" (initial), "tuned", and "robust" if requested, each (n,).

    `verdicts`: of tuned and robust gains; `points` and `margins`: operating points of each gain set. `judged`,
    `overshoots`: cost and overshoot (share of a step) of each gain set on hold-out plants (JUDGED,). `fmu_difference` N:
    largest difference of thrust between FMUs and compiled loop under the chosen gains.
    """

    objective: Objective
    gains: Mapping[str, np.ndarray]
    verdicts: Mapping[str, Verdict]
    points: Mapping[str, tuple[Point, ...]]
    margins: Mapping[str, tuple[Margins, ...]]
    judged: Mapping[str, np.ndarray]
    overshoots: Mapping[str, np.ndarray]
    fmu_difference: float = float("nan")

    @property
    def chosen(self) -> str:
        """Name of the chosen gains: the last that are better than the initial ones, else the initial ones."""
        return next((name for name in reversed(self.verdicts) if self.verdicts[name].better), "start")

    @property
    def final(self) -> np.ndarray:
        return self.gains[self.chosen]

    def cost(self, which: str) -> float:
        """The paper's cost on the nominal plant."""
        return self.objective.cost(self.gains[which])


@dataclass(frozen=True, eq=False)
class Tuning:
    """Results for the controllers "dual" and "speed_only", or "allocated"; `plants` (JUDGED, parameters): hold-out plants."""

    task: TuningTask
    tuned: Mapping[str, Tuned]
    plants: np.ndarray | None
    seconds: float


Found = Mapping[str, tuple[Objective, SearchResult]]
"""By controller: the best search, and the objective that it minimises."""


def tune(task: TuningTask, starts: Mapping[str, Mapping[str, float]], workers: int = 1, scheduler: str | None = None) -> Tuning:
    """Tune each controller of `starts`: settings, with initial gains, by the controller's name.

    `workers`, `scheduler` as in `identification.workers`; the gains do not depend on them.
    """
    began = time.perf_counter()
    objectives = {name: task.objective(settings) for name, settings in starts.items()}
    if task.lowered:
        objectives = {name: _lowered(objective) for name, objective in objectives.items()}
    found = {"tuned": _nominal(objectives, workers, scheduler)}
    plants = None
    if task.robust:
        found["robust"] = _robust(task, found["tuned"], workers, scheduler)
        plants = task.plants(JUDGED, stream=1)
    tuned = {name: _tuned(o, {which: each[name] for which, each in found.items()}, plants) for name, o in objectives.items()}
    finals = {name: each.objective.with_gains(each.final) for name, each in tuned.items()}
    courses = {name: objective.course for name, objective in objectives.items()}
    chain = next(iter(objectives.values())).chain
    model, values = task.parameters.model, task.parameters.values
    runs = through_fmus(model, values, task.controller, finals, chain, courses, task.profile)
    tuned = {n: replace(t, fmu_difference=largest_difference(t.objective.run(t.final), runs[n])) for n, t in tuned.items()}
    return Tuning(task, tuned, plants, time.perf_counter() - began)


def _lowered(objective: Objective) -> Objective:
    """Lower the initial gains until the loop keeps its limit on sensitivity; unchanged if none does.

    The response under the initial gains limits that of the tuned ones, and a loop close to instability is no useful limit.
    """
    for k in range(LOWEST + 1):
        gains = LOWER**k * objective.gains
        worst = least(margins_at(objective, gains, operating_points(objective, gains)))
        if worst and worst.stable and worst.sensitivity <= objective.sensitivity:
            return replace(objective, settings=objective.with_gains(gains))
    return objective


def _nominal(objectives: Mapping[str, Objective], workers, scheduler) -> Found:
    limited = {n: replace(o, points=operating_points(o, o.gains), reference=o.steps(o.gains)) for n, o in objectives.items()}
    starts = {name: [(factor * o.gains, ("PI", "D", "all")) for factor in STARTS] for name, o in objectives.items()}
    return rounds(limited, starts, None, SHAKES[0], workers, scheduler, "tuning")


def _robust(task: TuningTask, found: Found, workers, scheduler) -> Found:
    """Search on many plants, from the nominal and from the initial gains. For the worst case only the plants of largest cost
    are used; the others stay in reserve."""
    drawn = task.plants(task.draws, stream=0)
    many, starts = {}, {}
    for name, (o, each) in found.items():
        chosen = drawn
        if task.robust == "worst":
            chosen = drawn[np.argsort(replace(o, plants=drawn).costs(each.gains))[-HARDEST:]]
        many[name] = replace(o, plants=np.vstack([o.plants, chosen]))
        starts[name] = [(gains, ("all",)) for gains in (each.gains, o.gains)]
    reserve = drawn if task.robust == "worst" else None
    return rounds(many, starts, reserve, SHAKES[1], workers, scheduler, "robust tuning")


def _tuned(objective: Objective, found: Found, plants: np.ndarray | None) -> Tuned:
    """Evaluate the results of the searches, "tuned" and possibly "robust"."""
    gains = {"start": objective.gains} | {name: search.gains for name, (_, search) in found.items()}
    points = {name: operating_points(objective, own) for name, own in gains.items()}
    margins = {name: margins_at(objective, own, points[name]) for name, own in gains.items()}
    verdicts = {}
    for name, (searched, search) in found.items():
        penalised = searched.penalised(objective.gains), search.cost
        verdicts[name] = verdict(objective, search.gains, (margins["start"], margins[name]), penalised)
    judged, overshoots = {}, {}
    if plants is not None:
        others = replace(objective, plants=plants)
        judged = {name: others.costs(own) for name, own in gains.items()}
        overshoots = {name: others.merits(own)[:, 1] for name, own in gains.items()}
    return Tuned(objective, gains, verdicts, points, margins, judged, overshoots)
