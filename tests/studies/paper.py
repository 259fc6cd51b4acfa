"""python -m tests.studies paper: the paper's study, repeated on the emulated rig; its main numbers beside the paper's.

Grasev and Mendez, "Nonlinear System Identification of Variable-Pitch Propellers Using a Wiener Model", 2026. The study measures
the paper's campaign through the emulated rig's buses in virtual time, and fits the static map, the steps and the open loop the
paper's way. It tunes the controllers for the identified model and closes their loops on the rig. Beside the rig stands the
paper's own model, with the published gains. The emulated blades, inertia and unit of the speed PI were fitted to the paper.
Agreement in map and speed therefore does not confirm the physics.
"""

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hil.campaign import CampaignSize, steep
from hil.devices.calibration import read_calibration
from hil.emulator.rig import EmulatedRig
from hil.loop.rig import RunEnded
from hil.loop.session import Setup
from hil.results.campaign_folder import Measuring
from hil.run import run_on_rig
from hil.safety.limits import Limits
from identification.assessment.prediction import predict, rmse
from identification.fit.gradient_descent import descend
from identification.fit.refine import BASE_PARAMETERS, refine
from identification.identify import Identification, identify
from identification.static.static_map import StaticFit, design, fit_static_map
from identification.steps.response import StepSummary, fit_steps
from identification.steps.run import StepRun
from identification.tune.summary import step_error
from identification.tune.tune import TuningTask, chain_of, tune
from tests.tables import add_write, show, table
from vpp_fmu.campaign import Campaign, StaticMap, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.loop import run as run_loop
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.record import Record
from vpp_fmu.response import smoothed, steps

FULL, REPEATS = CampaignSize(before=5.0), 6
"""The paper's campaign; number of runs of each loop on the rig."""

QUICK, FEWER = CampaignSize(points=4, settle=1.0, samples=100, levels=2, before=0.4, after=2.5, section=8.0, validation=8.0), 1
"""A smaller campaign of the same shape; its numbers are rough."""

STATIC_MAP = {"c20": 0.21e-6, "c11": -5.7e-6, "c21": 0.023e-6, "c12": -1.25e-6, "c30": -2.15e-12}
"""Coefficients of the paper's static map in rpm, deg and N (section 4.1)."""

IN_RPM_AND_DEG = {"omega_scale": 1.0, "beta_offset": 0.0, "beta_scale": 1.0, "thrust_scale": 1.0}
"""Scales of such a map."""

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: the blades stall below it."""

R2_ADJUSTED, COST_START, COST_END, ITERATIONS = 0.996, 5.19e-4, 3.2e-4, 350
"""Adjusted R² of the static map (section 4.1); costs of the fine-tuning, mean(e²)/2 of normalised thrust, and its iterations
(section 4.2)."""

ASSUMED = {"tau_beta_2": 0.05}
"""The paper's controllers were designed for its fine-tuned model with this faster pitch actuator (section 4.2)."""

STEP_FROM, STEP_TO, STEP_AT, REACHED = 0.1, 0.8, 3.33, 0.5
"""The step test: normalised thrust, time of the step [s], and time until the set-point is reached [s] (section 4.3)."""

LAGS = {"omega": ("tau_omega_1", "tau_omega_2"), "beta": ("tau_beta_2", "tau_beta_1")}
"""The paper's names of the slower and of the faster lag, by channel."""

SMOOTH = 0.04
"""s over which a rig's mean thrust is smoothed before it is judged: less than a tenth of any settling time."""


class Row(NamedTuple):
    """A number or statement of the paper, with the rig's and the paper's model's; `std`: standard deviation of the rig's."""

    what: str
    paper: float | str
    rig: float | str
    model: float | str
    std: float | None = None

    def cells(self) -> list[str]:
        """Cells of the table: a number has four digits."""
        paper, rig, model = (cell if isinstance(cell, str) else f"{cell:.4g}" for cell in self[1:4])
        return [self.what, paper, rig if self.std is None else f"{rig} ± {self.std:.1g}", model]


