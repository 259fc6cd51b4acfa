"""The block bootstrap against theory, with known parameters and known colour of the residual."""

from functools import cache

import numpy as np
import pytest
from studies.synthetic import TRUTH, commands, covariance, measured

from identification.assessment.bootstrap import CHUNK, bootstrap
from identification.fit.problem import Prior
from identification.fit.refine import BASE_PARAMETERS, refine
from vpp_fmu.kernel.plant import AVERAGED, BASE, plant

SECTION = 8.0
"""Seconds of each part of a record: enough for all nine parameters, yet quick."""

COUNT = 100

CALM, MEMORY = 0.05, 0.1
"""Noise [N] small enough for linear theory, and its correlation time [s]."""


@cache
def fitted(seed: int, memory: float, std: float = CALM):
    """The refinement of one synthetic record."""
    rng = np.random.default_rng(seed)
    return refine(BASE, [measured(commands(rng, SECTION), rng, std, memory)], AVERAGED, channels=("thrust",))


@cache
def resampled(seed: int, memory: float):
    """Its bootstrap."""
    return bootstrap(fitted(seed, memory), COUNT, seed)


def theory(problem, memory: float = 0.0) -> np.ndarray:
    """Standard deviations of the parameters from one record of the first experiment alone, at the truth."""
    x, first, experiment = problem.coordinates.vector(TRUTH), problem.blocks[0].at, problem.experiments[0]
    inner = problem.coordinates.jacobian(x)
    scale = experiment.noise.colour.innovation * problem.scale["thrust"] / np.sqrt(len(experiment.records))
    return np.sqrt(np.diag(inner @ covariance(problem.evaluate(x)[1][first] * scale, CALM, memory) @ inner.T))


def white(refinement) -> np.ndarray:
    """Standard deviations under the assumption of white residuals."""
    return refinement.uncertainty.std / refinement.uncertainty.inflation


RECORDS = range(6)


@pytest.mark.parametrize("memory", [0.0, MEMORY])
def test_the_bootstrap_std_is_the_theoretical_scatter_of_the_estimates(memory):
    ratio = np.array([resampled(seed, memory).std / theory(fitted(seed, memory).problem, memory) for seed in RECORDS])
    # The lowest band of a spectrum has twelve ordinates or a few more, an amplitude from them a standard deviation of 14 %, and
    # a hundred samples 7 %: 16 % for a record, 6.5 % for the mean of six, judged at three times that.
    assert ratio.mean(axis=0) == pytest.approx(1.0, abs=0.2)


def test_coloured_residuals_are_not_taken_for_white():
    for seed in RECORDS:
        refinement, samples = fitted(seed, MEMORY), resampled(seed, MEMORY)
        # Theory: six to seven times the white deviation in all parameters.
        assert np.all(samples.std > 3.0 * white(refinement))
        assert samples.ratio == pytest.approx(samples.std / refinement.uncertainty.std)


def test_intervals_cover_the_truth_where_white_ones_do_not():
    truth = np.array([TRUTH[n] for n in BASE_PARAMETERS])
    ours, naive = [], []
    for seed in RECORDS:
        low, high = resampled(seed, MEMORY).intervals.T
        ours.append((low <= truth) & (truth <= high))
        refinement = fitted(seed, MEMORY)
        naive.append(np.abs(refinement.uncertainty.values - truth) <= 1.96 * white(refinement))
    # Of 54 intervals 51 are expected to cover; those of one record are correlated, so six records leave a wide margin.
    assert np.mean(ours) > 0.75
    assert np.mean(naive) < 0.5


def test_numbers_do_not_depend_on_workers():
    refinement = fitted(0, MEMORY)
    alone, two = (bootstrap(refinement, CHUNK + 2, seed=7, workers=n).samples for n in (1, 2))
    assert alone.shape == (CHUNK + 2, 9)
    assert np.array_equal(alone, two)


def test_numbers_on_dask_are_the_same():
    distributed = pytest.importorskip("dask.distributed", reason="dask.distributed is not installed (the extra 'dask')")
    refinement = fitted(0, MEMORY)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        there = bootstrap(refinement, CHUNK + 2, seed=7, scheduler=cluster.scheduler_address)
    assert np.array_equal(there.samples, bootstrap(refinement, CHUNK + 2, seed=7).samples)


def test_a_longer_bootstrap_starts_with_the_shorter_one():
    refinement = fitted(0, 0.0)
    short, long, other = (bootstrap(refinement, n, seed=s).samples for n, s in ((3, 1), (CHUNK + 1, 1), (3, 2)))
    assert np.array_equal(long[:3], short)
    assert not np.any(other == short)


def test_prior_knowledge_scatters_as_its_covariance_says():
    # The map is all prior: with weights that leave thrust almost nothing to say, its spread must be the prior's.
    names = ("c20", "c11")
    known = np.diag([1e-8, 4e-8])
    prior = Prior(names, np.array([TRUTH[n] for n in names]), known)
    rng = np.random.default_rng(0)
    record = measured(commands(rng, SECTION), rng)
    refinement = refine(BASE, [record], TRUTH, prior=prior, channels=("thrust",))
    samples = bootstrap(refinement, COUNT).samples
    at = [BASE_PARAMETERS.index(n) for n in names]
    # A deviation from a hundred samples is known to 7 %.
    assert samples[:, at].std(axis=0) == pytest.approx(np.sqrt(np.diag(known)), rel=0.25)


def test_both_channels_of_two_records_are_drawn_each_from_its_own():
    records = []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        record = measured(commands(rng, SECTION), rng)
        omega = 4000.0 + 500.0 * np.sin(record.time) + rng.normal(0.0, 1.0, len(record))
        records.append(record.with_columns(omega=omega))
    refinement = refine(BASE, records, TRUTH)
    channels = [(b.experiment, b.channel) for b in refinement.problem.blocks]
    assert channels == [(0, "thrust"), (1, "thrust"), (0, "omega"), (1, "omega")]
    samples = bootstrap(refinement, 4)
    assert np.all(np.isfinite(samples.samples))
    assert np.all(samples.std > 0)


def test_the_bootstrap_includes_the_effects_of_the_model():
    rng = np.random.default_rng(0)
    record = measured(commands(rng, SECTION), rng, CALM)
    names = [*BASE_PARAMETERS, "pitch_delay.delay"]
    model = plant(["pitch_delay"])
    refinement = refine(model, [record], TRUTH | {"pitch_delay.delay": 0.01}, names, channels=("thrust",))
    samples = bootstrap(refinement, 3)
    assert samples.names == refinement.names
    assert samples.samples.shape == (3, len(refinement.names))
