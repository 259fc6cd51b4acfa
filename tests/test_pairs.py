"""The order of a channel's two lags: a convention if the data do not determine it, else that of the data."""

import numpy as np
import pytest

from identification.assessment.pairs import agreed_order, exchangeable
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.record import Record

TIME = np.arange(0.0, 8.0, 0.01)
RECORD = Record(
    {"time": TIME, "omega_ref": np.where(TIME % 4.0 < 2.0, 3000.0, 5000.0), "beta_ref": np.where(TIME % 3.0 < 1.5, -2.0, 8.0)},
    "steps",
)
SWAPPED = {"tau_beta_1": "tau_beta_2", "tau_beta_2": "tau_beta_1"}  # the paper's published pitch lags have the faster one first


@pytest.mark.parametrize(
    ("effect", "values", "free"),
    [
        (None, {}, True),
        ("pitch_command_deadband", {"half_width": 1.0}, True),  # before both lags
        ("pitch_delay", {"delay": 0.05}, True),
        ("pitch_backlash", {"half_gap": 0.5, "form": 1.0}, True),  # behind both
        ("pitch_backlash", {"half_gap": 0.5, "form": 2.0}, False),  # between them
        ("pitch_rate_limit", {"rate": 6.0, "form": 2.0}, False),  # in the outer one
        ("pitch_rate_limit", {"rate": 900.0, "form": 2.0}, True),  # which nothing here runs into
        ("pitch_asymmetry", {"asymmetry": 0.3}, False),
    ],
)
def test_lags_are_exchangeable_unless_an_effect_stands_between(effect, values, free):
    model = plant([effect] if effect else [])
    at = model.values(FINE_TUNED | {f"{effect}.{n}": v for n, v in values.items()})
    assert exchangeable(model, at, RECORD, "beta") == free
    assert exchangeable(model, at, RECORD, "omega")
    assert agreed_order(model, at, RECORD) == (SWAPPED if free else {})
