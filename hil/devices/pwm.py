"""Pulse outputs (ESC, LAC) through the kernel's PWM files, /sys/class/pwm (Documentation/driver-api/pwm.rst).

A pulse outlives the process that set it, and a disabled output has no defined level: so an output is never disabled, it
idles. Rules of the kernel: a period before a pulse, no pulse above the period, polarity changes only while disabled.
"""

import contextlib
import errno
import os
from os import pwrite
from pathlib import Path

from hil.devices.clock import Clock
from hil.safety.faults import DeviceFault, FaultKind

ROOT = Path("/sys/class/pwm")
_PERMISSION = 1.0
"""Time for udev to give access to the files of an exported channel [s]."""


def find_chip(device: str, root: str | os.PathLike = ROOT) -> Path:
    """The folder of the chip whose device is `device` ("fe20c000.pwm" on the Pi 4): chips' numbers change with the kernel.

    DeviceFault NOT_READY names the existing devices.
    """
    found = {}
    for chip in sorted(Path(root).glob("pwmchip*")):
        found[(chip / "device").resolve().name] = chip
    if device not in found:
        there = ", ".join(sorted(found)) or "none (is the overlay in config.txt?)"
        raise DeviceFault("pwm", FaultKind.NOT_READY, f"{root}: found {there}, expected the PWM chip {device}")
    return found[device]


class PwmChannel:
    """Output `index` of the chip in the folder `chip`; `name` is the device behind it, for messages.

    DeviceFault: NOT_READY from `open`, OUTPUT_LOST from `set`.
    """

    def __init__(self, chip: str | os.PathLike, index: int, name: str, clock: Clock):
        self.folder, self.name = Path(chip) / f"pwm{index}", name
        self._chip, self._index, self._clock = Path(chip), index, clock
        self._duty: int | None = None
        self._shown: list[int] = []
        self._pulse = 0
        self._period = self.idle_ns = 0
        self.counters = {"pulses": 0}

    @property
    def duty_file(self) -> Path:
        """The file of the pulse [ns], written by this class, and by the supervisor if it must stop the rotor."""
        return self.folder / "duty_cycle"

    def open(self, period: float, pulse: float) -> None:
        """Export, set the period [s] and the idle pulse [s], enable. An output that already runs stays enabled."""
        self._period, self.idle_ns = _nanoseconds(period), _nanoseconds(pulse)
        try:
            self._export()
            running = self._read("enable") == "1"
            # In this order the pulse never exceeds the period.
            order = [("duty_cycle", self.idle_ns), ("period", self._period)]
            if not running or int(self._read("period")) < self._period:
                order.reverse()
            for file, value in order:
                self._write(file, value)
            if self._read("polarity") != "normal":
                self._write("polarity", "normal")
            self._duty = os.open(self.duty_file, os.O_RDWR)
            self._pulse = self.idle_ns
            if not running:
                self._write("enable", 1)
            self._shown = [os.open(self.folder / name, os.O_RDONLY) for name in ("enable", "period", "polarity")]
        except (OSError, ValueError) as error:
            self._let_go()
            detail = f"{self.folder}: found {getattr(error, 'strerror', None) or error}, expected an output"
            raise DeviceFault(self.name, FaultKind.NOT_READY, detail) from error

    def set(self, pulse: float) -> None:
        """Set the pulse [s]."""
        try:
            wanted = _nanoseconds(pulse)
            pwrite(self._duty, b"%d\n" % wanted, 0)
        except (OSError, ValueError, OverflowError, TypeError) as error:  # refused by the kernel; NaN; infinite; not open
            found = getattr(error, "strerror", None) or error
            raise DeviceFault(self.name, FaultKind.OUTPUT_LOST, f"pulse of {pulse} s: found {found}, expected none") from error
        self._pulse = wanted
        self.counters["pulses"] += 1

    def verify(self) -> None:
        """Check that the kernel still shows the values set: enable, period, polarity, pulse; DeviceFault OUTPUT_LOST if not.

        It takes some microseconds: four reads of open files.
        """
        try:
            found = [os.pread(file, 64, 0).split(b"\n", 1)[0] for file in (*self._shown, self._duty)]
        except (OSError, TypeError) as error:  # gone; not open
            detail = f"{self.folder}: found {getattr(error, 'strerror', None) or 'it closed'}, expected an open output"
            raise DeviceFault(self.name, FaultKind.OUTPUT_LOST, detail) from error
        enabled, period, polarity, pulse = (text.decode(errors="replace").strip() for text in found)
        if (enabled, period, polarity, pulse) != ("1", str(self._period), "normal", str(self._pulse)):
            shown = f"enable {enabled}, period {period} ns, polarity {polarity}, pulse {pulse} ns"
            detail = f"found {shown}, expected 1, {self._period} ns, normal, {self._pulse} ns: somebody else writes here"
            raise DeviceFault(self.name, FaultKind.OUTPUT_LOST, detail)

    def restore(self) -> None:
        """Set idle pulse, period and enable again, after another process has changed them."""
        for file, value in (("duty_cycle", self.idle_ns), ("period", self._period), ("enable", 1)):
            with contextlib.suppress(OSError):
                self._write(file, value)
        self._pulse = self.idle_ns

    def close(self) -> None:
        """Leave the output enabled at its idle pulse, and close its files. Harmless if it is not open."""
        if self._duty is not None:
            try:
                self.set(1e-9 * self.idle_ns)
            finally:
                self._let_go()

    def _let_go(self) -> None:
        if self._duty is not None:
            for file in (self._duty, *self._shown):
                os.close(file)
            self._duty, self._shown = None, []

    def _export(self) -> None:
        if not self.folder.exists():
            try:
                self._store(self._chip / "export", f"{self._index}")
            except OSError as error:
                if error.errno != errno.EBUSY:  # exported meanwhile, by someone else
                    raise
        deadline = self._clock.now() + _PERMISSION
        files = [self.folder / name for name in ("period", "duty_cycle", "polarity", "enable")]
        while not all(_permitted(file) for file in files):
            if self._clock.now() >= deadline:
                raise PermissionError(errno.EACCES, "no permission to write (udev rule, group gpio?)")
            self._clock.wait_until(self._clock.now() + 0.01)

    def _read(self, file: str) -> str:
        return (self.folder / file).read_text().strip()

    def _write(self, file: str, value: object) -> None:
        self._store(self.folder / file, str(value))

    @staticmethod
    def _store(path: Path, text: str) -> None:
        file = os.open(path, os.O_WRONLY)
        try:
            pwrite(file, text.encode() + b"\n", 0)
        finally:
            os.close(file)


def _permitted(file: Path) -> bool:
    try:
        os.close(os.open(file, os.O_RDWR))
    except (PermissionError, FileNotFoundError):
        return False
    return True


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9)
