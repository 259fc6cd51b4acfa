"""The best guess if the lack of fit is not explained: the best candidate, its size, and why it is not accepted.

It does not change the exported model. It also gives its difference in thrust from the best rival in the next experiment.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.assessment.prediction import predict
from identification.diagnose.acceptance import Judge
from identification.diagnose.judgement import MAJORITY, MOST
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.refits import evidence_over
from identification.diagnose.selection import Selection, Tried
from identification.diagnose.validation import share_explained
from vpp_fmu.record import Record


@dataclass(frozen=True)
class Size:
    """A parameter of an effect; `std`: its standard error, None if not identifiable."""

    effect: str
    name: str
    value: float
    unit: str
    std: float | None


@dataclass(frozen=True)
class Guess:
    """The best candidate, beside the accepted effects `beside`.

    `effects`: its names; several if a whole set is refuted. `evidence`: its penalised log-likelihood ratio. `explains`: share
    of the lack of fit that it removes; `most`: the largest such share of any refitted candidate. `against`: why it is not
    accepted. `rival`: the next best candidate; "" if there is none: the model without the guess. `here`, `there` [N]: rms
    difference of their thrusts on the fitted record and on the next experiment.
    """

    effects: tuple[str, ...]
    beside: tuple[str, ...]
    sizes: tuple[Size, ...]
    evidence: float
    explains: float
    most: float
    against: tuple[str, ...]
    rival: str
    here: float
    there: float

    @property
    def near(self) -> bool:
        """Whether it removes more than MAJORITY of the lack of fit."""
        return self.explains > MAJORITY


def best_guess(
    judge: Judge,
    selection: Selection,
    findings: tuple[LackOfFit, LackOfFit],
    refuted: str,
    partly: bool,
    tried: Callable[[], Tried],
    experiment: Record,
) -> Guess | None:
    """The best guess at the missing effect; None without candidates.

    `findings`: lack of fit of the base and of the selected set. `refuted`: why that set is refuted, else "". `partly`: the set
    is used, and the guess is for the remaining lack of fit. `tried()`: candidates beside the accepted effects, best first.
    """
    before, after = findings
    base, final = judge.base, selection.final
    if final.effects and not partly:
        explains = share_explained(base, final, before, after)
        against = (
            refuted
            or f"it removes {100.0 * max(explains, 0.0):.0f} % of the lack of fit, the minimum is {100.0 * MAJORITY:.0f} %"
        )
        return _guess(base, final, (explains, explains), (against,), ("", base), experiment)
    beside, missing = (final, after) if partly else (base, before)
    ranked = tried()
    if not ranked:
        return None
    (name, fit, judged), *others = ranked

    def explained(fit: Fit) -> float:
        return share_explained(beside, fit, missing, judge.lack(fit))

    explains = most = explained(fit)
    if explains <= MAJORITY:  # else `most` is not shown
        most = max(explains, *(explained(other) for _, other, _ in others), 0.0)
    limit = f"a diagnosis accepts at most {MOST} effects"
    known = selection.refused[name].refused if name in selection.refused else ("it makes an accepted effect superfluous",)
    against = judged().refused or ((limit,) if len(beside.effects) >= MOST else known)
    rival = next(((other, its) for other, its, _ in others if other != name), ("", beside))
    return _guess(beside, fit, (explains, most), against, rival, experiment)


def _guess(
    beside: Fit, fit: Fit, shares: tuple[float, float], against: tuple[str, ...], rival: tuple[str, Fit], experiment: Record
) -> Guess:
    own = tuple(n for n in fit.effects if n not in beside.effects)
    std, sizes = fit.std(), []
    for effect in (e for e in fit.problem.model.effects if e.name in own):
        free = [p for p in effect.parameters if effect.full(p.name) in fit.free]
        sizes += [Size(effect.name, p.name, fit.values[n := effect.full(p.name)], p.unit, std.get(n)) for p in free]
    explains, most = (float(np.clip(share, 0.0, 1.0)) for share in shares)
    record = fit.problem.experiments[0].record
    here, there = (_thrust_difference(fit, rival[1], one) for one in (record, experiment))
    evidence = float(evidence_over(fit, beside))
    return Guess(own, tuple(beside.effects), tuple(sizes), evidence, explains, most, against, rival[0], here, there)


def _thrust_difference(one: Fit, other: Fit, record: Record) -> float:
    """Rms difference [N] of the thrusts that two fits predict."""
    shown = [predict(fit.problem.model, fit.values, record).thrust for fit in (one, other)]
    return float(np.sqrt(np.mean((shown[0] - shown[1]) ** 2)))
