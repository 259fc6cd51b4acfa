import contextlib
import math
import os
import tempfile
from pathlib import Path

import pytest

from hil.devices.clock import VirtualClock
from hil.devices.pwm import PwmChannel, find_chip
from hil.emulator import pwm_tree
from hil.emulator.pwm_tree import PwmTree
from hil.safety.faults import DeviceFault, FaultKind

PERIOD, IDLE = 0.0025, 0.001
NOBODY = 65534


@pytest.fixture
def tree(tmp_path):
    made = PwmTree(tmp_path / "pwm")
    with pwm_tree.attached(made.root):
        yield made
    made.close()


@pytest.fixture
def writes(monkeypatch):
    """(file's name, text) of every write that the driver does."""
    log, beneath = [], pwm_tree.driver.pwrite

    def pwrite(file, data, offset):
        log.append((Path(os.readlink(f"/proc/self/fd/{file}")).name, data.decode().strip()))
        return beneath(file, data, offset)

    monkeypatch.setattr(pwm_tree.driver, "pwrite", pwrite)
    return log


def channel(tree, index=0):
    return PwmChannel(tree.chip, index, "esc", VirtualClock())


def shown(tree, index=0):
    folder = tree.chip / f"pwm{index}"
    return [(folder / name).read_text().split("\n")[0] for name in ("period", "duty_cycle", "enable", "polarity")]


def test_a_chip_is_found_by_its_device_whatever_its_number(tmp_path):
    PwmTree(tmp_path, chip=0, device="fef00000.other")
    PwmTree(tmp_path, chip=3, device="fe20c000.pwm")
    assert find_chip("fe20c000.pwm", tmp_path) == tmp_path / "pwmchip3"
    with pytest.raises(DeviceFault, match=r"found fe20c000\.pwm, fef00000\.other, expected .* 1f00098000\.pwm") as raised:
        find_chip("1f00098000.pwm", tmp_path)
    assert raised.value.kind is FaultKind.NOT_READY
    with pytest.raises(DeviceFault, match=r"none \(is the overlay in config\.txt\?\)"):
        find_chip("fe20c000.pwm", tmp_path / "nothing")


def test_opening_follows_the_kernels_order(tree, writes):
    esc = channel(tree)
    assert tree.duty(0) is None
    esc.open(PERIOD, IDLE)
    assert writes == [("export", "0"), ("period", "2500000"), ("duty_cycle", "1000000"), ("enable", "1")]
    assert tree.duty(0) == pytest.approx(IDLE)
    assert esc.duty_file.read_text() == "1000000\n"
    assert esc.idle_ns == 1_000_000


def test_a_pulse_is_written_in_nanoseconds(tree):
    esc = channel(tree)
    esc.open(PERIOD, IDLE)
    for pulse in (0.0015, 0.002, 0.000999, 0.00123456789, 0.0):
        esc.set(pulse)
        assert tree.duty(0) == pytest.approx(pulse, abs=5e-10)
    assert esc.counters["pulses"] == 5


def test_closing_leaves_the_idle_pulse_on_an_enabled_output(tree, writes):
    esc = channel(tree)
    esc.open(PERIOD, IDLE)
    esc.set(0.0018)
    esc.close()
    assert shown(tree) == ["2500000", "1000000", "1", "normal"]
    assert tree.duty(0) == pytest.approx(IDLE)
    esc.close()
    assert ("enable", "0") not in writes
    assert "unexport" not in [name for name, _ in writes]


@pytest.mark.parametrize(
    ("before", "after", "idle"),
    [(0.02, 0.0025, IDLE), (0.0025, 0.02, IDLE), (0.0025, 0.0025, IDLE), (0.0025, 0.02, 0.003), (0.02, 0.0015, IDLE)],
)
def test_an_output_that_still_runs_is_taken_over_without_a_gap(tree, writes, before, after, idle):
    """Started at the last program's full throttle and another period: never disabled, no pulse above the period."""
    first = channel(tree)
    first.open(before, IDLE)
    first.set(0.002)
    first._let_go()  # its process was killed
    del writes[:]
    channel(tree).open(after, idle)
    assert shown(tree) == [str(round(after * 1e9)), str(round(idle * 1e9)), "1", "normal"]
    assert all(name in ("period", "duty_cycle") for name, _ in writes)


