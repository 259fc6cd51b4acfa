"""Figures of one effect: static response over the command, change of thrust over thrust, and response over time."""

from collections.abc import Mapping

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style
from vpp_fmu.report.panels import add_line, panels


def reached_against_commanded(
    commanded: np.ndarray, reached: Mapping[str, np.ndarray], title: str, quantity: str, unit: str
) -> go.Figure:
    """Static response, lines (n,) by name in the order of the sweep, over the command (n,)."""
    fig = style.figure(title, 440)
    colours = style.colours(reached)
    ends = [float(np.min(commanded)), float(np.max(commanded))]
    line = {"color": style.SET_POINT, "width": 1.4, "dash": "dot"}
    fig.add_scatter(x=ends, y=ends, mode="lines", name="as commanded", line=line, hoverinfo="skip")
    for name, values in reached.items():
        line = {"color": colours[name], "width": 1.8}
        fig.add_scatter(x=commanded, y=values, mode="lines", name=style.escaped(name), line=line)
    fig.update_xaxes(title_text=f"{quantity} commanded [{unit}]")
    fig.update_yaxes(title_text=f"{quantity} reached [{unit}]")
    return fig


def behind_against_before(before: np.ndarray, change: np.ndarray, time: np.ndarray, title: str) -> go.Figure:
    """Change of the thrust by an effect [N] over the thrust without it [N], coloured by the time [s]; all (n,)."""
    fig = style.figure(title, 440, legend=False)
    fig.add_scatter(
        x=before,
        y=change,
        mode="markers",
        marker={
            "size": 4,
            "color": time,
            "colorscale": style.sequence(),
            "showscale": True,
            "colorbar": {"title": {"text": "time [s]"}},
        },
        hovertemplate=f"%{{y:+{style.SHOWN}}} N at %{{x:{style.SHOWN}}} N<extra></extra>",
    )
    fig.update_xaxes(title_text="thrust without the effect [N]")
    fig.update_yaxes(title_text="change by the effect [N]", zeroline=True)
    return fig


def stacked(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], title: str) -> go.Figure:
    """A panel for each of the `rows`, named by its axis label with unit: lines (n,) by name over the time [s].

    Lines with "command" in their name are held and dotted, "measured" ones thin; one name has one colour in all panels.
    """
    fig = panels(title, list(rows), [180] * len(rows))
    names = dict.fromkeys(name for lines in rows.values() for name in lines)
    colours, shown = style.colours(n for n in names if "command" not in n), set()
    for panel, lines in enumerate(rows.values()):
        for name, values in lines.items():
            line = {"color": colours.get(name, style.SET_POINT), "width": 1.0 if name == "measured" else 1.8}
            if "command" in name:
                line |= {"dash": "dot", "shape": "hv"}
            add_line(fig, panel, time, values, name, line, name if name in shown else None)
            shown.add(name)
    return fig
