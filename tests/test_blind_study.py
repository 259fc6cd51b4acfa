"""Facts of the blind study that must hold: hidden effects are named and no others, on rigs of any size."""

from studies import scores
from studies.cases import WHOLE, draw
from studies.diagnosis import outcome

from vpp_fmu.kernel.plant import LIBRARY

SHORT = ("pitch_command_deadband", "pitch_backlash", "speed_delay", "sensor_drift")
"""Effects that the diagnosis may choose from here; the whole library is for the study itself."""

SOME = tuple(e for e in LIBRARY if e.off is None or e.name in SHORT)

LIKE = {"noise": "white", "level": 1.0, "strength": 1.0, "locked": True} | WHOLE


def studied(kind, *hidden, size="paper", rate=100, seconds=20.0, **like):
    """The outcome of a case of full size, with all files except those in `like`."""
    case = draw(0, kind, SHORT, hidden, size=size, rate=rate, seconds=seconds, **(LIKE | like))
    return outcome(case, library=SOME)


def test_nothing_is_named_where_nothing_is_hidden():
    found = studied("none")
    assert found["verdict"] == "none"
    assert not scores.found(found)


def test_two_effects_are_both_named():
    found = studied("pair", "pitch_command_deadband", "sensor_drift")
    assert scores.hit(found)
    assert not scores.worse(found)


def test_a_term_of_the_speed_is_learned_where_the_speed_shows_no_lack_of_fit():
    """One mark per revolution is coarse: the thrust, or the validation record, shows that something is missing."""
    found = studied("single", "speed_dependent_lag")  # SOME lacks it
    assert found["verdict"] == "learned"
    before, after = found["true_error"]
    assert after < 0.5 * before
