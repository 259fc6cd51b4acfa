"""Every number that decides a diagnosis, each beside its statistic; and the rules that are made of them.

README.md has the table: what each constant trades, and what it does to false alarms and to detection.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import chi2

LEVEL = 0.01
"""Share of rigs that lack nothing in which the best of all candidates may pass for an effect: the family-wise level of the
likelihood ratio test, shared evenly among the points that the search looks at (Bonferroni). And of models that explain all,
those that may be taken to leave something: who claims to know it all must pass each test of lack of fit at this level."""

STRONG = 5.0
"""Natural logarithm of the penalised likelihood ratio (half a difference of the BIC) from which evidence is very strong (Kass
and Raftery, 1995): for an effect against none, and between two effects that are to be told apart."""

FORM = 0.0025
"""Share of the log-likelihood that the rest of a set explains in a band of a channel's frequencies which one more effect must
exceed there, beside what chance reaches: no form is a rig's own, and where an effect is described to 5 % of its amplitude the
error of its form has 0.25 % of its power. A slow effect has no power in fast bands, and the error of its form has none."""

CERTAIN = 0.001
"""Level of each test of lack of fit where nothing is claimed: of the pure error in a band, and of the score test on generic
shapes. Most rigs that are looked at lack nothing, and to look for what a rig lacks takes days."""

SMALLEST = 0.002
"""Least size of interest where the user names none: the power that an effect adds below SLOW, as a share of the noise's there.
An effect's declared `common` share takes its place for what every rig has a little of."""

ACCURACY = 2e-4
"""Share of the largest measured thrust below which no effect of the thrust is of interest where the user names no size: a load
cell's own error (class C3 of OIML R 60, 0.02 % of full scale). The noise of a long record may be averaged below it."""

SLOW = 10.0
"""Hz: what lies below is the rig's; above, bearings and blades hum in phase with themselves."""

MOST = 3
"""Effects that one diagnosis may name."""

FOLDS, FOLD_BLOCK = 5, 5.0
"""Interleaved folds of the cross-validation, and the seconds of the blocks they are made of: longer than any lag of a rig."""

RIVALS = 10.0
"""Nats within which a term at another port, or with another driver, counts as one that these records do not tell from it, and
another effect as one that a search may as well begin with: twice STRONG, for the fits of both are as rough as their knots, or
lack the same other effect."""

CARRIED = 0.05
"""Level of the test that thrust is predicted better by a term, or worse by a set than by the identified base, where it was not
fitted. What comes this far is beyond what chance finds among all comparisons; here it is asked whether it carries over, on a
dozen blocks or two."""

HALF = 0.5
"""Share of the lack of fit that a set must remove to be a part of the explanation; share of what passes for noise that must
turn with the rotor, of the speed's that must follow the commands, or of either's that must be missing at rest, to be none."""


@dataclass(frozen=True)
class Judgement:
    """What an effect of a set rests on, against the set without it.

    `fall`: of half the deviance on the fitted records; `needed`: what chance alone reaches in a share LEVEL of rigs without
    any effect, and what the forms of the set's others may leave. `evidence`: the fall less BIC's penalty. `gain`:
    cross-validated log-likelihood by channel. `size` [N]: what the effect changes of the thrust below SLOW, rms; `least`: the
    least size of interest. `refused`: reasons in words; none: it stands."""

    effect: str
    fall: float
    needed: float
    evidence: float
    gain: Mapping[str, float]
    size: float
    least: float
    refused: tuple[str, ...] = ()


@cache
def needed_fall(parameters: int, comparisons: int) -> float:
    """Fall of half the deviance that the best of `comparisons` candidates of so many free parameters reaches by chance with
    LEVEL."""
    return 0.5 * float(chi2.isf(LEVEL / max(comparisons, 1), max(parameters, 1)))


def left_by_forms(fall: np.ndarray, explained: np.ndarray) -> float:
    """How much of the log-likelihood that an effect gains, `fall` (bands,) of a channel, may come from errors of the forms of
    the set's others, which have `explained` (bands,) already."""
    return float(np.sum(np.minimum(np.maximum(fall, 0.0), FORM * np.maximum(explained, 0.0))))


@dataclass(frozen=True)
class Smallest:
    """Least sizes of interest that a user names: of the thrust [N] and of the speed [rpm], rms; None: not named."""

    thrust: float | None = None
    speed: float | None = None


def refusals(
    fall: float,
    needed: float,
    evidence: float,
    gain: Mapping[str, float],
    parameters: int,
    material: bool,
    carries_over: bool = True,
) -> list[str]:
    """Why an effect is rejected, in words; empty where it is accepted. `material`: it reaches the least size of interest;
    `carries_over`: so does the error that it removes from held-out data.

    Cross-validation is a veto: a gain that is no gain shows an effect that only these records like. Thrust by itself may lose
    what free parameters cost that tell nothing, half a nat each in expectation; a clean speed signal must not buy more.
    """
    found = []
    if fall < needed:
        found.append(f"log-likelihood rises by {fall:.1f}; chance, and what forms leave, reach {needed:.1f}")
    if evidence <= STRONG:
        found.append(f"evidence too weak: {evidence:.1f} after the penalty for its parameters, {STRONG:g} is asked for")
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
