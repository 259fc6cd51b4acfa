"""Figures that hold the paper's numbers against the rig's: the static map, C_T, step responses, the learning curve."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from identification.static.static_map import coefficient_grid, design, thrust_coefficient
from identification.steps.lag_fit import two_lags
from identification.steps.run import StepRun
from vpp_fmu.paper.fine_tuning import FineTuning
from vpp_fmu.paper.published import COST_END, COST_START, ITERATIONS
from vpp_fmu.paper.static import OPERATING_PITCH, PAPER_UNITS, Statics, paper_thrust
from vpp_fmu.report import map_lines, style
from vpp_fmu.report.coefficients import thrust_coefficients
from vpp_fmu.report.steps import step_responses

PAPER = style.PUBLISHED
"""Colour of what the paper published."""

_EVERY = 2
"""Of the speeds, those at which the paper's map is drawn."""


def static_map(s: Statics, title: str) -> go.Figure:
    """The rig's points, the map fitted to them at each speed, and the paper's at every other of these speeds."""
    used = s.rig.used
    points = s.points.omega[used], s.points.beta_ref[used], s.points.thrust[used]
    speeds, beta = np.unique(s.points.omega_ref[used]), np.linspace(*OPERATING_PITCH, 25)
    omega, pitches = (grid.ravel() for grid in np.meshgrid(speeds, beta, indexing="ij"))
    fitted = design(omega, pitches, PAPER_UNITS) @ np.array(list(s.rig.coefficients.values()))
    fig = map_lines(speeds, beta, fitted.reshape(-1, 25), points, title)
    line = {"color": PAPER, "width": 2, "dash": "dot"}
    for k, values in enumerate(paper_thrust(omega, pitches).reshape(-1, 25)[::_EVERY]):
        fig.add_scatter(
            x=beta, y=values, mode="lines", name="paper's map", legendgroup="paper's map", showlegend=k == 0, line=line
        )
    return fig


def coefficient(s: Statics, title: str) -> go.Figure:
    """C_T of all the rig's points over the pitch, and by the paper's map at its lowest, middle and highest speed."""
    speeds, pitches, ct = coefficient_grid(s.points)
    fig = thrust_coefficients(speeds, pitches, ct, title)
    beta = np.linspace(*OPERATING_PITCH, 31)
    for speed, dash in ((2000.0, "dot"), (4000.0, "dash"), (6000.0, "solid")):
        at = np.full_like(beta, speed)
        line = {"color": PAPER, "width": 2, "dash": dash}
        fig.add_scatter(
            x=beta, y=thrust_coefficient(paper_thrust(at, beta), at), mode="lines", name=f"paper, {speed:.0f} rpm", line=line
        )
    return fig


def steps(runs: Sequence[StepRun], paper: tuple[float, float], title: str, unit: str, level_unit: str) -> go.Figure:
    """Every step of a channel with its fit, and in each panel the response of the paper's averaged lags (slow, fast) s."""
    fig = step_responses(runs, title, unit, level_unit)
    time = np.linspace(-0.2, 1.5, 86)
    shares = np.round(two_lags(time, *paper)[:, 0], 4)
    panels = dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in fig.data)
    for k, (x, y) in enumerate(panels):
        line = {"color": PAPER, "width": 1.8, "dash": "dash"}
        name = f"paper: {paper[0]:g} and {paper[1]:g} s"
        fig.add_scatter(
            x=time,
            y=shares,
            mode="lines",
            name=name,
            legendgroup=name,
            showlegend=k == 0,
            legendrank=4,
            line=line,
            xaxis=x,
            yaxis=y,
        )
    return fig


def learning_curves(rig: FineTuning, model: FineTuning, noise_cost: float, title: str) -> go.Figure:
    """The paper's cost over iterations: its own two numbers, its descent on the rig's record and on its model's, our search."""
    fig = style.figure(title, 460)
    marker = {"size": 11, "color": PAPER, "symbol": "diamond"}
    fig.add_scatter(x=[0, ITERATIONS], y=[COST_START, COST_END], mode="markers", name="paper, published", marker=marker)
    for name, tuned, colour in (("emulated rig", rig, style.AFTER), ("paper's model", model, style.OTHERS[1])):
        solid, dotted = {"color": colour, "width": 2}, {"color": colour, "width": 2, "dash": "dot"}
        fig.add_scatter(
            x=np.arange(len(tuned.costs)), y=tuned.costs, mode="lines", name=f"{name}, the paper's descent", line=solid
        )
        ours = np.array(tuned.ours.curve) / tuned.ours.problem.size
        fig.add_scatter(x=np.arange(len(ours)), y=ours, mode="lines+markers", name=f"{name}, our search", line=dotted)
    line = {"color": style.MEASURED, "width": 1.2, "dash": "dash"}
    fig.add_hline(y=noise_cost, line=line, name="noise of the rig alone", showlegend=True)
    fig.update_xaxes(title_text="iterations [-]")
    fig.update_yaxes(title_text="cost mean(e²)/2 [-]", type="log", dtick="D2", tickformat=".0e")
    return fig


def mark_reached(fig: go.Figure, seconds: float, text: str) -> go.Figure:
    """A line at the time [s] at which the paper's step has reached its set-point."""
    line = {"color": PAPER, "width": 1.8, "dash": "dash"}
    fig.add_vline(x=seconds, line=line, name=style.escaped(text), showlegend=True)
    return fig


def speed_dips(dips: Mapping[float, tuple[np.ndarray, np.ndarray]], title: str) -> go.Figure:
    """Speed less its command [rpm] over the time [s] from a step of pitch, by the level of speed [rpm]."""
    fig = style.figure(title, 380)
    colours = style.colours(f"{level:g} rpm" for level in dips)
    for level, (time, dip) in dips.items():
        name = f"{level:g} rpm"
        fig.add_scatter(x=time, y=dip, mode="lines", name=name, line={"color": colours[name], "width": 1.6, "shape": "hv"})
    fig.update_xaxes(title_text="time from the step [s]", range=[-0.5, 3.0])
    fig.update_yaxes(title_text="speed less its command [rpm]")
    return fig
