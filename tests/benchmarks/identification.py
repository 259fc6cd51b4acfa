"""python -m tests.benchmarks.identification [--full]: the refinement beside other ways to the same fit, in one run.

One synthetic record (60 s at 250 Hz, thrust with 0.3 N of white noise) and one start, the paper's averaged constants and static
map; thrust alone, no prior. Cost and errors of every method come from the same exact model. Machines differ and are noisy, so
ratios are what to look at: of medians, with runs of ours before and after each other method. Numerical libraries may use one
thread: matrices are small, and on a machine that others use threads wait for each other.
"""

import argparse
import contextlib
import io
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from identification.fit.gradient_descent import RATE
from identification.fit.problem import Problem
from identification.fit.refine import BASE_PARAMETERS, paper_cost, refine
from tests.benchmarks.rivals import Outcome, casadi_shooting, jax_sysid, paper_descent
from tests.studies.synthetic import TRUTH, commands, covariance, measured
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.native import Simulator, compiler
from vpp_fmu.record import Record

PAPER_ITERATIONS = 350
TIMED_ITERATIONS = 20
"""Of the paper's descent, unless --full is given; its time for all of them is then scaled."""


@dataclass(frozen=True)
class Method:
    """A way to fit: `run()` once, `runs` times; `times`: by what its seconds are scaled."""

    name: str
    run: Callable[[], Outcome]
    runs: int
    times: float = 1.0


@dataclass(frozen=True)
class Measured:
    """Outcomes of a method, none where a package is missing."""

    method: Method
    outcomes: list[Outcome]

    @property
    def seconds(self) -> np.ndarray:
        """Of solving, (runs,)."""
        return self.method.times * np.array([outcome.solve for outcome in self.outcomes])

    @property
    def build(self) -> float:
        """Median seconds of building."""
        return float(np.median([outcome.build for outcome in self.outcomes]))


class Yardstick:
    """The record, and how costs and errors are measured on it."""

    def __init__(self, seed: int = 0):
        rng = np.random.default_rng(seed)
        self.record: Record = measured(commands(rng), rng)
        self.start = np.array([AVERAGED[n] for n in BASE_PARAMETERS])
        self._problem = Problem(BASE, [self.record], BASE.values(), BASE_PARAMETERS, channels=("thrust",))
        coordinates = self._problem.coordinates
        x = coordinates.vector(TRUTH)
        jacobian = self._problem.evaluate(x)[1] * self._problem.std["thrust"]
        rms = np.sqrt(2.0 * paper_cost(self._problem, BASE.values(TRUTH))) * BASE.values()["thrust_scale"]
        bound = coordinates.jacobian(x) @ covariance(jacobian, rms) @ coordinates.jacobian(x).T
        self._std = np.sqrt(np.diag(bound))

    def cost(self, parameters: np.ndarray) -> float:
        """mean(e^2) / 2 of normalised thrust."""
        return paper_cost(self._problem, BASE.values(dict(zip(BASE_PARAMETERS, parameters, strict=True))))

    def off(self, parameters: np.ndarray, truth: np.ndarray) -> float:
        """The largest distance of a parameter in standard deviations of the Cramer-Rao bound, slower constants first."""
        return float(np.max(np.abs(_slow_first(parameters) - _slow_first(truth)) / self._std))


def _slow_first(parameters: np.ndarray) -> np.ndarray:
    return np.concatenate([np.sort(parameters[:2])[::-1], np.sort(parameters[2:4])[::-1], parameters[4:]])


def ours(record: Record) -> Outcome:
    """`refine` as it is called, on a model not used before: the building is its tracing, which a process does once."""
    began = time.perf_counter()
    model = replace(BASE)
    Simulator(model, BASE_PARAMETERS)
    built = time.perf_counter()
    found = refine(model, [record], AVERAGED, channels=("thrust",))
    parameters = np.array([found.values[n] for n in BASE_PARAMETERS])
    return Outcome(parameters, built - began, time.perf_counter() - built)


def compiling() -> float:
    """Seconds of the C compiler: once for a model, ever; later runs take the library from the cache."""
    seconds = []
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(compiler, "cache_folder", return_value=Path(folder)):
        for _ in range(2):
            began = time.perf_counter()
            Simulator(replace(BASE), BASE_PARAMETERS)
            seconds.append(time.perf_counter() - began)
    return seconds[0] - seconds[1]


