"""The study of the emulated rig's hidden effects: its sizes, and how it counts names."""

import pytest
from studies.hidden import OWN, RELATED, group, others, sizes

from hil.emulator.rig import NEAREST
from hil.physics.rig_model import library
from vpp_fmu.kernel.plant import LIBRARY

HIDDEN = [e for e in library(commanded=False) if e.off is not None]


def test_sizes_are_shares_of_the_distance_from_off():
    by_name = {e.name: sizes(e) for e in HIDDEN}
    assert by_name["lac_command_deadband"] == [0.5, 1.0, 2.0]  # deg
    assert by_name["load_cell_gain"] == pytest.approx([1.025, 1.05, 1.1])
    assert by_name["esc_freewheel"] == [0.25, 0.5, 1.0]  # no more than all of it
    assert by_name["rod_speed_limit"] == [4.0, 8.0, 16.0]  # deg/s; off is no limit


def test_names_that_count_are_in_the_library():
    known = {e.name for e in LIBRARY if e.off is not None}
    assert {*OWN, *NEAREST.values(), *(name for names in RELATED.values() for name in names)} <= known
    assert {*NEAREST, *RELATED} <= {e.name for e in HIDDEN}


ROW = {"hidden": "lac_command_deadband=1", "failed": None, "verdict": "attributed", "effects": {}}
ROW |= {"family": {}, "learned": None, "error": [0.25, 0.17], "noise": 0.129, "cpu": 30.0}
ROW |= {"channels": {"speed": {"verdict": "none", "effects": []}, "thrust": {"verdict": "attributed", "effects": []}}}


@pytest.mark.parametrize(
    ("change", "counted", "more"),
    [
        ({"effects": {"pitch_command_deadband": {"half_width": 1.0}, "inflow_lag": {}}}, "right", []),
        ({"effects": {"pitch_stop_restart": {}}}, "related", []),
        ({"effects": {"map_terms": {}}, "family": {"map_terms": ["pitch_command_deadband"]}}, "right", []),
        ({"effects": {"map_terms": {}, "inflow_lag": {}}}, "other", ["map_terms"]),
        ({"effects": {"inflow_lag": {}}}, "own only", []),
        ({"effects": {"learned": {}}, "learned": ["pitch_command", "pitch"], "verdict": "learned"}, "learned", []),
        ({"verdict": "unexplained"}, "says so", []),
        ({"verdict": "none"}, "none", []),
        ({"hidden": "speed_hunting=0.01", "effects": {"speed_dependent_lag": {}}}, "own only", []),
        ({"hidden": "", "effects": {"recirculation": {}}}, "other", ["recirculation"]),
    ],
)
def test_a_name_is_counted_by_what_is_hidden(change, counted, more):
    assert (group(ROW | change), others(ROW | change)) == (counted, more)
