"""The coordinates of a fit: whatever they are, the values they stand for are within the model's bounds."""

import numpy as np
import pytest

from identification.fit.coordinates import Coordinates
from identification.fit.refine import BASE_PARAMETERS
from vpp_fmu.kernel.plant import BASE

COORDINATES = Coordinates(BASE, BASE_PARAMETERS)


def test_values_at_the_coordinates_bounds_are_allowed_ones():
    rng = np.random.default_rng(0)
    bounds = {p.name: (p.minimum, p.maximum) for p in BASE.parameters}
    for _ in range(200):
        x = np.where(rng.random(9) < 0.5, COORDINATES.lower, COORDINATES.upper)
        for name, value in COORDINATES.values(x).items():
            assert bounds[name][0] <= value <= bounds[name][1]


@pytest.mark.parametrize("total", [0.002, 0.5, 40.0, 59.0])
def test_slopes_are_those_of_the_values_also_where_a_lag_has_ended(total):
    x = COORDINATES.vector({p.name: p.default for p in BASE.parameters})
    i, j = COORDINATES.pairs[0]
    x[[i, j]] = np.log(total), 0.49
    h, slopes = 1e-6, COORDINATES.jacobian(x)
    for k in range(len(x)):
        up, down = (np.array(list(COORDINATES.values(x + side * h * np.eye(len(x))[k]).values())) for side in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, k], (up - down) / (2.0 * h), rtol=1e-5, atol=1e-7)
