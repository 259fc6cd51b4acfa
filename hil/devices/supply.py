"""Voltage, current and temperature of the motor's supply, and the rotor's torque: a second ADS1115, read input by input.

A chip converts one input at a time. So the free inputs of the load cell's chip are not used: each of their readings would cost
two readings of thrust.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hil.devices.ads1115 import Ads1115
from hil.devices.clock import Clock

NAMES = {"voltage": "V", "current": "A", "temperature": "degC", "torque": "N.m"}
"""Quantities that may be wired, with their units."""

EVERY = 25
"""Ticks from one input to the next, 0.1 s: enough for the supply's limits, and power is averaged over seconds."""

HOLD = 1.0
"""Time for which the last readings are held while the bus fails, s."""


class Input(NamedTuple):
    """How a quantity is wired: `channel` of the chip, the value at 0 V (`zero`), and its change per volt (`per_volt`)."""

    channel: str
    zero: float
    per_volt: float

    def volts(self, value: float) -> float:
        """Voltage on the channel at a value of the quantity."""
        return (value - self.zero) / self.per_volt


class Supply:
    """The chip at `address` with `inputs` by name. `values`: the last reading of each, NaN before the first; `new`: names of
    those that the last call of `read` updated."""

    def __init__(self, bus, address: int, inputs: Mapping[str, Input], *, clock: Clock):
        self.inputs, self._order, self._at, self._ticks = dict(inputs), list(inputs), 0, 0
        first = self.inputs[self._order[0]]
        self._adc = Ads1115(bus, address, first.channel, clock=clock, hold=HOLD, name="supply adc")
        self.name, self.counters = self._adc.name, self._adc.counters
        self.values, self.new = dict.fromkeys(NAMES, math.nan), ()

    def start(self) -> None:
        """Open the bus and begin to convert. DeviceFault NOT_READY."""
        self._adc.start()

    def read(self) -> None:
        """Call once a tick: every EVERY ticks it reads an input and selects the next. DeviceFault as `Ads1115.read`."""
        self._ticks, self.new = self._ticks + 1, ()
        if self._ticks % EVERY:
            return
        conversion = self._adc.read()
        if conversion.fresh:
            name = self._order[self._at]
            wired = self.inputs[name]
            self.values[name] = wired.zero + wired.per_volt * conversion.counts * self._adc.volts_per_count
            self.new = (name,)
            self._at = (self._at + 1) % len(self._order)
        self._adc.select(self.inputs[self._order[self._at]].channel)

    def close(self) -> None:
        self._adc.close()
