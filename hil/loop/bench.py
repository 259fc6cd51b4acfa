"""The devices of one rig, emulated or real, with the same interface."""

import contextlib
import fcntl
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.devices.ads1115 import Ads1115
from hil.devices.calibration import Calibration
from hil.devices.clock import Clock, MonotonicClock
from hil.devices.pwm import PwmChannel, find_chip
from hil.devices.supply import Supply
from hil.devices.tachometer import Port, Tachometer
from hil.safety.faults import DeviceFault, FaultKind
from vpp_fmu.errors import BadInput

ESC, LAC = 0, 1
"""Outputs of the PWM chip (GPIO 12 and 13, hil/README.md)."""

ADDRESS = 0x48
"""I2C address of the thrust's ADC."""

ESC_BOOT = 4.0
"""Time from an ESC's power-up at the idle pulse to its ready tone, s."""


@dataclass
class Bench:
    """Devices that are ready to use. `emulated`: how, empty for the real rig; `lock`: descriptor of the rig's lock; `ends`:
    clean-up calls, in reverse order; `esc_boot` [s]: from the ESC's power-up to its readiness; `hand`: sets the force [N] on an
    emulated stand, thrust positive; `supply`: sensors of the motor's supply, None if none are wired."""

    clock: Clock
    calibration: Calibration
    adc: Ads1115
    tachometer: Tachometer
    esc: PwmChannel
    lac: PwmChannel
    emulated: str = ""
    ends: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    lock: int = -1
    esc_boot: float = 0.0
    hand: Callable[[float], None] | None = None
    supply: Supply | None = None

    def open(self) -> "Bench":
        """Set the devices up: first the lock, then the outputs with the idle pulse. DeviceFault NOT_READY names a device that
        is not ready."""
        calibration = self.calibration
        try:
            self.lock = locked(self.esc.folder.parent)
            self.ends.callback(os.close, self.lock)
            self.esc.open(calibration.esc_period, calibration.esc_idle)
            self.ends.callback(self.esc.close)
            self.lac.open(calibration.lac_period, calibration.lac_idle)
            self.ends.callback(self.lac.close)
            self.adc.start()
            self.ends.callback(self.adc.close)
            if self.supply:
                self.supply.start()
                self.ends.callback(self.supply.close)
            self.tachometer.hello()
            self.ends.callback(self.tachometer.close)
        except BaseException:
            self.ends.close()
            raise
        return self

    @property
    def outputs(self) -> list[tuple[str, float]]:
        """(duty file, idle pulse [s]) of each output, for the supervisor."""
        pulses = (self.esc, self.calibration.esc_idle), (self.lac, self.calibration.lac_idle)
        return [(str(channel.duty_file), pulse) for channel, pulse in pulses]

    @property
    def counters(self) -> dict[str, Mapping[str, int]]:
        devices = (self.adc, self.tachometer, self.esc, self.lac, *((self.supply,) if self.supply else ()))
        return {device.name: dict(device.counters) for device in devices}

    def close(self) -> None:
        """Write the idle pulse, and close all devices."""
        self.ends.close()


@dataclass(frozen=True)
class Wiring:
    """Where a rig's devices are: the I2C bus, the tachometer's port, the PWM chip's device, and its outputs."""

    bus: int | str = 1
    port: str | Callable[[], Port] = "/dev/ttyACM0"
    pwm: str = "fe20c000.pwm"
    channels: tuple[int, int] = (ESC, LAC)


def real_bench(calibration: Calibration, wiring: Wiring) -> Bench:
    """The rig on this machine. DeviceFault NOT_READY if a device is missing."""
    return opened(calibration, MonotonicClock(), wiring, find_chip(wiring.pwm), esc_boot=ESC_BOOT)


def opened(calibration: Calibration, clock: Clock, wiring: Wiring, chip: Path, **more: Any) -> Bench:
    """The devices of a rig whose PWM chip is the folder `chip`, ready to use. `more`: further fields of the bench."""
    c, bus, (esc, lac) = calibration, wiring.bus, wiring.channels
    return Bench(
        clock,
        calibration,
        Ads1115(bus, ADDRESS, c.channel, c.full_scale, c.rate, clock=clock),
        Tachometer(wiring.port, clock),
        PwmChannel(chip, esc, "esc", clock),
        PwmChannel(chip, lac, "lac", clock),
        supply=Supply(bus, c.supply_address, c.supply, clock=clock) if c.supply else None,
        **more,
    ).open()


def check_limits(path: str, calibration: Calibration, beta_min: float, beta_max: float) -> None:
    """BadInput if the limits allow a pitch for which the calibration has no pulse."""
    for name, value in (("beta_min", beta_min), ("beta_max", beta_max)):
        if not calibration.pitch_min <= value <= calibration.pitch_max:
            allowed = f"{calibration.pitch_min:g} to {calibration.pitch_max:g} deg, as the calibration has it"
            raise BadInput(path, name, f"{value:g} deg", allowed)


def locked(chip: Path) -> int:
    """Take an exclusive lock on the rig with the PWM chip in the folder `chip`; returns the descriptor that holds it.

    The kernel releases it when the last process with the descriptor closes it or ends, also by a crash: no file is left behind.
    DeviceFault NOT_READY names the process that holds it.
    """
    descriptor = os.open(chip.resolve(), os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        holder = _holder(os.fstat(descriptor))
        os.close(descriptor)
        raise DeviceFault("rig", FaultKind.NOT_READY, f"found in use by {holder}, expected none; nothing written") from error
    return descriptor


def _holder(at: os.stat_result) -> str:
    """The process that holds a lock on the file, in words, from the kernel's list."""
    wanted = f"{os.major(at.st_dev):02x}:{os.minor(at.st_dev):02x}:{at.st_ino}"
    try:
        for line in Path("/proc/locks").read_text().splitlines():
            cells = line.split()
            if wanted in cells and "FLOCK" in cells and cells[4].isdecimal() and int(cells[4]) > 0:
                words = Path(f"/proc/{cells[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f"process {cells[4]} ({words.strip()[:80]})"
    except OSError:
        pass
    return "another process"
