"""The page of effects: the content of `vpp effects --html` as a page of the site, with drawings that need no script."""

from html import escape
from textwrap import dedent

import numpy as np

from vpp_fmu.app.report.canvas import Figure
from vpp_fmu.app.report.pages.effects import effects_page, theory
from vpp_fmu.digits import number
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect

PAGE = "reference/effects.md"

WIDTH, HEIGHT, LEFT, RIGHT, GAP = 680, 150, 58, 8, 26
"""Pixels: a panel of a drawing, its margins, and the room below it."""

POINTS = 500


def page() -> str:
    """The Markdown."""
    effects = [effect for effect in LIBRARY if effect.off is not None]
    drawn = effects_page(effects, LIBRARY).figures
    parts = [
        "# Effects",
        f"The plant may have {len(effects)} effects beside the base model. They are listed in their order from "
        "command to reading. "
        "Each is declared once, in a file of `vpp_fmu/kernel/effects`. This page, the simulation, the C code, the "
        "sensitivities and the FMU variables are made from the declaration. `vpp effects --html FILE` writes the same with "
        "figures that can be zoomed; with `--effects-from` for your own effects, too.",
        "Each picture shows the output that the effect changes most, without it (grey) and with it (colour), and the "
        "difference below. The value of each parameter in the picture is its *probe*. Bounds are those "
        "of a rig of the paper's size.",
    ]
    for effect, figure in zip(effects, drawn, strict=True):
        parts += [f"## {effect.name} {{ #{effect.name} }}", f"{effect.description[0].upper()}{effect.description[1:]}."]
        parts += [_theory(effect), _parameters(effect), drawing(figure)]
    return "\n\n".join(parts) + "\n"


def _theory(effect: Effect) -> str:
    found = [part for part in theory(effect).split("\n\n") if part.strip()]
    return "\n\n".join(
        f"<pre><code>{escape(dedent(part)).strip(chr(10))}</code></pre>"
        if part.startswith("    ")
        else f"<p>{escape(part.strip())}</p>"
        for part in found
    )


def _parameters(effect: Effect) -> str:
    rows = [
        f"| `{p.name}` | {p.unit} | {p.description} | {number(p.minimum)} | {number(p.maximum)} | "
        f"{number(effect.probe.get(p.name, p.default))} |"
        for p in effect.parameters
    ]
    return "\n".join(["| parameter | unit | meaning | from | to | probe |", "| --- | --- | --- | --: | --: | --: |", *rows])


def drawing(figure: Figure) -> str:
    """A figure's lines as SVG in the colours of the page."""
    panels: dict[str, list] = {}
    for mark in figure.marks:
        panels.setdefault(mark["axis"], []).append(mark)
    parts, top, title = [], 4, figure.title
    for axis, marks in panels.items():
        parts.append(_panel(marks, figure.axes[axis]["title"], top, last=axis == list(panels)[-1]))
        top += HEIGHT + GAP
    return (
        f'<figure class="plot" markdown="0"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {top + 12}" role="img" aria-label="{escape(title)}">{"".join(parts)}</svg></figure>'
    )


def _panel(marks: list, label: str, top: float, last: bool) -> str:
    xs, ys = (np.concatenate([np.asarray(mark[k], float) for mark in marks]) for k in "xy")
    low, high = _reach(ys)
    begin, end = float(np.nanmin(xs)), float(np.nanmax(xs))
    right, bottom = WIDTH - RIGHT, top + HEIGHT

    def px(x):
        return LEFT + (x - begin) / (end - begin) * (right - LEFT)

    def py(y):
        return bottom - (y - low) / (high - low) * HEIGHT

    parts = []
    for y in ticks(low, high):
        parts.append(f'<path class="grid" d="M{LEFT} {py(y):.1f}H{right}"/>')
        parts.append(f'<text class="y" x="{LEFT - 6}" y="{py(y) + 4:.1f}">{number(float(y), 3)}</text>')
    for x in ticks(begin, end) if last else ():
        parts.append(f'<text class="x" x="{px(x):.1f}" y="{bottom + 15}">{number(float(x), 3)} s</text>')
    for k, mark in enumerate(marks):
        every = max(1, len(mark["x"]) // POINTS)
        pairs = zip(np.asarray(mark["x"], float)[::every], np.asarray(mark["y"], float)[::every], strict=True)
        d = "L".join(f"{px(x):.1f} {py(y):.1f}" for x, y in pairs if np.isfinite(y))
        parts.append(f'<path class="line{k if len(marks) > 1 else 1}" d="M{d}"/>')
    parts.append(f'<text class="label" x="{LEFT + 6}" y="{top + 12}">{escape(label)}</text>')
    return "".join(parts)


def _reach(values: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.06 * (high - low) or 1.0
    return low - room, high + 2 * room


def ticks(low: float, high: float) -> np.ndarray:
    """Three to six round numbers."""
    raw = (high - low) / 4
    size = 10.0 ** np.floor(np.log10(raw))
    step = size * next(m for m in (1, 2, 5, 10) if m * size >= raw)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
