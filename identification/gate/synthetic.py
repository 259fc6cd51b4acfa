"""Synthetic campaigns, simulated by the model with noise and sensors: for a template, and to test the gate."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vpp_fmu.campaign import Campaign, StaticMap, write_static, write_steps
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record, write_record

TICK = 4e-6
"""Resolution of the tachometer's timer, s."""

JITTER = 3e-4
"""Standard deviation of the angle of a pulse, turns."""

SAMPLES = 400
"""Number of readings of a steady point."""


@dataclass(frozen=True)
class SyntheticRig:
    """A simulated rig that generates campaigns. Commands have ranges `speed` [rpm] and `pitch` [deg] (least, greatest) and a
    sampling period of `row` s. Each level is held for a time within `hold` [s]. Sections of speed, of pitch and of both last
    `section` s each. `values`: the model's parameters; `noise` N of a reading, rounded to `digit` N."""

    scales: Scales
    speed: tuple[float, float]
    pitch: tuple[float, float]
    row: float
    hold: tuple[float, float]
    section: float
    noise: float
    digit: float
    values: Mapping[str, float] = field(default_factory=dict)
    grid: int = 6

    def campaign(self, rng: np.random.Generator, folder: Path) -> Campaign:
        """The whole campaign, as if read from `folder`."""
        orders = self.orders(rng)
        commands = {"open_loop": orders, "repeat": orders, "validation": self.orders(rng)}
        records = {name: self.record(own, rng, f"{name}.csv") for name, own in commands.items()}
        steps = tuple(self.record(order, rng, f"steps.csv, run {k}") for k, order in enumerate(self.single_steps()))
        return Campaign(folder, self.steady(rng), steps, **records)

    def orders(self, rng: np.random.Generator) -> Mapping[str, np.ndarray]:
        """Commands of a long record: speed moves, pitch moves, both move. A command at rest has its middle value."""
        rows = round(self.section / self.row)
        rest = [np.full(rows, round(float(np.mean(ends)), 2)) for ends in (self.speed, self.pitch)]
        speed = [self._levels(rng, rows, self.speed), rest[0], self._levels(rng, rows, self.speed)]
        pitch = [rest[1], self._levels(rng, rows, self.pitch), self._levels(rng, rows, self.pitch)]
        return {"omega_ref": np.concatenate(speed), "beta_ref": np.concatenate(pitch)}

    def _levels(self, rng: np.random.Generator, rows: int, ends: tuple[float, float]) -> np.ndarray:
        most = int(rows * self.row / self.hold[0]) + 2
        holds = np.maximum(1, np.round(rng.uniform(*self.hold, most) / self.row)).astype(int)
        return np.repeat(np.round(rng.uniform(*ends, most), 2), holds)[:rows]

    def single_steps(self) -> list[Mapping[str, np.ndarray]]:
        """Steps up and down, of speed and of pitch, the other at its middle: 0.2 of the longest `hold` before, 1.5 after the
        step."""
        before, after = (max(10, round(share * self.hold[1] / self.row)) for share in (0.2, 1.5))
        found = []
        for own, other in (("omega_ref", "beta_ref"), ("beta_ref", "omega_ref")):
            ends = self.speed if own == "omega_ref" else self.pitch
            level = float(np.mean(self.pitch if own == "omega_ref" else self.speed))
            part = [ends[0] + share * (ends[1] - ends[0]) for share in (0.2, 0.8)]
            for low, high in (part, part[::-1]):
                stepped = np.append(np.full(before, round(low, 2)), np.full(after, round(high, 2)))
                found.append({own: stepped, other: np.full(before + after, round(level, 2))})
        return found

    def record(self, orders: Mapping[str, np.ndarray], rng: np.random.Generator, name: str) -> Record:
        """The sensors' readings under the commands `orders`."""
        rows = len(orders["omega_ref"])
        time = np.round(self.row * np.arange(rows), 9)
        model = BASE.sized(self.scales)
        outputs = Simulator(model).simulate(self.values, orders, np.diff(time))
        thrust = self.digit * np.round((outputs[:, 0] + self.noise * rng.standard_normal(rows)) / self.digit)
        columns = {"time": time, "omega_ref": orders["omega_ref"], "beta_ref": orders["beta_ref"]}
        return Record(columns | {"omega": one_mark(time, outputs[:, 1], rng), "thrust": thrust}, name)

    def steady(self, rng: np.random.Generator) -> StaticMap:
        """Steady points on a grid over both ranges."""
        axes = (np.linspace(*ends, self.grid) for ends in (self.speed, self.pitch))
        speed, pitch = (m.ravel() for m in np.meshgrid(*axes))
        orders = {"omega_ref": np.round(speed, 2), "beta_ref": np.round(pitch, 3)}
        model, settled = BASE.sized(self.scales), []
        for omega, beta in zip(*orders.values(), strict=True):
            held = {"omega_ref": np.full(2, omega), "beta_ref": np.full(2, beta)}
            settled.append(Simulator(model).simulate(self.values, held, np.ones(1))[-1, 0])
        thrust = np.array(settled) + self.noise / np.sqrt(SAMPLES) * rng.standard_normal(len(settled))
        spread, count = np.full(len(thrust), self.noise), np.full(len(thrust), float(SAMPLES))
        return StaticMap(orders["omega_ref"], orders["beta_ref"], orders["omega_ref"], thrust, spread, count, "static.csv")


def one_mark(time: np.ndarray, omega: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n,) rpm: readings of a tachometer with one mark. They are means over the last whole turn, in ticks of the timer, held
    until the next pulse; before the second pulse, the first speed."""
    turns = np.append(0.0, np.cumsum(0.5 * (omega[1:] + omega[:-1]) / 60.0 * np.diff(time)))
    marks = np.arange(1, int(turns[-1]) + 1)
    pulses = np.interp(marks + JITTER * rng.standard_normal(len(marks)), turns, time)
    if len(pulses) < 2:
        return np.full(len(time), omega[0])
    shown = 60.0 / (TICK * np.maximum(1.0, np.round(np.diff(pulses) / TICK)))
    last = np.searchsorted(pulses, time, side="right") - 2
    return np.where(last >= 0, shown[np.maximum(last, 0)], omega[0])


def write_campaign(folder: OutputFolder, campaign: Campaign) -> None:
    if campaign.static is not None:
        write_static(folder, campaign.static)
    if campaign.steps:
        write_steps(folder, campaign.steps)
    for name in ("open_loop", "repeat", "validation"):
        if (record := getattr(campaign, name)) is not None:
            write_record(folder, f"{name}.csv", record)


def varied(rig: SyntheticRig, rng: np.random.Generator, by: float) -> SyntheticRig:
    """A rig whose lags and map coefficients differ from this one's by at most a share `by`."""
    values = BASE.sized(rig.scales).values(rig.values)
    moved = {n: v * (1.0 + rng.uniform(-by, by)) for n, v in values.items() if n.startswith(("tau_", "c"))}
    return replace(rig, values={**rig.values, **moved})
