"""A small network in the controller's place: its weights are searched on plants drawn from the posterior.

    J = mean over plants of  integral of ((thrust_set - thrust) / thrust_scale)^2 dt  (1 + PENALTY max(0, overshoot - limit))
        + DECAY |weights|^2

The search is the covariance matrix adaptation of Hansen and Ostermeier (Evolutionary Computation 9, 2001), pycma's. Each
generation is simulated with new set-points on other plants of a pool. The search starts from a linear law: the commands are a
straight line over the set-point, plus proportional and integral action. The comparison uses plants, set-points and noise that
are not part of the search.
"""

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.tune.profile import common_reach
from identification.tune.tune import TuningTask
from vpp_fmu.commands import idle
from vpp_fmu.kernel.effects.dual_pid import ALLOCATION
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.types import Model, Signal
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.policy import Policy, policy_from_arrays, policy_model
from vpp_fmu.record import Record

with warnings.catch_warnings():  # its optional plots
    warnings.simplefilter("ignore")
    import cma

OBSERVE, HISTORY = ("thrust_set", "thrust", "integral", "omega_ref", "beta_ref"), 3

CHANNELS = "omega", "beta"

POOL, FLOWN = 64, 6
"""Number of plants to learn on, and of those that a generation is simulated on."""

HOLDS, FLIGHT = (2.0, 4.0), 16.0
"""Hold of a set-point (least, most), and duration of a flight (a simulated run), in time scales of the rig."""

PENALTY, DECAY, STEP = 10.0, 1e-6, 0.15
"""Factor on overshoot beyond its limit; cost of a squared weight; first standard deviation of the search."""

GENTLE = 0.3
"""Slope of the first unit at the start: the unit stays in its linear part."""

WIDER, FARTHER, RIDGE = 0.5, 1.5, 1e-4
"""Widening of the box on each side, as a share of the observations' range; factor on their largest distance; share of a
variance that is added to the covariance, because successive readings are nearly equal."""


@dataclass(frozen=True, eq=False)
class Flights:
    """Squared error [s] and overshoot (share of a step) on `plants` held-out plants, each (plants,)."""

    errors: np.ndarray
    overshoots: np.ndarray
    travel: float
    """Travel of the commands per second, as a share of their ranges: mean over some of the plants."""


@dataclass(frozen=True, eq=False)
class LearnedLaw:
    """The policy, its search (`evaluations`, `cost`, each (generations,)), and held-out flights by controller. `example`: a
    held-out flight on the nominal plant, by controller. `fallback`: share of time that the policy spends in it."""

    policy: Policy
    evaluations: np.ndarray
    cost: np.ndarray
    flights: Mapping[str, Flights]
    example: Mapping[str, Record]
    fallback: float
    seconds: float

    @property
    def passes(self) -> bool:
        """Whether the policy may be used: less mean error than the PID on the held-out plants, and no larger maximum."""
        own, other = (self.flights[name].errors for name in ("policy", "PID"))
        return bool(np.mean(own) < np.mean(other) and np.max(own) <= np.max(other))

    @property
    def better(self) -> float:
        """Share of the held-out plants on which the policy has less error."""
        return float(np.mean(self.flights["policy"].errors < self.flights["PID"].errors))


