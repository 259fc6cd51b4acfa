"""The figure of each candidate's evidence, and the reason for its rejection."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from plotly import graph_objects as go

from vpp_fmu.report import style

TAKEN, PASSED, FAILED = "taken", "strong evidence, not taken", "does not stand"
COLOURS = {TAKEN: style.AFTER, PASSED: style.LIGHT_BLUE, FAILED: style.FAINT}

_LEAST = 1.0
"""Start of the bars on the logarithmic axis."""


@dataclass(frozen=True)
class Bar:
    """A candidate: its evidence [nat], its outcome (a key of COLOURS) and why, in a few words."""

    name: str
    likelihood_gain: float
    outcome: str
    why: str


def evidence_bars(bars: Sequence[Bar], gate: float, title: str, taken: float | None = None) -> go.Figure:
    """Candidates by evidence [nat], the best on top, the threshold `gate` as a line, the reason beside each bar.

    `taken`: evidence of the accepted candidate. A shaded band marks candidates within `gate` of it, which fit as well.
    Candidates below 1 have no bar.
    """
    ranked = sorted(bars, key=lambda bar: -bar.likelihood_gain)
    fig = style.figure(title, 140 + 30 * len(ranked))
    for outcome, colour in COLOURS.items():
        own = [bar for bar in ranked if bar.outcome == outcome]
        if own:
            fig.add_bar(
                y=[style.escaped(bar.name) for bar in own],
                x=[max(bar.likelihood_gain, _LEAST) for bar in own],
                orientation="h",
                name=outcome,
                marker_color=colour,
                text=[f"{bar.likelihood_gain:,.0f}  {style.escaped(bar.why)}" for bar in own],
                textposition="outside",
                textfont={"size": 12},
                cliponaxis=False,
                hovertemplate="%{y}: %{text}<extra></extra>",
            )
    line = {"color": style.MEASURED, "width": 1.6, "dash": "dash"}
    fig.add_vline(x=gate, line=line, name=f"very strong: {gate:g}", layer="below", showlegend=True)
    if taken is not None:
        fig.add_vrect(x0=max(taken - gate, _LEAST), x1=taken + gate, fillcolor=style.AFTER, opacity=0.15, line_width=0)
    reach = np.log10(max(10.0 * gate, *(bar.likelihood_gain for bar in ranked)))
    # The reasons are beside the bars and take half of the width.
    fig.update_xaxes(title_text="evidence [nat]", type="log", range=[0.0, 2.0 * reach], tickvals=_decades(reach))
    order = [style.escaped(bar.name) for bar in ranked]
    fig.update_yaxes(title_text="candidate [-]", type="category", categoryorder="array", categoryarray=order[::-1])
    fig.update_layout(bargap=0.35, barmode="overlay")
    return fig


def _decades(reach: float) -> list[float]:
    return [10.0**k for k in range(int(np.ceil(reach)) + 1)]
