"""Records of the same commands: simulated once, fitted together, and common errors are not taken for independent ones."""

import tracemalloc

import numpy as np
import pytest
from studies.synthetic import STEP, TRUTH, commands, covariance, measured

from identification.fit.problem import Prior, Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings, refine
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.native.simulator import PIECE
from vpp_fmu.record import Record

SECTION = 8.0
"""Seconds of each part of a record."""

CALM = 0.05
"""Noise [N] small enough for linear theory."""


@pytest.fixture(scope="module")
def records():
    """Two records of the same commands with independent noise, and one of other commands."""
    rng = np.random.default_rng(0)
    orders = commands(rng, SECTION)
    return [measured(orders, rng), measured(orders, rng), measured(commands(rng, SECTION), rng)]


def fit(records):
    return refine(BASE, records, AVERAGED, channels=("thrust",))


def theory(problem) -> np.ndarray:
    """Standard deviations of the parameters from one record of the first experiment alone, at the truth."""
    x, first, experiment = problem.coordinates.vector(TRUTH), problem.blocks[0].at, problem.experiments[0]
    inner = problem.coordinates.jacobian(x)
    scale = experiment.noise.colour.innovation * problem.scale["thrust"] / np.sqrt(len(experiment.records))
    return np.sqrt(np.diag(inner @ covariance(problem.evaluate(x)[1][first] * scale, CALM) @ inner.T))


def problem_of(records):
    return Problem(BASE, independent_readings(records, BASE.values()), BASE.values(), BASE_PARAMETERS)


def test_records_of_the_same_commands_are_simulated_once_and_their_thrust_is_averaged(records):
    problem = problem_of(records)
    assert [len(e.records) for e in problem.experiments] == [2, 1]
    runs, simulate = [], problem.simulator.simulate
    problem.simulator.simulate = lambda *run: runs.append(run) or simulate(*run)
    residual, jacobian = problem.rows(TRUTH)
    assert len(runs) == 2
    one, other, third = (problem_of([record]).rows(TRUTH) for record in records)
    rows = len(records[0])
    # The mean of two has half the variance: in units of its standard deviation it is the sum over the root of two.
    np.testing.assert_allclose(residual[:rows], (one[0][:rows] + other[0][:rows]) / np.sqrt(2.0), atol=1e-12)
    np.testing.assert_allclose(jacobian[:rows], np.sqrt(2.0) * one[1][:rows], rtol=1e-12)
    np.testing.assert_allclose(residual[rows : rows + len(records[2])], third[0][: len(records[2])], rtol=1e-12)


def test_a_long_record_costs_no_more_memory_than_its_rows_and_two_jacobians():
    """Twenty pieces: the sensitivities of all outputs would be three Jacobians of the thrust."""
    rows = 20 * PIECE
    commands = {"omega_ref": np.where(np.arange(rows) // 500 % 2, 4000.0, 5000.0), "beta_ref": np.full(rows, 5.0)}
    record = Record({"time": STEP * np.arange(rows), **commands, "thrust": np.zeros(rows)}, "made")
    problem = problem_of([record])
    problem.rows(TRUTH)  # compiles
    tracemalloc.start()
    _, jacobian = problem.rows(TRUTH)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    signals = (len(record.columns) + len(problem.simulator.outputs) + 4) * 8 * rows
    assert most < 2 * jacobian.nbytes + signals


def test_other_times_or_commands_make_another_record(records):
    later = records[0].with_columns(time=records[0].time * 1.25)
    other = records[0].with_columns(beta_ref=records[0]["beta_ref"] + 1e-9)
    assert [len(e.records) for e in independent_readings([records[0], later, other], BASE.values())] == [1, 1, 1]


def test_a_reading_that_one_of_two_records_lacks_counts_in_neither(records):
    holed = records[1].with_columns(thrust=np.where(np.arange(len(records[1])) % 7, records[1]["thrust"], np.nan))
    (experiment,) = independent_readings([records[0], holed], BASE.values())
    assert experiment.sizes["thrust"] == int(np.isfinite(holed["thrust"]).sum())


@pytest.mark.parametrize("known", [False, True])
def test_the_same_record_twice_adds_no_information(records, known):
    """Also against a prior, it has the weight of one."""
    prior = Prior(("c20", "c21"), np.array([0.36, 0.81]), np.diag([1e-5, 1e-5])) if known else None
    found = [refine(BASE, part, AVERAGED, prior=prior, channels=("thrust",)) for part in (records[:1], [records[0]] * 2)]
    once, twice = (f.uncertainty for f in found)
    loose = 100.0 if known else 1.0
    np.testing.assert_allclose(twice.values, once.values, rtol=1e-6 * loose)
    np.testing.assert_allclose(twice.std, once.std, rtol=1e-5 * loose)
    assert known or twice.inflation == pytest.approx(once.inflation, rel=1e-5)


def test_independent_noise_halves_the_variance():
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        orders = commands(rng, SECTION)
        found = fit([measured(orders, rng, CALM), measured(orders, rng, CALM)])
        ratios.append(found.uncertainty.std / theory(found.problem))
    # A deviation is known to 14 % from a record, to 6 % from six; judged at three times that.
    assert np.mean(ratios, axis=0) == pytest.approx(1.0 / np.sqrt(2.0), abs=0.15)


def test_an_error_shared_by_both_records_is_not_averaged_out(records):
    """A slow model error in both, larger than the noise: a second record hardly improves the estimate."""
    time = np.arange(len(records[0])) * STEP
    wave = 0.5 * np.sin(2.0 * np.pi * time / 3.0) * np.sin(2.0 * np.pi * time / 23.0)
    shared = [record.with_columns(thrust=record["thrust"] + wave) for record in records[:2]]
    once, twice = fit(shared[:1]), fit(shared)
    ratio = twice.uncertainty.std / once.uncertainty.std
    assert np.median(ratio) > 0.85
