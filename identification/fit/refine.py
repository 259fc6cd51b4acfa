"""Fine-tuning: fit the parameters of the model's response to the measured one (paper, section 3.2).

The default is Levenberg-Marquardt on exact forward sensitivities, from several starts, on thrust and speed together, with the
static map as prior. The paper's gradient descent and a search on the adjoint gradient are options.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import ThreadpoolController

from identification.fit.adjoint import AdjointProblem
from identification.fit.coordinates import regular_start
from identification.fit.experiment import CHANNELS, Experiment
from identification.fit.gradient_descent import descend
from identification.fit.identifiability import held as undetermined
from identification.fit.least_squares import Solution
from identification.fit.noise import independent
from identification.fit.problem import Prior, Problem
from identification.fit.uncertainty import Uncertainty, uncertainty
from identification.roles import Fitted, together
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import FINE_TUNED
from vpp_fmu.kernel.types import Model
from vpp_fmu.record import Record

BASE_PARAMETERS = tuple(FINE_TUNED)
"""The four time constants and the five map coefficients."""

METHODS = ("levenberg-marquardt", "gradient-descent", "adjoint")

SAME, ROUGH = 1e-6, 1e-8
"""Relative tolerances of the cost: of two starts that reached the same optimum, and of the search from a random start."""


@dataclass(frozen=True)
class Refinement:
    """Result of a fine-tuning.

    `values`: every parameter of the model. `held`: parameters that are not identifiable, kept at their start: name ->
    reason. `cost_start`, `cost_final`: the paper's cost, mean(e^2) / 2 of normalised thrust. `curve`: the search's cost after
    each step of the first fit; `evaluations`: of all fits from the given start. `starts`, `reached`: numbers of starts, and of
    those that ended at the best optimum; `others`: the solutions of the other starts.
    """

    problem: Problem
    solution: Solution
    values: Mapping[str, float]
    uncertainty: Uncertainty
    held: Mapping[str, str]
    cost_start: float
    cost_final: float
    curve: tuple[float, ...]
    evaluations: int
    method: str
    starts: int
    reached: int
    seconds: float
    others: tuple[Solution, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that were fitted."""
        return self.uncertainty.names

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each fitted parameter."""
        return dict(zip(self.names, self.uncertainty.std.tolist(), strict=True))


def refine(
    model: Model,
    records: Sequence[Record],
    start: Mapping[str, float],
    names: Sequence[str] = BASE_PARAMETERS,
    prior: Prior | None = None,
    channels: Sequence[str] = CHANNELS,
    method: str = "levenberg-marquardt",
    starts: int = 1,
    seed: int = 0,
) -> Refinement:
    """Fit the parameters `names` of `model` to `records`, from the values `start` and from `starts` - 1 random ones.

    `start`: changes of the model's defaults, by name. Each record starts in equilibrium with its first command. Gradient
    descent uses only thrust, one start and no prior, as in the paper. The same `seed` gives the same random starts.
    """
    # On matrices this narrow one thread is faster than several, even more so on a busy machine.
    with _BLAS.limit(limits=1):
        return _refine(model, records, start, names, prior, channels, method, starts, seed)


_BLAS = ThreadpoolController()


def _refine(model, records, start, names, prior, channels, method, starts, seed) -> Refinement:
    began = time.perf_counter()
    values = regular_start(model, model.values(start), names)
    if method == "gradient-descent":
        prior, channels, starts = None, ("thrust",), 1
    kind = AdjointProblem if method == "adjoint" else Problem
    experiments = independent_readings(records, values, channels)
    trial = kind(model, experiments, values, names, prior)
    at = trial.coordinates.vector(values)
    known = [trial.rows(trial.coordinates.values(at))]
    why = undetermined(trial, at, known[0][1], names)
    free = [n for n in names if n not in why]
    if not free:
        reasons = "; ".join(dict.fromkeys(why.values()))
        raise BadInput(
            records[0].source, "thrust", f"no identifiable parameter ({reasons})", "a response to a command that moves"
        )
    problem, known = (kind(model, experiments, values, free, prior), []) if why else (trial, known)
    cost_start = paper_cost(problem, values)
    if method == "gradient-descent":
        rounds = [descend(problem, problem.coordinates.vector(values))]
    else:
        rounds = problem.solve_and_weigh(values, known)
    best, found = rounds[-1], [rounds[-1].slim()]
    if starts > 1:  # releases memory for the other starts
        best, rounds = found[0], [solution.slim() for solution in rounds]
    for at in _random_starts(problem, values, starts - 1, seed):
        one = problem.solve(at, 0.5 * ROUGH * problem.size).slim()
        if one.cost < best.cost * (1 - SAME):
            one = problem.solve(problem.coordinates.values(one.value)).slim()
        best = min(best, one, key=lambda solution: solution.cost)
        found.append(one)
    if starts > 1:
        best = problem.with_rows(best)
    final = values | problem.coordinates.values(best.value)
    return Refinement(
        problem=problem,
        solution=best,
        values=final,
        uncertainty=uncertainty(problem, best),
        held=why,
        cost_start=cost_start,
        cost_final=paper_cost(problem, final),
        curve=rounds[0].costs,
        evaluations=sum(solution.evaluations for solution in rounds),
        method=method,
        starts=len(found),
        reached=sum(s.cost <= best.cost * (1 + SAME) for s in found),
        seconds=time.perf_counter() - began,
        others=tuple(s for s in found if s.cost > best.cost * (1 + SAME)),
    )


def independent_readings(
    records: Sequence[Record], values: Mapping[str, float], channels: Sequence[str] = CHANNELS
) -> list[Experiment]:
    """Experiments from records, one for each set of the same commands, with readings assumed independent."""
    noise = independent(values["thrust_scale"])
    return [Experiment(g, noise, channels=channels) for g in together(Fitted(r.source, r) for r in records)]


def paper_cost(problem: Problem, values: Mapping[str, float]) -> float:
    """mean(e^2) / 2 of normalised thrust over the problem's records (paper, eq. 17, without its stray dt)."""
    errors = np.concatenate(problem.thrust_errors(problem.values | dict(values)))
    return 0.5 * float(np.mean(errors**2)) / values["thrust_scale"] ** 2


def _random_starts(problem: Problem, values: Mapping[str, float], count: int, seed: int):
    """Time constants within a factor of 3 of `values`, coefficients within +-0.3."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        moved = dict(values)
        for name in problem.coordinates.names:
            if name.startswith("tau_"):
                moved[name] *= float(np.exp(rng.uniform(-np.log(3.0), np.log(3.0))))
            else:
                moved[name] += float(rng.uniform(-0.3, 0.3))
        yield moved
