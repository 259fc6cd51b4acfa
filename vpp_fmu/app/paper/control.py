"""The paper's step test: published and tuned gains, both actuators and speed alone, on the paper's model and on the rig."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.calibration import read_calibration
from hil.campaign import steep
from hil.emulator.rig import Rig
from hil.rig import RunEnded
from hil.run import run_on_rig
from hil.safety.limits import Limits
from hil.session import Setup
from identification.tune.objective import Objective
from identification.tune.operating import operating_points
from identification.tune.search import search
from identification.tune.summary import step_error
from identification.tune.tune import Task, Tuning, tune
from vpp_fmu.app.paper.published import ASSUMED, STEP_AT, STEP_FROM, STEP_TO
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record
from vpp_fmu.response import smoothed, steps

MODEL, RIG, LIMITED = "paper's model", "emulated rig", "emulated rig, slew limits"
PUBLISHED, TUNED = "published gains", "tuned gains"
PI, PID, SPEED = "both actuators, PI", "both actuators", "speed alone"

STARTS = {"dual": DUAL | {"speed_only": 0.0}, "speed_only": SPEED_ONLY}
"""Start of the searches: the published gains."""

SMOOTH = 0.04
"""s over which a rig's mean thrust is smoothed before it is judged: less than a tenth of any settling time."""


@dataclass(frozen=True)
class Merit:
    """A step's figures: `settling` s to stay within 2 % of the step (None: never), `overshoot` in % of the step.
    `squared_error` is the integral of the squared normalised error [s] until the next step; `error_std`: for a mean of runs."""

    settling: float | None
    overshoot: float
    squared_error: float
    error_std: float | None = None

    @property
    def seconds(self) -> str:
        """The settling time as text."""
        return "not settled" if self.settling is None else f"{self.settling:.2f} s"

    def against(self, other: "Merit") -> str:
        """Whether the squared error is "better", "worse", or "as good": less than two standard deviations apart."""
        apart = self.squared_error - other.squared_error
        if abs(apart) <= 2.0 * np.hypot(self.error_std or 0.0, other.error_std or 0.0):
            return "as good"
        return "better" if apart < 0.0 else "worse"


class Loop(NamedTuple):
    """A closed loop: the plant, the gains, the controller."""

    plant: str
    gains: str
    controller: str


@dataclass(frozen=True, eq=False)
class StepTest:
    """A loop's step test. `settings`: the controller's values; `runs`: one on the paper's model, the repeats on the rig;
    `mean`: of the runs; `up` and `down`: figures of its two steps."""

    settings: Mapping[str, float]
    runs: Sequence[Record]
    mean: Record
    up: Merit
    down: Merit


def profile(scale: float) -> Record:
    """The paper's step, and the step back after the same time: `time` s, `thrust_set` N."""
    levels = np.array([STEP_FROM, STEP_TO, STEP_FROM, STEP_FROM]) * scale
    times = np.array([0.0, STEP_AT, 2.0 * STEP_AT, 3.0 * STEP_AT])
    return Record({"time": times, "thrust_set": levels}, "the paper's step test")


def emulated(limits: Limits, seed: int, map_is_known: bool = True) -> Setup:
    """The emulated rig in virtual time, without hidden effects. `seed`: of its noise."""
    calibration = read_calibration(str(files("hil.emulator") / "calibration.json"))
    return Setup(calibration, limits, Rig(seed=seed), virtual=True, map_is_known=map_is_known)


def control(
    identified: ParameterSet, noise: float, seed: int, repeats: int, stage: Callable[[str], None]
) -> tuple[Mapping[str, Tuning], Mapping[Loop, StepTest]]:
    """Tune for both plants, close all loops: (tunings by plant, step tests by loop). `noise` N: of a reading on the rig;
    `repeats`: runs of each loop there, each with other noise. The paper's design has no noise and no converter. RunEnded."""
    papers = ParameterSet(BASE).replaced(ASSUMED)
    course = profile(papers.values["thrust_scale"])
    chain = {"delay": CONTROLLER.values()["sample_time"] ** -1 / CONVERSIONS, "resolution": RESOLUTION}
    stage("tune for the paper's model")
    tuned = {MODEL: tune(Task(papers, course, tuple(ASSUMED), seed=seed), STARTS)}
    stage("tune for the rig's model")
    tuned[RIG] = tune(Task(identified, course, chain=chain, noise_std=noise, seed=seed), STARTS)
    tests, there = {}, {}
    for loop, (objective, gains) in _designs(MODEL, tuned[MODEL]).items():
        run = objective.run(gains)
        tests[loop] = StepTest(objective.with_gains(gains), (run,), run, *judged(run))
    for loop, (objective, gains) in _designs(RIG, tuned[RIG]).items():
        there[loop] = objective.with_gains(gains)
    there |= {loop._replace(plant=LIMITED): own for loop, own in there.items() if loop.controller != PI}
    for k, (loop, settings) in enumerate(there.items()):
        stage(f"loops on the rig {k / len(there):.0%}")
        limits = Limits() if loop.plant == LIMITED else steep(Limits())
        tests[loop] = _on_rig(settings, course, limits, [1000 * (seed + 1) + n for n in range(repeats)])
    return tuned, tests


def judged(run: Record) -> tuple[Merit, Merit]:
    """The figures of a run's step up and of its step down."""
    scale = BASE.values()["thrust_scale"]
    return tuple(Merit(s.settling, s.overshoot, step_error(run, s, s.end, scale)) for s in steps(run))


def _designs(plant: str, found: Tuning) -> dict[Loop, tuple[Objective, np.ndarray]]:
    """(objective, gains) of all controllers for a plant. The tuned PI is the result of the search's stage without derivative;
    the published PI has the published gains without the derivative."""
    dual, alone = found.tuned["dual"], found.tuned["speed_only"]
    objective, start = dual.objective, dual.gains["start"]
    derivative = np.array([name.startswith("kd") for name in objective.names])
    resting = replace(objective, points=operating_points(objective, objective.gains))
    return {
        Loop(plant, PUBLISHED, PID): (objective, start),
        Loop(plant, PUBLISHED, PI): (objective, np.where(derivative, 0.0, start)),
        Loop(plant, PUBLISHED, SPEED): (alone.objective, alone.gains["start"]),
        Loop(plant, TUNED, PID): (objective, dual.final),
        Loop(plant, TUNED, PI): (objective, search(resting, objective.gains, ("PI",)).gains),
        Loop(plant, TUNED, SPEED): (alone.objective, alone.final),
    }


def _on_rig(settings: Mapping[str, float], course: Record, limits: Limits, seeds: Sequence[int]) -> StepTest:
    """A controller's loop on the emulated rig, once for each seed of its noise; the figures are those of the mean run."""
    start, runs = (settings["omega_min"], settings["beta_fixed"] if settings["speed_only"] > 0.5 else 0.0), []
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            done = run_on_rig(emulated(limits, seed), KernelController(settings), course, Path(folder), start)
            if done.ended:
                raise RunEnded(done.ended)
            runs.append(done.record)
    columns = {name: np.mean([run[name] for run in runs], axis=0) for name in runs[0].columns}
    mean = Record(columns, f"mean of {len(runs)} runs")
    merits = judged(smoothed(mean, SMOOTH))
    if len(runs) > 1:
        errors = np.array([[merit.squared_error for merit in judged(smoothed(run, SMOOTH))] for run in runs])
        std = errors.std(axis=0, ddof=1) / np.sqrt(len(runs))
        merits = [replace(merit, error_std=float(own)) for merit, own in zip(merits, std, strict=True)]
    return StepTest(settings, runs, mean, *merits)
