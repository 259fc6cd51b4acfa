"""The load cell's ADC, an ADS1115 on I2C (Texas Instruments, SBAS444), in continuous conversion.

The driver makes one block read of the conversion register a tick. The chip does not signal a new conversion, but at 860 a
second (+-10 %) a loop of 250 Hz never reads one twice. Polling its ready bit would never end in continuous mode.
"""

import errno
from typing import NamedTuple

import smbus2

from hil.devices.clock import Clock
from hil.safety.faults import DeviceFault, FaultKind

CONVERSION, CONFIG = 0x00, 0x01
INPUTS = {
    "AIN0-AIN1": 0, "AIN0-AIN3": 1, "AIN1-AIN3": 2, "AIN2-AIN3": 3, "AIN0": 4, "AIN1": 5, "AIN2": 6, "AIN3": 7,
}  # fmt: skip
FULL_SCALES = {6.144: 0, 4.096: 1, 2.048: 2, 1.024: 3, 0.512: 4, 0.256: 5}
RATES = {8: 0, 16: 1, 32: 2, 64: 3, 128: 4, 250: 5, 475: 6, 860: 7}
LARGEST, SMALLEST = 0x7FFF, -0x8000
SLOWEST = 0.9
"""The chip's clock may be this much slower than its data sheet's rate."""

_I2C_TIMEOUT = 0x0702
_TIMEOUT = 2
"""The kernel's timeout for a bus that hangs, in units of 10 ms. The default is a second: 250 ticks."""

_START, _READY, _COMPARATOR_OFF = 0x8000, 0x8000, 0x0003
_TRIES = 3
_SUSPECT = 5
"""Equal readings in a row after which the settings are checked: noise changes live readings."""
_VERIFY_EVERY = 1.0  # s
_LOSSES = 2
_LOSSES_WITHIN = 10.0  # s


class Conversion(NamedTuple):
    """A reading: `counts` (16 bit, signed); `saturated`: at an end of the range; `fresh`: read in this call, else held; largest
    possible `age` [s], including the conversion; `repeats`: equal readings in a row."""

    counts: int
    saturated: bool
    fresh: bool
    age: float
    repeats: int