@dataclass(frozen=True)
class Merit:
    """A step's figures: `settling` s to stay within 2 % of the step (None: never), `overshoot` in % of the step, and the
    integral of the squared normalised error [s] until the next step."""

    settling: float | None
    overshoot: float
    squared_error: float

    @property
    def seconds(self) -> str:
        """The settling time as text."""
        return "not settled" if self.settling is None else f"{self.settling:.2f} s"


@dataclass(frozen=True, eq=False)
class FineTuning:
    """The paper's descent on one record from `start`: cost at each iteration (ITERATIONS + 1,), and the `values` at its end.
    `best`: values of the least cost, by Levenberg-Marquardt."""

    record: Record
    start: Mapping[str, float]
    costs: np.ndarray
    values: Mapping[str, float]
    best: Mapping[str, float]

    @property
    def reduction(self) -> float:
        """Reduction of the cost, %."""
        return 100.0 * (1.0 - float(self.costs[-1] / self.costs[0]))


@dataclass(frozen=True, eq=False)
class Study:
    """All results, each pair on the rig and on the paper's model. `loops`: merits of the step up and of the step down, by
    controller ("both", "speed")."""

    campaign: Campaign
    found: Identification
    maps: tuple[StaticFit, StaticFit]
    steps: tuple[StepSummary, StepSummary]
    tuned: tuple[FineTuning, FineTuning]
    loops: tuple[Mapping[str, tuple[Merit, Merit]], Mapping[str, tuple[Merit, Merit]]]


def study(folder: Path, plan: CampaignSize, repeats: int, seed: int) -> Study:
    """Measure the campaign into `folder`, then repeat the paper's analysis; `repeats`: runs of each loop on the rig."""
    campaign = recorded(folder, plan, seed)
    found = identify(campaign, seed=seed)
    rig = fit_steps(campaign.steps, BASE.values())
    noise = float(np.median([run.noise for run in rig.runs]))
    model = fit_steps(simulated(campaign.steps, AVERAGED, noise, seed), BASE.values())
    # With this noise the best model has the paper's final cost.
    noise = BASE.values()["thrust_scale"] * np.sqrt(2.0 * COST_END)
    (papers,) = simulated([campaign.open_loop], FINE_TUNED, noise, seed)
    tuned = fine_tuned(campaign.open_loop, found.start), fine_tuned(papers, AVERAGED)
    published = {"both": DUAL, "speed": SPEED_ONLY}
    loops = on_rig(tuned_gains(found, seed), repeats, seed), {name: judged(on_model(own)) for name, own in published.items()}
    return Study(campaign, found, static_maps(campaign.static, seed), (rig, model), tuned, loops)


def emulated(limits: Limits, seed: int, map_is_known: bool = True) -> Setup:
    """The emulated rig in virtual time, without hidden effects. `seed`: of its noise."""
    calibration = read_calibration(str(files("hil.emulator") / "calibration.json"))
    return Setup(calibration, limits, EmulatedRig(seed=seed), virtual=True, map_is_known=map_is_known)


def recorded(folder: Path, plan: CampaignSize, seed: int) -> Campaign:
    """Measure a campaign into a folder as `vpp hil campaign --virtual --seed` does, and read it back."""
    measuring = Measuring(emulated(steep(Limits()), seed, map_is_known=False), plan)
    measuring.run(OutputFolder(folder), {"parts": {}}, None, partial(print, file=sys.stderr))
    return read_campaign(folder)


def simulated(records: Sequence[Record], values: Mapping[str, float], noise: float, seed: int) -> list[Record]:
    """The plain plant with `values` under the records' commands, its thrust with white noise [N]."""
    rng, found = np.random.default_rng([seed, 4]), []
    for record in records:
        shown = predict(BASE, BASE.values(values), record)
        thrust = shown.thrust + noise * rng.standard_normal(len(record))
        found.append(record.with_columns(thrust=thrust, omega=shown.omega))
    return found


