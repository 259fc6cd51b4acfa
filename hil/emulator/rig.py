"""The emulated rig: the physics and the devices behind the buses, in one folder of small files."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import files
from pathlib import Path

from hil.devices.calibration import Calibration
from hil.devices.clock import Clock, VirtualClock
from hil.devices.supply import Input
from hil.devices.tachometer import Port
from hil.emulator import i2c, pwm_tree
from hil.emulator.i2c import Ads1115Chip
from hil.emulator.pwm_tree import PwmTree
from hil.emulator.serial_line import MemoryLine, SerialLine
from hil.emulator.shared import SharedNumbers
from hil.emulator.uno import Uno
from hil.emulator.world import LoadCell, World
from hil.loop.bench import ESC, LAC, Bench, Wiring, opened
from hil.physics.pitch_actuator import ACTUATOR
from hil.physics.rig_model import library, powertrain
from vpp_fmu.errors import BadInput, near
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.rig import PAPERS_SIZE
from vpp_fmu.rig import Rig as Ranges

ZERO_SHIFT = 120.0
"""Counts by which the load cell's zero has moved since the calibration: only a tare finds it."""

BUS, SECOND, LINE, PORT, PULSES, SHOWN, HAND = "i2c", "i2c-second", "line", "tty", "pwm", "shown", "hand"
"""Names in the folder."""

CALIBRATION = files("hil.emulator") / "calibration.json"

POWERED = {
    "voltage": Input("AIN0", 0.0, 11.0),
    "current": Input("AIN1", -25.0, 50.0),
    "torque": Input("AIN2", -1.0, 1.0),
}
"""Optional sensors of the emulated rig: a divider of 100 and 10 kOhm, a Hall sensor, a torque cell of 1 N.m/V."""

LARGEST_SPEED = 6900.0
"""Highest speed, rpm, of a rig that the emulated one can represent; it is the paper's, with a rotor of 6000 rpm."""

FORCES = PAPER.thrust_scale / PAPERS_SIZE, PAPER.thrust_scale * PAPERS_SIZE
"""Thrust scales of such a rig, N."""

_RANGES = {p.name: p.default for p in ACTUATOR.parameters}
TRAVEL = _RANGES["beta_low"], _RANGES["beta_high"]
"""Travel of the rod as blade pitch, deg."""

BYSTANDER, PULLED = ("relay", "omega", "thrust"), ("force",)


NEAREST = {
    "lac_command_delay": "pitch_delay",
    "lac_pulse_average": "pitch_delay",
    "lac_command_deadband": "pitch_command_deadband",
    "rod_speed_limit": "pitch_speed_limits",
    "lac_stop_band": "pitch_stop_band",
    "rod_stuck": "pitch_stall_latch",
    "linkage_play": "pitch_backlash",
    "supply_droop": "supply_sag",
    "blade_torsion": "map_terms",
    "motor_heating": "speed_saturation",
    "esc_freewheel": "speed_asymmetry",
    "room_recirculation": "recirculation",
    "stand_swing": "stand_resonance",
    "rotor_imbalance": "rotor_vibration",
    "amplifier_low_pass": "sensor_lag",
    "load_cell_gain": "sensor_gain",
    "load_cell_drift": "sensor_drift",
}
"""Hidden effects by name, and the effect of the model's library that acts most alike; the others have none."""


@dataclass(frozen=True)
class EmulatedRig:
    """The emulated rig: changes to the physics' defaults, hidden effects by name, and the seed of all random numbers.

    `lingers`: time, s, for which a rig in real time continues after its parent has ended, as a real one does.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    hidden: tuple[str, ...] = ()
    seed: int = 0
    lingers: float = 0.0


def with_effects(words: Iterable[str], seed: int = 0) -> EmulatedRig:
    """The emulated rig with hidden effects, each NAME, NAME=SIZE or NAME.PARAMETER=SIZE. BadInput."""
    hidden = [_hidden(text) for text in words]
    return EmulatedRig(
        {name: value for _, values in hidden for name, value in values.items()}, tuple(name for name, _ in hidden), seed
    )


def effects_to_hide() -> list[str]:
    """The effects of --hide, one a line: sizes with their ranges, and the nearest effect of the model's library."""
    lines = []
    for effect in (e for e in library(commanded=False) if e.off is not None):
        sizes = []
        for p in effect.parameters:
            size, unit = effect.probe.get(p.name, p.default), "" if p.unit == "1" else f" {p.unit}"
            sizes.append(f"{p.name}={size:g} ({p.minimum:g} to {p.maximum:g}{unit})")
        nearest = NEAREST.get(effect.name) or "none"
        lines.append(f"{effect.name}: {effect.description}; {', '.join(sizes)}; nearest in vpp effects: {nearest}")
    return lines


