"""Limits: their file, and the limiter, whose outputs never exceed them."""

import dataclasses
import json
import math
import random

import pytest

from hil.safety.faults import FaultKind
from hil.safety.limits import Cut, Limiter, Limits, limits_of, read_limits
from vpp_fmu.errors import BadInput
from vpp_fmu.rig import DECLARED, Rig

DT = 0.004


def written(path, limits, **more):
    path.write_text(json.dumps({"format": "vpp-limits/1", "limits": limits, **more}))
    return path


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"omega_maximum": {"value": 1, "unit": "rpm"}}, 'limits, "omega_maximum": found an unknown field'),
        ({"omega_max": 5000}, "limits, omega_max: found 5000"),
        ({"omega_max": {"value": 80.0, "unit": "Hz"}}, 'limits, omega_max, unit: found "Hz", expected "rpm"'),
        ({"omega_max": {"value": True, "unit": "rpm"}}, "omega_max, value: found true, expected a number"),
        ({"omega_max": {"value": 20000, "unit": "rpm"}}, "omega_trip: found 6900, expected more than omega_max, 20000"),
        ({"omega_max": {"value": 200000, "unit": "rpm"}}, "found 200000, expected a number from 10 to 100000 rpm"),
        ({"thrust_trip": {"value": 20000, "unit": "N"}}, "found 20000, expected a number from 0.01 to 10000 N"),
        ({"omega_max": {"value": math.nan, "unit": "rpm"}}, "found NaN, expected finite numbers"),
        ({"omega_trip": {"value": 5500, "unit": "rpm"}}, "omega_trip: found 5500, expected more than omega_max, 6000"),
        ({"beta_min": {"value": 20, "unit": "deg"}}, "beta_max: found 10, expected at least beta_min, 20"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path, limits, said):
    path = written(tmp_path / "limits.json", limits)
    with pytest.raises(BadInput) as raised:
        read_limits(path)
    assert said in str(raised.value)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(
    ("speed", "pitch", "thrust", "trips"),
    [
        ((6660.0, 20000.0), (-12.0, 12.0), (-0.1, 1.2), (23000.0, 2.0)),
        ((830.0, 2500.0), (12.0, 25.0), (-180.0, 160.0), (2875.0, 300.0)),
        ((5000.0, 5000.0), (4.0, 4.0), (3.0, 15.0), (5750.0, 25.0)),
    ],
)
def test_another_rigs_limits_are_its_ranges_and_trips_beyond_them(speed, pitch, thrust, trips):
    own = limits_of(Rig(speed=speed, pitch=pitch, thrust=thrust))
    assert (own.omega_min, own.omega_max, own.beta_min, own.beta_max) == (*speed, *pitch)
    assert (own.omega_trip, own.thrust_trip) == pytest.approx(trips)
    slow = limits_of(Rig(speed=speed, pitch=pitch, thrust=thrust, speed_slew=500.0, pitch_slew=3.0))
    assert (slow.omega_slew, slow.beta_slew) == (500.0, 3.0)
    assert slow.omega_ramp <= 500.0
    assert slow.beta_ramp <= 3.0


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        (Rig(speed=(2000.0, 150000.0)), "omega_max: found 150000, expected a number from 10 to 100000 rpm"),
        (Rig(thrust=(0.0, 90000.0)), "thrust_trip: found 150000"),
    ],
)
def test_a_rig_beyond_the_bounds_is_refused(rig, said):
    with pytest.raises(BadInput, match=said):
        limits_of(rig, "rig.json")


def test_a_file_may_exceed_a_measured_range_but_not_a_rig_json(tmp_path):
    path = written(tmp_path / "limits.json", {"omega_max": {"value": 5500, "unit": "rpm"}})
    measured = Rig(speed=(2000.0, 5000.0), origin={"speed": "the campaign"})
    assert read_limits(path, measured).omega_max == 5500.0
    declared = dataclasses.replace(measured, origin={"speed": DECLARED})
    with pytest.raises(BadInput, match=r"omega_max: found 5500, expected at most 5000, as rig.json has it"):
        read_limits(path, declared)
    path = written(tmp_path / "limits.json", {"beta_slew": {"value": 90, "unit": "deg/s"}})
    with pytest.raises(BadInput, match=r"beta_slew: found 90, expected at most 45"):
        read_limits(path, Rig(pitch_slew=45.0, origin={"pitch_slew": DECLARED}))


def test_a_step_comes_out_as_a_ramp_of_the_slews_slope():
    limits = Limits()
    limiter = Limiter(limits, 2000.0, 0.0)
    outs = [limiter.apply(4000.0, 6.0, DT) for _ in range(60)]
    for k, out in enumerate(outs, start=1):
        assert out.omega_ref == pytest.approx(min(4000.0, 2000.0 + limits.omega_slew * DT * k))
        assert out.beta_ref == pytest.approx(min(6.0, limits.beta_slew * DT * k))
        slow = Cut.OMEGA_SLEW * (k < 25) | Cut.BETA_SLEW * (k < 25)
        assert out.cut == slow
        assert out.fault is None


def test_spin_up_and_ramp_down_take_the_slow_slope_and_reach_standstill():
    limits = dataclasses.replace(Limits(), omega_min=1500.0)
    limiter, ticks = Limiter(limits), 0
    while limiter.ramp(2000.0, 0.0, DT).cut:
        ticks += 1
    assert ticks == pytest.approx(2000.0 / 4000.0 / DT, abs=1)
    assert limiter.apply(0.0, 0.0, DT).cut == Cut.OMEGA_RANGE | Cut.OMEGA_SLEW
    assert limiter.apply(0.0, 0.0, 1.0)[0] == 1500.0
    for _ in range(400):
        out = limiter.ramp(0.0, 0.0, DT)
    assert out.omega_ref == 0.0


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (3000.0, math.nan), (math.inf, 0.0), (3000.0, -math.inf)])
@pytest.mark.parametrize("move", ["apply", "ramp"])
def test_nan_and_infinity_never_pass(bad, move):
    limiter = Limiter(Limits(), 3000.0, 2.0)
    out = getattr(limiter, move)(*bad, DT)
    assert out[:2] == (3000.0, 2.0)
    assert (out.fault.device, out.fault.kind) == ("controller", FaultKind.NOT_A_NUMBER)
    assert limiter.apply(3000.0, 2.0, DT) == (3000.0, 2.0, Cut.NONE, None)


def test_outputs_are_within_range_and_slope_for_any_input():
    dice, limits = random.Random(5), Limits()
    limiter = Limiter(limits)
    omega, beta, reached = 0.0, 0.0, False
    for _ in range(20000):
        wild = [dice.choice((dice.uniform(-1e4, 2e4), dice.gauss(0, 1e9), math.nan, math.inf, -math.inf)) for _ in range(2)]
        out = limiter.apply(*wild, DT)
        assert abs(out.omega_ref - omega) <= limits.omega_slew * DT * (1 + 1e-9)
        assert abs(out.beta_ref - beta) <= limits.beta_slew * DT * (1 + 1e-9)
        omega, beta = out[:2]
        reached = reached or omega >= limits.omega_min
        assert (limits.omega_min if reached else 0.0) <= omega <= limits.omega_max
        assert limits.beta_min <= beta <= limits.beta_max
