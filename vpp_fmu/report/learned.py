"""The figure of a learned term: its curve with a band over the driver, and below it where the data were."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go
from plotly.subplots import make_subplots

from vpp_fmu.report import style

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
    fig = style.figure(title, 560)
    fig = go.Figure(
        make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.75, 0.25], vertical_spacing=0.06)
    ).update_layout(fig.layout)
    band = {"x": np.concatenate([at, at[::-1]]), "y": np.concatenate([value + half, (value - half)[::-1]])}
    fig.add_scatter(
        **band, fill="toself", fillcolor="rgba(0,114,178,0.18)", line_width=0, name="95 %", hoverinfo="skip", row=1, col=1
    )
    colours = style.colours(lines)
    for name, (x, y) in lines.items():
        mode = "lines+markers" if len(x) == len(at) else "lines"
        line = {"color": colours[name], "width": 1.8}
        fig.add_scatter(x=x, y=y, mode=mode, name=style.escaped(name), line=line, row=1, col=1)
    count, edges = np.histogram(data, BINS)
    share = 100.0 * count / max(count.sum(), 1)
    fig.add_bar(
        x=0.5 * (edges[1:] + edges[:-1]), y=share, marker_color=style.MEASURED, name="data", showlegend=False, row=2, col=1
    )
    fig.update_yaxes(title_text=f"{term[0]} [{'-' if term[1] == '1' else term[1]}]", row=1, col=1)
    fig.update_yaxes(title_text="share of time [%]", row=2, col=1)
    fig.update_xaxes(title_text=f"{driver[0]} [{driver[1]}]", row=2, col=1)
    return fig