@pytest.mark.parametrize("pulse", [0.00251, -1e-6, math.nan, math.inf])
def test_an_invalid_pulse_is_a_fault_and_leaves_the_output_as_it_was(tree, pulse):
    esc = channel(tree)
    esc.open(PERIOD, IDLE)
    with pytest.raises(DeviceFault) as raised:
        esc.set(pulse)
    assert raised.value.kind is FaultKind.OUTPUT_LOST
    assert raised.value.device == "esc"
    assert tree.duty(0) == pytest.approx(IDLE)
    esc.close()


def test_a_write_that_the_kernel_refuses_is_a_fault(tmp_path):
    tree, broken = PwmTree(tmp_path / "pwm"), []
    with pwm_tree.attached(tree.root, refuse=lambda file: file in broken):
        esc = channel(tree)
        esc.open(PERIOD, IDLE)
        broken.append("duty_cycle")
        with pytest.raises(DeviceFault, match=r"pulse of 0\.0015 s: found Input/output error") as raised:
            esc.set(0.0015)
        assert raised.value.kind is FaultKind.OUTPUT_LOST
        with pytest.raises(DeviceFault):
            esc.close()
        esc.close()  # its files are closed all the same
        broken[:] = ["period"]
        with pytest.raises(DeviceFault) as raised:
            channel(tree, 1).open(PERIOD, IDLE)
        assert raised.value.kind is FaultKind.NOT_READY


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be someone else")
@pytest.mark.parametrize("hand_over", [0.3, 5.0])
def test_permission_that_udev_gives_later_is_waited_for(hand_over):
    with tempfile.TemporaryDirectory() as name:  # outside pytest's own, which others can't enter
        os.chmod(name, 0o755)
        tree, clock = PwmTree(Path(name) / "pwm"), VirtualClock()
        os.chown(tree.chip / "export", NOBODY, NOBODY)
        (tree.chip / "pwm0").mkdir()
        for file, value in {"period": "0", "duty_cycle": "0", "enable": "0", "polarity": "normal"}.items():
            (tree.chip / "pwm0" / file).write_text(value)
            (tree.chip / "pwm0" / file).chmod(0o644)

        def udev(t):
            if t >= hand_over:
                os.seteuid(0)
                for file in (tree.chip / "pwm0").iterdir():
                    os.chown(file, NOBODY, NOBODY)
                os.seteuid(NOBODY)

        clock.listeners.append(udev)
        esc = PwmChannel(tree.chip, 0, "esc", clock)
        os.seteuid(NOBODY)
        try:
            with pwm_tree.attached(tree.root):
                if hand_over < 1.0:
                    esc.open(PERIOD, IDLE)
                    assert clock.now() == pytest.approx(hand_over, abs=0.011)
                    esc.close()
                else:
                    with pytest.raises(DeviceFault, match="udev rule") as raised:
                        esc.open(PERIOD, IDLE)
                    assert raised.value.kind is FaultKind.NOT_READY
        finally:
            os.seteuid(0)


def test_an_inverted_output_is_set_right_while_it_is_disabled(tree):
    with contextlib.closing(channel(tree)) as esc:
        esc.open(PERIOD, IDLE)
    (tree.chip / "pwm0" / "polarity").write_text("inversed\n")
    esc = channel(tree)
    with pytest.raises(DeviceFault, match="busy") as raised:  # impossible while it runs
        esc.open(PERIOD, IDLE)
    assert raised.value.kind is FaultKind.NOT_READY
    (tree.chip / "pwm0" / "enable").write_text("0\n")
    esc.open(PERIOD, IDLE)
    assert shown(tree)[2:] == ["1", "normal"]
    esc.close()
