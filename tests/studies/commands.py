"""All commands that the project writes or sends stay within a rig's ranges and slews, on random rigs of any size.

    python -m tests.studies commands --rigs 10000

Aim: no command outside a range, no change steeper than a slew. A command is one row of one channel. Ranges and slews are
checked independently of the code that makes the commands.
"""

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf, isfinite

import numpy as np

from hil.campaign import steep
from hil.commands import grid, open_loop, steps, validation
from hil.cycle import PERIOD
from hil.safety.limits import Limiter, limits_of
from identification.diagnose.experiment import discriminating_experiment
from identification.plan.excitation import candidate, paper_plan, variant
from identification.plan.plan import plan
from identification.thrust_steps import step_profile
from identification.workers import spread
from vpp_fmu.commands import commanded, idle
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig, infer_rig

PLANNED = 500
"""One rig in so many also gets a search for a whole plan, which takes a hundred times as long as all other checks."""

ROUNDING = 1e-9
"""Relative rounding error that is allowed for a sum of floating-point numbers."""


@dataclass
class Count:
    """Numbers of commands checked, outside their range, and steeper than their slew, each by the commands' source."""

    checked: Counter = field(default_factory=Counter)
    outside: Counter = field(default_factory=Counter)
    steeper: Counter = field(default_factory=Counter)

    def add(self, name: str, rig: Rig, commands: np.ndarray, step: float = inf) -> None:
        """Check commands (rows, 2) of speed [rpm] and pitch [deg], every `step` s; infinite: they are not consecutive."""
        channels = zip(commands.T, (rig.speed, rig.pitch), (rig.speed_slew, rig.pitch_slew), strict=True)
        for column, (low, high), slew in channels:
            self.within(name, column, low, high)
            if isfinite(slew) and isfinite(step):
                allowed = slew * step * (1.0 + ROUNDING) + ROUNDING * max(abs(low), abs(high))
                self.steeper[name] += int(np.sum(np.abs(np.diff(column)) > allowed))

    def merge(self, other: "Count") -> None:
        """Add what another has counted."""
        for own, more in ((self.checked, other.checked), (self.outside, other.outside), (self.steeper, other.steeper)):
            own.update(more)

    def within(self, name: str, column: np.ndarray, low: float, high: float) -> None:
        """Check one channel's range, exactly and as a file has it."""
        written = np.array([float(f"{x:.9g}") for x in np.unique(column)])
        self.checked[name] += len(column)
        self.outside[name] += int(np.sum(~((column >= low) & (column <= high)))) + int(
            np.sum((written < low) | (written > high))
        )


def random_rig(rng: np.random.Generator) -> Rig:
    """A rig of 100 to 60 000 rpm, 0.02 to 5 s, any pitch, with slews or without; a channel is fixed in one of eight."""
    top = np.exp(rng.uniform(np.log(100.0), np.log(60000.0)))
    speed = _span(rng, top * rng.uniform(0.0, 0.9), top)
    kinds = (
        (-5.0, 10.0),
        (12.0, 25.0),
        tuple(np.sort(rng.uniform(-30.0, -1.0, 2))),
        tuple(np.sort(rng.uniform(-40.0, 40.0, 2))),
    )
    pitch = _span(rng, *kinds[rng.integers(len(kinds))])
    force = np.exp(rng.uniform(np.log(0.1), np.log(1000.0)))
    measured = {
        "omega_ref": np.array(speed),
        "beta_ref": np.array(pitch),
        "thrust": force * np.array([rng.uniform(-0.5, 0.2), 1.0]),
    }
    unit = float(np.exp(rng.uniform(np.log(0.02), np.log(5.0))))
    rig = infer_rig([], measured, {}).timed(unit)
    spans = (speed[1] - speed[0]) or speed[1], (pitch[1] - pitch[0]) or 1.0
    slews = [
        inf if rng.random() < 0.5 else float(f"{size / unit * np.exp(rng.uniform(np.log(0.1), np.log(30.0))):.6g}")
        for size in spans
    ]
    return replace(rig, speed_slew=slews[0], pitch_slew=slews[1])


def _span(rng: np.random.Generator, low: float, high: float) -> tuple[float, float]:
    """Two ends as a file has them, with two to eight digits; equal in one of eight."""
    low, high = (float(f"{x:.{rng.integers(2, 9)}g}") for x in (low, high))
    return (high, high) if rng.random() < 0.125 or not low < high else (low, high)


