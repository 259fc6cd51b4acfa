"""An emulated I2C bus with an ADS1115: smbus2's own ioctl calls and structures access its registers.

The bus is a small file that smbus2 opens like /dev/i2c-1. At the near end, `attached` replaces the driver's ioctl and reads its
structures in Linux's layout (uapi/linux/i2c.h, i2c-dev.h). At the far end, `Ads1115Chip` converts volts at its own rate.
"""

import contextlib
import ctypes
import errno
import math
import os
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from hil.devices import ads1115 as driver
from hil.devices.clock import Clock
from hil.emulator.shared import SharedNumbers, refusal
from hil.loop.bench import ADDRESS

REGISTERS = ("conversion", "config", "low", "high")
STATE = ("converting", "since")
FAULTS = ("not_acknowledged", "timeout", "frozen", "overload")
"""Faults that any process may set: numbers of transfers to come that are not acknowledged, or time out (math.inf: all); 1: the
conversions are frozen; volts added to the input."""

POWER_UP = {"conversion": 0x0000, "config": 0x0583, "low": 0x8000, "high": 0x7FFF}
"""Registers after a reset. The config's top bit (whether a conversion runs) is stored separately: it reads 0x8583."""
TIMEOUT = 1.0
"""The kernel's default timeout of a transfer, s."""

_READY, _SINGLE = 0x8000, 0x0100
_SCALES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256, 0.256, 0.256)
_RATES = (8, 16, 32, 64, 128, 250, 475, 860)
_INPUTS = ((0, 1), (0, 3), (1, 3), (2, 3), (0, None), (1, None), (2, None), (3, None))
_WAKE = 25e-6


def open_bus(path: str | os.PathLike, create: bool = False) -> SharedNumbers:
    """The bus's registers and faults, to read and to set. `create`: a new bus, its chip just powered up."""
    bus = SharedNumbers(path, REGISTERS + STATE + FAULTS, create)
    if create:
        brown_out(bus)
    return bus


def brown_out(bus: SharedNumbers) -> None:
    """Emulate a dip of the chip's supply: its registers are as after power-up, and conversions stop."""
    for name, value in POWER_UP.items():
        bus[name] = value
    bus["converting"] = 0


class Ads1115Chip:
    """The converter of the chip. `volts(t)`: voltage at input `channel` at time t [s]; `others`: the same for other inputs; all
    remaining inputs are at 0 V.

    `clock_error`: relative error of its clock, positive if fast; the data sheet allows +-0.1. A conversion samples the input at
    its end.
    """

    def __init__(
        self, bus: SharedNumbers, volts: Callable[[float], float], channel: int = 0, clock_error: float = 0.0, others=None
    ):
        self._bus, self._clock_error = bus, clock_error
        own = lambda t: volts(t) + bus["overload"]  # noqa: E731
        self._inputs: dict[int, Callable[[float], float]] = {**(others or {}), channel: own}
        self._since, self._done = math.nan, 0

    def serve(self, t: float) -> None:
        """Do the conversions that end by time t [s]."""
        bus = self._bus
        config = int(bus["config"])
        period = 1.0 / (_RATES[config >> 5 & 7] * (1.0 + self._clock_error))
        if bus["since"] != self._since:  # a write to the settings begins a conversion anew
            self._since, self._done = bus["since"], 0
        if not bus["converting"]:
            return
        begun = self._since + _WAKE
        done = math.floor((t - begun) / period)
        if done <= self._done:
            return
        if config & _SINGLE:
            done, bus["converting"] = 1, 0
        self._done = done
        if not bus["frozen"]:
            bus["conversion"] = self._counts(config, begun + done * period) & 0xFFFF

    def _counts(self, config: int, t: float) -> int:
        plus, minus = _INPUTS[config >> 12 & 7]
        high, low = (self._inputs[each](t) if each in self._inputs else 0.0 for each in (plus, minus))
        counts = round((high - low) / _SCALES[config >> 9 & 7] * 0x8000)
        return min(max(counts, driver.SMALLEST), driver.LARGEST)


