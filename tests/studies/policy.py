"""python -m tests.studies policy --seeds 20: cost of the tuned PID, of the law of the best pairs, and of a learned law.

Each seed is a rig of the energy study, known with 10 % of uncertainty in each parameter. All three controllers are made from
that knowledge: both PID laws are tuned on set-points of the later test's kind, the network is learned on plants of the
uncertainty. Each is then tested on 50 other plants of the uncertainty with new set-points and noise, and on these with an
unknown dead band of the pitch command of 1 to 2.5 deg. Cost: integral of the squared error over the thrust's scale [s] in a
flight.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from identification.power.allocation import allocate, allocated_controller
from identification.power.fit import fit_power, steady_readings
from identification.power.model import PowerModel
from identification.tune.controllers import controllers
from identification.tune.learn import Trial, learn, random_steps
from identification.tune.profile import rig_profile
from identification.tune.tune import Task, tune
from identification.workers import spread
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.effects.dual_pid import ALLOCATION
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.parameters import ParameterSet

from .energy import points, rig

PLANTS, NOISE, UNITS = 50, 0.13, 6
"""Held-out plants of each seed; noise of a reading [N]; hidden units."""

HIDDEN, WIDTHS = "pitch_command_deadband", (1.0, 2.5)
"""The effect that the controllers do not know, and the range of its half width [deg]."""

LAWS = "tuned PID", "best pairs", "learned"


def costs(seed: int, generations: int) -> dict[str, dict[str, np.ndarray]]:
    """Costs (plants,) by test ("as known", "with a dead band") and by law."""
    rng = np.random.default_rng([seed, 47])
    truth = rig(rng)
    parameters = ParameterSet(BASE).replaced(truth.values)
    fit = fit_power(steady_readings(points(truth, rng), parameters.values))
    powered = fit.added_to(parameters)
    pairs = allocated_controller(allocate(powered, PowerModel(powered, fit.names, fit.covariance), 1.0), powered).values
    own = controllers(parameters).settings["dual"]
    chain = {"delay": 1.0 / CONVERSIONS / own["sample_time"], "resolution": RESOLUTION}
    task = Task(parameters, rig_profile(parameters, {"dual": own}), chain=chain, noise_std=NOISE, overshoot=0.05, seed=seed)
    seen = replace(task, profile=random_steps(task, own))
    starts = {"tuned PID": own, "best pairs": {**own, **{n: pairs[n] for n in (*ALLOCATION, "ki_beta")}}}
    settings = {}
    for name, start in starts.items():
        found = tune(seen, {name: start}).tuned[name]
        settings[name] = found.objective.with_gains(found.final)
    policy = learn(task, settings["tuned PID"], UNITS, generations, 2).policy
    law = policy.parameters(settings["tuned PID"])
    models = {name: (CONTROLLER, values) for name, values in settings.items()}
    models["learned"] = replace(law.model, outputs=law.model.outputs[:2]), law.values
    plants = task.plants(PLANTS, 18)
    beyond = ParameterSet(plant((HIDDEN,))).replaced(truth.values)
    names = [p.name for p in parameters.model.parameters]
    with_band = []
    for values, width in zip(plants, rng.uniform(*WIDTHS, PLANTS), strict=True):
        full = {**dict(zip(names, values.tolist(), strict=True)), f"{HIDDEN}.half_width": width}
        with_band.append(list(beyond.model.values(full).values()))
    flown = {"as known": (task, plants), "with a dead band": (replace(task, parameters=beyond), np.array(with_band))}
    return {
        case: {name: _flown(on, settings["tuned PID"], models[name], those, seed) for name in LAWS}
        for case, (on, those) in flown.items()
    }


def _flown(task: Task, settings: Mapping[str, float], law, plants: np.ndarray, seed: int) -> np.ndarray:
    model, values = law
    vector = np.array(list(model.values({n: values[n] for n in model.values()}).values()))
    return Trial(task, settings).flights(model, vector, plants, (seed, 19)).errors


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=20, metavar="N")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N")
    parser.add_argument("--generations", type=int, default=600, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    parsed = parser.parse_args(arguments)
    seeds = range(parsed.first_seed, parsed.first_seed + parsed.seeds)
    found = spread(partial(costs, generations=parsed.generations), seeds, parsed.workers, what="rigs")
    for case in found[0]:
        print(f"\n{case}, {len(found)} rigs of {PLANTS} plants")
        print(f"{'law':12s} {'median':>9s} {'worst':>9s} {'less than the PID':>18s}")
        for name in LAWS:
            own, pid = (np.array([each[case][law] for each in found]) for law in (name, "tuned PID"))
            less = f"{100.0 * np.mean(own < pid):.0f} %" if name != "tuned PID" else ""
            print(f"{name:12s} {np.median(own):9.4f} {own.max():9.4f} {less:>18s}")
