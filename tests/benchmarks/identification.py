"""python -m tests.benchmarks.identification: `refine` compared with other methods for the same fit.

All fit one synthetic record (60 s at 250 Hz, thrust with 0.3 N of white noise) from one start, the paper's averaged constants
and static map; thrust alone, no prior. One exact model computes cost and errors of every method. The others are set up as an
expert would, with exact sensitivities and a least-squares solver, and out of the box, as their documentation shows them.
Building and compiling are not counted. Ours also decides which parameters are identifiable, and computes their uncertainty.
Machines differ and are noisy, so compare ratios of medians; ours runs before and after each other method. Numerical libraries
use one thread: the matrices are small, and on a shared machine threads wait for each other.
"""

import contextlib
import io
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from identification.fit.gradient_descent import RATE
from identification.fit.problem import Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings, paper_cost, refine
from tests.benchmarks.rivals import (
    Fit,
    by_scipy,
    casadi_forward,
    casadi_shooting,
    filters,
    jax_forward,
    jax_sysid,
    paper_descent,
)
from tests.studies.synthetic import TRUTH, commands, covariance, measured
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.native import Simulator
from vpp_fmu.native.simulator import _runner
from vpp_fmu.record import Record

PAPER_ITERATIONS = 350
TIMED_ITERATIONS = 20
"""Iterations of the paper's descent that run; its time is scaled to PAPER_ITERATIONS."""


@dataclass(frozen=True)
class Method:
    """A way to fit: one `build()` and `runs` fits; `times` is the factor that scales its seconds."""

    name: str
    build: Callable[[], Fit]
    runs: int
    times: float = 1.0


class Timed:
    """A method, its seconds of building and of each fit, and its last parameters. Raises ImportError."""

    def __init__(self, method: Method):
        began = time.perf_counter()
        self.method, self._fit = method, method.build()
        self.build, self._seconds, self.parameters = time.perf_counter() - began, [], np.empty(0)

    def run(self, start: np.ndarray) -> None:
        """Fit `method.runs` times."""
        for _ in range(self.method.runs):
            began = time.perf_counter()
            with contextlib.redirect_stdout(io.StringIO()):
                self.parameters = self._fit(start)
            self._seconds.append(time.perf_counter() - began)

    @property
    def seconds(self) -> np.ndarray:
        """Seconds of the fits, (fits,)."""
        return self.method.times * np.array(self._seconds)


class Yardstick:
    """The record, and the cost and the errors of parameters on it."""

    def __init__(self, seed: int = 0):
        rng = np.random.default_rng(seed)
        self.record: Record = measured(commands(rng), rng)
        self.start = np.array([AVERAGED[n] for n in BASE_PARAMETERS])
        experiments = independent_readings([self.record], BASE.values(), ("thrust",))
        self._problem = Problem(BASE, experiments, BASE.values(), BASE_PARAMETERS)
        coordinates = self._problem.coordinates
        x = coordinates.vector(TRUTH)
        jacobian = self._problem.evaluate(x)[1] * BASE.values()["thrust_scale"]
        rms = np.sqrt(2.0 * paper_cost(self._problem, BASE.values(TRUTH))) * BASE.values()["thrust_scale"]
        bound = coordinates.jacobian(x) @ covariance(jacobian, rms) @ coordinates.jacobian(x).T
        self._std = np.sqrt(np.diag(bound))

    def cost(self, parameters: np.ndarray) -> float:
        """mean(e^2) / 2 of normalised thrust."""
        return paper_cost(self._problem, BASE.values(dict(zip(BASE_PARAMETERS, parameters, strict=True))))

    def off(self, parameters: np.ndarray, truth: np.ndarray) -> float:
        """Largest difference of a parameter in standard deviations of the Cramer-Rao bound; lags are sorted by size first."""
        return float(np.max(np.abs(_slow_first(parameters) - _slow_first(truth)) / self._std))


def _slow_first(parameters: np.ndarray) -> np.ndarray:
    return np.concatenate([np.sort(parameters[:2])[::-1], np.sort(parameters[2:4])[::-1], parameters[4:]])


def ours(record: Record) -> Fit:
    """`refine` as a user calls it; its building is the loading of the compiled model, once per process."""
    _runner.cache_clear()
    Simulator(BASE, BASE_PARAMETERS)

    def fit(start: np.ndarray) -> np.ndarray:
        found = refine(BASE, [record], dict(zip(BASE_PARAMETERS, start, strict=True)), channels=("thrust",))
        return np.array([found.values[n] for n in BASE_PARAMETERS])

    return fit


