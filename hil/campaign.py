"""A measuring campaign on the rig: the paper's static map and steps, and records for fine-tuning and validation.

Each part is a separate run: tare, arm, run, ramp down. Its data are in the log and in the log's events, from which
`hil.results.campaign_folder` makes the records.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil import commands
from hil.commands import PAPERS, StepCommand
from hil.loop.cycle import PERIOD
from hil.loop.rig import RigPlant
from hil.safety.limits import Limits, limits_of, read_limits
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig as Ranges

PARTS = ("static", "steps", "open_loop", "repeat", "validation")

APPROACH = 0.25
"""Size of the step up to a record's first pitch, as a share of the range: 5 of 20 deg. It is needed because a dead band may
ignore the small commands of the spin-up's ramp, and the position within any play is unknown after it."""


@dataclass(frozen=True)
class CampaignSize:
    """Size of a campaign. Defaults are the paper's: 10 x 10 points, 3 s to settle, 5000 samples each; steps of 5 s + 5 s.

    `points` per side of the grid; `settle` [s]; `samples` per point; `levels` of the constant command during steps; recorded
    times `before` and `after` a step [s]; each of three open-loop `section`s [s]; `validation` [s]; `seed` of the sequences.
    """

    points: int = 10
    settle: float = 3.0
    samples: int = 5000
    levels: int = 5
    before: float = 1.0
    after: float = 5.0
    section: float = 30.0
    validation: float = 60.0
    seed: int = 1


def plan_for(rig: Ranges) -> CampaignSize:
    """The paper's plan with durations scaled up by the rig's time scale, never below the paper's."""
    plan, longer = CampaignSize(), max(rig.scales.time_scale / PAPERS.scales.time_scale, 1.0)
    times = ("settle", "before", "after", "section", "validation")
    return replace(plan, **{name: longer * getattr(plan, name) for name in times})


def steep(limits: Limits, rig: Ranges = PAPERS) -> Limits:
    """The limits of a campaign: a command may cross its range in one tick, unless the rig declares a slew rate. An
    identification needs steps and not ramps of commands; the speed loop limits the rotor's acceleration."""
    omega, beta = limits.omega_max - limits.omega_min, limits.beta_max - limits.beta_min
    slews = {
        "omega_slew": max(limits.omega_slew, omega / PERIOD) if math.isinf(rig.speed_slew) else limits.omega_slew,
        "beta_slew": max(limits.beta_slew, beta / PERIOD) if math.isinf(rig.pitch_slew) else limits.beta_slew,
    }
    return replace(limits, **slews)


def within(rig: Ranges, limits: Limits, freely: Limits) -> Ranges:
    """The rig's ranges within the limits; slew rates too, if they are below those of `freely`, the limits without a limits
    file. Commands beyond the limits would be cut. BadInput if a range becomes empty."""
    found = {
        "speed": (max(rig.speed[0], limits.omega_min), min(rig.speed[1], limits.omega_max)),
        "pitch": (max(rig.pitch[0], limits.beta_min), min(rig.pitch[1], limits.beta_max)),
    }
    if limits.omega_slew < freely.omega_slew:
        found["speed_slew"] = min(rig.speed_slew, limits.omega_slew)
    if limits.beta_slew < freely.beta_slew:
        found["pitch_slew"] = min(rig.pitch_slew, limits.beta_slew)
    for name in ("speed", "pitch"):
        if found[name][0] > found[name][1]:
            low, high = getattr(rig, name)
            raise BadInput("limits", f"range of {name}", "an empty range", f"a range within the rig's {low:g} to {high:g}")
    changed = {name: value for name, value in found.items() if value != getattr(rig, name)}
    return replace(rig, **changed, origin={**rig.origin, **dict.fromkeys(changed, "the limits")})


def limits_for(allowed: Ranges, where: str, file: str | None = None, steps: bool = False) -> tuple[Limits, Ranges]:
    """(limits outside the controller, the rig's ranges within them). `where`: the file that `allowed` comes from. `file`: of
    limits. `steps`: commands may jump if the rig declares no slew rate. BadInput."""
    freely = limits_of(allowed, where)
    freely = steep(freely, allowed) if steps else freely
    limits = read_limits(file, allowed, freely) if file else freely
    return limits, within(allowed, limits, freely)


def parts_for(rig: Ranges) -> tuple[str, ...]:
    """Parts of a campaign; a rig with constant speed and pitch has no steps."""
    return tuple(part for part in PARTS if part != "steps" or commands.steps(1, rig))