def paper_thrust(omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Thrust (n,) N by the paper's static map, of speed (n,) rpm and pitch (n,) deg."""
    return design(np.asarray(omega, float), np.asarray(beta, float), IN_RPM_AND_DEG) @ np.array(list(STATIC_MAP.values()))


def static_maps(points: StaticMap, seed: int) -> tuple[StaticFit, StaticFit]:
    """The paper's fit to the rig's points, and to its own polynomial at these points with the rig's noise."""
    error = points.thrust_std / np.sqrt(points.samples) * np.random.default_rng([seed, 3]).standard_normal(len(points.thrust))
    noisy = replace(points, thrust=paper_thrust(points.omega, points.beta_ref) + error)
    rig, model = (fit_static_map(static, IN_RPM_AND_DEG, OPERATING_PITCH) for static in (points, noisy))
    return rig, model


def lags(runs: Sequence[StepRun]) -> tuple[np.ndarray, np.ndarray]:
    """Plain means (slow, fast) s over runs, as the paper takes them, and their standard deviations from run to run."""
    found = np.array([(run.fits["thrust"].plain.slow, run.fits["thrust"].plain.fast) for run in runs])
    return found.mean(axis=0), found.std(axis=0, ddof=1) if len(runs) > 1 else np.full(2, np.nan)


@threadpool_limits.wrap(limits=1)
def fine_tuned(record: Record, start: Mapping[str, float]) -> FineTuning:
    """Run the paper's descent and Levenberg-Marquardt on the thrust of a record, from nine parameters of `start`."""
    start = {name: start[name] for name in BASE_PARAMETERS}
    best = refine(BASE, [record], start, channels=("thrust",))
    problem = best.problem
    found = descend(problem, problem.coordinates.vector(BASE.values(start)), limit=ITERATIONS + 1)
    values = BASE.values(start) | problem.coordinates.values(found.value)
    return FineTuning(record, start, np.array(found.costs) / problem.size, values, best.values)


def part_errors(tuned: FineTuning) -> dict[str, tuple[float, float]]:
    """Thrust error [N rms] before and after the descent, by the moving commands of each part of an open-loop record."""
    record, found = tuned.record, {}
    before, after = (predict(BASE, BASE.values(own), record).thrust - record["thrust"] for own in (tuned.start, tuned.values))
    for rows in np.array_split(np.arange(len(record)), 3):
        speed, pitch = (np.ptp(record[name][rows[1:]]) > 0.0 for name in ("omega_ref", "beta_ref"))
        found["both" if speed and pitch else "speed only" if speed else "pitch only"] = rmse(before[rows]), rmse(after[rows])
    return found


def profile() -> Record:
    """The paper's step, and the step back after the same time: `time` s, `thrust_set` N."""
    levels = np.array([STEP_FROM, STEP_TO, STEP_FROM, STEP_FROM]) * BASE.values()["thrust_scale"]
    return Record({"time": STEP_AT * np.arange(4), "thrust_set": levels}, "the paper's step test")


def tuned_gains(found: Identification, seed: int) -> dict[str, dict[str, float]]:
    """Controllers tuned for the rig's identified model, from the published gains, by name."""
    chain = chain_of(found.parameters, CONTROLLER.values()["sample_time"])
    starts = {"both": DUAL | {"speed_only": 0.0}, "speed": SPEED_ONLY}
    tuned = tune(TuningTask(found.parameters, profile(), chain=chain, noise_std=found.noise.std, seed=seed), starts).tuned
    return {name: each.objective.with_gains(each.final) for name, each in tuned.items()}


def on_model(gains: Mapping[str, float]) -> Record:
    """The step test of a controller with these gains on the paper's model."""
    start = CONTROLLER.values(gains)["omega_min"], gains.get("beta_fixed", 0.0)
    return run_loop(KernelPlant(parameters=ASSUMED), KernelController(gains), profile(), start)


def on_rig(controllers: Mapping[str, Mapping[str, float]], repeats: int, seed: int) -> dict[str, tuple[Merit, Merit]]:
    """The step test of controllers on the emulated rig, by name: merits of the mean of `repeats` runs with other noise."""
    found = {}
    for name, settings in controllers.items():
        start, runs = (settings["omega_min"], settings["beta_fixed"] if settings["speed_only"] > 0.5 else 0.0), []
        for n in range(repeats):
            setup = emulated(steep(Limits()), 1000 * (seed + 1) + n)
            with tempfile.TemporaryDirectory() as folder:
                done = run_on_rig(setup, KernelController(settings), profile(), Path(folder), start)
            if done.ended:
                raise RunEnded(done.ended)
            runs.append(done.record)
        mean = {column: np.mean([run[column] for run in runs], axis=0) for column in runs[0].columns}
        found[name] = judged(smoothed(Record(mean, f"mean of {repeats} runs"), SMOOTH))
    return found


def judged(run: Record) -> tuple[Merit, Merit]:
    """The figures of a run's step up and of its step down."""
    scale = BASE.values()["thrust_scale"]
    up, down = (Merit(s.settling, s.overshoot, step_error(run, s, s.end, scale)) for s in steps(run))
    return up, down


def compared(done: Study) -> dict[str, Row]:
    """The rows of the table by name."""
    return dict(_rows(done))


def _rows(done: Study) -> Iterator[tuple[str, Row]]:
    rig, model = done.maps
    yield "r2_adjusted", Row("adjusted R² of the static map", R2_ADJUSTED, rig.r2_adjusted, model.r2_adjusted)
    averaged = {}
    for channel, pair in LAGS.items():
        (means, spread), (models, _) = (lags(summary.used(channel)) for summary in done.steps)
        averaged |= {name: (float(means[k]), float(models[k]), float(spread[k])) for k, name in enumerate(pair)}
    names = sorted(averaged, key=list(AVERAGED).index)
    for name in names:
        yield f"averaged.{name}", Row(f"averaged {name} [s]", AVERAGED[name], *averaged[name])
    refined, best = done.found.refinement, done.tuned[1].best
    own, there = _by_speed(refined.values), _by_speed(best)
    for name in names:
        row = FINE_TUNED[name], refined.values[own[name]], best[there[name]], refined.std.get(own[name])
        yield f"fine_tuned.{name}", Row(f"fine-tuned {name} [s]", *row)
    yield "overshoots", Row("pitch steps that overshoot", "evident at 6000 rpm", *map(_overshoots, done.steps))
    fall = 100.0 * (1.0 - COST_END / COST_START)
    yield "cost_fall", Row("reduction of the cost [%]", round(fall, 1), *(tuned.reduction for tuned in done.tuned))
    changes = [
        ", ".join(f"{part} {100.0 * (after / before - 1.0):+.0f} %" for part, (before, after) in part_errors(tuned).items())
        for tuned in done.tuned
    ]
    yield "improved", Row("where fine-tuning improves most", "pitch only, both", *changes)
    ups = [loops["both"][0] for loops in done.loops]
    reached = ("never" if up.settling is None else up.settling for up in ups)
    yield "reached", Row("set-point reached after [s]", REACHED, *reached)
    yield "overshoot", Row("overshoot, both actuators [%]", 0.0, *(up.overshoot for up in ups))
    for k, (way, papers) in enumerate({"up": "superior", "down": "superior, especially"}.items()):
        cells = []
        for loops in done.loops:
            both, speed = loops["both"][k], loops["speed"][k]
            change = 100.0 * (both.squared_error / speed.squared_error - 1.0)
            cells.append(f"both {both.seconds}, speed {speed.seconds}, squared error {change:+.0f} %")
        yield way, Row(f"step {way}, both actuators against speed alone", papers, *cells)


def _by_speed(values: Mapping[str, float]) -> dict[str, str]:
    """The paper's name of each lag -> its name in a fit: the slower lag there is the slower one here."""
    return {n: own for pair in LAGS.values() for n, own in zip(pair, sorted(pair, key=lambda n: -values[n]), strict=True)}


def _overshoots(summary: StepSummary) -> str:
    runs = summary.used("beta")
    level = max(run.level for run in runs)
    fastest = [run for run in runs if run.level == level]
    return f"seen in {sum(run.overshoots for run in fastest)} of {len(fastest)} at {level:g} rpm"


def main(parser, arguments):
    parser.add_argument("--quick", action="store_true", help="a smaller campaign, to see what the study does")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of everything random (default: %(default)s)")
    add_write(parser)
    options = parser.parse_args(arguments)
    if options.quick and options.write:
        parser.error("--write: a quick study is not written into a page")
    with tempfile.TemporaryDirectory() as folder:
        done = study(Path(folder), *((QUICK, FEWER) if options.quick else (FULL, REPEATS)), options.seed)
    columns = ("what", "paper", "ours, rig", "ours, paper's model")
    show("paper", table(columns, [row.cells() for row in compared(done).values()]), options.write)
