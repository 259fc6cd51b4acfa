"""python -m tests.studies days: does a rig's day (`vpp twin`) make model and controller better, and which policy does?

Emulated rigs of the paper's size, each a little different, are identified from a campaign; from the second round on something
is hidden in them. Each rig has the same day under each policy: gains that stay, that are retuned on the model alone, that are
searched on the rig alone, and both. In the end what each left flies, on noise that no day had, beside gains that were tuned
with full knowledge: as `vpp tune` does it, under the same limits, on the rig's own physics with what is hidden in them.

Aims: the cost of both side by side within 5 % of that; nothing ends worse than it began.
"""

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from hil.calibration import read_calibration
from hil.emulator.rig import Rig as Emulated
from hil.physics.rig_model import rig_model
from hil.safety.limits import Limits
from hil.session import Setup
from identification.tune.objective import Objective
from identification.tune.operating import operating_points
from identification.tune.rounds import rounds
from identification.tune.tune import STARTS, Task
from identification.workers import spread
from vpp_fmu.cli.hil_options import EMULATED
from vpp_fmu.day.day import POLICIES, Rig, new_day, next_round
from vpp_fmu.day.flight import GAINS, fly
from vpp_fmu.day.policy import task
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native.closed_loop import ClosedLoop
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

from .twin import identified

HIDDEN = {
    "thrust falls by 15 %": (("load_cell_gain",), {"load_cell_gain.gain": 0.85}),
    "a dead band appears": (("lac_command_deadband",), {"lac_command_deadband.half_width": 2.0}),
}
FROM = 2
"""Round from which on it is there."""

FINAL = 4
"""Flights by which gains are compared in the end."""

CAREFUL = 0.5
"""Of the paper's gains, what a day begins with: they are near the best there are, and would leave little to find."""


@dataclass(frozen=True)
class Told:
    """A day: model error [N] and cost of what flies next, round by round; what was named; final `cost` on fresh noise."""

    errors: tuple[float, ...]
    costs: tuple[float, ...]
    named: tuple[str, ...]
    cost: float


def main(arguments: list[str]) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies days", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="rigs for each change (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=4, metavar="N", help="of a day (default: %(default)s)")
    parser.add_argument("--policies", default=",".join(POLICIES), metavar="A,B", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="days side by side (default: %(default)s)")
    options = parser.parse_args(arguments)
    policies = options.policies.split(",")
    for change in HIDDEN:
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        found = spread(partial(days, change, policies, options.rounds), seeds, options.workers, what=change)
        _show(change, policies, found)


def days(change: str, policies: list[str], count: int, seed: int) -> tuple[float, float, dict[str, Told]]:
    """(cost of the first gains in the end, of those that know the rig in full, a day of each policy) on one rig."""
    known = identified(3 * seed)  # of a campaign as long as the paper's
    parameters = ParameterSet(plant()).replaced(known.values)
    settings = {name: (CAREFUL if name in GAINS else 1.0) * value for name, value in CONTROLLER.values().items()}
    day = new_day(parameters, settings)
    with tempfile.TemporaryDirectory() as folder:

        def setup(hidden: bool, flight: int) -> Setup:
            names, sizes = HIDDEN[change] if hidden else ((), {})
            own = Emulated({**known.own, **sizes}, names, 1000 * seed + flight)
            return Setup(read_calibration(EMULATED), Limits(), own, virtual=True, plant=parameters.values)

        def final(gains: Mapping[str, float]) -> float:
            return float(np.mean([_cost(setup(True, 900 + k), gains, day.profile, Path(folder)) for k in range(FINAL)]))

        told = {}
        for policy in policies:
            one = new_day(parameters, settings)
            rig = Rig(lambda number, flight: setup(number >= FROM, 50 * number + flight), lambda what: None, lambda number: ())
            for number in range(1, count + 1):
                place = Path(folder) / policy / str(number)
                place.mkdir(parents=True)
                one.rounds.append(next_round(one, rig, known.band, policy, place, seed, 1, lambda text: None))
            errors = tuple(r.chosen.fitted if np.isnan(r.chosen.unseen) else r.chosen.unseen for r in one.rounds)
            named = tuple(n for r in one.rounds for n in r.named)
            told[policy] = Told(errors, tuple(r.cost for r in one.rounds), named, final(one.flies))
        names, sizes = HIDDEN[change]
        wanted = task(parameters, day.profile, known.band.noise, settings["sample_time"], seed)
        full = _known_in_full(wanted, settings, {**known.own, **sizes}, names)
        return final(settings), final(full), told


@dataclass(frozen=True, eq=False)
class Truth(Objective):
    """What a tuning makes small, on the rig's own physics: `plants` are its values, `hidden` what is hidden in it."""

    hidden: tuple[str, ...] = ()

    @property
    def loop(self) -> ClosedLoop:
        """The loop around the rig."""
        return _loop(self.hidden)


SCALES = Effect(
    "scales",
    "what a response is normalised by",
    lambda ops, s, x, p, dt: ({}, {}),
    parameters=tuple(p for p in plant().parameters if p.name in ("omega_scale", "beta_scale", "thrust_scale")),
)


@cache
def _loop(hidden: tuple[str, ...]) -> ClosedLoop:
    model = rig_model(hidden)
    return ClosedLoop(replace(model, effects=(*model.effects, SCALES)))


def _known_in_full(wanted: Task, settings: Mapping[str, float], own: Mapping[str, float], hidden: tuple[str, ...]):
    """Gains tuned with full knowledge, from these settings on; limits as for gains that are tuned on a model."""
    told = wanted.objective(settings)
    given = {f.name: getattr(told, f.name) for f in fields(told)}
    values = np.array([list(_loop(hidden).models[0].values(own).values())])
    truth = Truth(**{**given, "plants": values}, hidden=hidden)
    truth = replace(truth, points=operating_points(truth, truth.gains), reference=truth.steps(truth.gains))
    starts = [(factor * truth.gains, ("PI", "D", "all")) for factor in STARTS]
    objective, found = rounds({"dual": truth}, {"dual": starts})["dual"]
    better = found.cost < objective.penalised(truth.gains)
    return truth.with_gains(found.gains if better else truth.gains)


def _cost(setup: Setup, gains: Mapping[str, float], profile: Record, folder: Path) -> float:
    return fly(replace(setup), gains, profile, folder / "flight").cost


def _show(change: str, policies: list[str], found: list[tuple[float, float, dict[str, Told]]]) -> None:
    began, full = np.array([f[0] for f in found]), np.array([f[1] for f in found])
    print(f"\n{change}, {len(found)} rigs: the first gains cost {np.median(began):.4f}, full knowledge {np.median(full):.4f}")
    for policy in policies:
        own = [f[2][policy] for f in found]
        cost = np.array([o.cost for o in own])
        errors = np.median([o.errors for o in own], axis=0)
        costs = np.median([o.costs for o in own], axis=0)
        print(f"{policy}: over full knowledge {np.median(cost / full):.3f} (median; worst {np.max(cost / full):.3f}; aim 1.05)")
        print(f"  worse than the first gains: {int(np.sum(cost > began))} of {len(own)}")
        print(f"  model error by round [N]: {' '.join(f'{e:.3f}' for e in errors)}")
        print(f"  cost by round: {' '.join(f'{c:.4f}' for c in costs)}")
        named = [" + ".join(o.named) for o in own if o.named]
        print(f"  named: {', '.join(named) or 'nothing'}")
