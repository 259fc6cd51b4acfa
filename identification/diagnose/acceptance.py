"""Accept or reject an effect: likelihood, cross-validation and size, against the set without it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from identification.diagnose.command_shapes import map_slopes
from identification.diagnose.crossval import HeldOut, cross_validated, rms
from identification.diagnose.judgement import (
    ACCURACY,
    SMALLEST,
    Judgement,
    Smallest,
    chance_threshold,
    model_form_allowance,
    refusals,
)
from identification.diagnose.lack_of_fit import LackOfFit, lack_of_fit
from identification.diagnose.score_test import mean_powers, noise_levels, predicted_rows
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over
from identification.fit.bands import starts
from vpp_fmu.record import Record


class Judge:
    """Compares a set of effects with the set without one of them, which may be the `base`.

    `smallest`: minimum sizes of interest. Defaults: for the thrust, SMALLEST of the slow noise power, at least ACCURACY of the
    largest thrust; for the speed, the sensor's uncertainty. `runs`: step responses. No fit of a diagnosis uses them, except for
    their settled ends as steady points, if there are no others. `speed_error` [rpm]: standard error of a known speed; what it
    changes in the thrust is no effect.
    """

    def __init__(self, searcher: Searcher, base: Fit, smallest: Smallest, runs: Sequence[Record], speed_error: float = 0.0):
        self.searcher, self.base, self.smallest, self.speed_error = searcher, base, smallest, speed_error
        self.runs = [r for r in runs if np.isfinite(r["thrust"]).any()]
        self._held_out: dict[int, tuple[Fit, HeldOut]] = {}

    def held_out(self, fit: Fit) -> HeldOut:
        """Cross-validation of a fit, cached."""
        if id(fit) not in self._held_out:
            self._held_out[id(fit)] = fit, cross_validated(fit)  # keeps the fit, so that no other object gets its id
        return self._held_out[id(fit)][1]

    def on_runs(self, fit: Fit) -> np.ndarray:
        """Mean square thrust error (runs,) of each step response, N^2."""
        simulator = fit.problem.simulator
        shown = [simulator.simulate(fit.values, *r.run)[:, 0] for r in self.runs]
        return np.array([np.nanmean((y - r["thrust"]) ** 2) for y, r in zip(shown, self.runs, strict=True)])

    def __call__(self, effect: str, with_it: Fit, without: Fit) -> Judgement:
        """Judge one effect of a set."""
        gains, by_forms = self.likelihood_gain(with_it, without)
        likelihood_gain, more = sum(gains.values()), max(1, len(with_it.free) - len(without.free))
        evidence = counting(likelihood_gain, with_it, without)
        needed = chance_threshold(more, self.searcher.points) + by_forms
        gain = self.held_out(with_it).gain(self.held_out(without))
        declared = next(e for e in with_it.problem.model.effects if e.name == effect)
        size, least, speed, material = self._size(with_it, without, declared.common)
        carries_over = bool(declared.common) or self._carries_over(with_it, without, size / speed if speed else 0.0)
        refused = refusals(likelihood_gain, needed, evidence, gain, more, material, carries_over)
        small = bool(refused) and not refusals(likelihood_gain, needed, evidence, gain, more, True, True)
        found = Judgement(effect, float(likelihood_gain), needed, float(evidence), gain, size, least, material)
        return replace(found, refused=tuple(refused), small=small, speed=speed)

    def evidence(self, with_it: Fit, without: Fit) -> float:
        """Penalised log-likelihood ratio of two fits, of which only the `likelihood_gain` counts."""
        return counting(sum(self.likelihood_gain(with_it, without)[0].values()), with_it, without)

    def likelihood_gain(self, with_it: Fit, without: Fit) -> tuple[dict[str, float], float]:
        """(log-likelihood gain of an effect by channel; the part of it that errors in the forms of the others may cause). The
        gain in a band is divided by the noise power there."""
        gains, explained, by_forms = (
            with_it.score.gain_over(without.score),
            without.score.gain_over(self.base.score),
            0.0,
        )
        for channel in [c for c, likelihood_gain in gains.items() if likelihood_gain > 0.0]:
            (known, gained), level = gains_in_bands((self.base, without, with_it), channel)
            gained = gains[channel] * gained / (gained.sum() or 1.0) / level
            gains[channel] = float(np.clip(gained.sum(), 0.0, gains[channel]))
            if channel == "thrust" and not all(e.noise.verified for e in with_it.problem.experiments):
                gains[channel] = min(gains[channel], gain_beside_flicker(without, with_it))
            if explained[channel] > 0.0:
                by_forms += model_form_allowance(gained, explained[channel] * known / (known.sum() or 1.0) / level)
        return gains, by_forms

    def lack(self, fit: Fit) -> LackOfFit:
        """Run the checks of lack of fit."""
        return lack_of_fit(fit, self.least(), self.least_speed(), self.base)

    def least(self) -> float:
        """Minimum size of interest of the thrust below 10 Hz, N."""
        if self.smallest.thrust is not None:
            return self.smallest.thrust
        return self._least

    @cached_property
    def _least(self) -> float:
        experiments = self.searcher.experiments
        largest = max(float(np.nanmax(np.abs(r.record["thrust"]))) for e in experiments for r in e.records)
        slopes = [rms([map_slopes(self.base.values, *predicted_rows(self.base, e).T[1:])[1]]) for e in experiments]
        averaged = float(np.sqrt(SMALLEST * max(e.noise.slow for e in experiments)))
        return max(averaged, ACCURACY * largest, self.speed_error * max(slopes))

    def least_speed(self) -> float:
        """Minimum size of interest of the speed, rpm; infinite where no speed was measured."""
        if self.smallest.speed is not None:
            return self.smallest.speed
        known = [np.median(t.std) for e in self.searcher.experiments for t in e.tachometers if len(t)]
        return float(max(known, default=np.inf))

    def within_sensor(self, judged: Judgement) -> bool:
        """Whether an effect, found in the speed alone, is smaller than the uncertainty of the speed sensor."""
        return "thrust" not in self.searcher.experiments[0].channels and judged.speed < self.least_speed()

    def _carries_over(self, with_it: Fit, without: Fit, slope: float) -> bool:
        """Whether the cross-validated error that an effect removes reaches the minimum size, in either channel. An error of the
        speed counts by its thrust, too: `slope` [N/rpm] is the ratio of the changes of both."""
        now, was = self.held_out(with_it), self.held_out(without)
        if was.rmse_thrust**2 - now.rmse_thrust**2 >= self.least() ** 2:
            return True
        if was.rmse_omega is None:
            return False
        removed = was.rmse_omega**2 - now.rmse_omega**2
        return removed >= self.least_speed() ** 2 or removed * slope**2 >= self.least() ** 2

    def matters(self, effect: str, fit: Fit) -> bool:
        """Whether an effect reaches the minimum size, all other parameters held. Without one of the speed's reading, the lags
        would be wrong, though it changes no thrust."""
        declared = next(e for e in fit.problem.model.effects if e.name == effect)
        rest = replace(fit, values={**fit.values, **declared.switched_off})
        return declared.reading == "speed" or self._size(fit, rest, declared.common)[-1]

    def _size(self, with_it: Fit, without: Fit, common: float) -> tuple[float, float, float, bool]:
        """(rms change of the thrust [N]; the minimum size; rms change of the speed's readings [rpm]; whether the change of
        thrust or of speed reaches its minimum)."""
        thrust, rows, speed = [], [], []
        for e in self.searcher.experiments:
            shown = [predicted_rows(fit, e) for fit in (with_it, without)]
            change = shown[0] - shown[1]
            rows.append(change[:, 0])
            thrust.append(e.slow_thrust(change[:, 0]))
            if len(e.omega_time):
                speed.append(np.concatenate([t.shows(change[:, 1]) for t in e.tachometers]))
        size, least, turned = rms(thrust), self.least(), rms(speed) if speed else 0.0
        if common:
            floor = max(e.noise.floor for e in self.searcher.experiments)
            return rms(rows), float(np.sqrt(common)) * floor, turned, rms(rows) ** 2 >= common * floor**2
        return size, least, turned, size >= least or turned >= self.least_speed()


def counting(likelihood_gain: float, with_it: Fit, without: Fit) -> float:
    """Penalised log-likelihood ratio of two fits, with this gain in the place of their own."""
    return evidence_over(with_it, without) - 0.5 * (without.deviance - with_it.deviance) + likelihood_gain


def gain_beside_flicker(without: Fit, with_it: Fit) -> float:
    """Log-likelihood gain of the thrust from one fit to another, where the noise of each may have flicker of any strength.

    A single record does not show whether its slowest part is flicker or a drift. A fit whose residual is flicker loses the
    logarithm of its power; flicker that explains a drift would be seen at higher frequencies, too (Whittle's likelihood)."""
    scale, found = with_it.problem.scale["thrust"], 0.0
    for fit, sign in ((without, -1.0), (with_it, 1.0)):
        about, factor = fit.linearised(), fit.problem.scale["thrust"] / scale
        parts = [b.at for b in fit.problem.blocks if b.channel == "thrust"]
        found += sign * sum(with_flicker(factor * about.residual[at], about.directions(at)) for at in parts)
    return max(found, 0.0)


def with_flicker(whitened: np.ndarray, fitted: np.ndarray) -> float:
    """Log-likelihood, up to a constant, of whitened noise (n,) beside flicker of the most likely corner, or of none. `fitted`
    (m, n): directions of the parameters in units of their standard errors; they are fitted again beside the flicker."""
    n = len(whitened)
    spectra, ordinate = np.fft.rfft(np.vstack([whitened, fitted]), axis=1), np.arange(n // 2 + 1)
    share = np.where(2 * ordinate % n, 2.0, 1.0) / n  # of an ordinate and its mirror image in the products of rows
    ordinate = np.maximum(ordinate, 0.5)  # the mean, as at half the frequency of the next

    def products(ratio: np.ndarray) -> np.ndarray:
        return ((spectra * (share / ratio)) @ spectra.conj().T).real

    even = products(np.ones(1))

    def log_likelihood(corner: float) -> float:
        ratio = 1.0 + corner / ordinate
        own = products(ratio)
        moved = own[1:, 0] - even[1:, 0]
        gained = moved @ np.linalg.lstsq(np.eye(len(fitted)) + own[1:, 1:] - even[1:, 1:], moved, rcond=None)[0]
        return -float(np.sum(np.log(ratio)) + 0.5 * (own[0, 0] - gained))

    return max(map(log_likelihood, (0.0, *2.0 ** np.arange(np.log2(len(ordinate))))))


def gains_in_bands(fits: Sequence[Fit], channel: str) -> tuple[np.ndarray, np.ndarray]:
    """(`gains` (fits - 1, bands), `level` (bands,)): gain of log-likelihood of a channel from each fit to the next, in bands of
    a third of an octave of each record; and the power of the whitened noise in a band, nominally 1.

    With a repeat record the noise is known, and the level is 1. Else the noise colour is estimated from one record. Noise
    slower than the filter's memory then exceeds the estimate, and would look like a drift. So the level is the power of the
    last residual, at least 1.
    """
    last = fits[-1].problem
    residuals = [f.problem.residual_at(f.values) * (f.problem.scale[channel] / last.scale[channel]) for f in fits]
    known = channel != "thrust" or all(e.noise.verified for e in last.experiments)
    about = None if known else fits[-1].linearised()
    parts = [
        gains_in_bands_of([rows[b.at] for rows in residuals], about and about.directions(b.at))
        for b in last.blocks
        if b.channel == channel
    ]
    gains, levels = zip(*parts, strict=True)
    return np.hstack(gains), np.concatenate(levels)


def gains_in_bands_of(rows: Sequence[np.ndarray], fitted: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The same from whitened rows (n,) of one record. `fitted` (m, n): orthonormal directions that the last fit has removed;
    None: the noise power is known."""
    powers = [mean_powers(each[None]) for each in rows]
    first = starts(len(powers[0]))
    gains = np.array([np.add.reduceat(old - new, first) for old, new in pairwise(powers)])
    level = np.ones(len(first)) if fitted is None else np.maximum(noise_levels(powers[-1], mean_powers(fitted))[0][first], 1.0)
    return gains, level
