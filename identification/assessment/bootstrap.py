"""Block bootstrap of a fit: scatter of the estimates over resampled residuals.

The residual of each channel of each record is resampled in blocks of BLOCK seconds that may wrap around the record's end
(circular block bootstrap: Politis and Romano, 1992). It is added to the model's prediction, and the parameters are refitted
from the optimum. Records of the same commands get the same blocks, so they still share the model error. The noise that the fit
absorbed is first restored, by frequency. Unlike the covariance this needs no linearisation: near a bound or a double pole the
intervals are asymmetric. It assumes a residual of constant colour and size along the record; the covariance does not. The
channels' weights are fixed; a prior is resampled from its covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from identification.fit.experiment import Experiment
from identification.fit.least_squares import solve
from identification.fit.problem import Block, Prior, Problem
from identification.fit.refine import Refinement
from identification.fit.uncertainty import restored
from identification.workers import spread
from vpp_fmu.kernel.plant import plant

BLOCK = 2.0
"""Length of a block, s: several correlation times of the rig's residuals. A correlation at lag l decreases to 1 - l / BLOCK."""

CHUNK = 25
"""Samples of one task, for which the model is traced once. Results do not depend on it."""


@dataclass(frozen=True)
class Bootstrap:
    """Estimates of `count` refits: `samples` (count, n) of the parameters `names`, in their units.

    `ratio` (n,): standard deviation of the samples over that of the fit's covariance.
    """

    names: tuple[str, ...]
    samples: np.ndarray
    ratio: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """(n,)"""
        return self.samples.std(axis=0, ddof=1)

    @property
    def intervals(self) -> np.ndarray:
        """(n, 2) 95 % intervals, from the samples' percentiles."""
        return np.percentile(self.samples, [2.5, 97.5], axis=0).T

    def summary(self) -> dict:
        """For identification.json."""
        std, intervals = (dict(zip(self.names, each.tolist(), strict=True)) for each in (self.std, self.intervals))
        return {"samples": len(self.samples), "std": std, "interval": intervals}


@dataclass(frozen=True)
class Fit:
    """A fitted problem as plain data to send to another process, with the model given by its effects' names.

    `value` (n,): coordinates of the optimum; `scale`: the channels' weights; `residual` (rows,): the residual to resample. The
    other fields are arguments of `Problem`.
    """

    effects: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    values: Mapping[str, float]
    names: tuple[str, ...]
    prior: Prior | None
    slow_first: Mapping[str, bool]
    scale: Mapping[str, float]
    value: np.ndarray
    residual: np.ndarray

    def problem(self) -> Problem:
        """The problem with the weights of the fit."""
        problem = Problem(plant(self.effects), self.experiments, self.values, self.names, self.prior, self.slow_first)
        problem.scale.update(self.scale)
        return problem


def bootstrap(
    refinement: Refinement, count: int = 200, seed: int = 0, workers: int = 1, scheduler: str | None = None
) -> Bootstrap:
    """Refit `count` resamples of a refinement's residual. The same `seed` gives the same samples for any `workers`.

    `workers`, `scheduler` as in `identification.workers`. The model's effects must be the library's.
    """
    fit = _fit(refinement)
    seeds = np.random.SeedSequence(seed).spawn(count)
    chunks = [seeds[k : k + CHUNK] for k in range(0, count, CHUNK)]
    samples = np.concatenate(spread(partial(_refits, fit), chunks, workers, scheduler, "bootstrap"))
    std = refinement.uncertainty.std
    with np.errstate(invalid="ignore", divide="ignore"):  # a parameter at a bound has no variance
        ratio = samples.std(axis=0, ddof=1) / std
    return Bootstrap(refinement.names, samples, ratio)


def _fit(refinement: Refinement) -> Fit:
    problem = refinement.problem
    return Fit(
        effects=problem.model.optional,
        experiments=problem.experiments,
        values=problem.values,
        names=problem.coordinates.names,
        prior=problem.prior,
        slow_first=problem.coordinates.slow_first,
        scale=dict(problem.scale),
        value=refinement.solution.value,
        residual=restored(problem, refinement.solution),
    )


@threadpool_limits.wrap(limits=1)  # one thread everywhere: sums round the same, and workers do not compete
def _refits(fit: Fit, seeds: Sequence[np.random.SeedSequence]) -> np.ndarray:
    """Parameters (len(seeds), n) of one refit for each seed."""
    problem = fit.problem()
    lower, upper = problem.coordinates.lower, problem.coordinates.upper
    optimum, _ = problem.evaluate(fit.value)
    groups = [[(b.at, _rows(b)) for b in group] for group in problem.groups]
    samples = []
    for seed in seeds:
        drawn = _drawn(np.random.default_rng(seed), fit.residual, groups)

        def evaluate(x, shift=drawn - optimum):
            # The drawn measurement is the prediction at the optimum minus the drawn residual.
            residual, jacobian = problem.evaluate(x)
            return residual + shift, jacobian

        found = solve(evaluate, fit.value, lower, upper)
        samples.append(list(problem.coordinates.values(found.value).values()))
    return np.array(samples)


def _drawn(rng: np.random.Generator, residual: np.ndarray, groups: Sequence[Sequence[tuple[slice, int]]]) -> np.ndarray:
    """A residual (rows,) composed of blocks of the given one.

    `groups`: for each group of a problem, (rows of a channel of a record, length of a block) of its records.
    """
    drawn = rng.standard_normal(len(residual))  # kept for the rows of a prior, which have unit variance
    for group in groups:
        most = max(-(-(at.stop - at.start) // length) for at, length in group)
        starts = rng.random(most)
        for at, length in group:
            own = residual[at] - residual[at].mean()  # the mean of the residual must not enter the samples
            m = len(own)
            rows = (starts * m).astype(int)[:, None] + np.arange(length)
            drawn[at] = own[rows % m].ravel()[:m]
    return drawn


def _rows(block: Block) -> int:
    """Rows of a channel that span BLOCK, at most a quarter of the record."""
    time = block.time
    if len(time) < 2:
        return 1
    return max(1, min(len(time) // 4, round(BLOCK / float(np.median(np.diff(time))))))
