"""Facts of the blind study that must hold: the right name where there is one, none where there is none."""

import pytest
from studies import detectable, scores
from studies.cases import Case
from studies.diagnosis import outcome
from studies.rig import Rig

from vpp_fmu.kernel.plant import LIBRARY

SHORT = (
    "pitch_command_deadband",
    "pitch_error_deadzone",
    "pitch_backlash",
    "pitch_speed_coupling",
    "pitch_delay",
    "sensor_drift",
)
"""Effects that the diagnosis may choose from here; the whole library is for the study itself."""


def library(*names):
    """The library with these effects only."""
    return tuple(e for e in LIBRARY if e.off is None or e.name in names)


SOME = library(*SHORT)


def studied(case):
    """The case's outcome; skips where the library lacks what the case hides."""
    if missing := set(case.hidden) - {e.name for e in SOME}:
        pytest.skip(f"not in the library: {', '.join(sorted(missing))}")
    return outcome(case, library=SOME)


@pytest.mark.parametrize("name", ["pitch_command_deadband", "pitch_speed_coupling"])
def test_single_effect_is_named(name):
    found = studied(Case("singles", (name,), 0))
    assert scores.hit(found)
    assert found["removed"] > 0.9
    assert all(good for *_, good in found["parameters"].values())
    assert found["parameters"]


def test_a_threshold_between_the_fitted_commands_is_placed_by_the_unseen_ones():
    found = studied(Case("singles", ("pitch_command_deadband",), 60))  # the fitted records leave 1.5 % open
    assert scores.hit(found)
    assert found["removed"] > 0.99
    ((true, value, *_),) = found["parameters"].values()
    assert value == pytest.approx(true, rel=0.005)


def test_a_stop_that_the_fitted_records_never_meet_is_not_put_where_others_do():
    # Validation goes below the -3 deg at which a look had left the other stop.
    case = Case("singles", ("pitch_travel_limit",), 32)
    found = outcome(case, library=library("pitch_travel_limit", "map_terms"))
    assert scores.hit(found)
    assert "pitch_travel_limit.minimum" not in found["values"]
    assert found["removed"] > 0.98


def test_a_small_effect_stands_beside_a_large_one_of_another_channel():
    case = Case("pairs", ("pitch_command_deadband", "stand_resonance"), 80)  # 0.5 % of what both explain
    found = outcome(case, library=library("pitch_command_deadband", "pitch_error_deadzone", "stand_resonance"))
    assert scores.hit(found)
    assert all(good for *_, good in found["parameters"].values())


def test_what_the_fitted_records_show_at_one_point_only_is_placed_by_the_unseen_ones():
    case = Case("singles", ("supply_sag",), 83)  # the limit that falls with pitch is met at one pitch only
    found = outcome(case, library=library("supply_sag", "speed_saturation", "speed_dependent_lag"))
    assert scores.hit(found)
    assert found["removed"] > 0.99
    assert not found["parameters"]  # limit and slope at that pitch go together: no interval of either is claimed
    for name, true in case.truth(found["sizes"]).items():
        assert found["values"][name] == pytest.approx(true, rel=0.05)


def test_an_effect_is_found_from_its_special_case():
    case = Case("singles", ("pitch_speed_limits",), 82)  # from anywhere else the fit ends where the least speed is none
    found = outcome(case, library=library("pitch_speed_limits", "pitch_rate_limit"))
    assert found["verdict"] == "attributed"
    assert found["effects"] == ["pitch_speed_limits"]
    assert found["removed"] > 0.99
    assert found["parameters"]["pitch_speed_limits.slowest"][-1]
    assert found["parameters"]["pitch_speed_limits.full"][-1]


def test_what_a_better_start_gains_is_not_another_effect_s():
    # Beside a dead band that stopped at the second best place, any candidate's refit would gain what the best place does.
    case = Case("singles", ("pitch_command_deadband",), 92)
    found = outcome(case, library=library("pitch_command_deadband", "inflow_lag", "map_terms"))
    assert scores.hit(found)
    assert found["effects"] == ["pitch_command_deadband"]


def test_a_wider_effect_that_comes_down_to_a_simple_one_goes_by_its_name():
    case = Case("singles", ("pitch_stop_band",), 92)
    found = outcome(case, library=library("pitch_stop_band", "pitch_speed_limits", "pitch_stop_restart"))
    assert scores.hit(found)
    assert found["effects"] == ["pitch_stop_band"]


def test_what_only_the_fitted_records_like_is_not_built_upon():
    case = Case("deleted", ("pitch_asymmetry",), 80, "pitch_asymmetry")
    found = outcome(case, library=library("pitch_asymmetry", "map_terms", "pitch_rate_limit", "thrust_gain_drift"))
    assert found["verdict"] == "unexplained"
    assert not found["effects"]
    assert len(found["rounds"]) == 1
    for name in ("map_terms", "pitch_rate_limit", "thrust_gain_drift"):  # each promises a log-likelihood of 100 on those
        assert any("unseen data" in why for why in found["refused"][name])


def test_nothing_is_named_where_nothing_is_hidden():
    found = studied(Case("none", (), 0))
    assert found["verdict"] == "none"
    assert found["effects"] == []


def test_effect_out_of_the_library_is_not_replaced_by_another():
    found = studied(Case("deleted", ("pitch_command_deadband",), 0, deleted="pitch_command_deadband"))
    assert not scores.wrong(found)
    assert found["verdict"] != "none"


def test_small_effect_is_found_beside_a_large_one():
    found = studied(Case("pairs", ("pitch_delay", "sensor_drift"), 40))
    assert scores.hit(found)
    assert all(good for *_, good in found["parameters"].values())


def test_a_pair_is_as_detectable_as_its_fainter_effect():
    case = Case("pairs", ("pitch_delay", "supply_sag"), 40)
    measured, rig, sizes = case.build()
    speed, pitch = measured.open_loop["omega_ref"], measured.open_loop["beta_ref"]
    base = {k: v for k, v in rig.settings.items() if k not in sizes}
    delay, sag = (detectable.evidence(Rig(base | {k: sizes[k]}), base, speed, pitch) for k in ("pitch_delay", "droop"))
    assert sag > 1000.0 * delay  # 11 ms of delay, a tenth of the speed at full load
    assert case.evidence(measured, rig) == pytest.approx(delay, rel=0.3)
