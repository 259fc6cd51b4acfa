"""Plausibility checks on the physical model of the rig: no fault while nothing is wrong, and the right fault otherwise."""

import math

import numpy as np
import pytest
from rig_readings import DT, NEWTON_PER_COUNT, Tachometer, run, steps

from hil.physics.rig_model import library
from hil.safety.faults import FaultKind, Reaction
from hil.safety.limits import Limits, limits_of
from hil.safety.plausibility import Plausibility, Reading, Thresholds, thresholds_of
from hil.safety.rotor_bounds import RotorBounds, RotorPhysics
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.rig import Rig

AT = 1.0
HIDDEN = [e.name for e in library(False) if e.off is not None and e.name != "rod_stuck"]


def constant(omega, beta=5.0):
    return lambda t: (omega, beta)


@pytest.mark.parametrize("seed", range(4))
def test_no_alarm_while_speed_and_pitch_step_over_their_whole_range(seed):
    assert run(steps(seed), 40.0, seed=seed)[0] is None


@pytest.mark.sampled("effect")
@pytest.mark.parametrize("effect", HIDDEN)
def test_an_effect_the_model_lacks_is_no_fault(effect):
    assert run(steps(1), 12.0, hidden=(effect,))[0] is None


@pytest.mark.parametrize("omega", [2000.0, 4000.0, 6000.0])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_doubled_or_halved_speed_freezes_the_loop_and_is_a_fault_after_50_ms_or_three_revolutions(omega, factor):
    def spoil(t, reading):
        return reading if t < AT else reading._replace(omega=factor * reading.omega)

    fault, t = run(constant(omega), 3.0, spoil)
    assert (fault.device, fault.kind) == ("tachometer", FaultKind.SPEED_JUMP)
    lower = omega * (1.0 - RotorPhysics().tolerance)
    assert t - AT <= max(0.05, 3 * 60.0 / lower) + 60.0 / omega + 2 * DT


@pytest.mark.parametrize("omega", [2000.0, 6000.0])
def test_every_second_mark_missed_is_a_wrong_speed_and_no_standstill(omega):
    """As the board sees it: half as many passes, and the age of the last one up to twice as large."""
    seen = {}

    def spoil(t, reading):
        if t < AT:
            seen["first"] = seen["last"] = reading
            return reading
        if (reading.pulses - seen["first"].pulses) % 2:
            last = seen["last"]
            return reading._replace(omega=last.omega, pulses=last.pulses, mark_age=last.mark_age + t - last.t)
        seen["last"] = reading._replace(omega=reading.omega / 2.0) if reading.pulses > seen["first"].pulses else reading
        return seen["last"]

    fault, t = run(constant(omega), 3.0, spoil)
    assert fault.kind is FaultKind.SPEED_JUMP
    assert t - AT < 0.25


@pytest.mark.parametrize("omega", [2000.0, 6000.0])
def test_a_single_missed_mark_is_tolerated(omega):
    """The pass at AT is missed: one late pass, one halved speed, then normal readings."""
    seen = {}

    def spoil(t, reading):
        if t < AT:
            seen["pulses"], seen["reading"] = reading.pulses, reading
            return reading
        if reading.pulses == seen["pulses"] + 1:
            late = seen["reading"]
            return reading._replace(omega=late.omega, pulses=late.pulses, mark_age=reading.mark_age + 60.0 / late.omega)
        if reading.pulses == seen["pulses"] + 2:
            return reading._replace(omega=reading.omega / 2.0)
        return reading

    assert run(constant(omega), 3.0, spoil)[0] is None


@pytest.mark.parametrize("omega", [2000.0, 4000.0, 6000.0])
def test_no_revolutions_with_an_open_throttle(omega):
    held = {}

    def spoil(t, reading):
        if t < AT:
            held["reading"], held["t"] = reading, t
            return reading
        last, age = held["reading"], held["reading"].mark_age + t - held["t"]
        return reading._replace(pulses=last.pulses, mark_age=age, omega=last.omega if age < 0.2 else 0.0)

    fault, t = run(constant(omega), 3.0, spoil)
    assert (fault.kind, fault.kind.reaction) == (FaultKind.NO_ROTATION, Reaction.IDLE)
    assert t - AT <= 0.2


@pytest.mark.parametrize("seed", range(4))
def test_a_stuck_actuator_is_detected_from_the_thrust(seed):
    assert run(steps(seed), 30.0, stuck_at=AT, seed=seed)[0].kind is FaultKind.STUCK_ACTUATOR


def quiet(k):
    """A good reading at rest, tick k."""
    counts = 10 + (k % 3)
    return Reading(k * DT, counts, False, counts * NEWTON_PER_COUNT, 0.002, 0.0, 0, 10.0, 0.004, 0.0, 0.0)


def first_fault(change, ticks=100, at=20):
    """(fault, ticks since the change) of quiet readings that `change(reading, ticks since)` spoils from tick `at` on."""
    checks = Plausibility(Limits(), DT)
    for k in range(ticks):
        reading = quiet(k) if k < at else change(quiet(k), k - at)
        if fault := checks.check(reading):
            return fault, k - at
    return None, None


