"""The static map: its fit, its uncertainty, and its points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from identification.static.at_rest import AtRest
from identification.static.static_map import TERMS, design, fit_static_map, static_fit
from identification.static.steady import samples_needed, steady_points, with_steady_points
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.record import Record

SCALES = BASE.values()
KNOWN = np.array([SCALES[name] for name in TERMS])


def grid(noise: float | np.ndarray = 0.0, seed: int = 0, pitches=None) -> StaticMap:
    """The known map on the paper's grid; each mean has an error of `noise` [N], given as the spread of 100 readings."""
    pitches = np.linspace(-10.0, 10.0, 10) if pitches is None else pitches
    omega, beta = (axis.ravel() for axis in np.meshgrid(np.linspace(2000.0, 6000.0, 10), pitches, indexing="ij"))
    noise = np.broadcast_to(noise, omega.shape)
    thrust = design(omega, beta, SCALES) @ KNOWN * SCALES["thrust_scale"]
    thrust = thrust + noise * np.random.default_rng(seed).standard_normal(len(omega))
    return StaticMap(omega, beta, omega, thrust, np.maximum(noise, 0.01) * 10.0, np.full(len(omega), 100.0), "made up")


def campaign(static: StaticMap, low: float, high: float) -> Campaign:
    """A campaign whose record commands pitch from low to high."""
    columns = {"time": np.arange(3.0), "omega_ref": np.full(3, 4000.0), "beta_ref": np.array([low, high, low])}
    record = Record({**columns, "thrust": np.zeros(3)}, "record")
    return Campaign(Path("made up"), static, (), record, None, None)


def test_all_points_are_used_where_the_map_fits_all():
    static = grid(0.02)
    fit = static_fit(campaign(static, -5.0, 10.0), SCALES)
    assert fit.used.all()
    assert fit.pitch == (-10.0, 10.0)
    assert static_fit(Campaign(Path("made up"), None, (), None, None, None), SCALES) is None


def test_stalled_points_beyond_the_pitch_of_the_records_are_left_out():
    static = grid(0.02)
    stalled = static.beta_ref < -5.0
    bent = replace(static, thrust=np.where(stalled, static.thrust + 5.0, static.thrust))
    fit = static_fit(campaign(bent, -5.0, 10.0), SCALES)
    np.testing.assert_array_equal(fit.used, ~stalled)
    pulls = (np.array(list(fit.coefficients.values())) - KNOWN) / list(fit.std.values())
    assert np.abs(pulls).max() < 4.0
    assert static_fit(campaign(bent, -10.0, 10.0), SCALES).used.all()
    assert fit_static_map(static, SCALES, (-10.0, 0.0)).used.sum() == 50


def map_std(fit, omega, beta):
    """Standard deviation (n,) N of a fitted map at n points: sqrt(a.T C a), with a the terms at a point."""
    a = design(omega, beta, SCALES)
    return np.sqrt(np.einsum("ni,ij,nj->n", a, fit.covariance, a)) * SCALES["thrust_scale"]


@pytest.mark.parametrize(
    ("speeds", "pitches", "not_identifiable"),
    [
        (np.linspace(2000.0, 6000.0, 9), [3.0], {"c20", "c11", "c21", "c12"}),  # w^3 alone bears no power of b
        ([5000.0], np.linspace(-5.0, 10.0, 9), {"c20", "c11", "c30", "c21"}),  # w^j b^2 alone has a power of its own
        ([3000.0, 5000.0], [5.0], set(TERMS)),
        ([5000.0], [5.0], set(TERMS)),
        (np.linspace(2000.0, 6000.0, 6), np.linspace(12.0, 25.0, 6), set()),
    ],
)
def test_coefficients_that_a_grid_does_not_identify_are_named(speeds, pitches, not_identifiable):
    omega, beta = (axis.ravel() for axis in np.meshgrid(speeds, pitches))
    truth, noise = design(omega, beta, SCALES) @ KNOWN * SCALES["thrust_scale"], 0.02
    fits = []
    for seed in range(200):
        thrust = truth + noise * np.random.default_rng(seed).standard_normal(len(omega))
        spread, samples = np.full(len(omega), 10.0 * noise), np.full(len(omega), 100.0)
        fits.append(fit_static_map(StaticMap(omega, beta, omega, thrust, spread, samples, "made up"), SCALES))
    assert {name for fit in fits for name in fit.not_identifiable} == not_identifiable
    # The map at the points themselves is known for any grid: without bias, and with the uncertainty of its scatter.
    shown = np.array([design(omega, beta, SCALES) @ list(fit.coefficients.values()) for fit in fits]) * SCALES["thrust_scale"]
    uncertainty = np.sqrt(np.mean([map_std(fit, omega, beta) ** 2 for fit in fits], axis=0))
    np.testing.assert_allclose(shown.mean(axis=0), truth, atol=4.0 * noise / np.sqrt(len(fits)))
    np.testing.assert_allclose(shown.std(axis=0), uncertainty, rtol=0.2)
    told = [k for k, name in enumerate(TERMS) if name not in not_identifiable]
    pulls = np.array([[(list(f.coefficients.values())[k] - KNOWN[k]) / list(f.std.values())[k] for k in told] for f in fits])
    assert np.all(np.abs(pulls) < 6.0)
    assert all(fit.r2_adjusted is None for fit in fits) == (len(omega) < 3)
    assert (map_std(fits[0], np.array([2000.0]), np.array([-5.0])) > 1.0) == bool(not_identifiable)  # away from the points


