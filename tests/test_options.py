"""Every number option of every verb declares its range; all parsers are searched, so that none is forgotten."""

import argparse
import math

import pytest

from vpp_fmu.app.cli import VERBS, parser_of
from vpp_fmu.app.cli.options import Number
from vpp_fmu.files import InFolder

NO_NUMBERS = ("-1e9", "1e400", "nan", "inf", "-inf", "", "two", "1,5", "0x10", "9" * 5000)


def actions(verb, parser):
    """(words that lead there, action) of every option and argument of a verb and its subverbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from actions([*verb, name], below)
        else:
            yield verb, action


EVERY = [found for verb in VERBS for found in actions([verb], parser_of(verb)[0])]
NUMBERS = [(verb, action) for verb, action in EVERY if isinstance(action.type, Number)]


def test_no_option_takes_a_number_without_bounds():
    assert len(NUMBERS) > 40
    for verb, action in EVERY:
        assert action.type in (None, str) or isinstance(action.type, Number | InFolder), (verb, action.dest)
        default = action.default if isinstance(action.default, list | tuple) else [action.default]
        if not isinstance(action.type, Number):
            assert {type(value) for value in default}.isdisjoint({int, float}), (verb, action.dest)


@pytest.mark.parametrize(("verb", "action"), NUMBERS, ids=lambda part: part.dest if hasattr(part, "dest") else " ".join(part))
def test_bounds_are_finite_hold_the_default_and_refuse_what_is_no_number(verb, action):
    kind = action.type
    assert -math.inf < kind.low < kind.high < math.inf
    default = action.default if isinstance(action.default, list | tuple) else [action.default]
    for value in (value for value in default if value is not None):
        assert kind(repr(value)) == value
    for text in (*NO_NUMBERS, repr(kind.low - 1), repr(kind.high * 1.01 + 1)):
        with pytest.raises(argparse.ArgumentTypeError, match="expected a "):
            kind(text)


@pytest.mark.parametrize("verb", sorted({tuple(verb) for verb, _ in NUMBERS}))
def test_a_number_out_of_range_is_refused_in_one_line(verb, refused):
    option = next(action.option_strings[0] for where, action in NUMBERS if tuple(where) == verb and action.nargs is None)
    said = refused(*verb, f"{option}=nan")
    for word in (f"vpp {' '.join(verb)}", option, "found nan", "expected", "--help"):
        assert word in said