def trf(record: Record, start: np.ndarray) -> Fit:
    """scipy's trust-region reflective solver on the same residual and sensitivities."""
    values = BASE.values(dict(zip(BASE_PARAMETERS, start, strict=True)))
    problem = Problem(BASE, independent_readings([record], values, ("thrust",)), values, BASE_PARAMETERS)
    coordinates = problem.coordinates
    solve = by_scipy(problem.evaluate, "trf", bounds=(coordinates.lower, coordinates.upper), x_scale="jac")

    def fit(start: np.ndarray) -> np.ndarray:
        found = solve(coordinates.vector(dict(zip(BASE_PARAMETERS, start, strict=True))))
        return np.array([coordinates.values(found)[n] for n in BASE_PARAMETERS])

    return fit


def methods(yardstick: Yardstick) -> dict[str, list[Method]]:
    """All methods, grouped by their set-up; ours first."""
    scales, record, start = BASE.values(), yardstick.record, yardstick.start
    u = np.column_stack(
        [record["omega_ref"] / scales["omega_scale"], (record["beta_ref"] + scales["beta_offset"]) / scales["beta_scale"]]
    )
    y = record["thrust"] / scales["thrust_scale"]
    count = TIMED_ITERATIONS
    descent = f"the paper's descent, {count} iterations"
    return {
        "": [Method("this project's refine", lambda: ours(record), 20)],
        "as an expert sets them up": [
            Method("scipy lfilter, MINPACK", lambda: filters(u, y, "lm"), 20),
            Method("scipy lfilter, TRF", lambda: filters(u, y, "trf"), 20),
            Method("JAX scan and jacfwd, TRF", lambda: jax_forward(u, y), 20),
            Method("CasADi mapaccum, compiled, MINPACK", lambda: casadi_forward(u, y, True), 9),
            Method("CasADi mapaccum, interpreted, MINPACK", lambda: casadi_forward(u, y, False), 5),
            Method("our sensitivities, scipy TRF", lambda: trf(record, start), 20),
        ],
        "out of the box": [
            Method("jax-sysid L-BFGS", lambda: jax_sysid(u, y), 3),
            Method("CasADi shooting, Gauss-Newton", lambda: casadi_shooting(u, y, True), 3),
            Method("CasADi shooting, exact Hessian", lambda: casadi_shooting(u, y, False), 1),
            Method(descent, lambda: paper_descent(u, y, RATE, count), 1, PAPER_ITERATIONS / count),
        ],
    }


def show(found: Timed, first: Timed, yardstick: Yardstick) -> None:
    """Print a method's line; `first` is ours."""
    seconds, parameters, truth = found.seconds, found.parameters, np.array([TRUTH[n] for n in BASE_PARAMETERS])
    print(
        f"{found.method.name:38} {len(seconds):4} {found.build:8.3f} {1e3 * seconds.min():9.1f} {1e3 * np.median(seconds):9.1f}"
        f" {np.median(seconds) / np.median(first.seconds):8.2f} {yardstick.cost(parameters):15.9g}"
        f" {yardstick.off(parameters, truth):9.2f} {yardstick.off(parameters, first.parameters):9.0e}"
    )


@threadpool_limits.wrap(limits=1)
def main() -> None:
    """Run and print all."""
    yardstick = Yardstick()
    print(f"{len(yardstick.record)} rows")
    groups, missing = methods(yardstick), []
    (method,) = groups.pop("")
    first, others = Timed(method), {}
    first.run(yardstick.start)
    for group, own in groups.items():
        others[group] = []
        for method in own:
            try:
                one = Timed(method)
            except ImportError as error:
                missing.append(f"{method.name}: {error.name} is not installed (pip install '.[benchmarks]')")
                continue
            one.run(yardstick.start)
            others[group].append(one)
            first.run(yardstick.start)
    heads = f"{'build s':>8} {'best ms':>9} {'median ms':>9} {'ratio':>8} {'J':>15} {'off truth':>9} {'off ours':>9}"
    print(f"{'':38} {'fits':>4} {heads}")
    show(first, first, yardstick)
    for group, own in others.items():
        print(f"{group}:")
        for one in own:
            show(one, first, yardstick)
    print("\n".join(missing))
    print(
        f"The paper's descent ran {TIMED_ITERATIONS} iterations: its time is scaled to {PAPER_ITERATIONS}; its cost and"
        " errors are those after them."
    )
    print("off: the farthest parameter, in standard deviations of the Cramer-Rao bound.")
    print("ratio: of median times of fits, without what is built and compiled before, but jax-sysid compiles in its fit.")


if __name__ == "__main__":
    main()
