"""The emulated buses in real time, their two ends in two processes, as in the emulated rig."""

import subprocess
import sys
import time

import pytest
from rigs import within

from hil.devices.ads1115 import Ads1115
from hil.devices.clock import MonotonicClock
from hil.devices.pwm import PwmChannel
from hil.devices.tachometer import Tachometer
from hil.emulator import i2c, pwm_tree, serial_line
from hil.emulator.shared import SharedNumbers
from hil.safety.faults import DeviceFault, FaultKind

FAR_END = """
import math, os, sys, time
from hil.emulator import i2c
from hil.emulator.pwm_tree import PwmTree
from hil.emulator.serial_line import PtyLine
from hil.emulator.uno import Uno
at = sys.argv[1]
tree = PwmTree(at + "/pwm")
def volts(t):  # a millivolt for each microsecond of the ESC's pulse
    return 1e3 * (tree.duty(0) or 0.0)
def pulses(t):
    return math.floor(t / 0.02), math.floor(t / 0.02) * 0.02, 0.02
bus = i2c.open_bus(at + "/i2c", create=True)
chip = i2c.Ads1115Chip(bus, volts)
line = PtyLine(Uno(pulses, boot=0.02), at + "/line", at + "/tty")
os.set_blocking(0, False)
print("ready", flush=True)
while True:
    try:
        if not os.read(0, 1):
            break
    except BlockingIOError:
        pass
    chip.serve(time.monotonic())
    line.serve(time.monotonic())
    time.sleep(0.0005)
"""


@pytest.fixture
def folder(tmp_path):
    command = [sys.executable, "-W", "error", "-c", FAR_END, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as far:
        assert far.stdout.readline() == b"ready\n"
        yield tmp_path
        far.stdin.close()
        assert far.wait(10) == 0


def test_a_pulse_written_here_comes_back_as_volts_and_marks_as_revolutions(folder):
    clock = MonotonicClock()
    with i2c.attached(folder / "i2c", clock) as bus, pwm_tree.attached(folder / "pwm"):
        esc = PwmChannel(folder / "pwm" / "pwmchip0", 0, "esc", clock)
        esc.open(0.0025, 0.001)
        adc, tachometer = Ads1115(str(folder / "i2c"), clock=clock, hold=5.0), Tachometer(str(folder / "tty"), clock, 5.0)
        adc.start()
        tachometer.hello()
        for pulse in (0.001, 0.0015, 0.002):
            esc.set(pulse)
            within(5.0, lambda pulse=pulse: abs(adc.read().counts * adc.volts_per_count - 1e3 * pulse) < 1e-3)
        answers = []

        def turning():
            tachometer.request()
            time.sleep(0.004)
            answers.append(tachometer.poll())
            return len([a for a in answers if a is not None and a.omega == pytest.approx(3000.0, rel=3e-4)]) >= 10

        within(10.0, turning)

        bus["frozen"] = 1  # a fault set in this process acts in the other
        time.sleep(0.02)
        adc.read()
        esc.set(0.001)
        time.sleep(0.05)
        assert adc.read().counts * adc.volts_per_count == pytest.approx(2.0, abs=1e-3)
        bus["frozen"] = 0
        within(5.0, lambda: abs(adc.read().counts * adc.volts_per_count - 1.0) < 1e-3)

        faults = SharedNumbers(folder / "line", serial_line.FAULTS)
        faults["unplugged"] = 1
        time.sleep(0.05)
        with pytest.raises(DeviceFault) as raised:
            within(5.0, lambda: tachometer.poll() and False)
        assert raised.value.kind is FaultKind.UNPLUGGED
        faults.close()
        for device in (tachometer, adc, esc):
            device.close()
