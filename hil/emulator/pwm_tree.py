"""The kernel's PWM files, emulated: ordinary files that hold what sysfs would show, and the kernel's rules on writes.

`attached` applies the rules at the driver's system call, so a refusal is the OSError that the kernel gives. Other processes
that write a file, as the supervisor does, also change the outputs, as on the rig, but without the rules.
"""

import contextlib
import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.devices import pwm as driver
from hil.emulator.shared import refusal

DEVICE = "fe20c000.pwm"
"""The Pi 4's PWM controller."""
CHANNELS = 2


class PwmTree:
    """The tree below `folder`, created if it does not exist: `pwmchipN` with its device link and the Pi's channels."""

    def __init__(self, folder: str | os.PathLike, chip: int = 0, device: str = DEVICE):
        self.root = Path(folder)
        self.chip = self.root / f"pwmchip{chip}"
        self._last, self._files = [0.0] * CHANNELS, {}
        if not self.chip.exists():
            self.chip.mkdir(parents=True)
            (self.root / "devices" / device).mkdir(parents=True)
            (self.chip / "device").symlink_to(Path("..", "devices", device))
            (self.chip / "npwm").write_text(f"{CHANNELS}\n")
            for name in ("export", "unexport"):
                (self.chip / name).write_text("")

    def duty(self, channel: int) -> float | None:
        """The pulse on the output [s]; None while it is disabled or has no valid period."""
        files = self._files.get(channel) or self._look(channel)
        if not files:
            return None
        enabled, period, duty = (_first_line(os.pread(file, 64, 0)) for file in files)
        if enabled != b"1" or not period.isdigit() or int(period) == 0:
            return None
        if duty.isdigit() and int(duty) <= int(period):  # else: being written at this moment, or refused by a kernel
            self._last[channel] = 1e-9 * int(duty)
        return self._last[channel]

    def close(self) -> None:
        """Close the files, which are kept."""
        for files in self._files.values():
            for file in files:
                os.close(file)
        self._files.clear()

    def _look(self, channel: int) -> list[int]:
        """Files of the channel, once it is exported."""
        folder = self.chip / f"pwm{channel}"
        if (folder / "polarity").exists():  # the last file that an export creates
            self._files[channel] = [os.open(folder / name, os.O_RDONLY) for name in ("enable", "period", "duty_cycle")]
        return self._files.get(channel, [])


@contextlib.contextmanager
def attached(folder: str | os.PathLike, refuse: Callable[[str], bool] = lambda file: False) -> Iterator[None]:
    """Within this context the driver's writes below `folder` follow the kernel's rules. `refuse`: called with each file's
    name before a write; True makes it fail with EIO."""
    root, beneath = Path(folder).resolve(), driver.pwrite

    def pwrite(file: int, data: bytes, offset: int) -> int:
        path = Path(os.readlink(f"/proc/self/fd/{file}"))
        if root not in path.parents:
            return beneath(file, data, offset)
        if refuse(path.name):
            raise refusal(errno.EIO)
        _check(path, data.decode().strip())
        return beneath(file, data, offset)

    driver.pwrite = pwrite
    try:
        yield
    finally:
        driver.pwrite = beneath


def _check(path: Path, text: str) -> None:
    if path.name == "export":
        return _export(path.parent, text)
    shown = {name: _first(path.parent / name) for name in ("period", "duty_cycle", "enable", "polarity")}
    if path.name == "polarity":
        if text not in ("normal", "inversed"):
            raise refusal(errno.EINVAL)
        if shown["enable"] == "1":
            raise refusal(errno.EBUSY)
    elif not text.isdecimal() or (path.name == "enable" and text not in ("0", "1")):
        raise refusal(errno.EINVAL)
    wanted = {**shown, path.name: text}
    # As pwm_apply_state: whatever is written, there must be a period, and the pulse must fit in it.
    if int(wanted["period"]) == 0 or int(wanted["duty_cycle"]) > int(wanted["period"]):
        raise refusal(errno.EINVAL)


def _export(chip: Path, text: str) -> None:
    if not text.isdecimal():
        raise refusal(errno.EINVAL)
    if int(text) >= int(_first(chip / "npwm")):
        raise refusal(errno.ENODEV)
    channel = chip / f"pwm{text}"
    if channel.exists():
        raise refusal(errno.EBUSY)
    channel.mkdir()
    for name, value in {"period": "0", "duty_cycle": "0", "enable": "0", "polarity": "normal"}.items():
        (channel / name).write_text(f"{value}\n")


def _first(path: Path) -> str:
    return _first_line(path.read_bytes()).decode()


def _first_line(content: bytes) -> bytes:
    """The first line only: a shorter number written over a longer one leaves the longer one's end after it."""
    return content.split(b"\n", 1)[0].strip()
