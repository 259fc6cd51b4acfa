"""The paper's step test: published and tuned gains, both actuators and speed alone, on the paper's model and on the rig."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import steep
from hil.report import smoothed
from hil.safety.limits import Limits
from identification.tune.operating import operating_points
from identification.tune.search import search
from identification.tune.summary import step_error
from identification.tune.tune import Task, Tuned, Tuning, tune
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.paper import recording
from vpp_fmu.paper.published import ASSUMED, STEP_AT, STEP_FROM, STEP_TO
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.response import steps

MODEL, RIG, LIMITED = "paper's model", "emulated rig", "emulated rig, slew limits"
PUBLISHED, TUNED = "published gains", "tuned gains"
PI, PID, SPEED = "both actuators, PI", "both actuators", "speed alone"

STARTS = {"dual": DUAL | {"speed_only": 0.0}, "speed_only": SPEED_ONLY}
"""Where the searches for gains start: the published ones."""

SMOOTH = 0.04
"""s over which a rig's mean thrust is smoothed before it is judged: less than a tenth of any settling time."""


@dataclass(frozen=True)
class Merit:
    """A step's figures: `settling` s to stay within 2 % of the step (None: never), `overshoot` in % of the step, and the
    integral of the squared normalised error [s] until the next step; of a mean of runs with that error's standard deviation."""

    settling: float | None
    overshoot: float
    squared_error: float
    error_std: float | None = None

    def against(self, other: "Merit") -> str:
        """Whether the squared error is "better", "worse", or "as good": less than two standard deviations apart."""
        apart = self.squared_error - other.squared_error
        if abs(apart) <= 2.0 * np.hypot(self.error_std or 0.0, other.error_std or 0.0):
            return "as good"
        return "better" if apart < 0.0 else "worse"


@dataclass(frozen=True)
class Loop:
    """Which loop: on which plant, under which gains, with which controller."""

    plant: str
    gains: str
    controller: str


@dataclass(frozen=True, eq=False)
class Control:
    """`tuned`: gains for the paper's model, as the paper designed for it, and for the model that the rig's campaign gave.
    `settings`: the controller's values; `runs`: what the loops showed, of the rig as mean over its `repeats`, of which `single`
    has the first; `merits` of the steps up and down."""

    tuned: Mapping[str, Tuning]
    settings: Mapping[Loop, Mapping[str, float]]
    runs: Mapping[Loop, Record]
    single: Mapping[Loop, Record]
    merits: Mapping[Loop, tuple[Merit, Merit]]
    repeats: int


def profile(scale: float) -> Record:
    """The paper's step, and the way back as long after it: `time` s, `thrust_set` N."""
    levels = np.array([STEP_FROM, STEP_TO, STEP_FROM, STEP_FROM]) * scale
    return Record(
        {"time": np.array([0.0, STEP_AT, 2.0 * STEP_AT, 3.0 * STEP_AT]), "thrust_set": levels}, "the paper's step test"
    )


def control(identified: ParameterSet, noise: float, seed: int, repeats: int, stage: Callable[[str], None]) -> Control:
    """Tune for both plants, close all loops. `noise` N: of a reading on the rig; `repeats`: runs of each loop there, each with
    other noise. The paper's own design knows no noise and no converter."""
    papers = ParameterSet(BASE).replaced(ASSUMED)
    course = profile(papers.values["thrust_scale"])
    chain = {"delay": CONTROLLER.values()["sample_time"] ** -1 / CONVERSIONS, "resolution": RESOLUTION}
    stage("tune for the paper's model")
    tuned = {MODEL: tune(Task(papers, course, tuple(ASSUMED), seed=seed), STARTS)}
    stage("tune for the rig's model")
    tuned[RIG] = tune(Task(identified, course, chain=chain, noise_std=noise, seed=seed), STARTS)
    settings = {loop: own for plant, found in tuned.items() for loop, own in _settings(plant, found).items()}
    runs = {loop: _simulated(tuned[MODEL], own) for loop, own in settings.items() if loop.plant == MODEL}
    seeds = [1000 * (seed + 1) + k for k in range(repeats)]
    settings |= {
        replace(loop, plant=LIMITED): own for loop, own in settings.items() if loop.plant == RIG and loop.controller != PI
    }
    merits = {loop: judged(run) for loop, run in runs.items()}
    single = {}
    there = [loop for loop in settings if loop.plant != MODEL]
    for k, loop in enumerate(there):
        stage(f"loops on the rig {k / len(there):.0%}")
        limits = Limits() if loop.plant == LIMITED else steep(Limits())
        own = recording.loops(settings[loop], course, limits, seeds)
        runs[loop], single[loop], merits[loop] = recording.mean(own), own[0], averaged(own)
    return Control(tuned, settings, runs, single, merits, repeats)


def averaged(runs: Sequence[Record]) -> tuple[Merit, Merit]:
    """The figures of the mean of a loop's runs on the rig, up and down."""
    merits = judged(smoothed(recording.mean(runs), SMOOTH))
    if len(runs) == 1:
        return merits
    errors = np.array([[merit.squared_error for merit in judged(smoothed(run, SMOOTH))] for run in runs])
    std = errors.std(axis=0, ddof=1) / np.sqrt(len(runs))
    return tuple(replace(merit, error_std=float(own)) for merit, own in zip(merits, std, strict=True))


def judged(run: Record) -> tuple[Merit, Merit]:
    """The figures of a run's step up and of its step down."""
    found = steps(run)
    ends = [step.time for step in found[1:]] + [float(run.time[-1])]
    scale = BASE.values()["thrust_scale"]
    return tuple(
        Merit(step.settling, step.overshoot, step_error(run, step, end, scale)) for step, end in zip(found, ends, strict=True)
    )


def _settings(plant: str, found: Tuning) -> dict[Loop, dict[str, float]]:
    """All controllers for a plant. A PI is what the paper's search has before the derivative: of the published gains, those
    without it."""
    dual, alone = found.tuned["dual"], found.tuned["speed_only"]
    derivative = np.array([name.startswith("kd") for name in dual.objective.names])
    start = dual.gains["start"]
    return {
        Loop(plant, PUBLISHED, PID): dual.objective.with_gains(start),
        Loop(plant, PUBLISHED, PI): dual.objective.with_gains(np.where(derivative, 0.0, start)),
        Loop(plant, PUBLISHED, SPEED): alone.objective.with_gains(alone.gains["start"]),
        Loop(plant, TUNED, PID): dual.objective.with_gains(dual.final),
        Loop(plant, TUNED, PI): dual.objective.with_gains(_without_derivative(dual)),
        Loop(plant, TUNED, SPEED): alone.objective.with_gains(alone.final),
    }


def _without_derivative(tuned: Tuned) -> np.ndarray:
    """The gains of the search's first stage."""
    objective = tuned.objective
    return search(replace(objective, points=operating_points(objective, objective.gains)), objective.gains, ("PI",)).gains


def _simulated(found: Tuning, settings: Mapping[str, float]) -> Record:
    """A controller's loop on the plant that was tuned for."""
    tuned = found.tuned["speed_only" if settings["speed_only"] > 0.5 else "dual"]
    return tuned.objective.run(np.array([settings[name] for name in tuned.objective.names]))
