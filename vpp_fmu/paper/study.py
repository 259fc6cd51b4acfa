"""The paper's study from its campaign to its controllers, on the emulated rig and on the paper's own model."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from hil.campaign import PARTS, Plan, measure, steep
from hil.safety.limits import Limits
from hil.session import session
from identification.assessment.prediction import predict
from identification.fit.gradient_descent import descend
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.identify import Identification, identify
from identification.static.static_map import StaticFit, design, fit_static_map, thrust_coefficient
from identification.steps.response import StepSummary, fit_steps
from identification.steps.run import StepRun
from vpp_fmu.campaign import Campaign, StaticMap, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.paper.control import Control, control, emulated
from vpp_fmu.paper.published import COST_END, ITERATIONS, R2_ADJUSTED, STATIC_MAP
from vpp_fmu.record import Record, write_record

FULL, REPEATS = Plan(before=5.0), 6
"""The paper's campaign; runs of each loop on the rig."""

QUICK, FEWER = Plan(points=4, settle=1.0, samples=100, levels=2, before=0.4, after=2.5, section=8.0, validation=8.0), 1
"""The same shape, smaller: fewer points, readings and steps, shorter records."""

OPERATING_PITCH = (-5.0, 10.0)
"""The paper's operating region, deg: below it the blades stall and the cubic no longer fits."""

PAPER_UNITS = {"omega_scale": 1.0, "beta_offset": 0.0, "beta_scale": 1.0, "thrust_scale": 1.0}
"""A map in rpm, deg and N."""


@dataclass(frozen=True, eq=False)
class Statics:
    """`rig`: the paper's fit to the rig's points; `model`: the same fit to the paper's own polynomial at these points, with the
    rig's noise. `difference` (points used,) N: the rig less the paper's polynomial. `r2_of_paper`: adjusted R² of that
    polynomial, as it stands, on the rig's points. `scatter` N: residual that the paper's R² implies on its own surface.
    `mean_std` N: uncertainty of a mean of that many white readings. `fixed` N: rms residual of a fit with one coefficient at
    the paper's value. `ct_by_speed`: rms change of C_T with speed, of the rig and of the paper's polynomial; `ct_by_pitch`:
    its range over the pitch.
    """

    points: StaticMap
    rig: StaticFit
    model: StaticFit
    difference: np.ndarray
    r2_of_paper: float
    scatter: float
    mean_std: float
    fixed: Mapping[str, float]
    ct_by_speed: tuple[float, float]
    ct_by_pitch: tuple[float, float]

    @property
    def difference_rms(self) -> float:
        """N."""
        return float(np.sqrt(np.mean(self.difference**2)))


@dataclass(frozen=True, eq=False)
class FineTuning:
    """Two searches on one record from one `start`: the paper's descent, with the cost at each iteration (ITERATIONS + 1,) and
    its `values` at the end, in `seconds`; and Levenberg and Marquardt's, `ours`. Costs are mean(e²)/2 of normalised thrust."""

    record: Record
    start: Mapping[str, float]
    costs: np.ndarray
    values: Mapping[str, float]
    seconds: float
    ours: Refinement

    @property
    def fall(self) -> tuple[float, float]:
        """What the descent and our search take off the cost, %."""
        return tuple(100.0 * (1.0 - end / self.costs[0]) for end in (self.costs[-1], self.ours.cost_final))


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that was found. `steps`: fits of normalised thrust without a map, as the paper's; `fine_tuning` of the
    open-loop record; both on the rig and on the paper's model. `seconds` of each stage, by name."""

    plan: Plan
    seed: int
    campaign: Campaign
    found: Identification
    statics: Statics
    steps: tuple[StepSummary, StepSummary]
    fine_tuning: tuple[FineTuning, FineTuning]
    control: Control
    seconds: Mapping[str, float]

    @property
    def is_full(self) -> bool:
        """Whether the campaign is as large as the paper's."""
        return self.plan == FULL


class Stages:
    """Seconds of stages by name; `show` is told what is going on."""

    def __init__(self, show: Callable[[str], None] = lambda text: None):
        self.show, self.seconds, self._last = show, {}, time.perf_counter()

    def done(self, name: str) -> None:
        """The stage of that name has ended."""
        now = time.perf_counter()
        self.seconds[name], self._last = now - self._last, now


def study(folder: OutputFolder, plan: Plan, repeats: int, seed: int, stages: Stages) -> Study:
    """Measure the campaign into `folder` on the emulated rig, then do all that the paper did with it."""
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
    noise = BASE.values()["thrust_scale"] * np.sqrt(2.0 * COST_END)  # it leaves the best model with the paper's final cost
    papers = simulated([campaign.open_loop], FINE_TUNED, noise, seed)[0]
    starts = (campaign.open_loop, found.start), (papers, AVERAGED)
    tuned = tuple(fine_tuned(record, {name: start[name] for name in BASE_PARAMETERS}) for record, start in starts)
    stages.done("fine-tuning the paper's way")
    loops = control(found.parameters, found.noise.std, seed, repeats, stages.show)
    stages.done("control")
    return Study(plan, seed, campaign, found, map_fits, (rig, model), tuned, loops, stages.seconds)