class Ads1115:
    """The chip at `address` of the bus `bus` (number or path). `full_scale` in V, `rate` in conversions a second.

    A transfer that is not acknowledged (a motor starts) is tried again twice; after that, or a timeout, the last reading is
    held for up to `hold` seconds. Settings lost in a brown-out are written again. `counters`: how often this happened.
    DeviceFault if it does not help: REFUSED, TIMEOUT, RECONFIGURED (lost twice within 10 s), NOT_READY at the start.
    """

    def __init__(self, bus, address=0x48, channel="AIN0", full_scale=4.096, rate=860, *, clock: Clock, hold=0.05, name="adc"):
        self.name = name
        self._bus_name, self._address, self._clock, self._hold = bus, address, clock, hold
        self._settings = INPUTS[channel] << 12 | FULL_SCALES[full_scale] << 9 | RATES[rate] << 5 | _COMPARATOR_OFF
        self._conversion_time = 1.0 / (SLOWEST * rate)
        self.volts_per_count = full_scale / 0x8000
        self.counters = {"not acknowledged": 0, "timeouts": 0, "held": 0, "settings lost": 0}
        self._bus: smbus2.SMBus | None = None
        self._last, self._read_at, self._verified_at, self._valid_from = 0, 0.0, 0.0, 0.0
        self._repeats = 0
        self._losses: list[float] = []

    def start(self) -> None:
        """Open the bus, write the settings, take the first conversion."""
        try:
            self._bus = smbus2.SMBus(self._bus_name)
            smbus2.smbus2.ioctl(self._bus.fd, _I2C_TIMEOUT, _TIMEOUT)  # smbus2 has no call for it
            self._write_settings()
            found = self._register(CONFIG)
            self._clock.wait_until(self._valid_from)
            self._last = _signed(self._register(CONVERSION))
        except OSError as error:
            self.close()
            detail = f"bus {self._bus_name}: found {error.strerror or error}, expected an ADS1115"
            raise DeviceFault(self.name, FaultKind.NOT_READY, detail) from error
        if found & ~_READY & 0xFFFF != self._settings:
            self.close()
            detail = f"settings: found 0x{found:04x}, expected 0x{self._settings:04x}, as written: is it an ADS1115?"
            raise DeviceFault(self.name, FaultKind.NOT_READY, detail)
        self._read_at = self._verified_at = self._clock.now()
        self._repeats, self._losses = 0, []

    def read(self) -> Conversion:
        """The newest conversion, or if that fails the last one, unless it is older than `hold`."""
        now = self._clock.now()
        try:
            counts = _signed(self._transfer())
        except OSError as error:
            return self._held(self._clock.now(), error)
        self._repeats = self._repeats + 1 if counts == self._last else 0
        suspect = self._repeats and self._repeats % _SUSPECT == 0
        if suspect or counts == 0 or now - self._verified_at >= _VERIFY_EVERY:
            self.verify()
        if now < self._valid_from:
            return self._conversion(self._last, now, fresh=False)
        self._last, self._read_at = counts, now
        return self._conversion(counts, now, fresh=True)

    def verify(self) -> None:
        """Check the chip's settings. If they are lost, write them again; a second loss within 10 s is a fault."""
        now = self._clock.now()
        try:
            found = self._register(CONFIG)
            self._verified_at = now
            if found & ~_READY & 0xFFFF == self._settings:
                return
            self._write_settings()
        except OSError as error:  # the settings are unknown: the next tick checks again
            self._held(self._clock.now(), error)
            return
        self.counters["settings lost"] += 1
        self._losses = [t for t in self._losses if now - t < _LOSSES_WITHIN] + [now]
        if len(self._losses) >= _LOSSES:
            detail = f"settings: found 0x{found:04x} for the second time, expected 0x{self._settings:04x}"
            raise DeviceFault(self.name, FaultKind.RECONFIGURED, detail)

    def select(self, channel: str) -> None:
        """Convert another input from now on; readings are held until its first conversion. DeviceFault as `read`."""
        before, self._settings = self._settings, self._settings & ~(7 << 12) | INPUTS[channel] << 12
        if self._settings == before:
            return
        try:
            self._write_settings()
            self._repeats = 0
        except OSError as error:  # the caller selects again
            self._settings = before
            self._held(self._clock.now(), error)

    def close(self) -> None:
        """Close the bus; the chip continues to convert."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _transfer(self) -> int:
        for left in range(_TRIES - 1, -1, -1):
            try:
                return self._register(CONVERSION)
            except OSError as error:
                if error.errno == errno.ETIMEDOUT:  # it has cost five ticks already
                    self.counters["timeouts"] += 1
                    raise
                self.counters["not acknowledged"] += 1
                if not left:
                    raise
        raise AssertionError("unreachable")

    def _held(self, now: float, error: OSError) -> Conversion:
        without = now - self._read_at
        if without > self._hold:
            kind = FaultKind.TIMEOUT if error.errno == errno.ETIMEDOUT else FaultKind.REFUSED
            found = f"no reading for {1e3 * without:.0f} ms ({error.strerror or error})"
            raise DeviceFault(self.name, kind, f"found {found}, expected one within {1e3 * self._hold:.0f} ms") from error
        self.counters["held"] += 1
        return self._conversion(self._last, now, fresh=False)

    def _conversion(self, counts: int, now: float, fresh: bool) -> Conversion:
        age = now - self._read_at + self._conversion_time
        return Conversion(counts, counts in (LARGEST, SMALLEST), fresh, age, self._repeats)

    def _register(self, register: int) -> int:
        # Two bytes, high one first; smbus2's word read would swap them.
        high, low = self._bus.read_i2c_block_data(self._address, register, 2)
        return high << 8 | low

    def _write_settings(self) -> None:
        value = self._settings | _START
        self._bus.write_i2c_block_data(self._address, CONFIG, [value >> 8, value & 0xFF])
        self._valid_from = self._clock.now() + 2.0 * self._conversion_time


def _signed(word: int) -> int:
    return word - 0x10000 if word & 0x8000 else word
