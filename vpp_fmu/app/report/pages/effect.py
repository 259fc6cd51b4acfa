"""Sections on the effects of a diagnosis: their curves, their influence at rest and over time, and learned terms."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.learned.columns import Course, lagged
from identification.diagnose.learned.description import FILE, rival_words, sentence
from identification.diagnose.learned.laws import curve_of
from identification.diagnose.search.fits import Fit
from identification.fit.noise import blocks
from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, figure, panels
from vpp_fmu.app.report.figures import stacked
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.sentences import titled
from vpp_fmu.digits import number
from vpp_fmu.kernel.learned import DRIVERS, PORTS
from vpp_fmu.kernel.learned.shapes import LAWS, SHAPES
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.record import Record

QUANTITIES = {"beta": ("pitch", "deg", 0.02), "omega": ("speed", "rpm", 5.0)}
"""Output: its word and unit, and the minimum change by which an effect acts on it."""

OUTPUTS = ("thrust", "omega", "beta")
STAIRS, HOLD, STEP = 60, 3.0, 0.02
"""Stairs of a sweep up and down, seconds on each, and the simulation step, s."""

NEAR = 1.5
"""Seconds shown before and after the largest influence of an effect."""

AT_REST = 0.01
"""Minimum share of the range that counts as an influence at rest."""

POINTS, BINS = 200, 60
"""Points of a law's line; bins of a histogram."""


def add_effects(page: Page, found: Diagnosis) -> None:
    """The effects of the final set: one curve at rest for all those of a channel; if they have none, each one's largest
    influence over time."""
    moved: dict[str, dict[str, Mapping]] = {}
    for effect in found.final.effects:
        on, off = _with_and_without(found.final, effect, found.shown)
        change = {n: on[n] - off[n] for n in on}
        channel = next((n for n, (*_, least) in QUANTITIES.items() if np.max(np.abs(change[n])) > least), "thrust")
        moved.setdefault(channel, {})[effect] = change
    for channel, changes in moved.items():
        if channel == "thrust" or not _add_at_rest(page, found, list(changes), channel):
            for effect, change in changes.items():
                _add_in_time(page, found, effect, channel, change)


def around(time: np.ndarray, center: float, half: float) -> np.ndarray:
    """Mask (n,) of the times [s] up to `half` s around a moment; at an end of the record the window is shifted inside."""
    first = max(time[0], min(center - half, time[-1] - 2.0 * half))
    return (time >= first) & (time <= first + 2.0 * half)


def _simulated(fit: Fit, columns, steps, late=0.0, changes=()) -> dict[str, np.ndarray]:
    """Outputs (rows,) by name."""
    outputs = fit.problem.simulator.simulate({**fit.values, **dict(changes)}, columns, steps, late)
    return dict(zip(OUTPUTS, outputs.T, strict=True))


def _with_and_without(fit: Fit, name: str, record: Record) -> tuple[dict, dict]:
    effect = next(e for e in fit.problem.model.effects if e.name == name)
    off = {effect.full(n): v for n, v in effect.off.items()}
    return _simulated(fit, *record.run), _simulated(fit, *record.run, off)


def _add_at_rest(page: Page, found: Diagnosis, effects: Sequence[str], channel: str) -> bool:
    """Reached against commanded values, up and down; False and nothing if the effects have no influence at rest."""
    word, unit, _ = QUANTITIES[channel]
    record, command = found.shown, f"{channel}_ref"
    up = np.linspace(record[command].min(), record[command].max(), STAIRS + 1)
    stairs = np.concatenate([up, up[-2::-1]])
    reached = {name: at_rest(fit, record, command, stairs)[channel] for name, fit in found.fits.items()}
    off = float(np.max(np.abs(list(reached.values())[-1] - stairs)))
    if off < AT_REST * np.ptp(stairs):
        return False
    title = f"{titled(' and '.join(effects))}: at rest the {word} deviates by up to {number(off, 3)} {unit} from its command"
    fig = figure(title, 320, f"{word} commanded [{unit}]", f"{word} reached [{unit}]")
    fig.line(up[[0, -1]], up[[0, -1]], "as commanded", style.SET_POINT, 1.4, dash="dot", mute=True)
    colours = style.colours(reached)
    for name, values in reached.items():
        fig.line(stairs, values, name, colours[name])
    page.figure(fig, f"The settled models on stairs of {number(stairs[1] - stairs[0], 2)} {unit}, up and down.")
    return True


