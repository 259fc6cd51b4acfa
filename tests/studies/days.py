"""python -m tests.studies days: does a rig's day (`vpp twin`) improve model and controller, and under which policy?

Emulated rigs of the paper's size, each slightly different, are identified from a campaign; from the second round on each has a
hidden effect. Each rig has the same day with fixed gains, and with gains tuned on the model. The final gains are compared on
new noise with gains that are tuned with full knowledge: by the method of `vpp tune`, under the same limits, on the rig's own
physics with the hidden effect.

Aims: a cost within 5 % of that of full knowledge; no day ends at a higher cost than it began.
"""

import json
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from hil.calibration import read_calibration
from hil.emulator.rig import CALIBRATION
from hil.emulator.rig import EmulatedRig as Emulated
from hil.physics.rig_model import rig_model
from hil.safety.limits import Limits
from hil.session import Setup
from identification.tune.objective import Objective
from identification.tune.operating import operating_points
from identification.tune.rounds import rounds
from identification.tune.tune import STARTS, TuningTask, chain_of
from identification.workers import spread
from vpp_fmu.app.api.rounds import FIXED, MODEL_BASED, new_day, next_round
from vpp_fmu.app.day import GAINS, Law, fly
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.twin.prediction import BROUGHT
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native.closed_loop import ClosedLoop
from vpp_fmu.parameters import ParameterSet

from .row_file import read
from .twin import identified

HIDDEN = {
    "thrust falls by 15 %": (("load_cell_gain",), {"load_cell_gain.gain": 0.85}),
    "a dead band appears": (("lac_command_deadband",), {"lac_command_deadband.half_width": 2.0}),
}
FROM = 2
"""Round from which on the effect is present."""

FINAL = 4
"""Flights for the final comparison of gains."""

CAREFUL = 0.5
"""Share of the paper's gains with which a day begins; the full gains are near the best, and would leave little to find."""


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="rigs for each change (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--changes", default=",".join(HIDDEN), metavar="A,B", help="(default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="of a day (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="rigs side by side (default: %(default)s)")
    parser.add_argument("-o", "--output", default="out/days.jsonl", metavar="F", help="lines (default: %(default)s)")
    parser.add_argument("--only-table", action="store_true", help="no new days: the table of the file's lines")
    options = parser.parse_args(arguments)
    path = Path(options.output)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not options.only_table:
        known = {(row["change"], row["seed"]) for row in read(path)}
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        wanted = [(change, seed) for seed in seeds for change in options.changes.split(",") if (change, seed) not in known]
        spread(partial(_kept, path, options.rounds), wanted, options.workers, what="rigs")
    for change in HIDDEN:
        found = [row for row in read(path) if row["change"] == change]
        if found:
            _show(change, found)


def _kept(path: Path, count: int, wanted: tuple[str, int]) -> None:
    change, seed = wanted
    row = {"change": change, "seed": seed, **days(change, count, seed)}
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")