@pytest.mark.parametrize(("throttle", "waits"), [(0.19, 2.0), (0.21, 0.0)])
def test_a_motor_has_2_s_to_start_but_none_under_a_wide_throttle(throttle, waits):
    fault, ticks = first_fault(lambda reading, since: reading._replace(throttle=throttle), ticks=1000)
    assert fault.kind is FaultKind.NO_ROTATION
    assert ticks * DT == pytest.approx(waits, abs=DT)


@pytest.mark.parametrize(
    ("change", "device", "kind", "ticks"),
    [
        (lambda r, k: r._replace(counts=77), "adc", FaultKind.FROZEN, 11),
        (lambda r, k: r._replace(counts=32767 - k % 2, saturated=True), "adc", FaultKind.SATURATED, 2),
        (lambda r, k: r._replace(thrust=25.1), "rig", FaultKind.OVER_THRUST, 2),
        (lambda r, k: r._replace(thrust=-25.1), "rig", FaultKind.OVER_THRUST, 2),
        (lambda r, k: r._replace(thrust=math.nan), "loop", FaultKind.NOT_A_NUMBER, 0),
        (lambda r, k: r._replace(beta_ref=math.inf), "loop", FaultKind.NOT_A_NUMBER, 0),
        (lambda r, k: r._replace(t=r.t - 2 * DT), "loop", FaultKind.TIME_BACKWARDS, 0),
        (lambda r, k: r._replace(thrust_age=DT * k), "adc", FaultKind.STALE, 13),
        (lambda r, k: r._replace(speed_age=DT * k), "tachometer", FaultKind.STALE, 13),
    ],
)
def test_each_reading_has_its_fault_and_its_number_of_ticks(change, device, kind, ticks):
    fault, after = first_fault(change)
    assert (fault.device, fault.kind, after) == (device, kind, ticks)


def opened(checks, free, slope, throttle_max=1.0):
    """(first fault or None, speed shown, speed) of a motor of `free` rpm whose throttle opens by `slope` a second."""
    mark, omega, angle = Tachometer(), 0.0, 0.0
    for k in range(1000):
        throttle = min(slope * k * DT, throttle_max)
        omega += (free * throttle - omega) * DT / 0.1
        angle += omega / 60.0 * DT
        mark.see(k * DT, DT, angle)
        now = (k + 1) * DT
        turning = {"omega": mark.speed(now), "pulses": mark.pulses, "mark_age": now - mark.last, "throttle": throttle}
        if fault := checks.check(quiet(k)._replace(t=now, **turning)):
            break
    return fault, turning["omega"], omega


def test_over_speed_is_idle_at_once():
    """The throttle opens steadily and the motor follows: every reading is plausible, but the speed is too high."""
    fault, seen, omega = opened(Plausibility(Limits(omega_max=3000.0, omega_trip=3300.0), DT), 13200.0, 0.1)
    assert (fault.kind, fault.kind.reaction) == (FaultKind.OVER_SPEED, Reaction.IDLE)
    assert 3300.0 < seen <= omega <= 3300.0 + 0.1 * 13200.0 * (1.5 * 60.0 / 3300.0 + 2 * DT)


def test_a_rig_of_another_size_starts_under_its_own_bounds_but_not_the_papers():
    """A motor of 44 000 rpm on a rotor of 20 000 rpm: every reading is plausible."""
    rig = Rig(speed=(6660.0, 20000.0), pitch=(-12.0, 12.0), thrust=(0.0, 1.2), scales=Scales(20000.0, 18.0, 6.0, 1.2, 0.2))
    checks = [Plausibility(limits_of(rig), DT, None, thresholds) for thresholds in (thresholds_of(rig), Thresholds())]
    own, papers = (opened(each, 44000.0, 0.1, 20000.0 / 44000.0)[0] for each in checks)
    assert own is None
    assert papers.kind is FaultKind.SPEED_JUMP


def test_the_bounds_hold_any_motor_within_the_stated_physics():
    """Random throttles on motors of any allowed time constant and gain: the speed never leaves the bounds."""
    physics = RotorPhysics()
    for seed in range(30):
        dice = np.random.default_rng(seed)
        tau = dice.uniform(physics.tau_fast, physics.tau_slow)
        gain = physics.free * dice.uniform(1.0 - physics.tolerance, 1.0 + physics.tolerance)
        bounds, throttle = RotorBounds(physics), 0.2
        omega = gain * throttle
        bounds.believe(omega, throttle, 0.0)
        for k in range(500):
            if k % 25 == 0:
                throttle = dice.uniform(0.0, 0.5)
            omega += (gain * throttle - omega) * (1.0 - math.exp(-DT / tau))
            bounds.advance(throttle, DT)
            assert bounds.low - 1e-6 <= omega <= bounds.high + 1e-6
            if k % 10 == 9:
                assert bounds.allows(omega)
                bounds.believe(omega, throttle, 0.0)
