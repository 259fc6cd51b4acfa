"""The page of effects: the content of `vpp effects --html` as a page of the site, with drawings that need no script."""

import re
from html import escape
from textwrap import dedent

import numpy as np
from plotly import graph_objects as go

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


def drawing(figure: go.Figure) -> str:
    """A figure's lines as SVG in the colours of the page."""
    panels: dict[str, list] = {}
    for trace in figure.data:
        if trace.x is not None and len(trace.x) > 1:
            panels.setdefault(trace.yaxis or "y", []).append(trace)
    parts, top = [], 4
    title = " ".join(re.sub(r"<[^>]*>", " ", figure.layout.title.text).split())
    for axis, traces in panels.items():
        label = getattr(figure.layout, "yaxis" + axis[1:]).title.text or ""
        parts.append(_panel(traces, label, top, last=axis == list(panels)[-1]))
        top += HEIGHT + GAP
    return (
        f'<figure class="plot" markdown="0"><figcaption>{escape(title)}</figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {top + 12}" role="img" aria-label="{escape(title)}">{"".join(parts)}</svg></figure>'
    )


def _panel(traces: list, label: str, top: float, last: bool) -> str:
    xs, ys = (np.concatenate([np.asarray(getattr(t, k), float) for t in traces]) for k in "xy")
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
    for k, trace in enumerate(traces):
        every = max(1, len(trace.x) // POINTS)
        pairs = zip(np.asarray(trace.x, float)[::every], np.asarray(trace.y, float)[::every], strict=True)
        d = "L".join(f"{px(x):.1f} {py(y):.1f}" for x, y in pairs if np.isfinite(y))
        parts.append(f'<path class="line{k if len(traces) > 1 else 1}" d="M{d}"/>')
    parts.append(f'<text class="label" x="{LEFT + 6}" y="{top + 12}">{escape(label.replace("<br>", " "))}</text>')
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
