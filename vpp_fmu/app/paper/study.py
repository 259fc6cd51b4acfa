"""The paper's study from its campaign to its controllers, on the emulated rig and on the paper's own model."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from hil.campaign import PARTS, Plan, measure, seconds, steep
from hil.safety.limits import Limits
from hil.session import session
from identification.assessment.prediction import predict
from identification.assessment.quality import rmse
from identification.fit.gradient_descent import descend
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.identify import Identification, identify
from identification.static.static_map import StaticFit, design, fit_static_map, thrust_coefficient
from identification.steps.response import StepSummary, fit_steps
from identification.steps.run import StepRun
from identification.tune.tune import Tuning
from vpp_fmu.app.paper.control import MODEL, PUBLISHED, RIG, TUNED, Loop, StepTest, control, emulated
from vpp_fmu.app.paper.published import COST_END, ITERATIONS, R2_ADJUSTED, STATIC_MAP
from vpp_fmu.campaign import Campaign, StaticMap, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.record import Record, write_record

FULL, REPEATS = Plan(before=5.0), 6
"""The paper's campaign; number of runs of each loop on the rig."""

QUICK, FEWER = Plan(points=4, settle=1.0, samples=100, levels=2, before=0.4, after=2.5, section=8.0, validation=8.0), 1
"""The same shape, smaller: fewer points, readings and steps, shorter records."""

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: below it the blades stall and the cubic no longer fits."""

PAPER_UNITS = {"omega_scale": 1.0, "beta_offset": 0.0, "beta_scale": 1.0, "thrust_scale": 1.0}
"""Scales of a map in rpm, deg and N."""


@dataclass(frozen=True, eq=False)
class Statics:
    """`rig`: the paper's fit to the rig's points; `model`: the same fit to the paper's own polynomial at these points, with the
    rig's noise; `papers` (points used,) N: thrust by that polynomial. `ct`: of the rig and of the polynomial, (rms change of
    C_T with speed, its range over the pitch)."""

    points: StaticMap
    rig: StaticFit
    model: StaticFit
    papers: np.ndarray
    ct: tuple[tuple[float, float], tuple[float, float]]

    @property
    def difference(self) -> np.ndarray:
        """(points used,) N: the rig less the paper's polynomial."""
        return self.points.thrust[self.rig.used] - self.papers

    @property
    def scatter(self) -> float:
        """N: residual that the paper's R² implies for its own polynomial."""
        return float(np.sqrt((1.0 - R2_ADJUSTED) * np.var(self.papers, ddof=1)))


@dataclass(frozen=True, eq=False)
class FineTuning:
    """Two searches on one record from one `start`: the paper's descent, with the cost at each iteration (ITERATIONS + 1,) and
    its `values` at the end, in `seconds`; and `ours`, Levenberg-Marquardt. Costs are mean(e²)/2 of normalised thrust."""

    record: Record
    start: Mapping[str, float]
    costs: np.ndarray
    values: Mapping[str, float]
    seconds: float
    ours: Refinement

    @property
    def reduction(self) -> tuple[float, float]:
        """Reduction of the cost by the descent and by our search, %."""
        return tuple(100.0 * (1.0 - end / self.costs[0]) for end in (self.costs[-1], self.ours.cost_final))


@dataclass(frozen=True, eq=False)
class Study:
    """All results. `steps`: fits of normalised thrust without a map, as the paper's; `fine_tuning` of the
    open-loop record; both on the rig and on the paper's model. `tuned`: gains for the paper's model, as in the
    paper, and for the model identified from the rig's campaign; `tests` of all loops. `seconds` of each stage, by name."""

    plan: Plan
    seed: int
    campaign: Campaign
    found: Identification
    statics: Statics
    steps: tuple[StepSummary, StepSummary]
    fine_tuning: tuple[FineTuning, FineTuning]
    tuned: Mapping[str, Tuning]
    tests: Mapping[Loop, StepTest]
    seconds: Mapping[str, float]

    @property
    def is_full(self) -> bool:
        """Whether the campaign is as large as the paper's."""
        return self.plan == FULL

    def compared(self, controller: str) -> tuple[StepTest, StepTest]:
        """Step tests that are compared with the paper's: tuned gains on the rig, published ones on the paper's model."""
        return self.tests[Loop(RIG, TUNED, controller)], self.tests[Loop(MODEL, PUBLISHED, controller)]


class Stages:
    """Seconds of stages by name; `show` gets the name of each stage."""

    def __init__(self, show: Callable[[str], None]):
        self.show, self.seconds, self._last = show, {}, time.perf_counter()

    def done(self, name: str) -> None:
        """Record the end of a stage."""
        now = time.perf_counter()
        self.seconds[name], self._last = now - self._last, now


