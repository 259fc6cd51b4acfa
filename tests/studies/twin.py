"""python -m tests.studies twin: false alarms of the rig's twin, and its delay to the alarm of a change.

Emulated rigs of the paper's size, each slightly different (`hil.physics`, its noise and the tare's), are measured by campaigns
of three lengths and identified as by `vpp identify`; the twin and its band are those of `vpp hil run --twin`. Each run of RUN s
starts anew, under random steps, under the controller within the rig's limits, or at constant set-points. Of runs in which
nothing changes, alarms are counted. A change is there from the start or comes at LATER s, and must be found within WATCHED s.

The physics and the loop are compiled and run in virtual time, without buses and drivers; each row goes through `Twin.update`.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from hil import commands
from hil.emulator.world import LoadCell
from hil.physics.rig_model import rig_model
from hil.safety.limits import Limits
from hil.twin.band import Band, read_band
from hil.twin.twin import Twin, twin_of
from identification.identify import identify
from identification.workers import spread
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native.simulator import Simulator
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.structured import as_json

DT, RUN, LATER, WATCHED = 0.004, 600.0, 120.0, 300.0
"""s: a tick; a run without a change; begin of a late change; time within which a change must be detected."""

TARE = 0.006
"""N: standard deviation of a tare's error, the noise's mean over 4 s."""
SPREAD = 0.1
"""Largest relative deviation of a rig's parameters from the emulated rig's."""
DRAWN = ("inertia", "kp_lac", "lift", "induced", "resistance")


class Length(NamedTuple):
    """Length of a campaign: points a side of its static map, levels of its steps, s of an open-loop section and of the
    validation."""

    points: int
    levels: int
    section: float
    validation: float


LENGTHS = Length(10, 5, 30.0, 60.0), Length(7, 3, 15.0, 30.0), Length(5, 1, 8.0, 15.0)
"""The paper's, half of it, and a short one."""

CHANGES = ("gain 1.4", "pitch +0.5 deg", "speed reading +2 %", "reading +0.3 N")
KINDS = ("random steps", "closed loop", "constant set-points")


class Known(NamedTuple):
    """A rig's own parameters; the values, band and standard deviations from its campaign."""

    own: dict[str, float]
    values: dict[str, float]
    band: Band
    std: dict[str, float]