def check(rig: Rig, rng: np.random.Generator, count: Count) -> None:
    """All checks but the search for a plan."""
    for name, commands, step in _experiments(rig, rng):
        count.add(name, rig, commands, step)
    for name, asked in _campaign(rig, rng):
        count.add(name, rig, asked, PERIOD if name.startswith("hil, record") else inf)
        count.add(f"{name}, behind the limits", rig, _acting(rig, asked), PERIOD)
    count.add("idle", rig, np.array([idle(rig)]))
    count.within("step profile, N", step_profile(rig)["thrust_set"], *rig.thrust)


def check_plan(rig: Rig, count: Count) -> None:
    """Check a whole plan from a short search."""
    unit = rig.scales.time_scale
    lags = {
        f"tau_{u}_{k}": share * unit
        for u, k, share in (("omega", 1, 0.3), ("omega", 2, 0.1), ("beta", 1, 0.7), ("beta", 2, 0.3))
    }
    found = plan(BASE.sized(rig.scales), lags, rig, 20.0 * unit, evaluations=6)
    count.add("plan", rig, _columns(found.commands), found.step)


def _experiments(rig: Rig, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, float]]:
    """(name, commands, step) of segments as the search for a plan has them, and of a diagnosis' next experiment."""
    step, seed = 0.04 * rig.scales.time_scale, int(rng.integers(2**31))
    for _ in range(3):
        segment = candidate(rng, 250, step, rig)
        for targets in (segment, variant(rng, segment, step, rig)):
            yield "plan, segment", commanded(rig, targets, step), step
        yield "plan, segment as sampled", commanded(rig, segment.repeat(4, axis=0), 0.25 * step), 0.25 * step
    yield "plan, the paper's", commanded(rig, paper_plan(rng, 500, step, rig), step), step
    period = (None, 0.02 * rig.scales.time_scale, 0.1)[rng.integers(3)]
    record = discriminating_experiment(rig, seed, period)
    yield "next experiment", _columns(record), float(record.time[1])


def _campaign(rig: Rig, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """(name, commands) that `vpp hil campaign` sends."""
    seed = int(rng.integers(2**31))
    yield "hil, grid", np.array(grid(4, rig))
    found = steps(2, rig)
    if found:
        yield "hil, steps", np.array([end for one in found for end in (one.before, one.after) for _ in range(3)])
    yield "hil, record of the open loop", _columns(open_loop(seed, 1.0, PERIOD, rig))
    yield "hil, record of the validation", _columns(validation(seed, 1.0, PERIOD, rig))


def _acting(rig: Rig, asked: np.ndarray) -> np.ndarray:
    """The commands after the rig's limits in a campaign, (rows, 2)."""
    limiter = Limiter(steep(limits_of(rig), rig), *asked[0].tolist())
    return np.array([limiter.apply(*row, PERIOD)[:2] for row in asked.tolist()])


def _columns(record: Record) -> np.ndarray:
    return np.column_stack([record["omega_ref"], record["beta_ref"]])


def study(rigs: Iterable[int], seed: int = 0, planned: int = PLANNED) -> Count:
    """The count over rigs by number; each has its own seed, so that one rig can be checked alone."""
    count = Count()
    for k in rigs:
        rng = np.random.default_rng([seed, k])
        rig = random_rig(rng)
        check(rig, rng, count)
        if planned and k % planned == 0:
            check_plan(rig, count)
    return count


def main(parser, arguments):
    parser.add_argument("--rigs", type=int, default=10000, metavar="N", help="random rigs (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes side by side")
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    count, shares = Count(), [range(k, options.rigs, options.workers) for k in range(options.workers)]
    for found in spread(partial(study, seed=options.seed), shares, options.workers, what="rigs"):
        count.merge(found)
    print(f"{'commands of':50} {'checked':>12} {'outside':>8} {'steeper':>8}")
    for name, checked in count.checked.items():
        print(f"{name:50} {checked:12d} {count.outside[name]:8d} {count.steeper[name]:8d}")
    total = [sum(each.values()) for each in (count.checked, count.outside, count.steeper)]
    print(f"{options.rigs} rigs tried, {total[0]} commands checked: {total[1]} outside range, {total[2]} slews exceeded")
    print(f"{time.perf_counter() - began:.0f} s")
