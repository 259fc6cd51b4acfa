"""The report's section on the parameters: their values, how far these are to be trusted, how the search got there."""

import numpy as np

from identification.fit.refine import Refinement
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.identify import Identification
from identification.worth.pairs import forms
from vpp_fmu.report import Page, correlation_heatmap, learning_curve, parameter_change

TELLING = 0.2
"""Share of the weakest direction from which a parameter is named with it."""


def add_found(page: Page, found: Identification) -> None:
    """Figures and tables of what an identification found."""
    r, doubt = found.refinement, found.refinement.uncertainty
    page.section("What was found")
    start, (low, high) = np.array([found.start[n] for n in r.names]), doubt.intervals.T
    moved = _most_moved(r.names, start, doubt)
    change = "Change in % of the start, which steps and static map gave; 95 % intervals."
    page.figure(parameter_change(r.names, start, doubt.values, low, high, moved), change)
    kinds = [doubt.kind(n) for n in r.names]
    rows = list(zip(r.names, start, doubt.values, doubt.std, low, high, kinds, doubt.inflation, strict=True))
    columns = ("parameter", "start", "final", "std", "95 % from", "to", "by", "std over white")
    page.table(columns, rows, "Time constants in s, coefficients normalised; std accounts for the residuals' colour.")
    if doubt.profiled:
        page.note(
            f"The cost is no parabola in {', '.join(doubt.profiled)}: their intervals end where the cost, all other parameters "
            "refitted, has risen by what 95 % allow."
        )
    for name, why in r.held.items():
        page.note(f"{name} is held at {r.values[name]:.4g}: {why}.")
    _add_bootstrap(page, found)
    _add_forms(page, doubt)
    _add_curve(page, r)
    correlation = doubt.correlation
    page.figure(correlation_heatmap(r.names, correlation, _strongest(r.names, correlation)), _weakest(doubt))


def _add_bootstrap(page: Page, found: Identification) -> None:
    if found.bootstrap is not None:
        b = found.bootstrap
        rows = list(zip(b.names, b.std, *b.intervals.T, b.ratio, strict=True))
        columns = ("parameter", "std", "95 % from", "to", "over the covariance's std")
        page.table(columns, rows, f"Block bootstrap, {len(b.samples)} resamples: the same without any parabola.")


def _add_forms(page: Page, doubt: Uncertainty) -> None:
    """What is told of a pair of lags whichever comes first."""
    rows = [
        (f"{'speed' if channel == 'omega' else 'pitch'}, {form} [{unit}]", told[form]["value"], told[form]["std"])
        for channel, told in forms(doubt).items()
        for form, unit in (("sum", "s"), ("product", "s²"))
    ]
    if rows:
        relative = [(*row, f"{100 * row[2] / row[1]:.2g}") for row in rows]
        caption = "The lags of a channel do not tell which comes first: their sum and product are what is known best."
        page.table(("lags", "value", "std", "std [%]"), relative, caption)


def _weakest(doubt: Uncertainty) -> str:
    """The caption that names what is known least."""
    condition, direction, spread = doubt.directions()
    named = [f"{direction[k]:+.2f} {doubt.names[k]}" for k in np.argsort(-np.abs(direction)) if abs(direction[k]) >= TELLING]
    least = f"Least is known of the direction {', '.join(named)} (relative): ± {100 * NORMAL_95 * spread:.3g} %"
    return f"Correlation of the estimates. {least}; condition number {condition:.0f}."


def _add_curve(page: Page, r: Refinement) -> None:
    """How the search closed in: its cost above that of its end, which has no place on a logarithm."""
    above = np.array(r.curve[:-1]) / r.curve[-1] - 1.0
    if len(above) < 2 or above.min() <= 0.0:
        return
    title = f"In {len(above)} steps the cost falls from {100 * above[0]:.2g} % above its end to within {above[-1]:.0e} of it"
    caption = f"{r.method}: half the weighted sum of squares, under the first weights, over that of the end, less one."
    page.figure(learning_curve(np.arange(len(above)), above, title, "cost above its end [-]"), caption)


def _most_moved(names, start: np.ndarray, doubt: Uncertainty) -> str:
    """Which parameter the fine-tuning moved farthest, in its standard deviations."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.nan_to_num(np.abs(doubt.values - start) / doubt.std, posinf=0.0)
    k = int(np.argmax(far))
    moved = f"by {far[k]:.1f} standard deviations, from {start[k]:.3g} to {doubt.values[k]:.3g}"
    return f"Fine-tuning moves {names[k]} the most: {moved}"


def _strongest(names, correlation) -> str:
    pairs = np.abs(np.triu(correlation, 1))
    i, j = np.unravel_index(np.argmax(pairs), pairs.shape)
    return f"{names[i]} and {names[j]} are the hardest to tell apart: correlation {correlation[i, j]:.2f}"
