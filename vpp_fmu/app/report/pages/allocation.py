"""The report of an allocation: least power over thrust, and the pairs on the map of power."""

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from identification.power.allocation import Allocation
from vpp_fmu.app.report.figures.map import best_pairs, least_power
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.sentences import size
from vpp_fmu.digits import number


def key_figures(found: Allocation) -> list[tuple[str, str, str]]:
    """(label, value, note) of the figures of the first screen."""
    low, high = (number(float(extreme(found.beta)), 3) for extreme in (np.min, np.max))
    share = float(np.max(NORMAL_95 * found.power_std / found.power))
    return [
        (
            "power saved",
            f"{100.0 * found.saving:.1f} %",
            f"mean, against the best fixed pitch of the same range of thrust, {found.fixed_beta:.3g} deg",
        ),
        ("best pitch", f"{low} to {high} deg", f"at {number(found.thrust[0], 3)} to {number(found.thrust[-1], 3)} N"),
        (f"{found.model.kind} power", f"± {100.0 * share:.2g} %", "largest half width of its 95 % interval along the pairs"),
        ("reserve of pitch alone", f"{number(float(np.min(found.reserve)), 2)} N", "the least over all thrusts, both ways"),
    ]


def headline(found: Allocation) -> str:
    """The saving in a sentence."""
    verb = "save" if found.saving >= 0.0 else "cost"
    ends = f"{number(found.thrust[0])} to {number(found.thrust[-1])} N"
    return (
        f"The pairs of speed and pitch {verb} {100.0 * abs(found.saving):.1f} % of the {found.model.kind} power over {ends}, "
        f"against the best fixed pitch of {size(found.fixed_beta, 'deg')}."
    )


def allocation_page(found: Allocation) -> Page:
    """The report of an allocation."""
    goal = "the least power" if found.weight == 0.0 else f"power and reserve of thrust at a weight of {found.weight:g}"
    text = f"For each thrust the pair of speed and pitch of {goal}, within the rig's limits. Between pairs of the same thrust, "
    text += f"{found.model.kind} power differs."
    page = Page("Speed and pitch for each thrust", text, found.model.parameters.label)
    page.tiles(key_figures(found))
    share = f"{100.0 * abs(found.saving):.1f} %"
    verb = f"save {share} of the power" if found.saving >= 0.0 else f"take {share} more power"
    title = f"The pairs {verb} against the best fixed pitch, {found.fixed_beta:.3g} deg"
    half = NORMAL_95 * found.power_std
    fixed = {f"best fixed pitch, {found.fixed_beta:.3g} deg": found.fixed}
    caption = "95 % interval: of the power's parameters; the choice of a map's terms is not part of it."
    page.figure(least_power(found.thrust, found.power, half, fixed, title), caption)
    speeds, pitches, thrust = found.surface.grid
    few = slice(None, None, max(1, len(speeds) // 100))
    watts = found.model.at(*np.meshgrid(speeds[few], pitches, indexing="ij"))
    title = "Pairs of equal thrust cross lines of equal power: the best ones lie on the line"
    lines = np.linspace(0.0, float(found.thrust[-1]), 7)[1:-1]
    figure = best_pairs(speeds[few], pitches, watts.T, thrust[few].T, lines, (found.omega, found.beta), title)
    values = ", ".join(number(level, 3) for level in lines)
    caption = (
        f"Colours: power. Thin lines: equal thrust, {values} N. Thick line: the pairs, from the least to the greatest thrust."
    )
    page.figure(figure, caption)
    rows = [
        (
            number(t, 4),
            number(w, 5),
            number(b, 3),
            f"{b0:.3g} to {b1:.3g}",
            number(p, 4),
            number(NORMAL_95 * s, 2),
            number(r, 3),
        )
        for t, w, b, (b0, b1), p, s, r in zip(
            *(found.thrust, found.omega, found.beta, found.beta_band, found.power, found.power_std, found.reserve), strict=True
        )
    ]
    columns = ("thrust [N]", "speed [rpm]", "pitch [deg]", "pitch, 95 % [deg]", "power [W]", "± 95 % [W]", "reserve [N]")
    page.table(columns, rows[:: max(1, len(rows) // 20)], "Pairs; allocation.csv has all of them.")
    return page
