"""Whether much more is gained beside a set of effects: then it is near the truth, and not the truth."""

from collections.abc import Iterable, Sequence

from identification.diagnose.search.candidates import Candidate
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.judge import BESIDE, NUISANCE, channels
from identification.diagnose.search.look import Seen
from identification.diagnose.search.rounds import looks, refitted

FURTHER = 10.0
"""Log-likelihood that one more candidate must gain for a set to be near the truth only; and at least the share BESIDE of what
the set itself gained, since no form is exact."""

CONFIRMED = 3
"""Candidates beside a final set, the most promising ones, that are refitted to see whether they gain so much."""


def gains_further(searcher: Searcher, base: Fit, fit: Fit, options: Iterable[Candidate], pool) -> bool:
    """Whether a further candidate gains so much beside a fit that the fit is near the truth and not the truth.

    Looks see along straight lines; the most promising are refitted to see what they keep.
    """
    first = _promising(searcher, base, fit, options, pool)[:CONFIRMED]
    fuller = pool.map(lambda pair: refitted(searcher, fit, *pair), first)
    return any(fit.deviance - new.deviance > 2.0 * much(base, fit) for new in fuller)


def _promising(searcher: Searcher, base: Fit, fit: Fit, options: Iterable[Candidate], pool) -> list[tuple[Candidate, Seen]]:
    """The candidates that promise much beside a fit, the best first; without what every rig has a little of."""
    looked = looks(searcher, fit, options, pool)
    return [(c, at) for c, at in looked if c.name not in NUISANCE and at.fall > much(base, fit)]


def much(base: Fit, fit: Fit) -> float:
    """Log-likelihood that is more than what the right forms leave beside a fit, which are never exact."""
    return max(FURTHER, 0.5 * BESIDE * (base.deviance - fit.deviance))


def elsewhere(searcher: Searcher, base: Fit, fit: Fit, options: Sequence[Candidate], pool) -> list[Candidate]:
    """The candidates in channels that a fit's effects leave alone, where the most promising one of all is there.

    What a slightly wrong form leaves shows in its own channel: there, a second effect would mend the first.
    """
    touched = set().union(*map(channels, fit.effects))
    apart = [c for c in options if touched.isdisjoint(channels(c.name))]
    further = _promising(searcher, base, fit, options, pool)
    return apart if further and further[0][0] in apart else []
