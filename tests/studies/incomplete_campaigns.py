"""Incomplete or unusual campaigns, of the project's own plant with noise, for rigs of three sizes.

The truth is the fine-tuned map in each rig's own scales. The files have only what a user's folder would have.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record, write_record

Columns = dict[str, np.ndarray]
Files = dict[str, Columns]
"""Columns by name, for each file by name."""


@dataclass(frozen=True)
class Size:
    """A rig: its `scales`, its lags over the paper's (`slowness`), `noise` of a thrust reading [N], readings a second."""

    scales: Scales
    slowness: float
    noise: float
    rate: float

    @property
    def truth(self) -> dict[str, float]:
        """Its parameters by name, each channel's slower lag first, as a fit writes them."""
        lags = {f"tau_{u}_{k + 1}": v for u in ("omega", "beta") for k, v in enumerate(sorted(_lags(u), reverse=True))}
        return FINE_TUNED | {n: v * self.slowness for n, v in lags.items()} | scale_parameters(self.scales)


def _lags(channel: str) -> list[float]:
    return [FINE_TUNED[f"tau_{channel}_{k}"] for k in (1, 2)]


def scale_parameters(scales: Scales) -> dict[str, float]:
    """The scales that are parameters of the plant."""
    return {n: v for n, v in asdict(scales).items() if n != "time_scale"}


SIZES = {
    "micro": Size(Scales(20000.0, 15.0, 5.0, 1.2, 0.2), 0.4, 0.008, 200.0),
    "paper": Size(PAPER, 1.0, 0.1, 125.0),
    "big": Size(Scales(2500.0, 15.0, 5.0, 180.0, 1.2), 2.5, 1.2, 100.0),
}

SECTION = 14.0
"""s of speed only, of pitch only, of both on the paper's rig: some forty lags."""

SHORTEST, LONGEST = 0.8, 5.0
"""Range of the hold of a level, in sums of the pitch's lags."""


def random_levels(size: Size, rng: np.random.Generator, rows: int, low: float, high: float) -> np.ndarray:
    """A command (rows,) that goes from level to level."""
    unit = sum(_lags("beta")) * size.slowness * size.rate
    holds = np.round(rng.uniform(SHORTEST, LONGEST, rows) * unit).astype(int)
    return np.repeat(rng.uniform(low, high, rows), np.maximum(holds, 1))[:rows]


def commanded(size: Size, rng: np.random.Generator, parts: str, pitch: tuple[float, float] = (-4.5, 9.5)) -> Columns:
    """Sections of commands, a letter each: w speed only, b pitch only, x both, - none."""
    rows = round(SECTION * size.slowness * size.rate)
    top, speeds, pitches = size.scales.omega_scale, [], []
    for part in parts:
        speeds.append(random_levels(size, rng, rows, 0.35 * top, 0.97 * top) if part in "wx" else np.full(rows, 0.7 * top))
        pitches.append(random_levels(size, rng, rows, *pitch) if part in "bx" else np.full(rows, 0.5 * sum(pitch)))
    speed, angle = np.round(np.concatenate(speeds), 1), np.round(np.concatenate(pitches), 3)
    return {"time": np.arange(len(speed)) / size.rate, "omega_ref": speed, "beta_ref": angle}


@cache
def _simulator(scales: Scales) -> Simulator:
    return Simulator(BASE.sized(scales))


def responded(size: Size, commands: Columns) -> np.ndarray:
    """(rows, 3): thrust, speed and pitch of the plant without noise."""
    return _simulator(size.scales).simulate(size.truth, commands, np.diff(commands["time"]))


def measured(size: Size, commands: Columns, rng: np.random.Generator, noise: float = 1.0) -> Columns:
    """The commands with new readings of the sensors; `noise` in units of the rig's own."""
    force, omega, _ = responded(size, commands).T
    shown = tachometer(commands["time"], omega, noise * JITTER * rng.standard_normal(REVOLUTIONS))
    return {**commands, "omega": shown, "thrust": force + noise * size.noise * rng.standard_normal(len(force))}


JITTER = 25e-6
"""s by which a pulse of the mark comes early or late."""

