"""The figure of a learned term: its curve with a band over the driver, and below it the distribution of the data."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.panels import panels

BINS = 60


def learned_curve(
    at: np.ndarray,
    value: np.ndarray,
    half: np.ndarray,
    lines: Mapping[str, tuple[np.ndarray, np.ndarray]],
    data: np.ndarray,
    title: str,
    driver: tuple[str, str],
    term: tuple[str, str],
) -> go.Figure:
    """A curve `value` (knots,) +- `half` over `at`, further `lines` (x, y) by name, and a histogram of the `data` (n,) below.

    `driver`, `term`: (words, unit) of the axes.
    """
    labels = [f"{term[0]} [{'-' if term[1] == '1' else term[1]}]", "share of time [%]"]
    fig = panels(title, labels, [320, 110])
    band = {"x": np.concatenate([at, at[::-1]]), "y": np.concatenate([value + half, (value - half)[::-1]])}
    fig.add_scatter(**band, mode="lines", fill="toself", fillcolor=style.VEIL, line_width=0, name="95 %", hoverinfo="skip")
    colours = style.colours(lines)
    for name, (x, y) in lines.items():
        mode = "lines+markers" if len(x) == len(at) else "lines"
        line = {"color": colours[name], "width": 1.8}
        fig.add_scatter(x=x, y=y, mode=mode, name=style.escaped(name), line=line)
    count, edges = np.histogram(data, BINS)
    share = 100.0 * count / max(count.sum(), 1)
    fig.add_bar(
        x=0.5 * (edges[1:] + edges[:-1]), y=share, marker_color=style.MEASURED, name="data", showlegend=False, yaxis="y2"
    )
    fig.update_xaxes(title_text=f"{driver[0]} [{driver[1]}]", hoverformat=".4~g")
    return fig
