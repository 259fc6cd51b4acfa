"""Numbers as text, with their significant digits, on a rig of any size."""

import json

import numpy as np
import pytest

from vpp_fmu.digits import number, with_uncertainty
from vpp_fmu.structured import as_json


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.123456, "0.123"),
        (0.0118734, "0.0119"),  # a micro rig's error, and the same rig a little better
        (0.0103351, "0.0103"),
        (124.7312, "125"),
        (np.float64(5604.61), "5605"),
        (np.int64(22500), "22500"),
        (20000.0, "20000"),
        (1234567.8, "1.23e+06"),
        (0.00020702, "2.07e-04"),
        (0.0002, "2e-04"),
        (-3e-7, "-3e-07"),
        (0.5, "0.5"),
        (0.50004, "0.500"),  # three digits are known to be these
        (0.99999, "1.00"),
        (999999.9, "1.00e+06"),
        (0.0, "0"),
        (None, "–"),
        (float("nan"), "–"),
        (float("-inf"), "−∞"),
        (True, "True"),
        ("as it is", "as it is"),
    ],
)
def test_numbers_are_written_with_three_digits_and_all_before_the_point(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (1.701, 0.0022, "1.7010 ± 0.0022 deg"),
        (17.01234, 0.5, "17.01 ± 0.50 deg"),
        (1234.5, 300.0, "1234 ± 300 deg"),
        (0.0, 0.01, "0.000 ± 0.010 deg"),
        (2e-5, 3.1e-7, "2.000e-05 ± 3.1e-07 deg"),
        (0.123456789, 1e-12, "0.1234568 ± 1.0e-12 deg"),  # data without noise
        (0.5, 0.0, "0.5 deg"),
        (0.5, float("inf"), "0.5 deg"),
    ],
)
def test_a_value_has_as_many_digits_as_its_uncertainty(value, half, text):
    assert with_uncertainty(value, half, "deg") == text


def test_json_is_strict():
    assert json.loads(as_json({"a": None, "b": 1.5})) == {"a": None, "b": 1.5}
    for value in (float("nan"), float("inf"), -float("inf")):
        with pytest.raises(ValueError, match="JSON compliant"):
            as_json({"deep": [value]})
