"""The paper's fine-tuning on a record, beside the search that this project uses (sections 3.2 and 4.2)."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from identification.fit.gradient_descent import descend
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from vpp_fmu.kernel.plant import AVERAGED, BASE, FINE_TUNED
from vpp_fmu.native import Simulator
from vpp_fmu.paper.averages import simulated
from vpp_fmu.paper.published import COST_END, ITERATIONS
from vpp_fmu.record import Record


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


@threadpool_limits.wrap(limits=1)
def fine_tuned(record: Record, start: Mapping[str, float]) -> FineTuning:
    """Run both searches on the thrust of a record; `start`: the nine parameters by name."""
    ours = refine(BASE, [record], start, channels=("thrust",))
    problem, began = ours.problem, time.perf_counter()
    found = descend(problem, problem.coordinates.vector(BASE.values(start)), limit=ITERATIONS + 1)
    seconds = time.perf_counter() - began
    values = BASE.values(start) | problem.coordinates.values(found.value)
    return FineTuning(record, dict(start), np.array(found.costs) / problem.size, values, seconds, ours)


def on_the_papers_model(commands: Record, seed: int) -> FineTuning:
    """The same on a record of the paper's fine-tuned model under the same commands, from the paper's own start.

    White noise on the thrust leaves the best model with the paper's final cost.
    """
    noise = BASE.values()["thrust_scale"] * np.sqrt(2.0 * COST_END)
    return fine_tuned(simulated([commands], FINE_TUNED, noise, seed)[0], {n: AVERAGED[n] for n in BASE_PARAMETERS})


def parts(record: Record) -> dict[str, np.ndarray]:
    """Rows of the three parts of an open-loop record, by what moves in them: "speed only", "pitch only", "both"."""
    found = {}
    for rows in np.array_split(np.arange(len(record)), 3):
        moves = [np.ptp(record[name][rows[1:]]) > 0.0 for name in ("omega_ref", "beta_ref")]
        found["both" if all(moves) else "speed only" if moves[0] else "pitch only"] = rows
    return found


def by_part(record: Record, models: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Thrust error [N rms] of each of the models, values by name, in each part of an open-loop record."""
    error = {name: thrust(record, values) - record["thrust"] for name, values in models.items()}
    return {
        part: {name: float(np.sqrt(np.nanmean(own[rows] ** 2))) for name, own in error.items()}
        for part, rows in parts(record).items()
    }


def thrust(record: Record, values: Mapping[str, float]) -> np.ndarray:
    """Thrust (rows,) N that the plain plant with `values` shows under a record's commands."""
    return Simulator(BASE).simulate(BASE.values(values), *record.run)[:, 0]
