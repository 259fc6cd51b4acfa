"""Commands: within a rig's range and slews, whatever the rig; and what a rig.json alone declares."""

import json
from dataclasses import replace

import numpy as np
import pytest
from studies.commands import Count, study

from identification.demo import step_profile
from identification.diagnose.experiment import discriminating_experiment
from vpp_fmu.commands import commanded, idle
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import Record
from vpp_fmu.rig import DECLARED, Rig, declared_rig


def test_no_command_leaves_its_range_or_slew_on_random_rigs():
    count = study(range(150), seed=1, planned=75)
    assert sum(count.outside.values()) == 0, count.outside
    assert sum(count.steeper.values()) == 0, count.steeper
    names = ("plan", "plan, segment", "next experiment", "hil, grid", "hil, steps", "step profile, N")
    assert all(count.checked[name] > 100 for name in names)


def test_the_study_sees_a_command_outside_and_a_slew_exceeded():
    count, rig = Count(), Rig(speed_slew=1000.0)
    count.add("good", rig, np.array([[2000.0, 10.0], [2010.0, -5.0]]), 0.01)
    count.add("bad", rig, np.array([[2000.0, 10.0], [2010.1, -5.0], [6000.1, 10.0001]]), 0.01)
    assert (count.checked["good"], count.outside["good"], count.steeper["good"]) == (4, 0, 0)
    assert (count.checked["bad"], count.steeper["bad"]) == (6, 2)
    assert count.outside["bad"] == 4  # two cells, as they are and as a file shows them


def test_a_step_becomes_a_ramp_of_the_slews_slope_in_whole_tenths():
    rig = Rig(speed=(2013.37, 5987.7), speed_slew=6000.0)
    told = commanded(rig, np.array([[0.0, 1.23456]] + [[1e9, 1.23456]] * 200), 0.005)
    assert told[0, 0] == 2013.4
    np.testing.assert_allclose(np.diff(told[:130, 0]), 30.0, rtol=1e-12)
    assert told[-1, 0] == 5987.7
    assert set(told[:, 1]) == {1.235}


@pytest.mark.parametrize(
    ("speed", "wanted", "told"),
    [
        ((100.0, 250.0), 123.45678, 123.46),
        ((12345.678, 60000.0), 12345.0, 12346.0),
        ((4321.09, 4321.09), 5000.0, 4321.09),
        ((4321.0987, 4321.09870001), 5000.0, 4321.0987),
    ],
)
def test_commands_are_rounded_to_what_their_range_can_tell_apart(speed, wanted, told):
    assert commanded(Rig(speed=speed), np.array([[wanted, 0.0]]), 0.004)[0, 0] == told


def test_a_slow_slew_gets_the_digits_that_it_needs():
    told = commanded(Rig(pitch_slew=0.05), np.array([[2000.0, 0.0]] + [[2000.0, 5.0]] * 100), 0.004)
    np.testing.assert_allclose(np.diff(told[:, 1]), 0.0002, rtol=1e-6)


@pytest.mark.parametrize(
    ("pitch", "beta"), [((-10.0, 10.0), 0.0), ((12.0, 25.0), 12.0), ((-20.0, -3.5), -3.5), ((4.0, 4.0), 4.0)]
)
def test_a_loop_begins_from_the_lowest_speed_and_the_pitch_next_to_0(pitch, beta):
    assert idle(Rig(speed=(900.0, 2500.0), pitch=pitch)) == (900.0, beta)


def test_the_step_profile_is_the_papers_and_leaves_room_on_other_rigs():
    np.testing.assert_allclose(step_profile()["thrust_set"], [1.5, 12.0, 1.5, 1.5])
    np.testing.assert_allclose(step_profile().time, [0.0, 3.0, 6.0, 9.0])
    large = Rig(thrust=(40.0, 140.0), scales=Scales(2500.0, 20.0, -6.0, 200.0, 2.0))
    np.testing.assert_allclose(step_profile(large)["thrust_set"], [43.0, 137.0, 43.0, 43.0])
    assert step_profile(large).time[-1] == 36.0


def moves(column):
    """Rows at which a command changes."""
    return np.flatnonzero(np.diff(column))


def test_the_discriminating_experiment_asks_the_papers_rig_all_it_did():
    found = discriminating_experiment(Rig())
    assert found.time[-1] == pytest.approx(96.0, abs=0.1)
    assert found.period == 0.004
    assert (found["omega_ref"].min(), found["omega_ref"].max(), found["beta_ref"].max()) == (2000.0, 6000.0, 10.0)
    assert found["beta_ref"].min() < -4.0
    sizes = np.unique(np.round(np.abs(np.diff(found["beta_ref"])), 3))
    for share in (0.02, 0.05, 0.1, 0.2):
        assert np.abs(sizes - 15.0 * share).min() < 2e-3  # the stairs
    first, last = found.part(slice(None, 700)), found.part(slice(-700, None))
    for rest in (first, last):
        assert set(rest["omega_ref"]) == {2000.0}
        assert set(rest["beta_ref"]) == {2.5}