def test_the_covariance_is_the_scatter_of_many_campaigns():
    noise = np.where(np.arange(100) % 3 == 0, 0.2, 0.03)
    fits = [fit_static_map(grid(noise, seed), SCALES) for seed in range(1000)]
    found = np.array([list(f.coefficients.values()) for f in fits])
    told = np.mean([f.covariance for f in fits], axis=0)
    np.testing.assert_allclose(found.mean(axis=0), KNOWN, atol=4.0 * np.sqrt(np.diag(told) / 1000).max())
    np.testing.assert_allclose(found.std(axis=0), np.sqrt(np.diag(told)), rtol=0.08)
    np.testing.assert_allclose(np.corrcoef(found.T), told / np.sqrt(np.outer(np.diag(told), np.diag(told))), atol=0.1)
    omega, beta = np.meshgrid([2000.0, 4000.0, 6000.0], [-5.0, 0.0, 10.0])
    thrust = found @ design(omega.ravel(), beta.ravel(), SCALES).T * SCALES["thrust_scale"]
    uncertainty = np.sqrt(np.mean([map_std(f, omega.ravel(), beta.ravel()) ** 2 for f in fits], axis=0))
    np.testing.assert_allclose(thrust.std(axis=0), uncertainty, rtol=0.08)


BENT, ERROR = 0.2, 0.02


def bent() -> StaticMap:
    """The grid of blades that stall by 0.2 w b^3 of the thrust scale, with an error of 0.02 N in each mean."""
    w, b = grid().omega / SCALES["omega_scale"], (grid().beta_ref + SCALES["beta_offset"]) / SCALES["beta_scale"]
    static = grid(ERROR, seed=4)
    return replace(static, thrust=static.thrust + BENT * w * b**3 * SCALES["thrust_scale"])


def told_beside(*effects: str, free: tuple[str, ...], **values: float):
    """Knowledge of the map and of `free` from these points beside effects, linearised at other values than the true ones."""
    static, model = bent(), plant(effects)
    knowledge = AtRest(static, fit_static_map(static, SCALES), SCALES)
    return knowledge(model, model.values(values), ["tau_omega_1", *TERMS, *free])


def test_steady_points_identify_the_map_and_an_effect_of_the_map():
    """Against explicit linear least squares of the six columns: coefficients, and covariance scaled by the residual."""
    static = bent()
    columns = design(static.omega, static.beta_ref, SCALES, [*TERMS.values(), (1, 3)])
    thrust = static.thrust / SCALES["thrust_scale"]
    best, left, *_ = np.linalg.lstsq(columns, thrust, rcond=None)
    covariance = np.linalg.inv(columns.T @ columns) * left[0] / (len(thrust) - 6)
    told = told_beside("map_terms", free=("map_terms.stall",), **{"map_terms.form": 1.0, "map_terms.stall": -0.1})
    assert told.names == (*TERMS, "map_terms.stall")
    np.testing.assert_allclose(told.mean, best, rtol=1e-5)
    np.testing.assert_allclose(told.covariance, covariance, rtol=1e-4)
    std = np.sqrt(np.diag(told.covariance))
    assert np.all(np.abs(told.mean - [*KNOWN, BENT]) < 4.0 * std)
    alone = told_beside(free=())
    assert np.max(np.abs(alone.mean - KNOWN) / std[:5]) > 30.0  # the polynomial alone has absorbed the stall


