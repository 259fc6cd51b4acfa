"""python -m tests.studies twin: the delay at which the rig's twin detects a change, and its rate of false alarms.

Emulated rigs of the paper's size, each slightly different (`hil.physics`, its noise and the tare's), are measured by campaigns
of three lengths and identified as by `vpp identify`; the twin and its band are those of `vpp hil run --twin`. A change begins
BEGIN s into a run of random steps. False alarms are counted over hours of random steps, of the controller's own commands under
random set-points, and of constant set-points; each run of RUN s starts anew.

The physics, the loop and the twin's model are compiled and run in virtual time, since 100 h through the emulated buses would
take 7 h of a core; the unchanged twin then gets the blocks of half a second. `--rigs` runs go through the unchanged buses,
drivers and loop, too.

Aims: no more than one false alarm in 100 h, and no change missed after a campaign of the paper's length.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from hil import commands
from hil.calibration import read_calibration
from hil.emulator.rig import CALIBRATION
from hil.emulator.rig import EmulatedRig as Emulated
from hil.emulator.world import LoadCell
from hil.physics.rig_model import rig_model
from hil.run import run_on_rig
from hil.safety.limits import Limits
from hil.session import Setup
from hil.twin.band import Band, read_band
from hil.twin.twin import BLOCK, Block, Twin
from identification.identify import identify
from identification.workers import spread
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.native.simulator import Simulator
from vpp_fmu.plants import KernelController, KernelPlant, Sample
from vpp_fmu.record import Record
from vpp_fmu.structured import as_json

DT, BEGIN, RUN, WATCHED = 0.004, 20.0, 600.0, 300.0
"""s: a tick; begin of a change; a run for false alarms; time within which a change must be detected."""

ROWS = round(BLOCK / DT)
REST = 2000.0, 0.0
"""rpm, deg: commands at the start of a closed loop."""
TARE = 0.006
"""N: standard deviation of a tare's error, the noise's mean over 4 s."""
SPREAD = 0.1
"""Largest relative deviation of a rig's parameters from the emulated rig's."""
DRAWN = ("inertia", "kp_lac", "lift", "induced", "resistance")


class Length(NamedTuple):
    """Length of a campaign: points a side of its static map, levels of its steps, s of an open-loop section and of the
    validation."""

    name: str
    points: int
    levels: int
    section: float
    validation: float


LENGTHS = Length("the paper's", 10, 5, 30.0, 60.0), Length("half of it", 7, 3, 15.0, 30.0), Length("short", 5, 1, 8.0, 15.0)

CHANGES = ("thrust x 0.9", "pitch +0.5 deg", "pitch +1 deg", "drift 0.01 N/s", "stuck rod")
KINDS = ("random steps", "closed loop", "standing set-points")


class Known(NamedTuple):
    """A rig's own parameters; the values, band and standard deviations from its campaign, and that campaign's length."""

    own: dict[str, float]
    values: dict[str, float]
    band: Band
    length: str
    std: Mapping[str, float] = MappingProxyType({})


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="of each change (default: %(default)s)")
    parser.add_argument("--hours", type=int, default=100, metavar="H", help="for false alarms (default: %(default)s)")
    parser.add_argument("--twins", type=int, default=24, metavar="N", help="rigs, each with a campaign (default: %(default)s)")
    parser.add_argument("--rigs", type=int, default=6, metavar="N", help="runs of 60 s through buses (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="side by side (default: %(default)s)")
    options = parser.parse_args(arguments)
    first, workers = options.first_seed, options.workers
    known = spread(identified, range(first, first + options.twins), workers, what="campaigns")
    print(__doc__.split("\n\n")[-1].strip())
    _show_bands(known)
    at = range(first, first + options.seeds)
    found = spread(partial(detected, known=known), at, workers, what="changes")
    _show_detected(known, at, found)
    pieces = spread(partial(alarms, known=known), range(first, first + options.hours), workers, what="hours")
    _show_alarms(pieces)
    if options.rigs:
        whole = spread(partial(through_buses, known=known), range(first, first + options.rigs), workers, what="rigs")
        _show_whole(whole)


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
        return Known(own, dict(found.parameters.values), read_band(path), length.name, std)


def detected(seed: int, known: list[Known]) -> list[float]:
    """s from each change's beginning to the alarm; NaN: none within WATCHED, negative: the alarm came before."""
    one, found = known[seed % len(known)], []
    for k, change in enumerate(CHANGES):
        rng = np.random.default_rng([seed, 2, k])
        orders = commands.validation(int(rng.integers(2**31)), BEGIN + WATCHED, DT)
        thrust = _changed(change, rng, one.own, orders)
        when = watched(one, orders["omega_ref"], orders["beta_ref"], thrust)[0]
        found.append(when - BEGIN)
    return found


