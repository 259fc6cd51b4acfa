"""Of the report: what speaks for each candidate and where it failed, and what these commands can tell apart at all."""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.judgement import ALPHA, MIN_EVIDENCE
from identification.diagnose.report.summary import summary, why_not
from identification.diagnose.search.refits import CandidateFit
from vpp_fmu.digits import number as digits
from vpp_fmu.report import Page, evidence_bars, overlap_heatmap, parameter_change
from vpp_fmu.report.evidence import FAILED, PASSED, TAKEN, Bar

VISIBLE = 10.0
"""Log-likelihood that an effect must gain at a plausible size to be shown among those that can be told apart."""

CLOSE = 0.8
"""Squared cosine from which a pair of effects is worth showing."""

MOST = 14
"""Effects in the figure of what can be told apart."""


def add_evidence(page: Page, found: Diagnosis) -> None:
    """A figure of each round of the search, and the table of all that was refitted."""
    for number, tried in enumerate(found.selection.rounds, start=1):
        fitted = [t for t in tried if t.fit is not None]
        if fitted:
            _add_round(page, found, number, fitted)
    rows = []
    for entry in (e for e in summary(found)["candidates"] if "delta_bic" in e):
        beside = " + ".join(entry["beside"]) or "nothing"
        form = ", ".join(f"{v:g}" for v in entry["form"].values()) or "only"
        size = ", ".join(f"{n.partition('.')[2]} {digits(v, 3)}" for n, v in entry["parameters"].items())
        rows.append((entry["name"], form, beside, f"{0.5 * entry['delta_bic']:.1f}", size, entry["why_not"] or "taken"))
    columns = ("effect", "form", "beside", "evidence [nat]", "parameters", "verdict")
    page.table(columns, rows, "Candidates that were refitted in full.")
    for effect, judged in found.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.4g}" for channel, gain in judged.gain.items())
        page.note(
            f"{effect}: log-likelihood rises by {judged.fall:.4g} (chance: {judged.needed:.3g} in one rig of "
            f"{1.0 / ALPHA:.0f}); in cross-validation: {gains}. It changes the thrust by {judged.size:.3g} N rms; from "
            f"{judged.least:.2g} N on it is of interest."
        )


def _add_round(page: Page, found: Diagnosis, number: int, fitted: list[CandidateFit]) -> None:
    bars = [_bar(found, t) for t in fitted]
    beside = " and ".join(fitted[0].beside) or "nothing"
    best = max(bars, key=lambda bar: bar.fall)
    taken = max((bar for bar in bars if bar.outcome == TAKEN), key=lambda bar: bar.fall, default=None)
    if taken is None:
        title = f"Round {number}, beside {beside}: no candidate is taken, {best.name} comes nearest"
    else:
        title = f"Round {number}, beside {beside}: the evidence for {taken.name} is {taken.fall:,.0f} nats"
    page.figure(
        evidence_bars(bars, MIN_EVIDENCE, title, None if taken is None else taken.fall),
        "Each candidate refitted with all parameters: half the fall of the BIC on the fitted records. What lies in the shaded "
        "band fits as well as the one that was taken.",
    )
    return bars


def _bar(found: Diagnosis, tried: CandidateFit) -> Bar:
    why, label = why_not(found, tried), tried.candidate.label
    if why is None:
        return Bar(label, tried.evidence, TAKEN, "in the final set")
    name = tried.candidate.name
    stands = tried.evidence > MIN_EVIDENCE and name not in found.selection.refused
    return Bar(label, tried.evidence, PASSED if stands else FAILED, _short(why))


def _short(reasons: str) -> str:
    """The head of the first reason, and how many more there are."""
    first, *more = reasons.split("; ")
    head = first.partition(":")[0].partition(" from ")[0]
    return head if not more else f"{head}, and {len(more)} more"


def add_shift(page: Page, found: Diagnosis) -> None:
    """What the base parameters had bent to without the effects."""
    shift = summary(found)["base_parameters"]
    names = list(shift)
    before, after = ({n: shift[n][k] for n in names} for k in ("before", "after"))
    for first, second in (("tau_omega_1", "tau_omega_2"), ("tau_beta_1", "tau_beta_2")):
        if {first, second} <= set(names) and (before[first] < before[second]) != (after[first] < after[second]):
            before[first], before[second] = before[second], before[first]
    before, after = (np.array(list(values.values())) for values in (before, after))
    reach = 1.96 * np.array([shift[n]["std"] or np.nan for n in names], float)
    k = int(np.argmax(np.abs(before - after) / np.maximum(np.abs(after), 1e-9)))
    title = f"Without the effect {names[k]} had bent to {digits(before[k])}; with it, it is {digits(after[k])}"
    figure = parameter_change(names, before, after, after - reach, after + reach, title)
    caption = "Start: the best fit without the effects; fitted: with them, 95 % intervals. Lags in the latter's order."
    page.figure(figure, caption)


def add_apart(page: Page, found: Diagnosis) -> None:
    """Which effects these commands can tell apart, and which they can't show."""
    apart = found.distinguishability
    visible = [i for i, v in enumerate(apart.visibility) if v >= VISIBLE]
    names = np.array([label.split(" ")[0] for label in apart.labels])
    close = np.where(names[:, None] != names, apart.overlap, 0.0)[:, visible].max(axis=1, initial=0.0)
    own = set(found.final.effects)
    chosen = [i for i in visible if close[i] >= CLOSE or names[i] in own]
    chosen = sorted(sorted(chosen, key=lambda i: (names[i] not in own, -close[i]))[:MOST])
    if len(chosen) > 1:
        pairs = apart.alike()
        title = "These commands tell every visible effect from every other"
        if pairs:
            one, other, _ = pairs[0]
            title = f"{len(pairs)} pairs of effects pass for each other under these commands, {one} and {other} first"
        labels = [apart.labels[i] for i in chosen]
        figure = overlap_heatmap(labels, apart.overlap[np.ix_(chosen, chosen)], title)
        caption = "Squared cosine of what the base parameters can't follow of each effect's trace; 1: one passes for the other."
        page.figure(figure, f"{caption} Effects that are close to another, and those found.")
    unseen = ", ".join(apart.invisible()) or "none"
    page.note(f"Would not show at a plausible size under these commands: {unseen}.")
