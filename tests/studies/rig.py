"""An emulator of the rig that shares no code with the project's kernel: one campaign of one rig, with what is hidden in it.

Its own physics (rig.c), its own sensors: one mark a revolution with a 4 us timer, a thrust reading in counts of the ADC, noise
in the colour of the shared records, and the rotor's own vibration.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.record import Record

from . import orders
from .physics import PAPER, ROW, Run, run

WHITE, SLOW, MEMORY = 0.12, 0.047, 0.13
"""N, N, s: white noise of a thrust reading, and a slow part whose correlation falls to 1 / e in MEMORY."""

LSB = 0.003
"""N, of the ADC."""

JITTER = 25e-6
"""s, by which a pulse of the mark comes early or late."""

VIBRATION = (0.02, 0.05)
"""N at full speed, once a revolution."""

FULL_SPEED, SPAN, OFFSET, FULL_THRUST, FULL_VOLTAGE = 6000.0, 15.0, 5.0, 15.0, 25.2
"""rpm, deg, deg, N, V: what is 1 in the physics."""


@dataclass(frozen=True)
class Rig:
    """One rig. `settings`: of physics.py, base and options; `extra(rows of run, w_ref, b_ref, rng)`: force (rows,) N that
    comes from outside the physics and repeats with the commands; `vibration` N."""

    settings: Mapping[str, float]
    extra: object = None
    vibration: float = 0.0

    def run(self, speed: np.ndarray, pitch: np.ndarray, jitter: np.ndarray | None = None) -> Run:
        """The physics under commands in rpm and deg (rows,)."""
        return run(self.settings, speed / FULL_SPEED, (pitch + OFFSET) / SPAN, jitter)

    def force(self, found: Run, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """Force on the load cell (rows,) N, without noise and vibration."""
        force = FULL_THRUST * found.load
        return force if self.extra is None else force + self.extra(speed, pitch)

    def record(self, rng: np.random.Generator, speed: np.ndarray, pitch: np.ndarray, name: str) -> Record:
        """What a record of these commands holds."""
        rows = len(speed)
        found = self.run(speed, pitch, JITTER * rng.standard_normal(20000))
        shaking = self.vibration * found.omega**2 * np.sin(2 * np.pi * found.turn)
        thrust = self.force(found, speed, pitch) + shaking + noise(rng, rows)
        columns = {"time": np.round(ROW * np.arange(rows), 9), "omega_ref": speed, "beta_ref": pitch}
        columns |= {"omega": found.shown, "thrust": LSB * np.round(thrust / LSB)}
        if self.settings.get("discharge"):
            volt = FULL_VOLTAGE * (1.0 - self.settings["discharge"] * columns["time"] / 100.0)
            columns["voltage"] = np.round(volt, 2)
        return Record(columns, name)


def random_base(rng: np.random.Generator) -> dict[str, float]:
    """Base settings within 15 % of the paper's; which of a channel's lags comes first is random."""
    base = {name: value * (1.0 + rng.uniform(-0.15, 0.15)) for name, value in PAPER.items()}
    for channel in "wb":
        if rng.random() < 0.5:
            one, two = f"tau_{channel}1", f"tau_{channel}2"
            base[one], base[two] = base[two], base[one]
    return base


def random_vibration(rng: np.random.Generator) -> float:
    """N at full speed."""
    return rng.uniform(*VIBRATION)


def noise(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Noise of a thrust reading (rows,) N."""
    rho = np.exp(-ROW / MEMORY)
    drive = np.sqrt(1.0 - rho**2) * rng.standard_normal(rows + 500)
    return WHITE * rng.standard_normal(rows) + SLOW * lfilter([1.0], [1.0, -rho], drive)[500:]


def campaign(rig: Rig, rng: np.random.Generator) -> Campaign:
    """A whole campaign: static map, steps, open loop and its repeat, validation."""
    told, other = orders.open_loop(rng), orders.validation(rng)
    records = {"open_loop": rig.record(rng, *told, "open_loop"), "repeat": rig.record(rng, *told, "repeat")}
    records["validation"] = rig.record(rng, *other, "validation")
    steps = tuple(rig.record(rng, *command, f"steps, run {k}") for k, command in enumerate(orders.steps()))
    return Campaign(Path("emulated"), static_map(rig, rng), steps, **records)


def static_map(rig: Rig, rng: np.random.Generator, samples: int = 375) -> StaticMap:
    """Steady points, 10 x 10, each the mean of 1.5 s after 1.5 s of rest."""
    rows = []
    for speed in np.linspace(2000.0, 6000.0, 10):
        for pitch in np.linspace(-10.0, 10.0, 10):
            record = rig.record(rng, np.full(2 * samples, np.round(speed, 2)), np.full(2 * samples, np.round(pitch, 3)), "")
            last = record.part(slice(samples, None))
            mean = last["omega"].mean(), last["thrust"].mean(), last["thrust"].std()
            rows.append((speed, pitch, *mean, samples))
    return StaticMap(*np.array(rows, float).T, source="static")