@threadpool_limits.wrap(limits=1)
def alarms(hour: int, known: list[Known]) -> tuple[str, str, int, float]:
    """(kind of commands, campaign's length, alarms, hours watched) of an hour in which nothing changes."""
    one, kind = known[hour % len(known)], KINDS[hour // len(LENGTHS) % len(KINDS)]
    count, seconds = 0, 0.0
    for k in range(round(3600.0 / RUN)):
        rng = np.random.default_rng([hour, 3, k])
        if kind == "closed loop":
            omega, beta, thrust, _ = _loop(rng, one.own)
        else:
            omega, beta = _orders(kind, rng)
            thrust = _read(rng, _true(one.own, omega, beta))
        when = watched(one, omega, beta, thrust)[0]
        count, seconds = count + np.isfinite(when), seconds + min(RUN, when if np.isfinite(when) else RUN)
    return kind, one.length, int(count), seconds / 3600.0


def through_buses(seed: int, known: list[Known]) -> tuple[str, float | None]:
    """(change, time of the alarm [s]) of a closed loop on the complete emulated rig, in virtual time."""
    one, change = known[seed % len(known)], ("nothing", "thrust x 0.9")[seed // len(LENGTHS) % 2]
    rng = np.random.default_rng([seed, 4])
    hidden = {"load_cell_gain.gain": 0.9} if change != "nothing" else {}
    emulated = Emulated(one.own | hidden, ("load_cell_gain",) if hidden else (), seed)
    setup = Setup(read_calibration(str(CALIBRATION)), Limits(), emulated, virtual=True)
    time = np.arange(0.0, 61.0, 3.0)
    profile = Record({"time": time, "thrust_set": rng.uniform(1.5, 10.0, len(time))}, "drawn")
    twin = Twin(KernelPlant(plant(), one.values), one.band)
    with tempfile.TemporaryDirectory() as folder:
        run = run_on_rig(setup, KernelController(), profile, Path(folder), twin=twin)
    rows = np.flatnonzero(run.log["alarm"] > 0.5)
    loop = np.flatnonzero(np.isfinite(run.log["omega_wanted"]))
    return change, float(run.log.time[rows[0]] - run.log.time[loop[0]]) if len(rows) else None


def watched(one: Known, omega: np.ndarray, beta: np.ndarray, thrust: np.ndarray) -> tuple[float, str]:
    """(time of the twin's alarm [s], inf if there is none; the cause that it names) for commands and readings (rows,), settled
    on the first commands."""
    model = _plant().simulate(one.values, {"omega_ref": omega, "beta_ref": beta}, np.full(len(omega) - 1, DT))
    twin = Twin(KernelPlant(plant(), one.values), one.band)
    count = (len(model) - 1) // ROWS
    shown = model[1 : 1 + count * ROWS].reshape(count, ROWS, 3)
    since = np.concatenate([model[: count * ROWS : ROWS, None], shown], axis=1)
    residual = (thrust - model[:, 0])[1 : 1 + count * ROWS].reshape(count, ROWS)
    columns = residual.mean(axis=1), residual.var(axis=1, ddof=1), shown[:, :, 0].mean(axis=1)
    last = np.arange(1, count + 1) * ROWS - 1
    twin.start(0.0, float(omega[0]), float(beta[0]))
    blocks = zip(
        zip(omega[last].tolist(), beta[last].tolist(), strict=True),
        *(column.tolist() for column in columns),
        *(map(Sample._make, ends.tolist()) for ends in (since.min(axis=1), since.max(axis=1))),
        strict=True,
    )
    for k, block in enumerate(blocks, 1):
        twin.decide(k * BLOCK, Block(*block))
        if twin.alarmed:
            return k * BLOCK, twin.cause
    return float("inf"), ""


@cache
def _rig(hidden: tuple[str, ...] = ()) -> Simulator:
    return Simulator(rig_model(hidden))


@cache
def _plant() -> Simulator:
    return Simulator(plant())


@cache
def _defaults() -> dict[str, float]:
    """Defaults of the parameters that differ from rig to rig."""
    return {p.name: p.default for p in rig_model().parameters if p.name in DRAWN}


def _true(own: dict[str, float], omega: np.ndarray, beta: np.ndarray, hidden: tuple[str, ...] = ()) -> np.ndarray:
    return _rig(hidden).simulate(own, {"omega_ref": omega, "beta_ref": beta}, np.full(len(omega) - 1, DT))[:, 0]


def _noise(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Noise of the emulated load cell, with its tare's error."""
    cell = LoadCell(0.0, 1.0)
    kept = np.exp(-DT / cell.memory)
    drive = cell.slow * np.sqrt(1.0 - kept**2) * rng.standard_normal(rows)
    slow = lfilter([1.0], [1.0, -kept], drive, zi=[kept * cell.slow * rng.standard_normal()])[0]
    return cell.white * rng.standard_normal(rows) + slow + TARE * rng.standard_normal()


def _read(rng: np.random.Generator, thrust: np.ndarray) -> np.ndarray:
    return thrust + _noise(rng, len(thrust))


def _changed(change: str, rng: np.random.Generator, own: dict[str, float], orders: Record) -> np.ndarray:
    """Thrust readings of a rig with a change at BEGIN."""
    omega, beta, after = orders["omega_ref"], orders["beta_ref"], orders.time >= BEGIN
    if change == "stuck rod":
        return _read(rng, _true(own | {"rod_stuck.after": BEGIN}, omega, beta, ("rod_stuck",)))
    if change.startswith("pitch"):
        beta = beta + after * float(change.split()[1])
    thrust = _true(own, omega, beta)
    if change.startswith("thrust"):
        thrust = thrust * np.where(after, 0.9, 1.0)
    if change.startswith("drift"):
        thrust = thrust + 0.01 * np.maximum(orders.time - BEGIN, 0.0)
    return _read(rng, thrust)


def _orders(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    seed = int(rng.integers(2**31))
    orders = commands.validation(seed, RUN, DT)
    if kind == "random steps":
        return orders["omega_ref"], orders["beta_ref"]
    rows = np.repeat(rng.integers(0, len(orders), 10), len(orders) // 10)  # each is held for a minute
    return orders["omega_ref"][rows], orders["beta_ref"][rows]


def _loop(rng: np.random.Generator, own: dict[str, float]) -> tuple[np.ndarray, ...]:
    """Commands of the controller, the thrust that it reads and the speed, under set-points that change every 1 to 5 s."""
    rows = round(RUN / DT)
    times = np.cumsum(rng.uniform(1.0, 5.0, rows // 200))
    wanted = rng.uniform(1.0, 10.0, len(times) + 1)[np.searchsorted(times, np.arange(rows) * DT)]
    noise, loop = _noise(rng, rows), _closed()
    sets = loop.vectors(own, {}, {})
    shown = loop.rows(sets, Course(wanted, noise, DT, 15.0, REST))[1]
    # The reading of a row precedes its commands: the first row is at rest, the others are one later.
    omega, beta = (np.concatenate([[at], column]) for at, column in zip(REST, shown[:, :2].T, strict=True))
    thrust, speed = (np.concatenate([shown[:1, k], shown[:, k]]) for k in (2, 3))
    return omega, beta, thrust + np.concatenate([noise[:1], noise]), speed


@cache
def _closed() -> ClosedLoop:
    return ClosedLoop(rig_model())


def _campaign(rng: np.random.Generator, own: dict[str, float], length: Length, seed: int) -> Campaign:
    """A campaign as by `vpp hil campaign`, with fewer samples a point of the static map."""

    def record(orders: Record, name: str) -> Record:
        inputs = {name: orders[name] for name in ("omega_ref", "beta_ref")}
        shown = _rig().simulate(own, inputs, np.full(len(orders) - 1, DT))
        return Record({"time": orders.time, **inputs, "omega": shown[:, 1], "thrust": _read(rng, shown[:, 0])}, name)

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


def _show_bands(known: list[Known]) -> None:
    print(f"\n{'campaign':14} {'rigs':>5} {'noise [N]':>10} {'steady [N]':>11} {'moving':>7} {'freedom':>8} (medians)")
    for length in LENGTHS:
        bands = [one.band for one in known if one.length == length.name]
        if bands:
            n, s, m, f = (np.median([getattr(b, name) for b in bands]) for name in ("noise", "steady", "moving", "freedom"))
            print(f"{length.name:14} {len(bands):5} {n:10.3f} {s:11.3f} {m:7.3f} {f:8.0f}")


def _show_detected(known: list[Known], seeds: range, found: list[list[float]]) -> None:
    print(f"\nchanges at {BEGIN:g} s of random steps: s to the alarm; missed within {WATCHED:g} s; alarms before the change")
    print(f"{'campaign':14} {'change':16} {'runs':>5} {'median':>7} {'95 %':>6} {'missed':>7} {'before':>7}")
    lengths = np.array([known[seed % len(known)].length for seed in seeds])
    for name in ("all", *(length.name for length in LENGTHS)):
        rows = np.array(found)[(lengths == name) | (name == "all")]
        for change, times in zip(CHANGES, rows.T, strict=True) if len(rows) else ():
            right = times[times >= 0.0]
            median, late = (np.quantile(right, q, method="higher") if len(right) else np.nan for q in (0.5, 0.95))
            missed, before = int(np.sum(np.isinf(right))), int(np.sum(times < 0.0))
            print(f"{name:14} {change:16} {len(times):5} {_s(median):>7} {_s(late):>6} {missed:7} {before:7}")


def _s(seconds: float) -> str:
    return f"{seconds:.1f}" if np.isfinite(seconds) else "-"


def _show_alarms(pieces: list[tuple[str, str, int, float]]) -> None:
    counts, hours = Counter(), Counter()
    for kind, length, count, watched_for in pieces:
        for name in (kind, length, "all"):
            counts[name] += count
            hours[name] += watched_for
    print("\nfalse alarms while nothing changes")
    for name in (*KINDS, *(length.name for length in LENGTHS), "all"):
        print(f"{name:20} {counts[name]:4} in {hours[name]:6.1f} h")


def _show_whole(found: list[tuple[str, float | None]]) -> None:
    print("\nthrough the buses, closed loop, 60 s each")
    for change in ("nothing", "thrust x 0.9"):
        times = [when for what, when in found if what == change]
        text = ", ".join("none" if when is None else f"{when:.1f} s" for when in times)
        print(f"{change:14} {len(times)} runs, alarms: {text}")