def main(parser, arguments):
    parser.add_argument("--runs", type=int, default=24, metavar="N", help="of each kind (default: %(default)s)")
    parser.add_argument("--twins", type=int, default=24, metavar="N", help="rigs, each with a campaign (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="side by side (default: %(default)s)")
    options = parser.parse_args(arguments)
    first, workers = options.first_seed, options.workers
    known = spread(identified, range(first, first + options.twins), workers, what="campaigns")
    seeds = range(first, first + options.runs)
    cases = [(kind, "", 0.0) for kind in KINDS] + list(product(KINDS[:2], CHANGES, (0.0, LATER)))
    for kind, change, begin in cases:
        found = spread(partial(alarm, kind, change, begin, known=known), seeds, workers, what="runs")
        when = np.sort([time for time, _ in found])
        if not change:
            print(f"{kind}, nothing changes: {np.isfinite(when).sum()} alarms in {len(when)} runs of {RUN:g} s")
            continue
        right = when[when >= 0.0]
        points = ", ".join(f"{count} {name}" for name, count in Counter(name for _, name in found if name).most_common())
        print(
            f"{kind}, {change} from {begin:g} s: median {right[len(right) // 2] if len(right) else np.nan:.1f} s, "
            f"missed {np.isinf(when).sum()}, before {np.sum(when < 0.0)} of {len(when)}; points to {points}"
        )


@threadpool_limits.wrap(limits=1)
def identified(seed: int) -> Known:
    """Measure a rig and identify it; its band is read as `vpp hil run --twin` reads it."""
    rng, length = np.random.default_rng([seed, 1]), LENGTHS[seed % len(LENGTHS)]
    own = {name: value * (1.0 + rng.uniform(-SPREAD, SPREAD)) for name, value in _defaults().items()}
    found = identify(_campaign(rng, own, length, seed), starts=2)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "identification.json"
        path.write_text(as_json(found.summary()))
        std = {name: e.std for name, e in found.parameters.estimates.items() if e.std is not None}
        return Known(own, dict(found.parameters.values), read_band(path), std)


@threadpool_limits.wrap(limits=1)
def alarm(kind: str, change: str, begin: float, seed: int, known: list[Known]) -> tuple[float, str]:
    """(s from the change's begin to the first alarm of a run, inf without one; what it points to)."""
    one = known[seed % len(known)]
    rng = np.random.default_rng([seed, 2, KINDS.index(kind), CHANGES.index(change) if change else 9, int(begin)])
    rows = flown(kind, change, begin, rng, one.own, begin + WATCHED if change else RUN)
    twin = Twin(twin_of(ParameterSet(plant()).replaced(one.values, one.std), one.band))
    twin.start(0.0, *rows[0])
    for k, row in enumerate(rows):
        twin.update(k * DT, *row)
        if twin.alarms:
            return k * DT - begin, twin.alarms[0].direction or "nothing"
    return np.inf, ""


def flown(kind: str, change: str, begin: float, rng: np.random.Generator, own: Mapping[str, float], seconds: float) -> list:
    """Rows of a run: commands [rpm, deg], readings of thrust and speed [N, rpm]. The change is in what acts or in what is
    read."""
    count, limits, model = round(seconds / DT), Limits(), rig_model()
    orders = commands.validation(int(rng.integers(2**31)), seconds, DT)
    omega, beta = orders["omega_ref"][:count].tolist(), orders["beta_ref"][:count].tolist()
    if kind == KINDS[2]:  # each is held for a minute
        held = np.repeat(rng.integers(0, count, 10), count // 10)
        omega, beta = (np.array(column)[held].tolist() for column in (omega, beta))
    times = np.cumsum(rng.uniform(1.0, 5.0, count // 200))
    wanted = rng.uniform(1.0, 10.0, len(times) + 1)[np.searchsorted(times, np.arange(count) * DT)].tolist()
    noise, rig, controller = _noise(rng, count).tolist(), Stepper(model, own), Stepper(CONTROLLER)
    extra, rows, acting = [u.start for u in model.inputs[2:]], [], (omega[0], beta[0])
    shown = rig.start([*acting, *extra])
    for k in range(len(omega)):
        new = change if k * DT >= begin else ""
        thrust = shown[0] * (1.4 if new == CHANGES[0] else 1.0) + (0.3 if new == CHANGES[3] else 0.0) + noise[k]
        if kind == KINDS[1]:
            if k == 0:
                controller.start([wanted[k], thrust])
            asked = controller.step([wanted[k], thrust], DT)
            acting = _slewed(asked, acting, limits)
        else:
            acting = omega[k], beta[k]
        off = 1.02 if new == CHANGES[2] else 1.0  # the rig's loop holds the speed that is read
        rows.append([*acting, thrust, shown[1], off])
        shown = rig.step([acting[0] / off, acting[1] + (0.5 if new == CHANGES[1] else 0.0), *extra], DT)
    speeds = tachometer(np.array([row[3] for row in rows])) * np.array([row[4] for row in rows])
    return [[*row[:3], speed] for row, speed in zip(rows, speeds.tolist(), strict=True)]


def _slewed(asked, acting, limits: Limits) -> tuple[float, float]:
    """The commands that act, within the limits and their rates."""
    ends = (limits.omega_min, limits.omega_max, limits.omega_slew), (limits.beta_min, limits.beta_max, limits.beta_slew)
    within = [min(max(value, low), high) for value, (low, high, _) in zip(asked, ends, strict=True)]
    moves = zip(within, acting, ends, strict=True)
    omega, beta = (min(max(value, was - rate * DT), was + rate * DT) for value, was, (_, _, rate) in moves)
    return omega, beta


def tachometer(omega: np.ndarray) -> np.ndarray:
    """A speed [rpm] as one mark a turn measures it: the mean of the last whole turn, held until the next."""
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (omega[1:] + omega[:-1]) / 60.0 * DT)])
    marks = np.interp(np.arange(int(turns[-1]) + 1), turns, np.arange(len(omega)) * DT)
    read = np.concatenate([omega[:1], 60.0 / np.diff(marks)])
    return read[np.floor(turns).astype(int)]


@cache
def _rig() -> Simulator:
    return Simulator(rig_model())


@cache
def _defaults() -> dict[str, float]:
    """Defaults of the parameters that differ from rig to rig."""
    return {p.name: p.default for p in rig_model().parameters if p.name in DRAWN}


def _noise(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Noise of the emulated load cell, with its tare's error."""
    cell = LoadCell(0.0, 1.0)
    kept = np.exp(-DT / cell.memory)
    drive = cell.slow * np.sqrt(1.0 - kept**2) * rng.standard_normal(rows)
    slow = lfilter([1.0], [1.0, -kept], drive, zi=[kept * cell.slow * rng.standard_normal()])[0]
    return cell.white * rng.standard_normal(rows) + slow + TARE * rng.standard_normal()


def _campaign(rng: np.random.Generator, own: dict[str, float], length: Length, seed: int) -> Campaign:
    """A campaign as by `vpp hil campaign`, with fewer samples a point of the static map."""

    def record(orders: Record, name: str) -> Record:
        inputs = {name: orders[name] for name in ("omega_ref", "beta_ref")}
        shown = _rig().simulate(own, inputs, np.full(len(orders) - 1, DT))
        return Record(
            {"time": orders.time, **inputs, "omega": shown[:, 1], "thrust": shown[:, 0] + _noise(rng, len(shown))}, name
        )

    def standing(at: list[tuple[float, float]], seconds: float) -> Record:
        rows = round(seconds / DT)
        omega, beta = np.repeat(np.array(at), rows, axis=0).T
        return Record({"time": np.arange(len(omega)) * DT, "omega_ref": omega, "beta_ref": beta}, "standing")

    points = []
    for at in commands.grid(length.points):
        shown = record(standing([at], 5.0), "point").part(slice(round(3.0 / DT), None))
        thrust = shown["thrust"]
        points.append((*at, shown["omega"].mean(), thrust.mean(), thrust.std(ddof=1), len(thrust)))
    steps = tuple(
        record(standing([one.before, *[one.after] * 5], 1.0), f"steps, run {k}")
        for k, one in enumerate(commands.steps(length.levels))
    )
    open_loop = commands.open_loop(seed, length.section, DT)
    return Campaign(
        Path("emulated"),
        StaticMap(*np.array(points).T, source="static"),
        steps,
        record(open_loop, "open_loop"),
        record(open_loop, "repeat"),
        record(commands.validation(seed, length.validation, DT), "validation"),
        rig=replace(commands.PAPERS),
    )
