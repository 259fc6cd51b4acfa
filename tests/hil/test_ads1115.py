import math

import pytest
import smbus2

from hil.devices.ads1115 import Ads1115
from hil.devices.clock import VirtualClock
from hil.emulator import i2c
from hil.safety.faults import DeviceFault, FaultKind

TICK = 0.004
LSB = 4.096 / 32768
"""Volts a count at +-4.096 V."""


class Bench:
    """A bus with an ADC on it under a virtual clock; `volts(t)` at its input."""

    def __init__(self, folder, volts, **chip):
        self.clock, self.path = VirtualClock(100.0), str(folder / "i2c-1")
        self.bus = i2c.open_bus(self.path, create=True)
        self.chip = i2c.Ads1115Chip(self.bus, volts, **chip)
        self.clock.listeners.append(self.chip.serve)

    def tick(self, seconds: float = TICK) -> None:
        self.clock.wait_until(self.clock.now() + seconds)


@pytest.fixture
def bench(tmp_path):
    """The input is `bench.input` plus a sawtooth of a count a millisecond in place of noise."""
    made = Bench(tmp_path, lambda t: made.input + LSB * math.floor(1e3 * t % 7))
    made.input = 1.0
    with i2c.attached(made.path, made.clock):
        yield made


@pytest.fixture
def adc(bench):
    adc = Ads1115(bench.path, clock=bench.clock)
    adc.start()
    yield adc
    adc.close()


def kind(call) -> FaultKind:
    with pytest.raises(DeviceFault) as raised:
        call()
    assert raised.value.device == "adc"
    return raised.value.kind


@pytest.mark.parametrize(
    ("options", "config"),
    [
        # Table 8-3 of the data sheet by hand: OS 1, MUX, PGA, MODE 0, DR, COMP_QUE 11.
        ({}, 0b1_100_001_0_111_00011),
        ({"channel": "AIN0-AIN1", "full_scale": 2.048, "rate": 475}, 0b1_000_010_0_110_00011),
        ({"channel": "AIN3", "full_scale": 0.256, "rate": 8}, 0b1_111_101_0_000_00011),
    ],
)
def test_transfers_are_those_of_the_data_sheet(tmp_path, monkeypatch, options, config):
    """The driver's ioctl calls, byte for byte."""
    (tmp_path / "bus").touch()
    asked = []

    def ioctl(file, request, argument):
        if request == 0x0720:  # I2C_SMBUS
            block = argument.data.contents.block
            count = block[0]
            asked.append((argument.read_write, argument.command, argument.size, bytes(block[1 : 1 + count])))
            if argument.read_write:
                block[1], block[2] = ((config & 0x7FFF) >> 8, config & 0xFF) if argument.command else (0xFF, 0xFE)
        elif request in (0x0702, 0x0703):  # I2C_TIMEOUT in 10 ms, I2C_SLAVE
            asked.append((request, argument))

    monkeypatch.setattr(smbus2.smbus2, "ioctl", ioctl)
    adc = Ads1115(str(tmp_path / "bus"), 0x49, clock=VirtualClock(), **options)
    adc.start()
    assert adc.read().counts == -2
    adc.close()
    written, nothing = bytes([config >> 8, config & 0xFF]), bytes(2)
    assert asked == [(0x0702, 2), (0x0703, 0x49), (0, 1, 8, written), (1, 1, 8, nothing), *[(1, 0, 8, nothing)] * 2]


@pytest.mark.parametrize("clock_error", [-0.1, 0.0, 0.1])
@pytest.mark.parametrize("rate", [250, 475, 860])
def test_duplicates_follow_from_the_chips_clock(tmp_path, rate, clock_error):
    """Of 1000 reads at 250 Hz, 1000 - floor(4 s * rate) repeat a conversion where the chip is slower than the loop."""
    count = iter(range(10**6))
    bench = Bench(tmp_path, lambda t: LSB * (next(count) % 30000 + 1), clock_error=clock_error)
    with i2c.attached(bench.path, bench.clock):
        adc = Ads1115(bench.path, rate=rate, clock=bench.clock)
        adc.start()
        repeated = 0
        for _ in range(1000):
            bench.tick()
            repeated += adc.read().repeats > 0
        adc.close()
    expected = max(0.0, 1000 - 4.0 * rate * (1.0 + clock_error))
    assert abs(repeated - expected) <= 1