REVOLUTIONS = 200_000

STOPPED = 0.5
"""s without a pulse after which a tachometer shows 0."""


def tachometer(time: np.ndarray, omega: np.ndarray, late: np.ndarray) -> np.ndarray:
    """The mean speed (rows,) rpm over the last whole revolution of a rotor with one mark, held until the next pulse.

    `late` (revolutions,) s of each pulse. The timer ticks every 4 us.
    """
    turns = np.append(0.0, np.cumsum(0.5 * (omega[1:] + omega[:-1]) / 60.0 * np.diff(time)))
    marks = np.arange(np.ceil(turns[-1]) + 3.0) - 2.0  # two before the record, at the speed that it starts with
    turning = np.append(True, np.diff(turns) > 0.0)
    before = time[0] + np.minimum(marks, 0.0) * 60.0 / max(omega[0], 1e-3)
    pulse = np.where(marks < 0.0, before, np.interp(marks, turns[turning], time[turning]))
    pulse = np.round((pulse + late[: len(pulse)])[marks <= turns[-1]] / 4e-6) * 4e-6
    last = np.searchsorted(pulse, time, side="right") - 1
    shown = 60.0 / (pulse[np.maximum(last, 1)] - pulse[np.maximum(last, 1) - 1])
    return np.where(time - pulse[last] > STOPPED, 0.0, shown)


def steady(size: Size, rng: np.random.Generator, speeds, pitches) -> Columns:
    """A grid of steady points, means of 100 readings; `speeds` as shares of the highest."""
    grid = np.meshgrid(np.asarray(speeds, float) * size.scales.omega_scale, np.asarray(pitches, float), indexing="ij")
    omega, beta = (axis.ravel() for axis in grid)
    rows = [
        responded(size, {"omega_ref": np.full(2, w), "beta_ref": np.full(2, b), "time": np.array([0.0, 1.0])})[0, 0]
        for w, b in zip(omega, beta, strict=True)
    ]
    thrust = np.array(rows) + 0.1 * size.noise * rng.standard_normal(len(rows))
    full = np.ones(len(rows))
    columns = {"omega_ref": omega, "beta_ref": beta, "omega": omega, "thrust": thrust}
    return columns | {"thrust_std": size.noise * full, "samples": 100.0 * full}


def stepped(size: Size, rng: np.random.Generator) -> Columns:
    """Runs of one step each: four of the speed, four of the pitch."""
    top, seconds = size.scales.omega_scale, 4.0 * size.slowness
    rows, before = round(seconds * size.rate), round(0.1 * seconds * size.rate)
    moves = [((0.4, a), (4.0, 4.0)) for a in (0.6, 0.9)] + [((0.9, a), (4.0, 4.0)) for a in (0.6, 0.4)]
    moves += [((0.8, 0.8), (-4.0, b)) for b in (2.0, 9.0)] + [((0.8, 0.8), (9.0, b)) for b in (2.0, -4.0)]
    runs = []
    for number, (speeds, pitches) in enumerate(moves, start=1):
        levels = [np.repeat(pair, [before, rows - before]) for pair in (np.array(speeds) * top, pitches)]
        commands = {"time": np.arange(rows) / size.rate, "omega_ref": levels[0], "beta_ref": levels[1].astype(float)}
        runs.append({"run": np.full(rows, float(number)), **measured(size, commands, rng)})
    return {name: np.concatenate([run[name] for run in runs]) for name in runs[0]}


def whole(size: Size, rng: np.random.Generator, parts: str = "wbx") -> Files:
    """A complete campaign."""
    given = commanded(size, rng, parts)
    return {
        "static": steady(size, rng, np.linspace(0.35, 1.0, 5), np.linspace(-5.0, 10.0, 5)),
        "steps": stepped(size, rng),
        "open_loop": measured(size, given, rng),
        "repeat": measured(size, given, rng),
        "validation": measured(size, commanded(size, rng, "x"), rng),
    }


LONG = ("open_loop", "repeat", "validation")
"""A campaign's long records."""


