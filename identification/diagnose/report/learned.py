"""Of the report: the curve that was learned, over its driver, with the data below it; the laws tried, and what it could also
be."""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.learned.columns import Course, lagged
from identification.diagnose.learned.description import FILE, rival_words, sentence
from identification.diagnose.learned.laws import curve_of
from identification.diagnose.report.summary import why_not_term
from vpp_fmu.digits import number
from vpp_fmu.kernel.learned import DRIVERS, PORTS
from vpp_fmu.kernel.learned.shapes import LAWS, SHAPES
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.report import Page, learned_curve

POINTS = 200
"""Of a law's line."""

MOST_TRIED = 6
"""Terms of which a page says why they do not stand."""


def add_learned(page: Page, found: Diagnosis) -> None:
    """The curve, the laws, the rivals."""
    learned, stds = found.learned, found.std
    term, curve = learned.term, learned.curve
    page.note(f"A term of no list {sentence(term)}. It is in {FILE}, which --effects-from takes, and in the FMU.")
    if curve.lead.shape == "curve":
        driver, port = DRIVERS[term.lead.driver], PORTS[term.lead.port]
        at, f, std = curve_of(curve)
        fine = np.linspace(at[0], at[-1], POINTS)
        lines = {"learned, as a table": (at, f)}
        if term is not curve:
            level = np.interp(at[0], at, f) - law(term, at[:1])[0] if _free(curve) else 0.0
            lines[f"law: {term.lead.shape}"] = fine, law(term, fine) + level
        title = f"The term at {port.words} over {driver.words}, as it was learned"
        figure = learned_curve(
            at, f, 1.96 * std, lines, data(found), title, (driver.words, driver.unit), (port.words, port.unit)
        )
        page.figure(figure, "Band: 95 %, knot by knot. Below: how long the fitted records were where. Flat beyond both ends.")
    rows = [
        (n, "fitted" if term.effect.full(n) in term.fit.free else "fixed", number(v), number(stds.get(term.effect.full(n)), 2))
        for n, v in term.values.items()
    ]
    page.table(("parameter", "how", "value", "std"), rows, f"Parameters of {term.effect.name}.")
    if learned.laws:
        told = [(name, SHAPES[name].equation, f"{evidence:.1f}") for name, evidence in learned.laws]
        page.table(("law", "f over the driver v", "evidence over the table [nat]"), told, "Simple laws in the curve's place.")
    if learned.rivals:
        others = ", ".join(dict.fromkeys(rival_words(t) for t in learned.rivals))
        page.note(f"These records hardly tell it from: {others}. next_experiment.csv holds commands that would.")


def add_attempt(page: Page, found: Diagnosis) -> None:
    """What was looked for and does not ship: where the best of it enters says where to look, though it is not it."""
    attempt = found.attempt
    if attempt.learned or not attempt.tried:
        return
    rows = [
        (sentence(term), number(judged.evidence), why_not_term(found, term, judged))
        for term, judged in attempt.tried[:MOST_TRIED]
    ]
    caption = f"Terms of no list, of {attempt.comparisons} looked at those that predict most of what was left out. None ships."
    page.table(("the term", "evidence [nat]", "why it does not ship"), rows, caption)


def _free(curve) -> bool:
    """Whether no knot is pinned: a level is then the base's, or the curve's, as it comes."""
    return not any(n.startswith("value_") for n in curve.lead.pinned)


def law(term, v: np.ndarray) -> np.ndarray:
    """A term's f at values v (n,) of its driver; NaN where it has a memory."""
    shape = SHAPES[term.lead.shape]
    if term.lead.shape not in LAWS or shape.memory:
        return np.full(len(v), np.nan)
    p = type("Values", (), term.values)
    return np.array([shape.value(NUMBERS, None, p, float(one), 0.0)[0] for one in v])


def data(found: Diagnosis) -> np.ndarray:
    """The driver as the fitted records go through it."""
    term, fit = found.learned.term, found.final
    lead, parts = term.lead, []
    for e in fit.problem.experiments:
        outputs = fit.problem.simulator.simulate(fit.values, *e.record.run)
        course = Course.of(e, fit.values, outputs)
        v = course.driver(lead.driver, lead.port, lead.form, False)
        parts.append(lagged(v, term.values.get("lag", 0.0), course.step))
    return np.concatenate(parts)
