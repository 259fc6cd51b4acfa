"""Figures of a planned experiment."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.panels import add_line, panels
from vpp_fmu.report.thinning import places

MOST = 300.0
"""Half-widths beyond this, in %, are drawn at the edge: the parameter is unknown."""


def planned_commands(
    time: np.ndarray, omega_ref: np.ndarray, beta_ref: np.ndarray, thrust: np.ndarray, title: str
) -> go.Figure:
    """Commands [rpm], [deg], held from row to row, and the thrust [N] that the model predicts, over time [s]; each (n,)."""
    fig = panels(title, [*map(style.label, ("omega_ref", "beta_ref")), "predicted thrust [N]"], [180, 180, 180])
    kept = places([omega_ref, beta_ref, thrust])
    for panel, (name, values) in enumerate((("commands", omega_ref), ("pitch command", beta_ref))):
        line = {"color": style.SET_POINT, "width": 1.3, "shape": "hv"}
        add_line(fig, panel, time[kept], values[kept], name, line, "commands" if panel else None)
    add_line(fig, 2, time[kept], thrust[kept], "thrust", {"color": style.AFTER, "width": 1.3})
    return fig


def interval_widths(names: Sequence[str], widths: Mapping[str, np.ndarray], title: str) -> go.Figure:
    """Half-widths of 95 % intervals of n parameters in % of their size, each (n,), by data set; the last is best.

    A line per parameter joins the widest with the last.
    """
    labels = [style.escaped(name) for name in names]
    shown = {name: np.minimum(np.asarray(values, float), MOST) for name, values in widths.items()}
    fig = style.figure(title, 130 + 34 * len(labels))
    last = list(shown.values())[-1]
    widest = np.max(list(shown.values()), axis=0)
    for label, low, high in zip(labels, last, widest, strict=True):
        line = {"color": style.FAINT, "width": 3}
        fig.add_scatter(x=[low, high], y=[label, label], mode="lines", line=line, showlegend=False, hoverinfo="skip")
    colours = style.colours(shown)
    for name, values in shown.items():
        text = [f"± {width:.3g} %" if width <= MOST else "unknown" for width in np.asarray(widths[name], float)]
        marker = {"size": 10, "color": style.SET_POINT if "paper" in name else colours[name]}
        fig.add_scatter(
            x=values,
            y=labels,
            mode="markers",
            name=style.escaped(name),
            marker=marker,
            text=text,
            hovertemplate="%{y}: %{text}<extra></extra>",
        )
    ticks = [digit * 10.0**power for power in range(-3, 3) for digit in (1, 2, 5)]
    text = "half-width of the 95 % interval [% of the value]"
    fig.update_xaxes(title_text=text, type="log", tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks])
    fig.update_yaxes(title_text="parameter [-]", type="category", autorange="reversed", tickfont_size=12)
    return fig