def seconds(plan: CampaignSize, parts: Iterable[str], rig: Ranges = PAPERS) -> float:
    """Duration of the parts on the rig [s], without tare and spin-up."""
    takes = {
        "static": len(commands.grid(plan.points, rig)) * (plan.settle + PERIOD * plan.samples),
        "steps": len(commands.steps(plan.levels, rig)) * (plan.settle + plan.before + plan.after),
        "open_loop": 3.0 * plan.section,
        "repeat": 3.0 * plan.section,
        "validation": plan.validation,
    }
    return sum(takes[part] for part in parts)


def measure(rig: RigPlant, part: str, plan: CampaignSize, allowed: Ranges = PAPERS, done: int = 0) -> None:
    """Measure one part, with commands within the `allowed` limits. `done`: points of the static map, or steps, that are
    measured already. RunEnded if the rig ended it."""
    if part == "static":
        static_map(rig, commands.grid(plan.points, allowed), plan.settle, plan.samples, done)
    elif part == "steps":
        step_responses(rig, commands.steps(plan.levels, allowed), plan, done)
    elif part == "validation":
        follow(rig, commands.validation(plan.seed, plan.validation, rig.dt, allowed), plan.settle)
    else:
        follow(rig, commands.open_loop(plan.seed, plan.section, rig.dt, allowed), plan.settle)


STATIC = ("omega_ref", "beta_ref", "omega", "thrust", "thrust_std", "samples")
"""Columns of static.csv; then those of POWER that were read."""

POWER = ("voltage", "current", "torque")


def static_map(rig: RigPlant, grid: Sequence[tuple[float, float]], settle: float, samples: int, done: int) -> None:
    """Means over `samples` readings at each point of the grid but the first `done`, after `settle` s. Each point goes to the
    log's events as soon as it is measured."""
    names = powered(rig.supply)
    rig.start(*grid[max(done - 1, 0)])  # the point before, from which the next one is approached
    for k, point in list(enumerate(grid))[done:]:
        for _ in range(round(settle / rig.dt)):
            sample = rig.step(*point)
        thrust, omega, power = np.empty(samples), 0.0, np.empty((samples, len(names)))
        for n in range(samples):
            sample = rig.step(*point)
            thrust[n] = sample.thrust
            omega += sample.omega
            power[n] = [rig.supply[name] for name in names]
        spread = thrust.std(ddof=1) if samples > 1 else 0.0
        found = (*point, omega / samples, thrust.mean(), spread, samples, *power.mean(axis=0))
        rig.keep(point=[float(value) for value in found])
        rig.show_done((k + 1) / len(grid))
    rig.stop()


def powered(supply: Iterable[str]) -> tuple[str, ...]:
    """Columns of POWER in static.csv: those that are wired."""
    return tuple(name for name in POWER if name in supply)


def step_responses(rig: RigPlant, steps: Sequence[StepCommand], plan: CampaignSize, done: int = 0) -> None:
    """Record each step but the first `done`, from a settled state."""
    rig.start(*steps[min(done, len(steps) - 1)].before)
    for k, one in list(enumerate(steps))[done:]:
        for _ in range(round(plan.settle / rig.dt)):
            rig.step(*one.before)
        counts = round(plan.before / rig.dt), round(plan.after / rig.dt)
        recorded(rig, np.repeat([one.before, one.after], counts, axis=0))
        rig.show_done((k + 1) / len(steps))
    rig.stop()


def follow(rig: RigPlant, orders: Record, settle: float) -> None:
    """Apply a record of commands, one row a tick, after `settle` s at the first."""
    targets = np.column_stack([orders["omega_ref"], orders["beta_ref"]])
    omega, beta = targets[0].tolist()
    rig.start(omega, beta)
    below = beta - APPROACH * (rig.limits.beta_max - rig.limits.beta_min)
    for pitch in (max(below, rig.limits.beta_min), beta):
        for _ in range(round(settle / rig.dt)):
            rig.step(omega, pitch)
    recorded(rig, targets, rig.show_done)
    rig.stop()


def recorded(rig: RigPlant, targets: np.ndarray, progress: Callable[[float], None] = lambda share: None) -> None:
    """Apply the commands `targets` (rows, 2) [rpm, deg], one a slot; two events mark the rows of the log. The command of a slot
    that was missed is left out."""
    count, first = len(targets), rig.ticks.slot
    rig.keep(record={"first": first, "count": count})
    while (k := rig.ticks.slot - first) < count:
        rig.step(*targets[k].tolist())
        progress(min((k + 1) / count, 1.0))
    rig.keep(recorded=first)


def same_commands(first: Record, second: Record) -> bool:
    """Whether two records had the same commands throughout: they differ if a slot was missed at a change of a command."""
    return all(np.array_equal(first[name], second[name]) for name in ("time", "omega_ref", "beta_ref"))