def test_steady_points_of_raw_samples():
    rng = np.random.default_rng(5)
    held = [(3000.0, 0.0, 8.0), (3000.0, 5.0, 2.0), (4000.0, 5.0, 6.0)]  # the second is over before it has settled
    rows = [round(seconds / 0.01) for *_, seconds in held]
    omega_ref, beta_ref = (np.repeat([point[k] for point in held], rows) for k in (0, 1))
    time = np.arange(len(omega_ref)) * 0.01
    since = np.concatenate([np.arange(n) * 0.01 for n in rows])
    thrust = omega_ref / 1000.0 + 0.1 * rng.standard_normal(len(time)) + np.where(since < 3.0, 40.0, 0.0)
    thrust[[400, 500, 1500]] = np.nan
    omega = np.where(np.arange(len(time)) % 25 == 0, omega_ref + 7.0, np.nan)
    columns = {"time": time, "omega_ref": omega_ref, "beta_ref": beta_ref, "thrust": thrust}
    found = steady_points(Record(columns | {"omega": omega}, "raw"))
    np.testing.assert_array_equal(found.omega_ref, [3000.0, 4000.0])
    np.testing.assert_array_equal(found.beta_ref, [0.0, 5.0])
    np.testing.assert_array_equal(found.omega, [3007.0, 4007.0])
    # White noise: each reading counts, within the precision of eight hundred; all stretches have the same colour.
    assert found.samples[0] / found.samples[1] == pytest.approx(498 / 299)
    assert 0.6 * 498 < found.samples[0] <= 498
    rest = thrust[300:800]
    assert found.thrust[0] == pytest.approx(np.nanmean(rest), rel=1e-12)
    assert found.thrust_std[0] == pytest.approx(np.nanstd(rest, ddof=1), rel=1e-12)
    assert found.source == "raw"
    np.testing.assert_array_equal(steady_points(Record(columns, "raw")).omega, [3000.0, 4000.0])
    assert len(steady_points(Record(columns, "raw"), settle=1.0).thrust) == 3
    with pytest.raises(BadInput, match="raw: steady stretches: found none"):
        steady_points(Record(columns, "raw"), settle=9.0)


def test_the_settled_ends_of_step_responses_are_the_steady_points_where_there_are_no_others():
    time = np.arange(0.0, 3.0, 0.01)

    def run(omega, beta):
        columns = {"time": time, "omega_ref": np.where(time < 0.5, 3000.0, omega), "beta_ref": np.where(time < 0.5, 5.0, beta)}
        thrust = 1e-3 * columns["omega_ref"] - 0.8 * np.where(time < 0.5, 0.0, np.exp(-(time - 0.5) / 0.2))
        return Record(columns | {"thrust": thrust}, f"{omega:g} rpm")

    runs = [run(5000.0, 5.0), run(3000.0, 8.0), run(6000.0, 5.0)]
    found = with_steady_points(Campaign(Path("."), None, runs, None, None, None), lag=0.2).static
    np.testing.assert_array_equal(found.omega_ref, [5000.0, 3000.0, 6000.0])
    np.testing.assert_array_equal(found.beta_ref, [5.0, 8.0, 5.0])
    np.testing.assert_allclose(found.thrust, [5.0, 3.0, 6.0], atol=0.8 * np.exp(-5.0))  # five lags after the step
    for lag in (None, 0.6):  # unknown, or too slow for runs of 2.5 s
        assert with_steady_points(Campaign(Path("."), None, runs, None, None, None), lag).static is None
    means = grid()
    assert with_steady_points(Campaign(Path("."), means, runs, None, None, None), 0.2).static is means


def first_order(rho: float, n: int, seed: int) -> np.ndarray:
    """Noise of variance 1 whose correlation is rho^lag."""
    from scipy.signal import lfilter

    drive = np.random.default_rng(seed).standard_normal(n + 1000) * np.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], drive)[1000:]


@pytest.mark.parametrize("rho", [0.5, 0.9, -0.5])
def test_coloured_readings_need_the_textbooks_inflation(rho):
    runs = [samples_needed(first_order(rho, 20_000, seed), 0.01) for seed in range(24)]
    factor = (1.0 + rho) / (1.0 - rho)
    assert np.mean([r.inflation for r in runs]) == pytest.approx(factor, rel=0.08)
    assert np.mean([r.number for r in runs]) == pytest.approx(factor / 0.01**2, rel=0.1)
    assert np.std([r.inflation for r in runs]) / factor == pytest.approx(runs[0].relative_std, rel=0.5)
    m = runs[0].m
    exact = (factor - 2.0 * rho * (1.0 - rho**m) / (m * (1.0 - rho) ** 2)) / m
    np.testing.assert_allclose(np.mean([r.std**2 for r in runs], axis=0), exact, rtol=0.1)