def days(change: str, count: int, seed: int) -> dict:
    """Results of one rig: final costs on new noise, of the first gains (`began`) and of gains tuned with full knowledge
    (`full`). For each policy: by round the error of the present model in a mission that it has not seen [N], the cost of the
    next gains, and alarms with the verdicts; effects of the final model, its final cost, and CPU seconds."""
    known = identified(3 * seed)  # from a campaign as long as the paper's
    parameters = ParameterSet(plant()).replaced(known.values)
    settings = {name: (CAREFUL if name in GAINS else 1.0) * value for name, value in CONTROLLER.values().items()}
    day, (names, sizes) = new_day(parameters, settings), HIDDEN[change]
    with tempfile.TemporaryDirectory() as folder:

        def setup(hidden: bool, flight: int) -> Setup:
            own = Emulated({**known.own, **(sizes if hidden else {})}, names if hidden else (), 1000 * seed + flight)
            return Setup(read_calibration(CALIBRATION), Limits(), own, virtual=True, plant=parameters.values)

        def final(law: Law) -> float:
            flown = (fly(setup(True, 900 + k), law, day.profile, Path(folder, "flight")) for k in range(FINAL))
            return float(np.mean([each.costs for each in flown]))

        results = {}
        for policy in (FIXED, MODEL_BASED):
            one, began = new_day(parameters, settings), time.process_time()
            for number in range(1, count + 1):
                place = Path(folder) / policy / str(number)
                place.mkdir(parents=True)
                rig = partial(_rig, setup)
                one.rounds.append(next_round(one, rig, known.band, policy, place, seed, 1, lambda text: None))
            results[policy] = {
                "errors": [r.before for r in one.rounds],
                "costs": [r.cost for r in one.rounds],
                "alarms": [f"{r.mission.alarms[0].direction}: {r.verdict}" if r.mission.alarms else "" for r in one.rounds],
                "effects": [e for e in one.parameters.model.optional if e not in BROUGHT],
                "cost": final(one.law),
                "seconds": time.process_time() - began,
            }
        chain = chain_of(parameters, settings["sample_time"])
        tuning = TuningTask(parameters, day.profile, chain=chain, noise_std=known.band.noise, reference="began", seed=seed)
        full = _known_in_full(tuning, settings, {**known.own, **sizes}, names)
        return {"began": final(Law(settings)), "full": final(Law(full)), "policies": results}


def _rig(setup, number: int, flight: int, what: str) -> Setup:
    """The rig of a flight."""
    return setup(number >= FROM, 50 * number + flight)


@dataclass(frozen=True, eq=False)
class Truth(Objective):
    """The objective of a tuning on the rig's own physics: `plants` are its values, `hidden` its hidden effects."""

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


def _known_in_full(wanted: TuningTask, settings: Mapping[str, float], own: Mapping[str, float], hidden: tuple[str, ...]):
    """Gains tuned with full knowledge, from these settings on; limits as for gains that are tuned on a model."""
    on_model = wanted.objective(settings)
    given = {f.name: getattr(on_model, f.name) for f in fields(on_model)}
    values = np.array([list(_loop(hidden).models[0].values(own).values())])
    truth = Truth(**{**given, "plants": values}, hidden=hidden)
    truth = replace(truth, points=operating_points(truth, truth.gains), reference=truth.steps(truth.gains))
    starts = [(factor * truth.gains, ("PI", "D", "all")) for factor in STARTS]
    objective, found = rounds({"dual": truth}, {"dual": starts})["dual"]
    better = found.cost < objective.penalised(truth.gains)
    return truth.with_gains(found.gains if better else truth.gains)


def _show(change: str, found: list[dict]) -> None:
    began, full = (np.array([row[name] for row in found]) for name in ("began", "full"))
    print(f"\n{change}, {len(found)} rigs: the first gains cost {np.median(began):.4f}, full knowledge {np.median(full):.4f}")
    for policy in (FIXED, MODEL_BASED):
        own = [row["policies"][policy] for row in found]
        cost = np.array([o["cost"] for o in own])
        least, most = np.quantile(cost / full, [0.0, 1.0])
        print(f"{policy}: over full knowledge {np.median(cost / full):.3f} ({least:.3f} to {most:.3f}; aim 1.05)")
        print(f"  over the first gains {np.median(cost / began):.3f}; costlier than they in {int(np.sum(cost > began))}")
        for name, what in (("errors", "model error by round [N]"), ("costs", "cost by round")):
            print(f"  {what}: {' '.join(f'{x:.4f}' for x in np.median([o[name] for o in own], axis=0))}")
        for number in range(len(own[0]["alarms"])):
            words = Counter(o["alarms"][number] or "no alarm" for o in own)
            print(f"  round {number + 1}: {', '.join(f'{n} {word}' for word, n in words.most_common())}")
        effects = Counter(e for o in own for e in o["effects"])
        print(f"  effects in the end: {', '.join(f'{n} {e}' for e, n in effects.most_common()) or 'none'}")
        print(f"  CPU seconds of a day: {np.median([o['seconds'] for o in own]):.0f}")
