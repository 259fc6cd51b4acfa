"""Size of the model error, from errors of known size at a known number of places."""

import numpy as np
import pytest

from identification.assessment.model_error import model_error
from identification.assessment.prediction import Prediction
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.native.simulator import Simulator
from vpp_fmu.record import Record

DT, STAY, ERROR = 0.01, 4.0, 0.2
VALUES = BASE.values()


@pytest.fixture(scope="module")
def visits():
    """200 places of the map in random order, 4 s each; each place has its own constant error of the reading [N]."""
    dice = np.random.default_rng(3)
    grid = [(w, b) for w in np.linspace(2100.0, 5900.0, 10) for b in np.linspace(-4.9, 9.9, 20)]
    order, rows = dice.permutation(len(grid)), round(STAY / DT)
    omega, beta = np.repeat([grid[k] for k in order], rows, axis=0).T
    own = np.repeat(ERROR * dice.standard_normal(len(grid)), rows)
    shown = Simulator(BASE).simulate({}, {"omega_ref": omega, "beta_ref": beta}, np.full(len(omega) - 1, DT))
    thrust = shown[:, 0] + own
    columns = {"time": np.arange(len(omega)) * DT, "omega_ref": omega, "beta_ref": beta, "thrust": thrust}
    return Prediction(Record(columns, "visits"), *shown.T)


def test_at_places_that_were_not_fitted_the_model_error_is_their_rms(visits):
    found = model_error([], [visits], VALUES, 9, noise=0.0)
    assert found.steady == pytest.approx(ERROR, rel=4.0 / (2 * 200) ** 0.5)
    assert found.freedom == 4 * 5  # boxes of 0.2 by 0.2 from 0.35 to 0.98 and from 0.01 to 0.99


def test_at_fitted_places_the_model_error_is_scaled_by_the_degrees_of_freedom(visits):
    unseen, fitted = (model_error(*records, VALUES, 9, noise=0.0) for records in (([], [visits]), ([visits], [])))
    assert fitted.freedom == unseen.freedom - 9
    assert (fitted.steady / unseen.steady) ** 2 == pytest.approx(unseen.freedom / fitted.freedom)
    assert model_error([visits], [], VALUES, 400, noise=0.0) is None  # more parameters than places: no information


def test_steady_points_lose_the_degrees_of_freedom_of_their_map():
    points = np.full(25, 0.1)
    found = model_error([], [], VALUES, 9, 0.0, points, terms=5)
    assert found.steady == pytest.approx(0.1 * (25 / 20) ** 0.5)
    assert (found.moving, found.freedom) == (0.0, 20)


def test_a_late_reading_is_an_error_of_the_moves_alone(visits):
    """A reading that is 0.1 s late is wrong during moves alone."""
    late = visits.record.with_columns(thrust=np.concatenate([np.full(10, visits.thrust[0]), visits.thrust[:-10]]))
    found = model_error([], [Prediction(late, visits.thrust, visits.omega, visits.beta)], VALUES, 9, noise=0.0)
    assert found.steady < 0.02
    assert found.moving > 0.03
