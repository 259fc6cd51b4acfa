"""Numbers as text, with their significant digits, on a rig of any size."""

import json

import numpy as np
import pytest

from vpp_fmu.digits import interval, number, signed, with_uncertainty
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


def test_digits_do_not_depend_on_the_unit():
    rng = np.random.default_rng(0)
    for value in rng.uniform(0.1, 1.0, 200) * 10.0 ** rng.uniform(-9.0, 9.0, 200):
        assert float(number(value)) == pytest.approx(value, rel=5e-3)
        assert float(number(value, 2)) == pytest.approx(value, rel=5e-2)


def test_a_sign_is_shown_where_it_is_asked_for():
    assert [signed(v) for v in (0.25, -0.25, 0.0, None)] == ["+0.25", "-0.25", "0", "–"]


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


def test_the_ends_of_an_interval_can_be_told_apart():
    assert interval(1.701, 1.7054) == "1.7010 to 1.7054"  # one that ends at its estimate
    assert interval(-0.4, 12.0, "N") == "0 to 12 N"
    assert interval(0.3, 0.3, "N") == "0.3 N"
    rng = np.random.default_rng(1)
    for low, width in zip(rng.normal(size=200), 10.0 ** rng.uniform(-5.0, 3.0, 200), strict=True):
        first, last = map(float, interval(low, low + width).split(" to "))
        assert last - first == pytest.approx(width, rel=0.15)


def test_json_is_strict():
    assert json.loads(as_json({"a": None, "b": 1.5})) == {"a": None, "b": 1.5}
    for value in (float("nan"), float("inf"), -float("inf")):
        with pytest.raises(ValueError, match="JSON compliant"):
            as_json({"deep": [value]})
