"""The constants that decide a diagnosis, each with its statistic, and the rules that use them.

README.md lists what a larger value of each constant costs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import chi2

ALPHA = 0.01
"""Family-wise level of the likelihood ratio test over all points of a search (Bonferroni), and level of each test of lack of
fit on a model with effects."""

MIN_EVIDENCE = 5.0
"""Minimum penalised log-likelihood ratio (half a BIC difference) of an effect against none, and between two effects: very
strong evidence (Kass and Raftery, 1995)."""

FORM = 0.0025
"""In each frequency band, one more effect must exceed this share of the log-likelihood that accepted effects explain: a model
form is right to some 5 % of amplitude, 0.25 % of power. A slow effect adds no threshold in fast bands."""

ALPHA_BASE = 0.001
"""Level of each test of lack of fit on a model without effects. Stricter than ALPHA: most rigs need no effect, and a false
alarm costs the user days."""

SMALLEST = 0.002
"""Default minimum size of interest: power that an effect adds below SLOW over the noise power there. An effect may declare a
`common` share instead, if every rig has a little of it."""

ACCURACY = 2e-4
"""Lower bound of the default minimum size of interest, as a share of the largest measured thrust: a load cell's own error
(class C3 of OIML R 60, 0.02 % of full scale). The averaged noise of a long record may be smaller."""

SLOW = 10.0
"""Hz: below, a repeatable residual is an error of the model; above, it may be vibration of bearings and blades."""

MOST = 6
"""Maximum number of effects of one stage."""

STRONG = 0.5
"""Share of the evidence of a refused effect that another one needs to be accepted: a weaker one would stand in for it."""

FOLDS, FOLD_BLOCK = 5, 5.0
"""Interleaved folds of the cross-validation, and seconds of their blocks: longer than any lag of a rig."""

ALTERNATIVE_WINDOW = 10.0
"""Nats within which another effect, or a learned term at another port, counts as not distinguished: twice MIN_EVIDENCE, because
both fits are approximate."""

ALPHA_HELD_OUT = 0.05
"""Level of the tests that an error on held-out data decreases or increases. Earlier tests account for multiple comparisons;
these have only some twenty blocks."""

MAJORITY = 0.5
"""Share of the lack of fit that a set must explain to be `partly`; share of a residual's power that must be structured, or at
the rotor frequency, to count as lack of fit."""


@dataclass(frozen=True)
class Judgement:
    """Statistics of one effect of a set, against the set without it.

    `likelihood_gain`: gain of log-likelihood on the fitted records. `needed`: its threshold, from chance at the level ALPHA and
    from the forms of the other effects. `evidence`: the gain minus the BIC penalty. `gain`: cross-validated log-likelihood
    ratio by channel. `size` [N]: rms change of the thrust below SLOW; `least`: its minimum; `material`: the effect's thrust or
    speed reaches its minimum. `refused`: reasons; empty: accepted; `small`: its size is the only
    one. `speed` [rpm]: rms change of the speed's readings."""

    effect: str
    likelihood_gain: float
    needed: float
    evidence: float
    gain: Mapping[str, float]
    size: float
    least: float
    material: bool = True
    refused: tuple[str, ...] = ()
    small: bool = False
    speed: float = 0.0

    def summary(self, unit: str = "N") -> dict:
        """For diagnosis.json; `unit`: of the size."""
        return {
            "evidence": self.evidence,
            "log_likelihood": self.likelihood_gain,
            "log_likelihood_by_chance": self.needed,
            "held_out_gain": dict(self.gain),
            "size": {"value": self.size, "unit": unit},
            "least_size": {"value": self.least, "unit": unit},
        }


@cache
def chance_threshold(parameters: int, comparisons: int) -> float:
    """Log-likelihood gain that the best of `comparisons` candidates with so many free parameters reaches by chance, at the
    level ALPHA."""
    return 0.5 * float(chi2.isf(ALPHA / max(comparisons, 1), max(parameters, 1)))


def model_form_allowance(likelihood_gain: np.ndarray, explained: np.ndarray) -> float:
    """Part of `likelihood_gain` (bands,) that errors in the forms of other effects, which `explained` (bands,), may cause."""
    return float(np.sum(np.minimum(np.maximum(likelihood_gain, 0.0), FORM * np.maximum(explained, 0.0))))


@dataclass(frozen=True)
class Smallest:
    """Minimum sizes of interest of a user: rms of thrust [N] and of speed [rpm]; None: the default."""

    thrust: float | None = None
    speed: float | None = None


def refusals(
    likelihood_gain: float,
    needed: float,
    evidence: float,
    gain: Mapping[str, float],
    parameters: int,
    material: bool,
    carries_over: bool = True,
) -> list[str]:
    """Reasons to reject an effect; empty: accepted. `material`: its size reaches the minimum; `carries_over`: so does the error
    that it removes from held-out data.

    Cross-validation can only reject. The thrust alone may lose half a nat a parameter, the expected cost of an unidentifiable
    one; a gain of the speed must not compensate for more.
    """
    found = []
    if likelihood_gain < needed:
        found.append(f"log-likelihood increases by {likelihood_gain:.1f}; chance and errors of form reach {needed:.1f}")
    if evidence <= MIN_EVIDENCE:
        found.append(f"evidence too weak: {evidence:.1f} after the penalty for its parameters, {MIN_EVIDENCE:g} is asked for")
    total = sum(gain.values())
    if total <= 0.0:
        found.append(f"cross-validation gains nothing: log-likelihood {total:.1f}")
    elif gain.get("thrust", 0.0) < -0.5 * parameters:
        found.append(f"thrust is predicted worse in cross-validation: log-likelihood {gain['thrust']:.1f}")
    if not material:
        found.append("below the least size of interest")
    elif not carries_over:
        found.append("the error that it removes from held-out data is below the least size of interest")
    return found
