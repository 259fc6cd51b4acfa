"""An emulator of rigs that shares no code with the project's kernel: campaigns of a rig of any size, with hidden effects.

It has its own physics (rig.c) and sensors: one mark a revolution with a 4 us timer, a thrust reading in counts of a converter
that is ranged for the rig's thrust, noise of several kinds (noise.py), and the rotor's vibration.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vpp_fmu.campaign import Campaign, StaticMap, write_static, write_steps
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import Record, write_record
from vpp_fmu.rig import infer_rig

from . import command_sequences
from .command_sequences import Clock, Commands
from .noise import LSB, SHARE, Noise
from .physics import PAPER, Frame, Run, in_time, pulses, run

STEP = 0.0001
"""Step of the rig's integration, s on the paper's rig: its error is below the resolution of 500 000 readings."""

JITTER = 0.0025
"""Revolutions at full speed by which a pulse of the mark comes early or late (25 us of the paper's 10 ms)."""

VIBRATION = (0.0003, 0.0035)
"""Range of the vibration over full thrust, at full speed, once a revolution."""

SPREAD = 0.15
"""Largest relative deviation of drawn sizes and settings from a standard size and from the paper's settings."""


@dataclass(frozen=True)
class Size:
    """Size of a rig: `speed` rpm, pitch from -`offset` over `span` deg, and `thrust` N are 1 in the physics; `slow` times
    slower than the paper's rig; a supply of `volt` V."""

    name: str
    speed: float
    span: float
    offset: float
    thrust: float
    slow: float
    volt: float

    def drawn(self, rng: np.random.Generator) -> "Size":
        """A rig of about this size."""
        drawn = {n: _round(getattr(self, n) * _about(rng)) for n in ("speed", "span", "offset", "thrust", "slow")}
        return replace(self, **drawn)

    @property
    def scales(self) -> dict[str, float]:
        """The scales of the rig's normalised map, as a rig.json declares them."""
        return {"omega_scale": self.speed, "beta_scale": self.span, "beta_offset": self.offset, "thrust_scale": self.thrust}

    def commands(self, w: np.ndarray, b: np.ndarray) -> Commands:
        """Normalised commands in rpm and deg, to as many digits as a person would write."""
        speed, pitch = np.multiply(w, self.speed), np.multiply(b, self.span) - self.offset
        return np.round(speed, _digits(self.speed)), np.round(pitch, _digits(self.span))

    def shares(self, speed: np.ndarray, pitch: np.ndarray) -> Commands:
        """Commands in rpm and deg, normalised."""
        return np.asarray(speed) / self.speed, (np.asarray(pitch) + self.offset) / self.span

    @property
    def declared(self) -> dict:
        """Contents of its rig.json, as `vpp_fmu.rig.read_rig` gives them."""
        (slowest, lowest), (fastest, highest) = (
            self.commands(*ends) for ends in zip(command_sequences.GRID_SPEED, command_sequences.GRID_PITCH, strict=True)
        )
        ranges = {"speed": (float(slowest), float(fastest)), "pitch": (float(lowest), float(highest))}
        return {"name": self.name, **ranges, "scales": self.scales}


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def _about(rng: np.random.Generator) -> float:
    return 1.0 + rng.uniform(-SPREAD, SPREAD)


def _digits(size: float) -> int:
    return 4 - int(np.log10(size))


SIZES = {
    "micro": Size("micro", 20000.0, 18.0, 3.0, 1.2, 0.3, 8.4),
    "paper": Size("paper", 6000.0, 15.0, 5.0, 15.0, 1.0, 25.2),
    "big": Size("big", 2500.0, 12.0, 2.0, 180.0, 3.0, 50.4),
}


def random_base(rng: np.random.Generator, slow: float) -> dict[str, float]:
    """Base settings about the paper's, `slow` times slower; which of a channel's lags comes first is random."""
    base = {name: value * _about(rng) for name, value in PAPER.items()}
    for channel in "wb":
        if rng.random() < 0.5:
            one, two = f"tau_{channel}1", f"tau_{channel}2"
            base[one], base[two] = base[two], base[one]
    return in_time(base, slow)


def random_vibration(rng: np.random.Generator) -> float:
    """Vibration over full thrust."""
    return float(np.exp(rng.uniform(*np.log(VIBRATION))))


@dataclass(frozen=True)
class Rig:
    """One rig. `settings`: of physics.py, base and options; `rate` Hz of its logger; `kind` and `level` of the noise, the level
    over SHARE; `extra(clock, speed, pitch)`: external force (rows,) over full thrust, which repeats with the normalised
    commands; `vibration` over full thrust; `locked`: whether a record starts on the rotor's mark.
    """

    settings: Mapping[str, float]
    size: Size = SIZES["paper"]
    rate: float = 250.0
    kind: str = "AR"
    level: float = 1.0
    extra: object = None
    vibration: float = 0.0
    locked: bool = True

    @property
    def clock(self) -> Clock:
        """The clock of its records."""
        return Clock(1.0 / self.rate, self.size.slow)

    @property
    def noise(self) -> Noise:
        """The noise of its thrust reading."""
        thrust = self.size.thrust
        return Noise(self.kind, SHARE * self.level * thrust, 1.0 / self.rate, self.size.slow, LSB * thrust)

    def frame(self, step: float = STEP) -> Frame:
        """Its integration and reading, at `step` s on the paper's rig."""
        return Frame(1.0 / self.rate, step * self.size.slow, self.size.slow, self.size.speed)

    def run(self, speed: np.ndarray, pitch: np.ndarray, step: float = STEP) -> Run:
        """The physics under commands in rpm and deg (rows,), as a perfect mark shows it."""
        return run(self.settings, self.frame(step), *self.size.shares(speed, pitch))

    def force(self, found: Run, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """Force on the load cell (rows,) N, without noise and without vibration."""
        force = self.size.thrust * found.load
        if self.extra is None:
            return force
        return force + self.size.thrust * self.extra(self.clock, *self.size.shares(speed, pitch))

    def record(self, rng: np.random.Generator, commands: Commands, name: str) -> Record:
        """A record of these normalised commands."""
        return self.observed(rng, commands, name)[0]

    def observed(self, rng: np.random.Generator, commands: Commands, name: str) -> tuple[Record, np.ndarray]:
        """(a record of these normalised commands, its true force (rows,) N, as `force`)."""
        speed, pitch = self.size.commands(*commands)
        rows, frame = len(speed), self.frame()
        jitter = JITTER * 60.0 / self.size.speed * rng.standard_normal(pulses(frame, rows))
        angle = 0.3 if self.locked else rng.random()
        found = run(self.settings, frame, *self.size.shares(speed, pitch), angle, jitter)
        shaking = self.vibration * self.size.thrust * found.omega**2 * np.sin(2.0 * np.pi * found.turn)
        force = self.force(found, speed, pitch)
        thrust = self.noise.reading(rng, force + shaking)
        columns = {"time": np.round(np.arange(rows) / self.rate, 9), "omega_ref": speed, "beta_ref": pitch}
        columns |= {"omega": found.shown, "thrust": thrust}
        if self.settings.get("discharge"):
            volt = self.size.volt * (1.0 - self.settings["discharge"] * columns["time"] / 100.0)
            columns["voltage"] = np.round(volt, 2)
        return Record(columns, name), force

    def truth(self) -> dict[str, float]:
        """The project's base parameters of this rig, each channel's slower lag first, as a fit reports them."""
        s = self.settings
        lags = {(u, c): sorted((s[f"tau_{c}1"], s[f"tau_{c}2"]), reverse=True) for u, c in (("omega", "w"), ("beta", "b"))}
        named = {f"tau_{u}_{k + 1}": tau for (u, _), pair in lags.items() for k, tau in enumerate(pair)}
        return named | {n: s[n] for n in ("c20", "c11", "c21", "c12", "c30")} | self.size.scales


@dataclass(frozen=True)
class Files:
    """Files of a campaign beside an open-loop record of so many `seconds`."""

    seconds: float = 90.0
    repeat: bool = True
    validation: bool = True
    static: bool = True
    steps: bool = True


VALIDATION = 2.0 / 3.0
"""Seconds of the validation record over the open-loop one's."""


def campaign(rig: Rig, rng: np.random.Generator, files: Files = Files()) -> Campaign:
    """A campaign measured on a rig."""
    orders = command_sequences.open_loop(rng, rig.clock, files.seconds)
    other = command_sequences.both(rng, rig.clock, VALIDATION * files.seconds)
    records = {"open_loop": rig.record(rng, orders, "open_loop"), "repeat": None, "validation": None}
    if files.repeat:
        records["repeat"] = rig.record(rng, orders, "repeat")
    if files.validation:
        records["validation"] = rig.record(rng, other, "validation")
    commanded = command_sequences.steps(rig.clock) if files.steps else ()
    steps = tuple(rig.record(rng, command, f"steps, run {k}") for k, command in enumerate(commanded))
    static = static_map(rig, rng) if files.static else None
    fitted = [r for n, r in records.items() if r is not None and n != "validation"] + list(steps)
    points = None if static is None else {n: getattr(static, n) for n in ("omega_ref", "beta_ref", "thrust")}
    return Campaign(Path("emulated"), static, steps, **records, rig=infer_rig(fitted, points, rig.size.declared))


def static_map(rig: Rig, rng: np.random.Generator) -> StaticMap:
    """Steady points, each the mean of 1.5 s after 1.5 s of rest, on the paper's rig."""
    rows, samples = [], rig.clock.rows(1.5)
    for w, b in command_sequences.grid():
        last = rig.record(rng, (np.full(2 * samples, w), np.full(2 * samples, b)), "").part(slice(samples, None))
        mean = last["omega"].mean(), last["thrust"].mean(), last["thrust"].std()
        rows.append((last["omega_ref"][0], last["beta_ref"][0], *mean, samples))
    return StaticMap(*np.array(rows, float).T, source="static")


def save(measured: Campaign, size: Size, path: Path) -> None:
    """Write a campaign as a folder that `vpp` accepts."""
    folder = OutputFolder(path)
    for name in ("open_loop", "repeat", "validation"):
        if (record := getattr(measured, name)) is not None:
            write_record(folder, f"{name}.csv", record)
    if measured.static is not None:
        write_static(folder, measured.static)
    if measured.steps:
        write_steps(folder, measured.steps)
    content = dict(size.declared)
    for name, unit in (("speed", "rpm"), ("pitch", "deg")):
        low, high = content[name]
        content[name] = {"min": low, "max": high, "unit": unit}
    folder.write("rig.json", json.dumps({"format": "vpp-rig/1", **content}, indent=2) + "\n")
