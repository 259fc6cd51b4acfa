"""Voltage and current of the motor's supply, its temperature, the rotor's torque: a second ADS1115, read input by input.

It is a chip of its own because a chip converts one input at a time: three inputs of the load cell's would be free, but each
look at one of them would cost thrust two readings.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hil.clock import Clock
from hil.devices.ads1115 import Ads1115

NAMES = {"voltage": "V", "current": "A", "temperature": "degC", "torque": "N.m"}
"""What may be wired, and its unit."""

EVERY = 25
"""Ticks from one input to the next, 0.1 s: limits of the supply need no more, and power is a mean over seconds."""

HOLD = 1.0
"""s that the last readings may stand in while the bus fails."""


class Input(NamedTuple):
    """How a quantity is wired: `channel` of the chip, what 0 V on it stand for (`zero`), and each volt more (`per_volt`)."""

    channel: str
    zero: float
    per_volt: float

    def volts(self, value: float) -> float:
        """On the channel at a value of the quantity."""
        return (value - self.zero) / self.per_volt


class Supply:
    """The chip at `address` with `inputs` by name. `values`: the last reading of each, NaN before the first; `new`: the names
    of those that the last call of `read` brought."""

    def __init__(self, bus, address: int, inputs: Mapping[str, Input], *, clock: Clock):
        self.inputs, self._order, self._at, self._ticks = dict(inputs), list(inputs), 0, 0
        first = self.inputs[self._order[0]]
        self._adc = Ads1115(bus, address, first.channel, clock=clock, hold=HOLD, name="supply adc")
        self.values, self.new = dict.fromkeys(NAMES, math.nan), ()

    @property
    def name(self) -> str:
        return self._adc.name

    @property
    def counters(self) -> Mapping[str, int]:
        return self._adc.counters

    def start(self) -> None:
        """Open the bus and begin to convert. DeviceFault NOT_READY."""
        self._adc.start()

    def read(self) -> None:
        """Once a tick: now and then it reads an input and goes on to the next. DeviceFault as `Ads1115.read`."""
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
        """Let go of the bus."""
        self._adc.close()
