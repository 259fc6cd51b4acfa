"""Of the report: what speaks for each candidate and where it failed, and what these commands can tell apart at all."""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.report.summary import summary
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.judge import ALIKE, ENOUGH_BIC, Seen, judge, seen_at_best
from identification.diagnose.search.rounds import Tried
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
    unseen = [Experiment([record], found.noise) for record in found.held]
    verdicts = []
    for number, tried in enumerate(found.selection.rounds, start=1):
        fitted = [t for t in tried if t.fit is not None]
        if fitted:
            verdicts += [bar.why for bar in _add_round(page, found, number, fitted, unseen)]
    rows = []
    refitted = [entry for entry in summary(found)["candidates"] if "delta_bic" in entry]
    for entry, verdict in zip(refitted, verdicts, strict=True):
        beside = " + ".join(entry["beside"]) or "nothing"
        form = ", ".join(f"{v:g}" for v in entry["form"].values()) or "only"
        size = ", ".join(f"{n.partition('.')[2]} {digits(v, 3)}" for n, v in entry["parameters"].items())
        rows.append((entry["name"], form, beside, f"{entry['delta_bic']:.1f}", size, verdict))
    columns = ("effect", "form", "beside", "fall of BIC", "parameters", "verdict")
    page.table(columns, rows, "Candidates that were refitted in full.")
    for effect, judged in found.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.1f}" for channel, gain in judged.held_out_gain.items())
        page.note(f"{effect}: BIC falls by {judged.delta_bic:.0f}; log-likelihood of unseen data: {gains}.")


def _add_round(page: Page, found: Diagnosis, number: int, fitted: list[Tried], unseen) -> list[Bar]:
    """A figure of the candidates of a round; returns what it shows of each, in their order."""
    base = _base_of(found, fitted[0].beside)
    without = seen_at_best(base, unseen)
    bars = [_bar(found, t, base, without, unseen, max(t.delta_bic for t in fitted)) for t in fitted]
    beside = " and ".join(fitted[0].beside) or "nothing"
    best = max(bars, key=lambda bar: bar.fall)
    taken = max((bar for bar in bars if bar.outcome == TAKEN), key=lambda bar: bar.fall, default=None)
    if taken is None:
        title = f"Round {number}, beside {beside}: no candidate is taken, {best.name} comes nearest"
    else:
        title = f"Round {number}, beside {beside}: {taken.name} lowers the BIC by {taken.fall:,.0f}"
    page.figure(
        evidence_bars(bars, ENOUGH_BIC, title),
        "Each candidate refitted with all parameters; gates: BIC, unseen thrust and speed, bounds, size.",
    )
    return bars


def _base_of(found: Diagnosis, beside: tuple[str, ...]) -> Fit:
    """The fit that a round's candidates were added to."""
    if not beside:
        return found.selection.base
    tried = [t for each in found.selection.rounds for t in each if t.fit is not None]
    return min((t.fit for t in tried if set(t.fit.effects) == set(beside)), key=Fit.bic, default=found.selection.base)


def _bar(found: Diagnosis, tried: Tried, base: Fit, without: Seen, unseen, top: float) -> Bar:
    name = tried.candidate.name
    judged = judge(name, tried.fit, base, seen_at_best(tried.fit, unseen), without, found.selection.base)
    label = tried.candidate.label
    if name in found.final.effects and all(found.final.forms.get(n) == v for n, v in tried.candidate.form.items()):
        return Bar(label, tried.delta_bic, TAKEN, "in the final set")
    if judged.refused:
        return Bar(label, tried.delta_bic, FAILED, _short(judged.refused))
    if name in found.selection.refused:
        return Bar(label, tried.delta_bic, FAILED, f"beside others: {_short(found.selection.refused[name].refused)}")
    why = "fits as well" if tried.delta_bic > top - ALIKE else "another explains more"
    return Bar(label, tried.delta_bic, PASSED, why)


def _short(reasons: tuple[str, ...]) -> str:
    """The head of the first reason, and how many more there are."""
    head = reasons[0].partition(":")[0].partition(" from ")[0]
    return head if len(reasons) == 1 else f"{head}, and {len(reasons) - 1} more"


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
    apart = found.apart
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