def _hidden(text: str) -> tuple[str, dict[str, float]]:
    known = {e.name: e for e in library(commanded=False) if e.off is not None}
    left, _, size = text.partition("=")
    name, _, parameter = left.partition(".")
    if name not in known:
        close = near(name, known)
        hint = "" if close else "--hide ? for sizes"
        raise BadInput("command line", "--hide", name, f"one of {', '.join(known)}{close}", hint)
    effect = known[name]
    values = dict(effect.probe)
    if size or parameter:
        chosen = next((p for p in effect.parameters if p.name == (parameter or effect.parameters[0].name)), None)
        if chosen is None:
            raise BadInput("command line", "--hide", left, f"one of {', '.join(f'{name}.{p.name}' for p in effect.parameters)}")
        values[chosen.name] = _size(left, size, chosen)
    return name, {f"{name}.{own}": value for own, value in values.items()}


def _size(name: str, text: str, parameter) -> float:
    allowed = f"a number from {parameter.minimum:g} to {parameter.maximum:g} {parameter.unit}".removesuffix(" 1")
    try:
        value = float(text)
    except ValueError as error:
        raise BadInput("command line", f"--hide {name}", text or "no size", allowed) from error
    if not parameter.minimum <= value <= parameter.maximum:
        raise BadInput("command line", f"--hide {name}", text, allowed)
    return value


def calibrated_for(calibration: Calibration, ranges: Ranges) -> Calibration:
    """The emulated rig's calibration for the `ranges` of a rig: its pitch table is stretched to a wider range of pitch.
    BadInput if the emulated rig cannot represent that rig."""
    (slowest, fastest), (low, high), force = ranges.speed, ranges.pitch, ranges.scales.thrust_scale
    sized = FORCES[0] <= force <= FORCES[1]
    if not (sized and fastest <= LARGEST_SPEED and TRAVEL[0] <= low <= high <= TRAVEL[1]):
        found = f"emulated, for a rig of {slowest:.6g} to {fastest:.6g} rpm, {low:.4g} to {high:.4g} deg, {force:.3g} N"
        allowed = (
            f"a rig that the emulated one, the paper's, can be: to {LARGEST_SPEED:g} rpm, {TRAVEL[0]:g} to {TRAVEL[1]:g} deg, "
            f"{FORCES[0]:g} to {FORCES[1]:g} N"
        )
        narrower = "--rig emulated RIG.json, which declares narrower ranges, or " if sized else ""
        model = "vpp cosim, which closes the loop with the model of --parameters"
        raise BadInput("command line", "--rig", found, allowed, f"{narrower}{model}; --rig real RIG.json is the rig itself")
    least, most = min(low, calibration.pitch_min), max(high, calibration.pitch_max)
    if (least, most) == (calibration.pitch_min, calibration.pitch_max):
        return calibration
    size = (most - least) / (calibration.pitch_max - calibration.pitch_min)
    pitches = tuple(least + size * (pitch - calibration.pitch_min) for pitch in calibration.pitches)
    return replace(calibration, pitches=pitches, pitch_min=least, pitch_max=most)