def at_rest(fit: Fit, record: Record, command: str, stairs: np.ndarray) -> dict[str, np.ndarray]:
    """Outputs (stairs,) at the end of each stair of a command, all other inputs at their means."""
    rows = round(HOLD / STEP)
    n = len(stairs) * rows
    inputs = [u.name for u in fit.problem.model.inputs if not u.clock]
    columns = {name: np.full(n, np.mean(record[name])) for name in inputs if name != command}
    columns[command] = np.repeat(stairs, rows)
    outputs = _simulated(fit, columns, np.full(n - 1, STEP))
    return {name: values[rows - 1 :: rows] for name, values in outputs.items()}


def _add_in_time(page: Page, found: Diagnosis, effect: str, channel: str, change: Mapping) -> None:
    record = found.shown
    at = blocks(record, 0.2)
    center = float(at.time[np.argmax(np.abs(at.mean(change[channel])))])
    near = np.flatnonzero(around(record.time, center, NEAR))
    shown = {name: found.prediction(fit, record) for name, fit in found.fits.items()}
    thrusts = {"measured": record["thrust"][near]} | {name: p.thrust[near] for name, p in shown.items()}
    rows, sizes = {"thrust [N]": thrusts}, [f"{number(np.max(np.abs(change['thrust'][near])), 3)} N of thrust"]
    if channel != "thrust":
        word, unit, _ = QUANTITIES[channel]
        lines = {f"{word} command": record[f"{channel}_ref"][near]}
        lines |= {"measured": record[channel][near]} if channel in record else {}
        rows = {f"{word} [{unit}]": lines | {name: getattr(p, channel)[near] for name, p in shown.items()}, **rows}
        sizes.insert(0, f"{number(np.max(np.abs(change[channel][near])), 3)} {unit} of {word}")
    title = f"{titled(effect)} has its largest influence around {center:.0f} s: {', '.join(sizes)}"
    page.figure(stacked(record.time[near], rows, title), "Before: the best model without the effect.")


def add_learned(page: Page, found: Diagnosis) -> None:
    learned = found.learned
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
        fig = learned_curve(
            at, f, NORMAL_95 * std, lines, data(found), title, (driver.words, driver.unit), (port.words, port.unit)
        )
        page.figure(fig, "Band: 95 % at each knot. Below: histogram of the fitted records. Constant beyond both ends.")
    if learned.rivals:
        others = ", ".join(dict.fromkeys(rival_words(t) for t in learned.rivals))
        page.note(f"These records hardly distinguish it from: {others}. The commands of next_experiment.csv do.")


def learned_curve(
    at: np.ndarray,
    value: np.ndarray,
    half: np.ndarray,
    lines: Mapping[str, tuple[np.ndarray, np.ndarray]],
    data: np.ndarray,
    title: str,
    driver: tuple[str, str],
    term: tuple[str, str],
) -> Figure:
    """A curve `value` (knots,) +- `half` over `at`, further `lines` (x, y) by name, and a histogram of the `data` (n,) below.

    `driver`, `term`: (words, unit) of the axes.
    """
    labels = [f"{term[0]} [{'-' if term[1] == '1' else term[1]}]", "share of time [%]"]
    fig = panels(title, labels, [320, 110], f"{driver[0]} [{driver[1]}]")
    fig.envelope(at, value - half, value + half, "95 %", style.VEIL)
    colours = style.colours(lines)
    for name, (x, y) in lines.items():
        fig.line(x, y, name, colours[name], size=6 * (len(x) == len(at)))
    count, edges = np.histogram(data, BINS)
    share = 100.0 * count / max(count.sum(), 1)
    fig.line(edges, np.append(share, 0.0), "data", style.MEASURED, panel=1, group="data", held=True)
    fig.axes["x"]["format"] = ".4~g"
    return fig


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
