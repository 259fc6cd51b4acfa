"""Limits: their file, and that nothing the limiter lets out is ever outside them."""

import dataclasses
import json
import math
import random

import pytest

from hil.safety.faults import FaultKind
from hil.safety.limits import Cut, Limiter, Limits, read_limits
from vpp_fmu.errors import BadInput

DT = 0.004


def written(path, limits, **more):
    path.write_text(json.dumps({"format": "vpp-limits/1", "limits": limits, **more}))
    return path


def test_a_file_changes_what_it_names(tmp_path):
    path = written(tmp_path / "limits.json", {"omega_max": {"value": 5000, "unit": "rpm"}})
    assert read_limits(path) == dataclasses.replace(Limits(), omega_max=5000.0)


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"omega_maximum": {"value": 1, "unit": "rpm"}}, 'limits, "omega_maximum": found a field that is not known'),
        ({"omega_max": 5000}, "limits, omega_max: found 5000"),
        ({"omega_max": {"value": 80.0, "unit": "Hz"}}, 'limits, omega_max, unit: found "Hz", allowed is "rpm"'),
        ({"omega_max": {"value": True, "unit": "rpm"}}, "omega_max, value: found true, allowed is a number"),
        ({"omega_max": {"value": 20000, "unit": "rpm"}}, "found 20000, allowed is a number from 100 to 12000 rpm"),
        ({"omega_max": {"value": math.nan, "unit": "rpm"}}, "found NaN, allowed is finite numbers"),
        ({"omega_trip": {"value": 5500, "unit": "rpm"}}, "omega_trip: found 5500, allowed is more than omega_max, 6000"),
        ({"beta_min": {"value": 20, "unit": "deg"}}, "beta_max: found 10, allowed is more than beta_min, 20"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path, limits, said):
    path = written(tmp_path / "limits.json", limits)
    with pytest.raises(BadInput) as raised:
        read_limits(path)
    assert said in str(raised.value)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "vpp-limits/2", "limits": {}}', '{"format": "vpp-limits/1"}'])
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "limits.json"
    path.write_text(text)
    with pytest.raises(BadInput):
        read_limits(path)


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
    limiter, ticks = Limiter(Limits()), 0
    while limiter.ramp(2000.0, 0.0, DT).cut:
        ticks += 1
    assert ticks == pytest.approx(2000.0 / 4000.0 / DT, abs=1)
    assert limiter.apply(0.0, 0.0, DT).cut == Cut.OMEGA_RANGE | Cut.OMEGA_SLEW
    assert limiter.apply(0.0, 0.0, 1.0)[0] == Limits().omega_min
    for _ in range(400):
        out = limiter.ramp(0.0, 0.0, DT)
    assert out.omega_ref == 0.0


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (3000.0, math.nan), (math.inf, 0.0), (3000.0, -math.inf)])
@pytest.mark.parametrize("move", ["apply", "ramp"])
def test_no_number_never_passes(bad, move):
    limiter = Limiter(Limits(), 3000.0, 2.0)
    out = getattr(limiter, move)(*bad, DT)
    assert out[:2] == (3000.0, 2.0)
    assert (out.fault.device, out.fault.kind) == ("controller", FaultKind.NOT_A_NUMBER)
    assert limiter.apply(3000.0, 2.0, DT) == (3000.0, 2.0, Cut.NONE, None)


def test_whatever_comes_in_what_goes_out_is_within_range_and_slope():
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
