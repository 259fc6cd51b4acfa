"""The coordinates of a fit always represent values within the model's bounds."""

import numpy as np
import pytest
from builders import random_steps

from identification.fit.coordinates import Coordinates
from identification.fit.refine import BASE_PARAMETERS, refine
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

COORDINATES = Coordinates(BASE, BASE_PARAMETERS)


def test_values_at_the_bounds_of_the_coordinates_are_within_the_bounds_of_the_model():
    rng = np.random.default_rng(0)
    bounds = {p.name: (p.minimum, p.maximum) for p in BASE.parameters}
    for _ in range(200):
        x = np.where(rng.random(9) < 0.5, COORDINATES.lower, COORDINATES.upper)
        for name, value in COORDINATES.values(x).items():
            assert bounds[name][0] <= value <= bounds[name][1]


@pytest.mark.parametrize("total", [0.002, 0.5, 40.0, 59.0])
def test_the_jacobian_is_right_also_where_a_lag_is_at_its_minimum(total):
    x = COORDINATES.vector({p.name: p.default for p in BASE.parameters})
    i, j = COORDINATES.pairs[0]
    x[[i, j]] = np.log(total), 0.49
    h, slopes = 1e-6, COORDINATES.jacobian(x)
    for k in range(len(x)):
        up, down = (np.array(list(COORDINATES.values(x + side * h * np.eye(len(x))[k]).values())) for side in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, k], (up - down) / (2.0 * h), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("first", [0.0002, 0.001, 0.05])
def test_a_lag_is_identified_from_a_start_without_it(first):
    """At its minimum a lag has no tangent, so that it would seem not to be identifiable."""
    inputs = random_steps(3001, 40)
    time, truth = 0.004 * np.arange(3001), {"tau_beta_1": 0.3, "tau_beta_2": 0.08}
    shown = Simulator(BASE).simulate(truth, inputs, np.diff(time))[:, 0]
    read = shown + 0.01 * np.random.default_rng(1).standard_normal(len(shown))
    found = refine(BASE, [Record({"time": time, **inputs, "thrust": read}, "made")], {"tau_beta_1": 0.35, "tau_beta_2": first})
    assert "tau_beta_2" in found.names
    for name, value in truth.items():
        assert abs(found.values[name] - value) < 4.0 * found.std[name] < 0.02