def study(folder: OutputFolder, plan: Plan, repeats: int, seed: int, stages: Stages) -> Study:
    """Measure the campaign into `folder` on the emulated rig, then repeat the paper's analysis."""
    campaign = recorded(folder, plan, seed, stages.show)
    stages.done("campaign on the emulated rig")
    found = identify(campaign, seed=seed, stage=stages.show)
    stages.done("identification")
    map_fits = statics(campaign.static, seed)
    stages.show("steps the paper's way")
    rig = fit_steps(campaign.steps, BASE.values())
    model = fit_steps(simulated(campaign.steps, AVERAGED, noise_of(rig), seed), BASE.values())
    stages.done("static map and steps the paper's way")
    stages.show("the paper's descent")
    noise = BASE.values()["thrust_scale"] * np.sqrt(2.0 * COST_END)  # the best model then has the paper's final cost
    papers = simulated([campaign.open_loop], FINE_TUNED, noise, seed)[0]
    starts = (campaign.open_loop, found.start), (papers, AVERAGED)
    tuned = tuple(fine_tuned(record, {name: start[name] for name in BASE_PARAMETERS}) for record, start in starts)
    stages.done("fine-tuning the paper's way")
    loops = control(found.parameters, found.noise.std, seed, repeats, stages.show)
    stages.done("control")
    return Study(plan, seed, campaign, found, map_fits, (rig, model), tuned, *loops, stages.seconds)


def recorded(folder: OutputFolder, plan: Plan, seed: int, stage: Callable[[str], None]) -> Campaign:
    """Measure a campaign into a folder, file by file as `vpp hil campaign --virtual --seed` does, and read it back."""
    content = {"format": "vpp-hil/1", "plan": asdict(plan), "parts": {}}
    for k, part in enumerate(PARTS):
        setup = emulated(steep(Limits()), 100 * seed + k, map_is_known=False)
        with session(setup, folder.path, f"log_{part}.csv.gz", seconds(plan, [part]), watch=False) as one:
            record = measure(one.rig, part, plan, lambda share, part=part: stage(f"{part} {share:.0%}"))
        content["parts"][part] = one.summary() | {"ended": ""}
        write_record(folder, f"{part}.csv", record)
    folder.write("hil.json", json.dumps(content, indent=2) + "\n")
    return read_campaign(folder.path)


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
    return design(np.asarray(omega, float), np.asarray(beta, float), PAPER_UNITS) @ np.array(list(STATIC_MAP.values()))


def statics(points: StaticMap, seed: int) -> Statics:
    """Compare the steady points of a campaign with the paper's static map."""
    error = points.thrust_std / np.sqrt(points.samples)
    papers = paper_thrust(points.omega, points.beta_ref)
    noisy = replace(points, thrust=papers + error * np.random.default_rng([seed, 3]).standard_normal(len(error)))
    rig, model = (fit_static_map(static, PAPER_UNITS, OPERATING_PITCH) for static in (points, noisy))
    ct = tuple(_ct(points, rig.used, thrust) for thrust in (points.thrust, papers))
    return Statics(points, rig, model, papers[rig.used], ct)


def _ct(points: StaticMap, used: np.ndarray, thrust: np.ndarray) -> tuple[float, float]:
    """(rms change with speed, range over pitch) of the thrust coefficient in the operating region."""
    ct, pitch = thrust_coefficient(thrust, points.omega)[used], points.beta_ref[used]
    groups = [ct[pitch == b] for b in np.unique(pitch)]
    return float(np.sqrt(np.mean([np.var(group) for group in groups]))), float(np.ptp([group.mean() for group in groups]))


def noise_of(summary: StepSummary) -> float:
    """Standard deviation [N] of a reading in step responses."""
    return float(np.median([run.noise for run in summary.runs]))


def lags(runs: Sequence[StepRun]) -> tuple[np.ndarray, np.ndarray]:
    """Plain means (slow, fast) s over runs, as the paper takes them, and their standard deviations from run to run."""
    found = np.array([(run.fits["thrust"].plain.slow, run.fits["thrust"].plain.fast) for run in runs])
    return found.mean(axis=0), found.std(axis=0, ddof=1) if len(runs) > 1 else np.full(2, np.nan)


def by_size(summary: StepSummary, channel: str) -> dict[float, np.ndarray]:
    """Size of a step [rpm or deg] -> plain means (slow, fast) s over the steps of that size."""
    runs = {}
    for run in summary.used(channel):
        runs.setdefault(round(abs(run.end - run.start), 6), []).append(run)
    return {size: lags(runs[size])[0] for size in sorted(runs)}


@threadpool_limits.wrap(limits=1)
def fine_tuned(record: Record, start: Mapping[str, float]) -> FineTuning:
    """Run the paper's descent and our search on the thrust of a record; `start`: the nine parameters by name."""
    ours = refine(BASE, [record], start, channels=("thrust",))
    problem, began = ours.problem, time.perf_counter()
    found = descend(problem, problem.coordinates.vector(BASE.values(start)), limit=ITERATIONS + 1)
    seconds = time.perf_counter() - began
    values = BASE.values(start) | problem.coordinates.values(found.value)
    return FineTuning(record, start, np.array(found.costs) / problem.size, values, seconds, ours)


def parts(record: Record) -> dict[str, np.ndarray]:
    """Rows of the three parts of an open-loop record, by the moving commands: "speed only", "pitch only", "both"."""
    found = {}
    for rows in np.array_split(np.arange(len(record)), 3):
        moves = [np.ptp(record[name][rows[1:]]) > 0.0 for name in ("omega_ref", "beta_ref")]
        found["both" if all(moves) else "speed only" if moves[0] else "pitch only"] = rows
    return found


def by_part(record: Record, models: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Thrust error [N rms] of each of the models, values by name, in each part of an open-loop record."""
    error = {name: predict(BASE, BASE.values(own), record).thrust - record["thrust"] for name, own in models.items()}
    return {part: {name: rmse(own[rows]) for name, own in error.items()} for part, rows in parts(record).items()}
