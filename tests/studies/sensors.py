"""Speed sensors, and a logger that writes its rows early or late, for the emulated rig.

The rig moves on a grid of FINE (rig.c). A sensor turns that motion into a value at any time; the logger reads it once a row, or
as the mean over a row.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from vpp_fmu.record import Record

from .command_sequences import Commands
from .physics import Frame, run
from .rig import STEP, Rig

FINE = 0.0005
"""s of the grid of the motion, which is linear between its points. Rows of the study are whole multiples of it."""

TIMER = 4e-6
"""s: a tick of the timer that times the pulses of a mark."""

RESOLUTION = 1.0
"""rpm of an encoder and of telemetry."""

BEFORE, AFTER = 1.0, 4
"""s at rest before a record, for the pulses before its first row; rows that are simulated after its last one."""


@dataclass(frozen=True)
class Motion:
    """`time` s, evenly spaced, `omega` rpm and `turn` revolutions, each (n,); linear between the times."""

    time: np.ndarray
    omega: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True)
class Mark:
    """`marks` a revolution: the mean speed between the last two pulses, held until the next one."""

    marks: int

    def shows(self, rng: np.random.Generator, motion: Motion, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(speed rpm, age s of the middle of its averaging window), at any times s."""
        turn = self.marks * motion.turn
        pulses = np.interp(np.arange(np.ceil(turn[0]), np.floor(turn[-1]) + 1.0), turn, motion.time)
        last = np.searchsorted(pulses, at, side="right") - 1
        ticks = np.round(pulses / TIMER)
        speed = 60.0 / (self.marks * TIMER * (ticks[last] - ticks[last - 1]))
        return np.round(speed), at - 0.5 * (pulses[last] + pulses[last - 1])


@dataclass(frozen=True)
class Encoder:
    """The instantaneous speed."""

    def shows(self, rng: np.random.Generator, motion: Motion, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Mark.shows`."""
        return RESOLUTION * np.round(np.interp(at, motion.time, motion.omega) / RESOLUTION), np.zeros_like(at)


@dataclass(frozen=True)
class Telemetry:
    """Speed after a first-order filter of `time_constant` s; a new value every `refresh` s, whatever the rows, then held."""

    time_constant: float
    refresh: float

    def shows(self, rng: np.random.Generator, motion: Motion, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Mark.shows`; the filter adds its time constant to the age."""
        # Exact for an input that is linear between the grid's points.
        ratio = (motion.time[1] - motion.time[0]) / self.time_constant
        keep = np.exp(-ratio)
        mean = (1.0 - keep) / ratio
        filtered = lfilter([1.0 - mean, mean - keep], [1.0, -keep], motion.omega, zi=mean * motion.omega[:1])[0]
        phase = self.refresh * rng.random()
        came = phase + self.refresh * np.floor((at - phase) / self.refresh)
        speed = RESOLUTION * np.round(np.interp(came, motion.time, filtered) / RESOLUTION)
        return speed, at - came + self.time_constant


Sensor = Mark | Encoder | Telemetry


@dataclass(frozen=True)
class Logger:
    """Times of the readings of a row, in rows. `lag`: time before the row's command acts; the contract's is 0.

    Readings that are taken after their command acts, and commands that are logged late, make the same rows: `lag` below 0,
    readings lead. Commands that are logged early have a lag above 0. `span`: length of the centred mean of a reading.
    """

    lag: float = 0.0
    span: float = 0.0

    def times(self, rows: int, row: float) -> np.ndarray:
        """(rows, k) s: a reading is the mean over its k instants."""
        many = max(1, round(self.span * row / FINE))
        within = self.span * ((np.arange(many) + 0.5) / many - 0.5)
        return row * (np.arange(rows)[:, None] - self.lag + within)


@dataclass(frozen=True)
class Reading:
    """Commands [rpm, deg], and readings without noise: `omega` rpm, `force` N, and the `age` s of the speed relative to the
    force; each (rows,)."""

    speed: np.ndarray
    pitch: np.ndarray
    omega: np.ndarray
    force: np.ndarray
    age: np.ndarray

    @property
    def delay(self) -> float:
        """Mean age of speed over the rows with a new value, s."""
        new = np.diff(self.omega, prepend=np.nan) != 0.0
        return float(self.age[new].mean())


@dataclass(frozen=True)
class LoggedRig(Rig):
    """A rig with a `logger` of its records and a `sensor` of its speed."""

    sensor: Sensor = Encoder()
    logger: Logger = Logger()

    def read(self, rng: np.random.Generator, commands: Commands) -> Reading:
        """Readings while these normalised commands (rows,) are sent, one a row."""
        speed, pitch = self.size.commands(*commands)
        row = 1.0 / self.rate
        fine = round(row / FINE)
        sent = (np.repeat(np.append(c, np.repeat(c[-1:], AFTER)), fine) for c in (speed, pitch))
        frame = Frame(row / fine, STEP * self.size.slow, self.size.slow, self.size.speed)
        found = run(self.settings, frame, *self.size.shares(*sent), rng.random())
        time, rest = frame.row * np.arange(len(found.omega)), np.arange(-round(BEFORE / frame.row), 0) * frame.row
        omega, turn = self.size.speed * found.omega, found.turn
        before = np.full(len(rest), omega[0]), turn[0] + rest * omega[0] / 60.0
        motion = Motion(*map(np.concatenate, ((rest, time), (before[0], omega), (before[1], turn))))
        at = self.logger.times(len(speed), row)
        shown, age = self.sensor.shows(rng, motion, at)
        force = np.interp(at, time, self.size.thrust * found.load)
        return Reading(speed, pitch, *(each.mean(axis=1) for each in (shown, force, age)))

    def observed(self, rng: np.random.Generator, commands: Commands, name: str) -> tuple[Record, np.ndarray]:
        """(a record of these normalised commands, its force (rows,) N without noise)."""
        read = self.read(rng, commands)
        columns = {"time": np.round(np.arange(len(read.speed)) / self.rate, 9), "omega_ref": read.speed, "beta_ref": read.pitch}
        columns |= {"omega": np.round(read.omega, 2), "thrust": self.noise.reading(rng, read.force)}
        return Record(columns, name), read.force