def only(*names: str) -> Callable[[Files, Size, np.random.Generator], Files]:
    """Keep only these files."""
    return lambda files, size, rng: {n: c for n, c in files.items() if n in names}


def each(change: Callable[[Columns, Size, np.random.Generator], Columns], names=LONG):
    """A change to each of the long records."""
    return lambda files, size, rng: files | {n: change(files[n], size, rng) for n in names if n in files}


def recorded(parts: str, pitch=(-4.5, 9.5), seconds: float | None = None, **grid):
    """Other sections of commands in the long records, as long as `seconds`; a `grid` of steady points, or none."""

    def change(files, size, rng):
        given, other = (commanded(size, rng, parts, pitch) for _ in range(2))
        if seconds is not None:
            given = {n: c[: round(seconds * size.rate) + 1] for n, c in given.items()}
        found = {"open_loop": measured(size, given, rng), "repeat": measured(size, given, rng)}
        found["validation"] = measured(size, other, rng)
        return found | ({"static": steady(size, rng, **grid)} if grid else {})

    return change


def gridded(speeds, pitches):
    """Another grid of steady points."""
    return lambda files, size, rng: files | {"static": steady(size, rng, speeds, pitches)}


def one_move(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """Records with a single step of the speed."""
    rows, top = round(20.0 * size.slowness * size.rate), size.scales.omega_scale
    speed = np.where(np.arange(rows) < rows // 4, 0.5 * top, 0.9 * top)
    given = {"time": np.arange(rows) / size.rate, "omega_ref": speed, "beta_ref": np.full(rows, 3.0)}
    return {n: measured(size, given, rng) for n in ("open_loop", "repeat")}


def at_rest(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """Constant commands, with the rotor at standstill."""
    given = commanded(size, rng, "--")
    given["omega_ref"] = np.zeros(len(given["time"]))
    return {name: measured(size, given, rng) for name in ("open_loop", "repeat")}


def emptied(column: str, share: float):
    """Random cells without a value."""

    def change(columns, size, rng):
        return columns | {column: np.where(rng.random(len(columns[column])) < share, np.nan, columns[column])}

    return each(change)


def thrust(read: Callable[[np.ndarray, Size], np.ndarray]):
    """The long records of another load cell, which reads `read(thrust, size)`."""
    return each(lambda columns, size, rng: columns | {"thrust": read(columns["thrust"], size)})


def section_emptied(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """No thrust while only the pitch moves."""
    time = columns["time"] / (SECTION * size.slowness)
    return columns | {"thrust": np.where((time >= 1.0) & (time < 2.0), np.nan, columns["thrust"])}


def without(name: str):
    """Remove a column."""
    return each(lambda columns, size, rng: {n: c for n, c in columns.items() if n != name})


def with_gaps(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """Three gaps of 1.5 s."""
    time, end = columns["time"], columns["time"][-1]
    lost = np.any([(time > at) & (time < at + 1.5) for at in (0.2 * end, 0.5 * end, 0.8 * end)], axis=0)
    return {n: c[~lost] for n, c in columns.items()}


def uneven(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """Row intervals that vary by a factor of three."""
    found = dict(files)
    for name in ("open_loop", "validation"):
        step = rng.uniform(0.5, 1.5, len(files[name]["time"])) / size.rate
        time = np.round(np.append(0.0, np.cumsum(step[1:])), 6)
        found[name] = measured(size, files[name] | {"time": time}, rng)
        if name == "open_loop":
            found["repeat"] = measured(size, found[name], rng)
    return found


def sampled(rate: float, seconds: float):
    """All records at another rate."""

    def change(files, size, rng):
        other = Size(size.scales, size.slowness, size.noise, rate)
        kept = round(seconds * rate)
        found = whole(other, rng)
        return found | {n: {k: c[-kept:] if k != "time" else c[:kept] for k, c in found[n].items()} for n in LONG}

    return change


def mid_flight(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """The logger was switched on while the rig moved."""
    moved = np.flatnonzero(np.diff(columns["omega_ref"]) != 0.0)
    first = int(moved[2]) + max(1, round(0.05 * size.slowness * size.rate))
    return {n: c[first:] - (c[first] if n == "time" else 0.0) for n, c in columns.items()}


def powered(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """Additional columns with a battery's voltage and current."""
    rows = len(columns["time"])
    return columns | {"voltage": 24.0 - 0.5 * np.linspace(0.0, 1.0, rows), "current": 8.0 + rng.standard_normal(rows)}


def annotated(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """Additional unknown columns, one of them text."""
    rows = len(columns["time"])
    return columns | {"mood": np.full(rows, "calm", dtype=object), "temperature": np.full(rows, 21.5)}


def noiseless(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """The plant's own response to the precision of a file, without a repeat, which would be a copy."""
    found = {name: file for name, file in files.items() if name != "repeat"}
    for name in set(LONG) & set(found):
        found[name] = measured(size, files[name], rng, 0.0)
    exact = {n: files["static"][n] for n in ("omega_ref", "beta_ref")}
    thrust = [
        responded(size, {"time": np.arange(2.0), **{n: np.full(2, v) for n, v in zip(exact, point, strict=True)}})[0, 0]
        for point in zip(*exact.values(), strict=True)
    ]
    found["static"] = files["static"] | {"thrust": np.array(thrust), "thrust_std": np.zeros(len(thrust))}
    return found


def static_of_zeros(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """Steady points of a load cell that was not plugged in."""
    return files | {"static": files["static"] | {n: np.zeros(len(files["static"][n])) for n in ("thrust", "thrust_std")}}


def noisier_repeat(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """A repeat with four times the noise."""
    return files | {"repeat": measured(size, files["open_loop"], rng, 4.0)}


def from_standstill(columns: Columns, size: Size, rng: np.random.Generator) -> Columns:
    """The rotor is at standstill at the beginning and at the end."""
    rows = len(columns["time"])
    still = (np.arange(rows) < rows // 8) | (np.arange(rows) > 7 * rows // 8)
    return measured(size, columns | {"omega_ref": np.where(still, 0.0, columns["omega_ref"])}, rng)


def raw_stretches(seconds: float):
    """Steady points as raw samples, each `seconds` long, and nothing else."""

    def change(files, size, rng):
        speeds, pitches = np.meshgrid(np.linspace(0.4, 1.0, 3), np.linspace(-4.0, 9.0, 3))
        rows = round(seconds * size.rate)
        given = {"omega_ref": np.repeat(speeds.ravel() * size.scales.omega_scale, rows)}
        given["beta_ref"] = np.repeat(pitches.ravel(), rows)
        return {"static_raw": measured(size, {"time": np.arange(9 * rows) / size.rate, **given}, rng)}

    return change


def unstepped(files: Files, size: Size, rng: np.random.Generator) -> Files:
    """Runs of steps without a step."""
    return {
        "steps": files["steps"]
        | {n: np.full(len(files["steps"]["run"]), files["steps"][n][0]) for n in ("omega_ref", "beta_ref")}
    }


@dataclass(frozen=True)
class Case:
    """A campaign: the size of its rig, and the change to a complete campaign; `declared`: with a rig.json."""

    size: str
    change: Callable[[Files, Size, np.random.Generator], Files]
    declared: bool = True

    def write(self, folder: Path, seed: int = 0) -> None:
        """Write its files."""
        size, rng = SIZES[self.size], np.random.default_rng(seed)
        out = OutputFolder(folder)
        for name, columns in self.change(whole(size, rng), size, rng).items():
            write_record(out, f"{name}.csv", Record(columns, name))
        if self.declared:
            out.write("rig.json", declaration(size))


def declaration(size: Size) -> str:
    """A rig.json that names the rig's scales, so that its map is compared in its own coefficients."""
    return json.dumps({"format": "vpp-rig/1", "scales": scale_parameters(size.scales)})


CASES: Mapping[str, Case] = {
    "nothing missing": Case("micro", lambda files, size, rng: files),
    "nothing missing, rig not declared": Case("big", lambda files, size, rng: files, declared=False),
    "fixed pitch": Case("micro", recorded("wwx", (4.0, 4.0), speeds=np.linspace(0.35, 1.0, 8), pitches=[4.0]), declared=False),
    "fixed speed": Case("paper", recorded("bbb")),
    "one move only": Case("big", one_move),
    "no move at all": Case("paper", recorded("--")),
    "no move, no speed column": Case("big", lambda *campaign: without("omega")(recorded("-")(*campaign), *campaign[1:])),
    "no move of a rotor at rest": Case("paper", at_rest),
    "no move beside map and steps": Case("micro", lambda files, *more: files | recorded("-")(files, *more)),
    "static map only": Case("micro", only("static")),
    "steps only": Case("paper", only("steps")),
    "static map and steps only": Case("big", only("static", "steps")),
    "raw steady samples only": Case("micro", raw_stretches(6.0)),
    "raw samples that never rest": Case("paper", raw_stretches(2.0)),
    "steps without a step": Case("paper", unstepped),
    "validation only": Case("micro", only("validation")),
    "repeat only": Case("paper", only("repeat")),
    "open loop only": Case("big", only("open_loop")),
    "thrust 10 % empty": Case("paper", emptied("thrust", 0.1)),
    "thrust 50 % empty": Case("micro", emptied("thrust", 0.5)),
    "thrust of a section empty": Case("big", each(section_emptied, ("open_loop", "repeat"))),
    "speed 30 % empty": Case("paper", emptied("omega", 0.3)),
    "speed all empty": Case("big", emptied("omega", 1.1)),
    "speed almost empty": Case("micro", emptied("omega", 0.999)),
    "thrust read every 30th row": Case(
        "micro", thrust(lambda read, size: np.where(np.arange(len(read)) % 30 == 0, read, np.nan))
    ),
    "no speed column": Case("micro", without("omega")),
    "static at one pitch": Case("paper", gridded(np.linspace(0.35, 1.0, 9), [3.0])),
    "static at one speed": Case("micro", gridded([0.8], np.linspace(-5.0, 10.0, 9))),
    "static of two points": Case("big", gridded([0.5, 0.9], [5.0])),
    "static of zeros": Case("micro", static_of_zeros),
    "static from standstill": Case("micro", gridded(np.linspace(0.0, 1.0, 5), np.linspace(-5.0, 10.0, 5))),
    "static of one point": Case("paper", gridded([0.5], [5.0])),
    "pitch 12 to 25 deg": Case(
        "paper",
        recorded("wbx", (12.0, 25.0), speeds=np.linspace(0.35, 1.0, 5), pitches=np.linspace(12.0, 25.0, 5)),
        declared=False,
    ),
    "static 12 to 25, records -5 to 10 deg": Case("big", gridded(np.linspace(0.35, 1.0, 5), np.linspace(12.0, 25.0, 5))),
    "record of 2 s": Case("micro", recorded("x", seconds=2.0)),
    "record of 1 s": Case("paper", recorded("x", seconds=1.0)),
    "record of 10 s": Case("big", recorded("x", seconds=10.0)),
    "gaps": Case("paper", each(with_gaps)),
    "uneven sampling": Case("micro", uneven),
    "100 Hz": Case("paper", sampled(100.0, 40.0)),
    "1 kHz": Case("micro", sampled(1000.0, 12.0)),
    "quantised thrust": Case("paper", thrust(lambda read, size: 4.0 * size.noise * np.round(read / (4.0 * size.noise)))),
    "saturated load cell": Case("big", thrust(lambda read, size: np.minimum(read, 0.4 * size.scales.thrust_scale))),
    "starts mid-flight": Case("micro", each(mid_flight)),
    "from standstill": Case("paper", each(from_standstill)),
    "voltage and current": Case("paper", each(powered)),
    "unknown columns": Case("micro", each(annotated)),
    "no noise": Case("paper", noiseless),
    "huge offset": Case("big", thrust(lambda read, size: read + 3.0 * size.scales.thrust_scale)),
    "dead load cell": Case("micro", thrust(lambda read, size: np.full(len(read), 1.0))),
    "repeat of other noise": Case("big", noisier_repeat),
}
"""Cases by their peculiarity."""
