"""Report section on the parameters: values, uncertainty, and the course of the search."""

import numpy as np

from identification.assessment.pairs import forms
from identification.fit.refine import Refinement
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.identify import Identification
from vpp_fmu.digits import interval, number
from vpp_fmu.report import Page, correlation_heatmap, learning_curve, parameter_change

TELLING = 0.2
"""Component of the weakest direction from which a parameter is named."""


def add_found(page: Page, found: Identification) -> None:
    """Add figures and tables of the parameters of an identification."""
    uncertainty = found.uncertainty
    page.section("Parameters")
    if found.refinement is not None:
        _add_change(page, found)
    _add_values(page, found)
    if lines := not_identifiable(found):
        page.note("\n\n".join(f"{line[0].upper()}{line[1:]}." for line in lines))
    if uncertainty.profiled:
        page.note(
            f"The cost is not quadratic in {', '.join(uncertainty.profiled)}: their 95 % intervals are those of the profile "
            "likelihood."
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


def not_identifiable(found: Identification) -> list[str]:
    """Parameters that are not identifiable, or that ended on a bound, as sentences without full stop."""
    reasons: dict[str, list[str]] = {}
    for name, why in found.not_identifiable.items():
        state = "fitted to" if name in found.uncertainty.names else "stays at"
        reasons.setdefault(why, []).append(f"{name} ({state} {number(found.parameters.values[name])})")
    lines = [f"not identifiable from these data: {', '.join(names)}: {why}" for why, names in reasons.items()]
    return lines + [f"on a bound: {name}, which ended at {number(bound)}" for name, bound in found.at_bounds.items()]


def _add_change(page: Page, found: Identification) -> None:
    """Change of the parameters from the start to the end of the fit."""
    uncertainty = found.uncertainty
    start, (low, high) = np.array([found.start[n] for n in uncertainty.names]), uncertainty.intervals.T
    moved = _most_moved(uncertainty.names, start, uncertainty)
    caption = "Change in % of the start values from steps and static map; 95 % intervals."
    page.figure(parameter_change(uncertainty.names, start, uncertainty.values, low, high, moved), caption)


def _add_values(page: Page, found: Identification) -> None:
    """Each value with its uncertainty."""
    uncertainty, rows = found.uncertainty, []
    for k, name in enumerate(uncertainty.names):
        bound = "on its bound" if name in found.at_bounds else uncertainty.kind(name)
        ends = interval(*uncertainty.intervals[k].tolist())
        estimate = (float(uncertainty.values[k]), number(float(uncertainty.std[k]), 3), ends)
        rows.append((name, found.start[name], *estimate, bound, number(uncertainty.inflation[k], 3)))
    units = "Time constants in s, coefficients normalised"
    if found.refinement is not None:
        columns = ("parameter", "start", "final", "std", "95 % interval", "by", "std over white")
        page.table(columns, rows, f"{units}; std accounts for the autocorrelation of the residuals.")
    else:
        columns = ("parameter", "value", "std", "95 % interval")
        page.table(columns, [(name, *estimate) for name, _, *estimate in (row[:5] for row in rows)], f"{units}.")


def _add_bootstrap(page: Page, found: Identification) -> None:
    if found.bootstrap is not None:
        b = found.bootstrap
        ends = [interval(*each) for each in b.intervals.tolist()]
        std, ratio = ([number(v, 3) for v in each] for each in (b.std, b.ratio))
        rows = list(zip(b.names, std, ends, ratio, strict=True))
        columns = ("parameter", "std", "95 % interval", "over the covariance's std")
        page.table(columns, rows, f"Block bootstrap, {len(b.samples)} resamples: without the assumption of a quadratic cost.")


def _add_forms(page: Page, uncertainty: Uncertainty) -> None:
    """Sum and product of a pair of lags, which do not depend on their order."""
    rows = [
        (f"{'speed' if channel == 'omega' else 'pitch'}, {form} [{unit}]", estimates[form]["value"], estimates[form]["std"])
        for channel, estimates in forms(uncertainty).items()
        for form, unit in (("sum", "s"), ("product", "s²"))
    ]
    if rows:
        relative = [(name, value, number(std, 3), number(100 * std / value, 2)) for name, value, std in rows]
        caption = "The order of a channel's lags is not identifiable; their sum and product are identified best."
        page.table(("lags", "value", "std", "std [%]"), relative, caption)


def _weakest(uncertainty: Uncertainty) -> str:
    """Caption that names the direction of the largest uncertainty."""
    condition, direction, spread = uncertainty.directions()
    named = [
        f"{direction[k]:+.2f} {uncertainty.names[k]}" for k in np.argsort(-np.abs(direction)) if abs(direction[k]) >= TELLING
    ]
    weakest = f"Largest uncertainty: direction {', '.join(named)} (relative), ± {number(100 * NORMAL_95 * spread, 3)} %"
    return f"Correlation of the estimates. {weakest}; condition number {number(condition, 3)}."


def _add_curve(page: Page, r: Refinement) -> None:
    """Learning curve: the cost relative to its final value, minus 1, on a logarithmic axis."""
    above = np.array(r.curve[:-1]) / r.curve[-1] - 1.0
    if len(above) < 2 or above.min() <= 0.0:
        return
    first, last = number(100 * above[0], 2), number(100 * above[-1], 2)
    title = f"In {len(above)} steps the cost decreases from {first} % to {last} % above its final value"
    caption = f"{r.method}: half the weighted sum of squares, with the first weights, over the final one, minus 1."
    page.figure(learning_curve(np.arange(len(above)), above, title, "cost above its final value [-]"), caption)


def _most_moved(names, start: np.ndarray, uncertainty: Uncertainty) -> str:
    """Title: the parameter with the largest change, in standard errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.nan_to_num(np.abs(uncertainty.values - start) / uncertainty.std, posinf=0.0)
    k = int(np.argmax(far))
    change = f"by {number(far[k], 2)} standard errors, from {number(start[k])} to {number(uncertainty.values[k])}"
    return f"The fit changes {names[k]} the most: {change}"


def _strongest(names, correlation) -> str:
    pairs = np.abs(np.triu(correlation, 1))
    i, j = np.unravel_index(np.argmax(pairs), pairs.shape)
    return f"{names[i]} and {names[j]} are correlated most strongly: {correlation[i, j]:.2f}"
