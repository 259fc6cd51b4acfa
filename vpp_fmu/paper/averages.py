"""Time constants of step responses as the paper averages them, on the rig and on the paper's own model (section 4.2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.steps.response import StepSummary, fit_steps
from identification.steps.run import StepRun
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


@dataclass(frozen=True, eq=False)
class Averages:
    """Fits of normalised thrust without a map, as the paper's: of the `rig`'s steps, and of the same steps of the paper's
    initial `model` with white noise. `noise` N: standard deviation of a reading there."""

    rig: StepSummary
    model: StepSummary
    noise: float


def averages(steps: Sequence[Record], seed: int) -> Averages:
    """Fit all steps of a campaign, and simulated ones under their commands."""
    rig = fit_steps(steps, BASE.values())
    noise = float(np.median([run.noise for run in rig.runs]))
    return Averages(rig, fit_steps(simulated(steps, AVERAGED, noise, seed), BASE.values()), noise)


def simulated(records: Sequence[Record], values: Mapping[str, float], noise: float, seed: int) -> list[Record]:
    """The plain plant with `values` under the records' commands, its thrust with white noise [N]."""
    rng, simulator, found = np.random.default_rng([seed, 4]), Simulator(BASE), []
    for record in records:
        outputs = simulator.simulate(BASE.values(values), *record.run)
        thrust = outputs[:, 0] + noise * rng.standard_normal(len(record))
        found.append(record.with_columns(thrust=thrust, omega=outputs[:, 1]))
    return found


def runs_of(summary: StepSummary, channel: str) -> list[StepRun]:
    """The runs of a channel that count."""
    return [run for run in summary.runs if run.channel == channel and not run.reason]


def lags(runs: Sequence[StepRun]) -> tuple[np.ndarray, np.ndarray]:
    """Plain means (slow, fast) s over runs, as the paper takes them, and their standard deviations from run to run."""
    found = np.array([(run.fits["thrust"].plain.slow, run.fits["thrust"].plain.fast) for run in runs])
    return found.mean(axis=0), found.std(axis=0, ddof=1) if len(runs) > 1 else np.full(2, np.nan)


def by_size(summary: StepSummary, channel: str) -> dict[float, tuple[float, float]]:
    """Size of a step [rpm or deg] -> plain means (slow, fast) s over the steps of that size."""
    runs = runs_of(summary, channel)
    sizes = sorted({round(abs(run.end - run.start), 6) for run in runs})
    return {size: tuple(lags([r for r in runs if round(abs(r.end - r.start), 6) == size])[0].tolist()) for size in sizes}
