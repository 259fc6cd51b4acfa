"""Profile-likelihood intervals against closed forms or an independent search."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from identification.assessment.profile import profiled
from identification.diagnose.search.fits import Searcher
from identification.fit.coordinates import Coordinates
from identification.fit.experiment import Experiment
from identification.fit.least_squares import solve
from identification.fit.noise import independent
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.roles import Fitted
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.types import Effect, Model, Parameter
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


class Level:
    """A problem of one parameter p: readings of `curve`(p), which has the slope `slope`(p)."""

    def __init__(self, readings, curve, slope, minimum=-10.0):
        effect = Effect("level", "", parameters=(Parameter("p", "1", 0.5, minimum, 10.0, ""),))
        self.model = Model("level", "", (), (), (effect,))
        self.coordinates = Coordinates(self.model, ["p"])
        self.readings, self.curve, self.slope = readings, curve, slope

    def rows(self, values, inner=None):
        p = values["p"]
        jacobian = np.full((len(self.readings), 1), self.slope(p))
        return self.curve(p) - self.readings, jacobian if inner is None else jacobian @ inner

    def solution(self):
        def evaluate(x):
            return self.rows({"p": float(x[0])})

        return solve(evaluate, np.array([0.5]), self.coordinates.lower, self.coordinates.upper)

    def interval(self, inflation=1.0, std=None):
        found = self.solution()
        n, slope = len(self.readings), self.slope(float(found.value[0]))
        own = inflation * np.sqrt(2.0 * found.cost / (n - 1) / n) / abs(slope) if std is None else std
        uncertainty = Uncertainty(("p",), found.value, np.array([[own**2]]), np.array([inflation]))
        return profiled(self, found, uncertainty)


@pytest.fixture
def readings():
    """Twenty readings with a mean of exactly 1 and a standard deviation of exactly 1."""
    values = np.random.default_rng(0).normal(size=20)
    values -= values.mean()
    return 1.0 + values / values.std(ddof=1)


@pytest.mark.parametrize("inflation", [1.0, 2.0])
def test_the_interval_of_a_logarithm_is_the_logarithm_of_the_interval(readings, inflation):
    """The interval of exp(p) is that of a mean, so that of p is its logarithm, whatever the inflation for coloured noise."""
    found = Level(readings, np.exp, np.exp).interval(inflation)
    half = inflation * NORMAL_95 / np.sqrt(20.0)
    assert found.profiled == ("p",)
    assert np.exp(found.intervals[0]) == pytest.approx([1.0 - half, 1.0 + half], abs=0.02 * half)


def test_a_parabola_keeps_its_interval(readings):
    level = Level(readings, lambda p: 2.0 * p, lambda p: 2.0)
    found = level.interval()
    half = NORMAL_95 / np.sqrt(20.0) / 2.0
    assert found.profiled == ()
    assert found.intervals[0] == pytest.approx([0.5 - half, 0.5 + half], rel=1e-6)


def test_the_interval_at_a_bound_is_the_likelihood_interval(readings):
    """A mean of -0.3 that may not be negative: the cost n (t + 0.3)^2 / 2 increases by 1.92 from t = 0 on."""
    level = Level(readings - 1.3, lambda p: p, lambda p: 1.0, minimum=0.0)
    found = level.interval(std=0.0)
    variance = 2.0 * level.solution().cost / 19.0
    assert found.intervals[0, 0] == 0.0
    assert found.intervals[0, 1] == pytest.approx(-0.3 + np.sqrt(0.09 + NORMAL_95**2 * variance / 20.0), rel=0.02)


def test_an_interval_reaches_other_optima_that_the_data_leave_open(readings):
    """cos(p) has the same minimum at p and at -p: a search from one never reaches the other."""
    level = Level(readings - 0.5, np.cos, lambda p: -np.sin(p))
    found = level.solution()
    own = np.sqrt(2.0 * found.cost / 19.0 / 20.0) / abs(np.sin(float(found.value[0])))
    uncertainty = Uncertainty(("p",), found.value, np.array([[own**2]]), np.ones(1))
    mirrored = replace(found, value=-found.value)
    worse = replace(mirrored, value=-2.0 * found.value, costs=(found.cost + 3.0,))  # 95 % allow 1.92
    for others in ((mirrored,), (mirrored, worse)):
        told = profiled(level, found, uncertainty, others)
        assert told.intervals[0, 0] == pytest.approx(-float(found.value[0]))
    assert told.intervals[0, 1] == pytest.approx(profiled(level, found, uncertainty).intervals[0, 1])


@pytest.mark.parametrize(("seed", "noise"), [(0, 0.08), (3, 0.15), (5, 0.15), (0, 0.3)])
def test_the_interval_of_a_size_includes_off_where_the_likelihood_ratio_does(seed, noise):
    """Beside two pitch lags, a weak inflow lag is far from linear: the linear interval includes 0 at a ratio of 7 nats."""
    rng, time = np.random.default_rng(seed), 0.04 * np.arange(1500)
    columns = {"time": time, "omega_ref": np.full(1500, 5000.0), "beta_ref": np.repeat(rng.uniform(0.0, 9.0, 60), 25)}
    true = {"inflow_lag.gain": 0.4, "inflow_lag.time_constant": 0.15, "inflow_lag.form": 1.0}
    model = plant(["inflow_lag"])
    shown = Simulator(model).simulate(model.values(true), columns, np.diff(time))[:, 0]
    record = Record(columns | {"thrust": shown + noise * rng.standard_normal(1500)}, "record")
    names, values = ["tau_beta_1", "tau_beta_2", "c20", "c11"], plant().values()
    searcher = Searcher([Experiment([Fitted("record", record)], independent(15.0))], names, None, LIBRARY)
    free = ["inflow_lag.gain", "inflow_lag.time_constant"]
    found = searcher.fit(["inflow_lag"], {"inflow_lag.form": 1.0}, free, {**values, **true})
    ratio = searcher.fit([], {}, [], values).deviance - found.deviance
    low, _ = found.intervals()["inflow_lag.gain"]
    # The interval's residual variance is estimated: near the limit, either is right.
    assert (low > 0.0) == (ratio > chi2.ppf(0.95, 1)) or abs(ratio / chi2.ppf(0.95, 1) - 1.0) < 0.1
