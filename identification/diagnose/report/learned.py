"""Report section: the learned curve over its driver, with a histogram of the data; the laws, and rival terms."""

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
"""Points of a law's line."""

MOST_TRIED = 6
"""Rejected terms that a page lists with reasons."""


def add_learned(page: Page, found: Diagnosis) -> None:
    """Add the curve, the laws and the rivals."""
    learned, stds = found.learned, found.std
    term, curve = learned.term, learned.curve
    page.note(f"A term outside the library {sentence(term)}. It is in the FMU, and in {FILE} for --effects-from.")
    if curve.lead.shape == "curve":
        driver, port = DRIVERS[term.lead.driver], PORTS[term.lead.port]
        at, f, std = curve_of(curve)
        fine = np.linspace(at[0], at[-1], POINTS)
        lines = {"learned, as a table": (at, f)}
        if term is not curve:
            level = np.interp(at[0], at, f) - law(term, at[:1])[0] if _free(curve) else 0.0
            lines[f"law: {term.lead.shape}"] = fine, law(term, fine) + level
        title = f"The term at {port.words} over {driver.words}, as learned"
        figure = learned_curve(
            at, f, 1.96 * std, lines, data(found), title, (driver.words, driver.unit), (port.words, port.unit)
        )
        page.figure(figure, "Band: 95 % at each knot. Below: histogram of the fitted records. Constant beyond both ends.")
    rows = [
        (n, "fitted" if term.effect.full(n) in term.fit.free else "fixed", number(v), number(stds.get(term.effect.full(n)), 2))
        for n, v in term.values.items()
    ]
    page.table(("parameter", "how", "value", "std"), rows, f"Parameters of {term.effect.name}.")
    if learned.laws:
        laws = [(name, SHAPES[name].equation, f"{evidence:.1f}") for name, evidence in learned.laws]
        page.table(("law", "f over the driver v", "evidence over the table [nat]"), laws, "Simple laws in place of the curve.")
    if learned.rivals:
        others = ", ".join(dict.fromkeys(rival_words(t) for t in learned.rivals))
        page.note(f"These records hardly distinguish it from: {others}. The commands of next_experiment.csv do.")


def add_attempt(page: Page, found: Diagnosis) -> None:
    """Add the rejected terms: the port of the best one suggests where to look."""
    attempt = found.attempt
    if attempt.learned or not attempt.tried:
        return
    rows = [
        (sentence(term), number(judged.evidence), why_not_term(found, term, judged))
        for term, judged in attempt.tried[:MOST_TRIED]
    ]
    caption = f"Terms outside the library: the best of {attempt.comparisons} by cross-validated gain. None is accepted."
    page.table(("the term", "evidence [nat]", "why it is rejected"), rows, caption)


def _free(curve) -> bool:
    """Whether no knot is pinned: then a constant may be in the base or in the curve."""
    return not any(n.startswith("value_") for n in curve.lead.pinned)


def law(term, v: np.ndarray) -> np.ndarray:
    """A term's f at values v (n,) of its driver; NaN if it has memory."""
    shape = SHAPES[term.lead.shape]
    if term.lead.shape not in LAWS or shape.memory:
        return np.full(len(v), np.nan)
    p = type("Values", (), term.values)
    return np.array([shape.value(NUMBERS, None, p, float(one), 0.0)[0] for one in v])


def data(found: Diagnosis) -> np.ndarray:
    """Values of the driver over the fitted records."""
    term, fit = found.learned.term, found.final
    lead, parts = term.lead, []
    for e in fit.problem.experiments:
        outputs = fit.problem.simulator.simulate(fit.values, *e.record.run)
        course = Course.of(e, fit.values, outputs)
        v = course.driver(lead.driver, lead.port, lead.form, False)
        parts.append(lagged(v, term.values.get("lag", 0.0), course.step))
    return np.concatenate(parts)