def trf(record: Record, start: np.ndarray) -> Outcome:
    """scipy's trust-region reflective solver on the same residual and sensitivities."""
    began, model = time.perf_counter(), replace(BASE)
    Simulator(model, BASE_PARAMETERS)
    built = time.perf_counter()
    values = model.values(dict(zip(BASE_PARAMETERS, start, strict=True)))
    problem = Problem(model, [record], values, BASE_PARAMETERS, channels=("thrust",))
    coordinates, last = problem.coordinates, {}

    def at(x):
        if not np.array_equal(x, last.get("x")):
            last["x"], last["found"] = x.copy(), problem.evaluate(x)
        return last["found"]

    bounds = coordinates.lower, coordinates.upper
    found = least_squares(lambda x: at(x)[0], coordinates.vector(values), lambda x: at(x)[1], bounds, x_scale="jac")
    parameters = np.array([coordinates.values(found.x)[n] for n in BASE_PARAMETERS])
    return Outcome(parameters, built - began, time.perf_counter() - built)


def methods(yardstick: Yardstick, full: bool) -> list[Method]:
    """All of them; ours first."""
    scales, record, start = BASE.values(), yardstick.record, yardstick.start
    u = np.column_stack(
        [record["omega_ref"] / scales["omega_scale"], (record["beta_ref"] + scales["beta_offset"]) / scales["beta_scale"]]
    )
    y = record["thrust"] / scales["thrust_scale"]
    count = PAPER_ITERATIONS if full else TIMED_ITERATIONS
    descent = f"the paper's descent, {count} iterations"
    return [
        Method("this project's refine", lambda: ours(record), 9),
        Method("scipy TRF, our sensitivities", lambda: trf(record, start), 9),
        Method(descent, lambda: paper_descent(u, y, start, RATE, count), 1, PAPER_ITERATIONS / count),
        Method("CasADi shooting, Gauss-Newton", lambda: casadi_shooting(u, y, start, True), 3),
        Method("CasADi shooting, exact Hessian", lambda: casadi_shooting(u, y, start, False), 1),
        Method("jax-sysid L-BFGS", lambda: jax_sysid(u, y, start), 3),
    ]


def outcomes(method: Method) -> list[Outcome]:
    """Run a method; a line why, and nothing, where a package is missing."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            return [method.run() for _ in range(method.runs)]
    except ImportError as missing:
        print(f"{method.name:36} skipped: {missing.name} is not installed (pip install '.[benchmarks]')")
        return []


def show(found: Measured, first: Measured, yardstick: Yardstick) -> None:
    """Print a method's line; `first` is ours."""
    seconds, last, reference = found.seconds, found.outcomes[-1], first.outcomes[-1].parameters
    truth, median, ours_median = np.array([TRUTH[n] for n in BASE_PARAMETERS]), np.median(seconds), np.median(first.seconds)
    ratio, with_build = median / ours_median, (found.build + median) / (first.build + ours_median)
    print(
        f"{found.method.name:36} {len(seconds):4} {found.build:8.3f} {seconds.min():8.3f} {median:8.3f} {ratio:8.1f}"
        f" {with_build:10.1f} {yardstick.cost(last.parameters):13.7g}"
        f" {yardstick.off(last.parameters, truth):7.2f} sd {yardstick.off(last.parameters, reference):6.2f} sd"
    )


@threadpool_limits.wrap(limits=1)
def main(full: bool) -> None:
    """Run and print all."""
    yardstick = Yardstick()
    print(f"{len(yardstick.record)} rows; our model's C is compiled once, ever: {compiling():.2f} s, not counted below")
    first, *others = methods(yardstick, full)
    ours_, rest = Measured(first, outcomes(first)), []
    for method in others:
        rest.append(Measured(method, outcomes(method)))
        ours_.outcomes.extend(outcomes(first))
    heads = f"{'build s':>8} {'best s':>8} {'median s':>8} {'ratio':>8} {'with build':>10} {'J':>13}"
    heads += f" {'off truth':>10} {'off ours':>9}"
    print(f"{'':36} {'runs':>4} {heads}")
    for found in (ours_, *(found for found in rest if found.outcomes)):
        show(found, ours_, yardstick)
    if not full:
        print(
            f"The paper's descent ran {TIMED_ITERATIONS} iterations: its seconds are scaled to {PAPER_ITERATIONS}, its cost and"
            " errors are as they stand then. --full runs them all."
        )
    print("sd: of the Cramer-Rao bound, the farthest parameter.")
    print("Ratios are of median seconds of solving, in which jax-sysid compiles.")
    print("Aims: ours in 0.05 s, the paper's descent 1000 x, CasADi and jax-sysid 20 x as long, at no lower cost.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.identification", description=__doc__)
    parser.add_argument("--full", action="store_true", help="run all 350 iterations of the paper's descent (minutes)")
    main(parser.parse_args().full)