def recorded(folder: OutputFolder, plan: Plan, seed: int, stage: Callable[[str], None]) -> Campaign:
    """Measure a campaign into a folder, file by file as `vpp hil campaign --virtual --seed` does, and read it back."""
    told = {"format": "vpp-hil/1", "plan": asdict(plan), "parts": {}}
    for k, part in enumerate(PARTS):
        setup = emulated(steep(Limits()), 100 * seed + k, map_is_known=False)
        with session(setup, folder.path, f"log_{part}.csv.gz", watch=False) as one:
            record = measure(one.rig, part, plan, lambda share, part=part: stage(f"{part} {share:.0%}"))
        told["parts"][part] = one.told() | {"ended": ""}
        write_record(folder, f"{part}.csv", record)
    folder.write("hil.json", json.dumps(told, indent=2) + "\n")
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
    rng, error = np.random.default_rng([seed, 3]), points.thrust_std / np.sqrt(points.samples)
    on_paper = paper_thrust(points.omega, points.beta_ref)
    fit = fit_static_map(points, PAPER_UNITS, OPERATING_PITCH)
    used, n, k = fit.used, int(fit.used.sum()), len(STATIC_MAP)
    measured, papers = points.thrust[used], on_paper[used]
    squares = float(np.sum((measured - papers) ** 2))
    noisy = replace(points, thrust=on_paper + error * rng.standard_normal(len(error)))
    by_speed, by_pitch = zip(*(_ct(points, used, thrust) for thrust in (points.thrust, on_paper)), strict=True)
    return Statics(
        points=points,
        rig=fit,
        model=fit_static_map(noisy, PAPER_UNITS, OPERATING_PITCH),
        difference=measured - papers,
        r2_of_paper=1.0 - squares / (n - k) / float(np.var(measured, ddof=1)),
        scatter=float(np.sqrt((1.0 - R2_ADJUSTED) * np.var(papers, ddof=1))),
        mean_std=float(error[used].mean()),
        fixed={name: _fixed(points, used, name) for name in STATIC_MAP},
        ct_by_speed=by_speed,
        ct_by_pitch=by_pitch,
    )


def _fixed(points: StaticMap, used: np.ndarray, name: str) -> float:
    """Residual [N rms] of a map whose coefficient `name` is the paper's."""
    terms, k = design(points.omega[used], points.beta_ref[used], PAPER_UNITS), list(STATIC_MAP).index(name)
    wanted, others = points.thrust[used] - STATIC_MAP[name] * terms[:, k], np.delete(terms, k, axis=1)
    others = others / np.abs(others).max(axis=0)
    found, *_ = np.linalg.lstsq(others, wanted, rcond=None)
    return float(np.sqrt(np.mean((wanted - others @ found) ** 2)))


def _ct(points: StaticMap, used: np.ndarray, thrust: np.ndarray) -> tuple[float, float]:
    """(rms change with speed, range over pitch) of the thrust coefficient in the operating region."""
    ct, pitch = thrust_coefficient(thrust, points.omega)[used], points.beta_ref[used]
    groups = [ct[pitch == b] for b in np.unique(pitch)]
    return float(np.sqrt(np.mean([np.var(group) for group in groups]))), float(np.ptp([group.mean() for group in groups]))


def noise_of(summary: StepSummary) -> float:
    """Standard deviation [N] of a reading in step responses."""
    return float(np.median([run.noise for run in summary.runs]))


def runs_of(summary: StepSummary, channel: str) -> list[StepRun]:
    """The runs of a channel that count."""
    return [run for run in summary.runs if run.channel == channel and not run.reason]


def lags(runs: Sequence[StepRun]) -> tuple[np.ndarray, np.ndarray]:
    """Plain means (slow, fast) s over runs, as the paper takes them, and their standard deviations from run to run."""
    found = np.array([(run.fits["thrust"].plain.slow, run.fits["thrust"].plain.fast) for run in runs])
    return found.mean(axis=0), found.std(axis=0, ddof=1) if len(runs) > 1 else np.full(2, np.nan)


def by_size(summary: StepSummary, channel: str) -> dict[float, np.ndarray]:
    """Size of a step [rpm or deg] -> plain means (slow, fast) s over the steps of that size."""
    runs = {}
    for run in runs_of(summary, channel):
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
    """Rows of the three parts of an open-loop record, by what moves in them: "speed only", "pitch only", "both"."""
    found = {}
    for rows in np.array_split(np.arange(len(record)), 3):
        moves = [np.ptp(record[name][rows[1:]]) > 0.0 for name in ("omega_ref", "beta_ref")]
        found["both" if all(moves) else "speed only" if moves[0] else "pitch only"] = rows
    return found


def by_part(record: Record, models: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Thrust error [N rms] of each of the models, values by name, in each part of an open-loop record."""
    error = {name: predict(BASE, BASE.values(own), record).thrust - record["thrust"] for name, own in models.items()}
    return {
        part: {name: float(np.sqrt(np.nanmean(own[rows] ** 2))) for name, own in error.items()}
        for part, rows in parts(record).items()
    }