class Emulation:
    """The far end of every bus. `serve(t)` emulates the rig up to time t [s]; `line` carries the tachometer's bytes.

    `shown`: true values that any process may read: whether the relay is closed, speed [rpm], thrust [N]; no device reads them.
    Any process may set the force [N] of a hand or a weight on the stand. `calibration`: the rig's true one.
    """

    def __init__(self, rig: EmulatedRig, calibration: Calibration, folder: Path, start: float):
        per_count = calibration.full_scale / 0x8000
        zero = per_count * (calibration.zero + ZERO_SHIFT)
        cell = LoadCell(zero, per_count / calibration.newton_per_count)
        tree = self._outputs = PwmTree(folder / PULSES)
        self._calibration, self._powered = calibration, False
        self.world = World(powertrain(rig.hidden), rig.parameters, self._driven, cell, rig.seed, start)
        bus = i2c.open_bus(folder / BUS, create=True)
        self._chips, self._files = [Ads1115Chip(bus, self.world.volts, int(calibration.channel[3]))], [bus, tree]
        if calibration.supply:
            second = i2c.open_bus(folder / SECOND, create=True)
            read = {int(w.channel[3]): partial(self._supply, name, w) for name, w in calibration.supply.items()}
            first = next(iter(read))
            self._chips.append(Ads1115Chip(second, read[first], first, others=read))
            self._files.append(second)
        self.board = Uno(self.world.pulses)
        self.line: SerialLine | None = None
        self.shown = SharedNumbers(folder / SHOWN, BYSTANDER, create=True)
        self._hand = SharedNumbers(folder / HAND, PULLED, create=True)

    def serve(self, t: float) -> None:
        self._powered = self.board.watch(t)
        self.world.pulled = self._hand["force"]
        self.world.advance(t)
        self.shown["relay"], self.shown["omega"], self.shown["thrust"] = self._powered, self.world.omega, self.world.thrust
        for far_end in (*self._chips, self.line):
            far_end.serve(t)

    def close(self) -> None:
        for file in (self.line, self.shown, self._hand, *self._files):
            file.close()

    def _supply(self, name: str, wired: Input, t: float) -> float:
        """Voltage on an input of the second ADC, without noise, which is less than a count."""
        return wired.volts(getattr(self.world, name))

    def _driven(self) -> tuple[float, float]:
        """Commands of the pulses: (throttle [1], pitch [deg]). Without a signal the ESC stops and the pitch is at rest."""
        esc, lac, calibration = self._outputs.duty(ESC), self._outputs.duty(LAC), self._calibration
        throttle = calibration.throttle(esc) if esc is not None and self._powered else 0.0
        return throttle, calibration.rest_pitch if lac is None else calibration.pitch(lac)


@contextlib.contextmanager
def folder() -> Iterable[Path]:
    """A folder for the emulated rig's files, in memory (/dev/shm) if possible."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="vpp-hil-", dir=place) as name:
        yield Path(name)


def virtual_bench(rig: EmulatedRig, calibration: Calibration, truth: Calibration | None = None) -> Bench:
    """An emulated rig in this process on a virtual clock: the same every time, and as fast as it can be computed. `truth`: its
    true calibration, if it differs from the one that the drivers use."""
    ends, clock = contextlib.ExitStack(), VirtualClock()
    at = ends.enter_context(folder())
    emulation = Emulation(rig, truth or calibration, at, clock.now())
    line = emulation.line = MemoryLine(emulation.board, at / LINE, clock, rig.seed)
    ends.callback(emulation.close)
    clock.listeners.append(emulation.serve)
    return bench_in(at, clock, calibration, truth or calibration, line.open_port, "in virtual time", ends)


def bench_in(
    at: Path,
    clock: Clock,
    calibration: Calibration,
    truth: Calibration,
    port: str | Callable[[], Port],
    emulated: str,
    ends: contextlib.ExitStack,
) -> Bench:
    """The devices of the emulated rig in the folder `at`, ready to use; `truth` as in `virtual_bench`."""
    ends.enter_context(i2c.attached(at / BUS, clock, {truth.supply_address: at / SECOND} if truth.supply else {}))
    hand = ends.enter_context(contextlib.closing(SharedNumbers(at / HAND, PULLED)))
    chip = at / PULSES / "pwmchip0"
    with pwm_tree.attached(at / PULSES):
        further = {"emulated": emulated, "ends": ends, "hand": partial(hand.__setitem__, "force")}
        return opened(calibration, clock, Wiring(str(at / BUS), port), chip, **further)
