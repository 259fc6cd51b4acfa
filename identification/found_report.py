"""The report's section on the parameters: their values, how far these are to be trusted, how the search got there."""

import numpy as np

from identification.assessment.pairs import forms
from identification.fit.refine import Refinement
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.identify import Identification
from vpp_fmu.digits import interval, number
from vpp_fmu.report import Page, correlation_heatmap, learning_curve, parameter_change

TELLING = 0.2
"""Share of the weakest direction from which a parameter is named with it."""


def add_found(page: Page, found: Identification) -> None:
    """Figures and tables of what an identification found."""
    uncertainty = found.uncertainty
    page.section("What was found")
    if found.refinement is not None:
        _add_change(page, found)
    _add_values(page, found)
    if lines := untold(found):
        page.note("\n\n".join(f"{line[0].upper()}{line[1:]}." for line in lines))
    if uncertainty.profiled:
        page.note(
            f"The cost is no parabola in {', '.join(uncertainty.profiled)}: their intervals end where the cost, all other "
            "parameters refitted, has risen by what 95 % allow."
        )
    _add_bootstrap(page, found)
    _add_forms(page, uncertainty)
    if found.refinement is not None:
        _add_curve(page, found.refinement)
    if len(uncertainty.names) > 1:
        figure = correlation_heatmap(
            uncertainty.names, uncertainty.correlation, _strongest(uncertainty.names, uncertainty.correlation)
        )
        page.figure(figure, _weakest(uncertainty))


def untold(found: Identification) -> list[str]:
    """In sentences without their stop: parameters that the data do not tell, or that ended on a bound."""
    reasons: dict[str, list[str]] = {}
    for name, why in found.not_identifiable.items():
        stands = "fitted to" if name in found.uncertainty.names else "stays at"
        reasons.setdefault(why, []).append(f"{name} ({stands} {number(found.parameters.values[name])})")
    lines = [f"not told by these data: {', '.join(names)}: {why}" for why, names in reasons.items()]
    return lines + [f"on a bound: {name}, which ended at {number(bound)}" for name, bound in found.at_bounds.items()]


def _add_change(page: Page, found: Identification) -> None:
    """From the start to the end of the fit."""
    uncertainty = found.uncertainty
    start, (low, high) = np.array([found.start[n] for n in uncertainty.names]), uncertainty.intervals.T
    moved = _most_moved(uncertainty.names, start, uncertainty)
    change = "Change in % of the start, which steps and static map gave; 95 % intervals."
    page.figure(parameter_change(uncertainty.names, start, uncertainty.values, low, high, moved), change)


def _add_values(page: Page, found: Identification) -> None:
    """Each value with what it is worth."""
    uncertainty, rows = found.uncertainty, []
    for k, name in enumerate(uncertainty.names):
        bound = "on its bound" if name in found.at_bounds else uncertainty.kind(name)
        ends = interval(*uncertainty.intervals[k].tolist())
        told = (float(uncertainty.values[k]), number(float(uncertainty.std[k]), 3), ends)
        rows.append((name, found.start[name], *told, bound, number(uncertainty.inflation[k], 3)))
    units = "Time constants in s, coefficients normalised"
    if found.refinement is not None:
        columns = ("parameter", "start", "final", "std", "95 % interval", "by", "std over white")
        page.table(columns, rows, f"{units}; std accounts for the residuals' colour.")
    else:
        columns = ("parameter", "value", "std", "95 % interval")
        page.table(columns, [(name, *told) for name, _, *told in (row[:5] for row in rows)], f"{units}.")


def _add_bootstrap(page: Page, found: Identification) -> None:
    if found.bootstrap is not None:
        b = found.bootstrap
        ends = [interval(*each) for each in b.intervals.tolist()]
        std, ratio = ([number(v, 3) for v in each] for each in (b.std, b.ratio))
        rows = list(zip(b.names, std, ends, ratio, strict=True))
        columns = ("parameter", "std", "95 % interval", "over the covariance's std")
        page.table(columns, rows, f"Block bootstrap, {len(b.samples)} resamples: the same without any parabola.")


def _add_forms(page: Page, uncertainty: Uncertainty) -> None:
    """What is told of a pair of lags whichever comes first."""
    rows = [
        (f"{'speed' if channel == 'omega' else 'pitch'}, {form} [{unit}]", told[form]["value"], told[form]["std"])
        for channel, told in forms(uncertainty).items()
        for form, unit in (("sum", "s"), ("product", "s²"))
    ]
    if rows:
        relative = [(name, value, number(std, 3), number(100 * std / value, 2)) for name, value, std in rows]
        caption = "The lags of a channel do not tell which comes first: their sum and product are what is known best."
        page.table(("lags", "value", "std", "std [%]"), relative, caption)


def _weakest(uncertainty: Uncertainty) -> str:
    """The caption that names what is known least."""
    condition, direction, spread = uncertainty.directions()
    named = [
        f"{direction[k]:+.2f} {uncertainty.names[k]}" for k in np.argsort(-np.abs(direction)) if abs(direction[k]) >= TELLING
    ]
    least = f"Least is known of the direction {', '.join(named)} (relative): ± {number(100 * NORMAL_95 * spread, 3)} %"
    return f"Correlation of the estimates. {least}; condition number {number(condition, 3)}."


def _add_curve(page: Page, r: Refinement) -> None:
    """How the search closed in: its cost above that of its end, which has no place on a logarithm."""
    above = np.array(r.curve[:-1]) / r.curve[-1] - 1.0
    if len(above) < 2 or above.min() <= 0.0:
        return
    first, last = number(100 * above[0], 2), number(100 * above[-1], 2)
    title = f"In {len(above)} steps the cost falls from {first} % above its end to within {last} % of it"
    caption = f"{r.method}: half the weighted sum of squares, under the first weights, over that of the end, less one."
    page.figure(learning_curve(np.arange(len(above)), above, title, "cost above its end [-]"), caption)


def _most_moved(names, start: np.ndarray, uncertainty: Uncertainty) -> str:
    """Which parameter the fine-tuning moved farthest, in its standard deviations."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.nan_to_num(np.abs(uncertainty.values - start) / uncertainty.std, posinf=0.0)
    k = int(np.argmax(far))
    moved = f"by {number(far[k], 2)} standard deviations, from {number(start[k])} to {number(uncertainty.values[k])}"
    return f"Fine-tuning moves {names[k]} the most: {moved}"


def _strongest(names, correlation) -> str:
    pairs = np.abs(np.triu(correlation, 1))
    i, j = np.unravel_index(np.argmax(pairs), pairs.shape)
    return f"{names[i]} and {names[j]} are the hardest to tell apart: correlation {correlation[i, j]:.2f}"