def test_both_ends_of_the_range_are_saturation(bench, adc):
    for overload, counts in ((10.0, 0x7FFF), (-10.0, -0x8000)):
        bench.bus["overload"] = overload
        bench.tick()
        reading = adc.read()
        assert (reading.counts, reading.saturated) == (counts, True)
    bench.bus["overload"] = 0.0
    bench.tick()
    assert not adc.read().saturated


def test_a_transfer_that_is_not_acknowledged_is_tried_again(bench, adc):
    bench.tick()
    bench.bus["not_acknowledged"] = 2
    reading = adc.read()
    assert reading.fresh
    assert adc.counters["not acknowledged"] == 2
    assert adc.counters["held"] == 0


def test_the_last_reading_is_held_for_50_ms_and_then_it_is_a_fault(bench, adc):
    bench.tick()
    last = adc.read()
    begun = bench.clock.now()
    bench.bus["not_acknowledged"] = math.inf
    while bench.clock.now() - begun < 0.05 - TICK:
        bench.tick()
        held = adc.read()
        assert (held.counts, held.fresh) == (last.counts, False)
        assert held.age == pytest.approx(bench.clock.now() - begun + 1 / (0.9 * 860))
    bench.tick(2 * TICK)
    assert kind(adc.read) is FaultKind.REFUSED
    bench.bus["not_acknowledged"] = 0
    bench.tick()
    assert adc.read().fresh  # it continues, because the ramp down needs readings


def test_a_timeout_costs_20_ms_and_is_not_tried_again_in_the_same_tick(bench, adc):
    bench.tick()
    adc.read()
    bench.bus["timeout"] = 1
    before = bench.clock.now()
    assert not adc.read().fresh
    assert bench.clock.now() - before == pytest.approx(0.02)
    assert adc.read().fresh
    assert adc.counters["timeouts"] == 1
    bench.bus["timeout"] = math.inf
    adc.read()
    adc.read()
    assert kind(adc.read) is FaultKind.TIMEOUT
    assert bench.clock.now() - before < 0.1


def test_a_brown_out_is_healed_within_a_tick_without_a_wrong_value(bench, adc):
    bench.tick()
    before = adc.read()
    i2c.brown_out(bench.bus)
    bench.tick()
    held = adc.read()
    assert (held.counts, held.fresh) == (before.counts, False)  # not the zero that the register shows
    bench.tick()
    after = adc.read()
    assert after.fresh
    assert abs(after.counts - 1.0 / LSB) <= 7
    assert adc.counters["settings lost"] == 1


def test_a_second_brown_out_within_ten_seconds_is_a_fault(bench, adc):
    for wait, fault in ((0.0, None), (11.0, None), (1.0, FaultKind.RECONFIGURED)):
        for _ in range(round(wait / TICK) + 1):
            bench.tick()
            adc.read()
        i2c.brown_out(bench.bus)
        bench.tick()
        if fault is None:
            adc.read()
        else:
            assert kind(adc.read) is fault


def test_settings_that_somebody_has_changed_are_found_within_a_second(bench, adc):
    """Another program sets another full scale: the readings continue, twice as large; only the settings reveal it."""
    with smbus2.SMBus(bench.path) as bus:
        bus.write_i2c_block_data(0x48, 1, [0xC4, 0xE3])  # 2.048 V
    found = bench.clock.now()
    while not adc.counters["settings lost"]:
        bench.tick()
        adc.read()
        assert bench.clock.now() - found < 1.0 + TICK


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda bench: bench.bus.__setitem__("not_acknowledged", math.inf), "Remote I/O error"),
        (lambda bench: setattr(bench, "path", bench.path + "0"), "No such file"),
        (lambda bench: bench.bus.__setitem__("timeout", math.inf), "timed out"),
    ],
)
def test_a_missing_device_is_reported_at_the_start(bench, spoil, says):
    spoil(bench)
    adc = Ads1115(bench.path, clock=bench.clock)
    with pytest.raises(DeviceFault, match=says) as raised:
        adc.start()
    assert raised.value.kind is FaultKind.NOT_READY
    adc.close()