class _Network:
    """The weights of a network as one vector. `span` N: range of the set-points; `values`: of the PID to fall back on."""

    def __init__(self, hidden: int, span: tuple[float, float], values: Mapping[str, float]):
        self.values = {n: v for n, v in values.items() if n not in ALLOCATION}
        names = [*OBSERVE, *["thrust"] * HISTORY]
        ends = {"thrust": span, "thrust_set": span, **{f"{u}_ref": (values[f"{u}_min"], values[f"{u}_max"]) for u in CHANNELS}}
        scales = {name: (0.5 * (low + high), max(0.5 * (high - low), 1e-6)) for name, (low, high) in ends.items()}
        scales["integral"] = 0.0, 0.1 * scales["thrust"][1]
        self.mean, self.scale = (np.array(column) for column in zip(*(scales[n] for n in names), strict=True))
        self.shapes = ((hidden, len(names)), (hidden,), (2, hidden), (2,))
        self.count = sum(int(np.prod(shape)) for shape in self.shapes)

    def start(self) -> np.ndarray:
        """The weights (count,) of the linear law."""
        inner, bias, outer, last = (np.zeros(shape) for shape in self.shapes)
        inner[0, :3] = GENTLE * np.array([2.0, -1.0, 1.0])
        outer[:, 0] = 1.0 / GENTLE
        return np.concatenate([inner.ravel(), bias, outer.ravel(), last])

    def arrays(self, weights: np.ndarray) -> list[np.ndarray]:
        """Weights and biases of both layers, in turn."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes])
        return [part.reshape(shape) for part, shape in zip(np.split(weights, ends[:-1]), self.shapes, strict=True)]

    def policy(self, weights: np.ndarray, **more) -> Policy:
        """The policy of weights (count,), without a box unless `more` has one."""
        inner, bias, outer, last = self.arrays(weights)
        wide = np.full(len(self.mean), 1e9)
        own = {"mean": self.mean, "scale": self.scale, "low": -wide, "high": wide, **more}
        mean, scale = (np.asarray(own[name]) for name in ("mean", "scale"))
        bias, inner = bias + inner @ ((mean - self.mean) / self.scale), inner * (scale / self.scale)
        own |= {"observe": OBSERVE, "history": HISTORY, "parameters": self.values}
        return policy_from_arrays([inner, outer], [bias, last], "vpp learn", **own)

    def model(self, scales: Scales) -> tuple[Model, np.ndarray]:
        """The law with its weights as parameters, in the order of the vector; its values (parameters,), the weights last."""
        names = iter(f"weight_{k}" for k in range(self.count))
        named = [np.array([next(names) for _ in range(int(np.prod(s)))]).reshape(s).tolist() for s in self.shapes]
        layers = tuple((tuple(map(tuple, rows)), tuple(biases)) for rows, biases in (named[:2], named[2:]))
        model = policy_model(replace(self.policy(np.zeros(self.count)).law, layers=layers), scales, outputs=2)
        return model, np.array(list(model.values(self.values).values()))


class Trial:
    """Simulated flights of controllers over random set-points."""

    def __init__(self, task: TuningTask, settings: Mapping[str, float]):
        self.task, self.settings, self.dt = task, settings, settings["sample_time"]
        self.span, rig = common_reach(task.parameters, {"": settings}), task.parameters.rig
        self.scale, self.rest = rig.scales.thrust_scale, idle(rig)
        self.time_scale = rig.scales.time_scale
        self.chain = np.array(list(MEASUREMENT.values({**(task.chain or {}), "sample_time": self.dt}).values()))

    def course(self, rng: np.random.Generator) -> Course:
        """Random set-points within reach, with noise of the readings."""
        points = max(10, round(FLIGHT * self.time_scale / self.dt))
        ends = np.cumsum(rng.uniform(*HOLDS, int(FLIGHT / HOLDS[0]) + 2)) * self.time_scale
        room = 0.1 * (self.span[1] - self.span[0])
        levels = rng.uniform(self.span[0] + room, self.span[1] - room, len(ends))
        wanted = levels[np.searchsorted(ends, self.dt * np.arange(points), side="right")]
        return Course(wanted, self.task.noise_std * rng.standard_normal(points), self.dt, self.scale, self.rest)

    def flights(self, model: Model, values: np.ndarray, plants: np.ndarray, seed: tuple[int, ...]) -> Flights:
        """One controller on plants (plants, parameters), each with its own set-points."""
        loop, merits, travel = ClosedLoop(self.task.parameters.model, model), [], []
        width = np.array([max(self.settings[f"{u}_max"] - self.settings[f"{u}_min"], 1e-9) for u in CHANNELS])
        for k, own in enumerate(plants):
            found, rows = loop.rows((own, self.chain, values), self.course(np.random.default_rng((*seed, k))))
            merits.append(found)
            travel.append(np.abs(np.diff(rows[:, :2], axis=0)).sum(axis=0) / width / (self.dt * len(rows)))
        errors, overshoots = np.array(merits).T
        return Flights(errors, overshoots, float(np.mean(travel)))


def random_steps(task: TuningTask, settings: Mapping[str, float]) -> Record:
    """A profile, `time` [s], `thrust_set` [N], of the kind that a policy learns on: for tuning the PID beside it."""
    course = Trial(task, settings).course(np.random.default_rng([task.seed, 17]))
    rows = np.unique([0, *(np.flatnonzero(np.diff(course.wanted)) + 1), len(course.wanted) - 1])
    return Record({"time": rows * course.dt, "thrust_set": course.wanted[rows]}, "random steps")


def learn(
    task: TuningTask,
    settings: Mapping[str, float],
    hidden: int,
    generations: int,
    judged: int,
    progress: Callable[[float], None] = lambda share: None,
) -> LearnedLaw:
    """Learn a policy of `hidden` units in so many generations; compare it with the controller of these `settings` on `judged`
    plants.

    `task`: plant, its posterior, noise, limit on overshoot and seed. The policy has the settings' limits and period, and their
    gains in its fallback.
    """
    began, trial, model = time.monotonic(), Trial(task, settings), task.parameters.model
    network = _Network(hidden, trial.span, settings)
    law, values = network.model(task.parameters.rig.scales)
    loop, pool = ClosedLoop(model, law), task.plants(POOL, 11)
    rng = np.random.default_rng([task.seed, 12])

    def costs(candidates: np.ndarray) -> np.ndarray:
        """(candidates,)"""
        course, plants = trial.course(rng), pool[rng.choice(POOL, FLOWN, replace=False)]
        sets = np.tile(values, (len(candidates), 1))
        sets[:, -network.count :] = candidates
        many = np.tile(plants, (len(candidates), 1)), trial.chain[None], np.repeat(sets, FLOWN, axis=0)
        errors, overshoots = loop.merits(many, course).reshape(len(candidates), FLOWN, 2).transpose(2, 0, 1)
        flown = errors * (1.0 + PENALTY * np.maximum(0.0, np.minimum(overshoots, 10.0) - task.overshoot))
        return np.nan_to_num(flown.mean(axis=1), posinf=1e9) + DECAY * np.square(candidates).sum(axis=1)

    options = {"seed": task.seed + 1, "verbose": -9, "verb_log": 0, "verb_disp": 0}
    search = cma.CMAEvolutionStrategy(network.start(), STEP, options)
    evaluations, curve = [], []
    for k in range(generations):
        progress(k / generations)
        candidates = np.array(search.ask())
        found = costs(candidates)
        search.tell(list(candidates), found.tolist())
        evaluations.append(search.countevals)
        curve.append(float(np.median(found)))
    policy = _guarded(network, np.asarray(search.mean), trial, pool[:FLOWN])
    own = policy.parameters(settings, task.parameters.rig.scales)
    plants, nominal = task.plants(judged, 13), np.array([list(task.parameters.values.values())])
    course = trial.course(np.random.default_rng([task.seed, 15]))
    compared = {"policy": (replace(own.model, outputs=own.model.outputs[:2]), own.values), "PID": (task.controller, settings)}
    flights, example = {}, {}
    for name, (which, chosen) in compared.items():
        vector = np.array([chosen[n] for n in which.values()])
        flights[name] = trial.flights(which, vector, plants, (task.seed, 14))
        example[name] = ClosedLoop(model, which).run((nominal, trial.chain, vector), course)
    fallback = _seen(policy, trial, plants[: min(judged, 20)], (task.seed, 14))[1]
    curves = np.array(evaluations), np.array(curve)
    return LearnedLaw(policy, *curves, flights, example, fallback, time.monotonic() - began)


def _guarded(network: _Network, weights: np.ndarray, trial: Trial, plants: np.ndarray) -> Policy:
    """The policy with the box and the distance of its observations on `plants` (n, parameters)."""
    seen, _ = _seen(network.policy(weights), trial, plants, (trial.task.seed, 16))
    low, high, mean = seen.min(axis=0), seen.max(axis=0), seen.mean(axis=0)
    room, scale = WIDER * (high - low) + 1e-6 * network.scale, np.maximum(seen.std(axis=0), 1e-3 * network.scale)
    z = (seen - mean) / scale
    precision = np.linalg.inv(z.T @ z / len(z) + RIDGE * np.eye(len(mean)))
    precision = 0.5 * (precision + precision.T)
    distance = FARTHER * float(np.sqrt(np.einsum("ni,ij,nj->n", z, precision, z).max()))
    box = {"low": low - room, "high": high + room, "precision": precision, "distance": distance}
    return network.policy(weights, mean=mean, scale=scale, **box)


def _seen(policy: Policy, trial: Trial, plants: np.ndarray, seed: tuple[int, ...]) -> tuple[np.ndarray, float]:
    """(observations (samples, observations), share of time in the fallback) of a policy on these plants."""
    found, names = [], [p.name for p in trial.task.parameters.model.parameters]
    own = policy.parameters(trial.settings, trial.task.parameters.rig.scales)
    shown = tuple(Signal(f"seen_{k}", "1", "observation", -1e9, 1e9) for k in range(len(policy.law.mean)))
    law = Stepper(replace(own.model, outputs=(*own.model.outputs, *shown)), own.values)
    chain = Stepper(MEASUREMENT, dict(zip(MEASUREMENT.values(), trial.chain.tolist(), strict=True)))
    extra = tuple(trial.task.parameters.model.measured_inputs.values())
    for k, each in enumerate(plants):
        course = trial.course(np.random.default_rng((*seed, k)))
        rig = Stepper(trial.task.parameters.model, dict(zip(names, each.tolist(), strict=True)))
        thrust = rig.start((*trial.rest, *extra))[0]
        (reading,) = chain.start((thrust, 0.0))
        law.start((course.wanted[0], reading))
        for wanted, noise in zip(course.wanted.tolist(), course.noise.tolist(), strict=True):
            (reading,) = chain.step((thrust, noise), course.dt)
            omega, beta, *rest = law.step((wanted, reading), course.dt)
            found.append(rest)
            thrust = rig.step((omega, beta, *extra), course.dt)[0]
    seen = np.array(found)
    return seen[:, 1:], float(seen[:, 0].mean())