@contextlib.contextmanager
def attached(
    path: str | os.PathLike, clock: Clock, others: Mapping[int, str | os.PathLike] = MappingProxyType({})
) -> Iterator[SharedNumbers]:
    """Within this context smbus2 accesses the bus `path`, and other buses as before. A timeout waits on `clock`. `others`:
    files of further chips on the same wires, by address."""
    module = driver.smbus2.smbus2
    chips = {address: open_bus(file) for address, file in {ADDRESS: path, **others}.items()}
    kernel, beneath, here = _Kernel(chips, clock), module.ioctl, os.stat(path)

    def ioctl(file, request, argument):
        there = os.fstat(file)
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            return beneath(file, request, argument)
        return kernel.ioctl(file, request, argument)

    module.ioctl = ioctl
    try:
        yield chips[ADDRESS]
    finally:
        module.ioctl = beneath
        for chip in chips.values():
            chip.close()


class _SmbusRequest(ctypes.Structure):  # struct i2c_smbus_ioctl_data
    _fields_ = (
        ("read_write", ctypes.c_uint8),
        ("command", ctypes.c_uint8),
        ("size", ctypes.c_uint32),
        ("data", ctypes.c_void_p),
    )


class _Kernel:
    """i2c-dev and the Pi's controller: turns a request's bytes in memory into transfers to the chip."""

    WAIT, SLAVE, FUNCS, SMBUS = 0x0702, 0x0703, 0x0705, 0x0720
    FUNCTIONS, BLOCK = 0x0C000000, 8
    """Reads and writes of blocks, the only transfers of the driver, and their size in a request."""

    def __init__(self, chips: dict[int, SharedNumbers], clock: Clock):
        self._chips, self._clock = chips, clock
        self._addresses: dict[int, int] = {}  # by open file
        self._timeout = TIMEOUT

    def ioctl(self, file: int, request: int, argument) -> int:
        if request == self.SLAVE:
            self._addresses[file] = argument
        elif request == self.WAIT:
            self._timeout = 0.01 * argument
        elif request == self.FUNCS:
            ctypes.c_ulong.from_address(ctypes.addressof(argument)).value = self.FUNCTIONS
        elif request == self.SMBUS:
            self._smbus(self._addresses.get(file, -1), _SmbusRequest.from_address(ctypes.addressof(argument)))
        else:
            raise refusal(errno.ENOTTY)
        return 0

    def _smbus(self, address: int, request: _SmbusRequest) -> None:
        if request.size != self.BLOCK:
            raise refusal(errno.EOPNOTSUPP)
        command, data = bytes([request.command]), (ctypes.c_uint8 * 34).from_address(request.data)
        count = data[0]  # the block is behind its length
        if request.read_write == 1:
            data[1 : 1 + count] = list(self._transfer(address, command, count))
        else:
            self._transfer(address, command + bytes(data[1 : 1 + count]))

    def _transfer(self, address: int, written: bytes, count: int = 0) -> bytes:
        """One transfer as on the wires: the bytes written, the first of them the register, then `count` bytes read."""
        bus = self._chips.get(address)
        if bus is None or bus.take("not_acknowledged"):
            raise refusal(errno.EREMOTEIO)
        if bus.take("timeout"):
            self._clock.wait_until(self._clock.now() + self._timeout)
            raise refusal(errno.ETIMEDOUT)
        name = REGISTERS[written[0] & 3]
        if len(written) >= 3:
            self._store(bus, name, written[1] << 8 | written[2])
        word = int(bus[name])
        if name == "config" and not bus["converting"]:
            word |= _READY
        return (word.to_bytes(2, "big") + b"\xff" * count)[:count]

    def _store(self, bus: SharedNumbers, name: str, word: int) -> None:
        if name == "conversion":
            return
        bus[name] = word & ~_READY if name == "config" else word
        if name == "config":
            bus["converting"] = float(not word & _SINGLE or word & _READY != 0)
            bus["since"] = self._clock.now()
