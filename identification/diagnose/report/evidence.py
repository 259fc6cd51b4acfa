"""Report sections: the evidence for each candidate, why it is rejected, and which effects the commands distinguish."""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.judgement import ALPHA, MIN_EVIDENCE
from identification.diagnose.report.summary import summary, why_not
from identification.diagnose.search.refits import CandidateFit
from vpp_fmu.digits import number as digits
from vpp_fmu.report import Page, evidence_bars, overlap_heatmap, parameter_change
from vpp_fmu.report.evidence import FAILED, PASSED, TAKEN, Bar

VISIBLE = 10.0
"""Log-likelihood gain at a plausible size from which an effect counts as visible."""

CLOSE = 0.8
"""Squared cosine from which a pair of effects is shown."""

MOST = 14
"""Maximum number of effects in the figure of similar effects."""


def add_evidence(page: Page, found: Diagnosis) -> None:
    """A figure of each round of the search, and the table of all refitted candidates."""
    for number, tried in enumerate(found.selection.rounds, start=1):
        fitted = [t for t in tried if t.fit is not None]
        if fitted:
            _add_round(page, found, number, fitted)
    rows = []
    for entry in (e for e in summary(found)["candidates"] if "delta_bic" in e):
        beside = " + ".join(entry["beside"]) or "nothing"
        form = ", ".join(f"{v:g}" for v in entry["form"].values()) or "only"
        size = ", ".join(f"{n.partition('.')[2]} {digits(v, 3)}" for n, v in entry["parameters"].items())
        rows.append((entry["name"], form, beside, f"{0.5 * entry['delta_bic']:.1f}", size, entry["why_not"] or "accepted"))
    columns = ("effect", "form", "beside", "evidence [nat]", "parameters", "verdict")
    page.table(columns, rows, "Candidates that were refitted in full.")
    for effect, judged in found.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.4g}" for channel, gain in judged.gain.items())
        page.note(
            f"{effect}: the log-likelihood increases by {judged.likelihood_gain:.4g}; chance exceeds {judged.needed:.3g} in "
            f"one rig of {1.0 / ALPHA:.0f}. In cross-validation: {gains}. It changes the thrust by {judged.size:.3g} N rms; "
            f"the minimum size of interest is {judged.least:.2g} N."
        )


def _add_round(page: Page, found: Diagnosis, number: int, fitted: list[CandidateFit]) -> None:
    bars = [_bar(found, t) for t in fitted]
    beside = " and ".join(fitted[0].beside) or "nothing"
    best = max(bars, key=lambda bar: bar.likelihood_gain)
    taken = max((bar for bar in bars if bar.outcome == TAKEN), key=lambda bar: bar.likelihood_gain, default=None)
    if taken is None:
        title = f"Round {number}, beside {beside}: no candidate is accepted, {best.name} has the most evidence"
    else:
        title = f"Round {number}, beside {beside}: the evidence for {taken.name} is {taken.likelihood_gain:,.0f} nats"
    page.figure(
        evidence_bars(bars, MIN_EVIDENCE, title, None if taken is None else taken.likelihood_gain),
        "Evidence of each refitted candidate: half the decrease of the BIC on the fitted records. Candidates in the shaded "
        "band fit as well as the accepted one.",
    )
    return bars


def _bar(found: Diagnosis, tried: CandidateFit) -> Bar:
    why, label = why_not(found, tried), tried.candidate.label
    if why is None:
        return Bar(label, tried.evidence, TAKEN, "in the final set")
    name = tried.candidate.name
    passed = tried.evidence > MIN_EVIDENCE and name not in found.selection.refused
    return Bar(label, tried.evidence, PASSED if passed else FAILED, _short(why))


def _short(reasons: str) -> str:
    """The start of the first reason, and the number of further ones."""
    first, *more = reasons.split("; ")
    head = first.partition(":")[0].partition(" from ")[0]
    return head if not more else f"{head}, and {len(more)} more"


def add_shift(page: Page, found: Diagnosis) -> None:
    """The bias of the base parameters without the effects."""
    shift = summary(found)["base_parameters"]
    names = list(shift)
    before, after = ({n: shift[n][k] for n in names} for k in ("before", "after"))
    for first, second in (("tau_omega_1", "tau_omega_2"), ("tau_beta_1", "tau_beta_2")):
        if {first, second} <= set(names) and (before[first] < before[second]) != (after[first] < after[second]):
            before[first], before[second] = before[second], before[first]
    before, after = (np.array(list(values.values())) for values in (before, after))
    reach = 1.96 * np.array([shift[n]["std"] or np.nan for n in names], float)
    k = int(np.argmax(np.abs(before - after) / np.maximum(np.abs(after), 1e-9)))
    title = f"Without the effect {names[k]} is biased to {digits(before[k])}; with it, it is {digits(after[k])}"
    figure = parameter_change(names, before, after, after - reach, after + reach, title)
    caption = "Start: the best fit without the effects; fitted: with them, 95 % intervals. Lags in the order of the latter."
    page.figure(figure, caption)


def add_apart(page: Page, found: Diagnosis) -> None:
    """The effects that these commands distinguish, and those that they do not show."""
    similarity = found.distinguishability
    visible = [i for i, v in enumerate(similarity.visibility) if v >= VISIBLE]
    names = np.array([label.split(" ")[0] for label in similarity.labels])
    close = np.where(names[:, None] != names, similarity.overlap, 0.0)[:, visible].max(axis=1, initial=0.0)
    own = set(found.final.effects)
    chosen = [i for i in visible if close[i] >= CLOSE or names[i] in own]
    chosen = sorted(sorted(chosen, key=lambda i: (names[i] not in own, -close[i]))[:MOST])
    if len(chosen) > 1:
        pairs = similarity.alike()
        title = "These commands distinguish all visible effects"
        if pairs:
            one, other, _ = pairs[0]
            title = f"These commands do not distinguish {len(pairs)} pairs of effects; the most similar are {one} and {other}"
        labels = [similarity.labels[i] for i in chosen]
        figure = overlap_heatmap(labels, similarity.overlap[np.ix_(chosen, chosen)], title)
        caption = (
            "Squared cosine of the responses to two effects, orthogonal to the base parameters' sensitivities; 1: the same."
        )
        page.figure(figure, f"{caption} Similar effects, and those found.")
    unseen = ", ".join(similarity.invisible()) or "none"
    page.note(f"Not visible at a plausible size under these commands: {unseen}.")