@pytest.mark.parametrize(("unit", "seconds"), [(5.0, 960.0), (0.05, 19.2)])
def test_a_slow_rig_gets_a_long_experiment_and_a_fast_one_more_moves(unit, seconds):
    paper, found = discriminating_experiment(Rig()), discriminating_experiment(Rig().timed(unit))
    assert found.time[-1] == pytest.approx(seconds, rel=0.01)
    random = [
        record.part((record.time > 0.04 * record.time[-1]) & (record.time < 0.2 * record.time[-1])) for record in (paper, found)
    ]
    holds = [np.median(np.diff(record.time[moves(record["omega_ref"])])) for record in random]
    assert holds[1] / holds[0] == pytest.approx(unit / 0.5, rel=0.5)


def test_what_stands_is_not_moved_and_the_other_is_asked_everything():
    fixed = discriminating_experiment(Rig(pitch=(4.0, 4.0)))
    assert set(fixed["beta_ref"]) == {4.0}
    sizes = np.unique(np.round(np.abs(np.diff(fixed["omega_ref"])), 1))
    assert {80.0, 200.0, 400.0, 800.0, 4000.0} <= set(sizes)
    still = discriminating_experiment(Rig(speed=(3000.0, 3000.0)))
    assert set(still["omega_ref"]) == {3000.0}
    assert len(moves(still["beta_ref"])) > 1000
    both = discriminating_experiment(Rig(speed=(3000.0, 3000.0), pitch=(4.0, 4.0)))
    assert len(moves(both["omega_ref"])) == len(moves(both["beta_ref"])) == 0


def test_a_slew_is_given_the_time_that_a_full_step_takes():
    slow = discriminating_experiment(Rig(speed_slew=800.0))  # 5 s from end to end
    assert np.abs(np.diff(slow["omega_ref"])).max() <= 800.0 * 0.004 * (1.0 + 1e-9)
    at_top = slow["beta_ref"] == 10.0
    assert (slow["omega_ref"][at_top].min(), slow["omega_ref"][at_top].max()) == (2000.0, 6000.0)


def test_the_campaigns_sampling_is_the_experiments():
    assert discriminating_experiment(Rig(), period=0.01).period == 0.01
    assert discriminating_experiment(Rig(), period=0.125).period == 0.02  # 8 Hz would not draw the moves
    assert Record({"time": np.array([0.0, 0.1, 0.2, 0.5])}, "").period == 0.1


def declared(path, **entries):
    path.write_text(json.dumps({"format": "vpp-rig/1", **entries}))
    return path


RANGES = {"speed": {"min": 6660, "max": 20000}, "pitch": {"min": -12, "max": 12}, "thrust": {"min": -0.1, "max": 1.15}}


def test_a_rig_json_alone_declares_a_rig(tmp_path):
    rig = declared_rig(declared(tmp_path / "rig.json", **RANGES, slew={"pitch": 200}))
    assert (rig.speed, rig.pitch, rig.pitch_slew) == ((6660.0, 20000.0), (-12.0, 12.0), 200.0)
    assert (rig.scales.omega_scale, rig.scales.thrust_scale) == (20000.0, 1.2)
    assert rig.unknown == ()
    assert "slew of pitch 200 deg/s (rig.json)" in rig.command_lines()
    for name in RANGES:
        less = {key: entry for key, entry in RANGES.items() if key != name}
        with pytest.raises(BadInput, match=f"{name}: found nothing"):
            declared_rig(declared(tmp_path / "less.json", **less))


def test_a_rig_json_goes_before_what_was_measured_and_leaves_the_models_scales(tmp_path):
    measured = replace(Rig(), origin={"speed": "the campaign", "pitch": "the campaign"})
    rig = declared_rig(declared(tmp_path / "rig.json", speed=RANGES["speed"], scales={"omega_scale": 30000}), measured)
    assert (rig.speed, rig.pitch, rig.scales) == ((6660.0, 20000.0), measured.pitch, measured.scales)
    assert rig.origin == {"speed": DECLARED, "pitch": "the campaign"}


def test_a_rig_json_tells_the_time_scale_of_a_rig_that_was_measured(tmp_path):
    path = declared(tmp_path / "rig.json", scales={"time_scale": 2.0, "omega_scale": 30000})
    assert declared_rig(path, Rig()).scales == replace(Rig().scales, time_scale=2.0)


@pytest.mark.parametrize(("name", "unit", "own"), [("speed", "rad/s", "rpm"), ("pitch", "rad", "deg"), ("thrust", "kgf", "N")])
def test_a_range_in_another_unit_is_refused(tmp_path, name, unit, own):
    right = {**RANGES, name: RANGES[name] | {"unit": own}}
    assert getattr(declared_rig(declared(tmp_path / "rig.json", **right)), name) == tuple(RANGES[name].values())
    wrong = {**RANGES, name: RANGES[name] | {"unit": unit}}
    with pytest.raises(BadInput, match=f'{name}, unit: found "{unit}", allowed is "{own}"'):
        declared_rig(declared(tmp_path / "rig.json", **wrong))


def test_what_only_the_models_scales_span_is_not_known():
    assert Rig().unknown == ("speed", "pitch")
    assert replace(Rig(), origin={"speed": DECLARED}).unknown == ("pitch",)
