"""Figures that compare the paper's numbers with the rig's: the static map, C_T, step responses, the learning curve, and what
happens inside the loops."""

from collections.abc import Mapping, Sequence

import numpy as np
from plotly import graph_objects as go

from identification.static.static_map import coefficient_grid, design, thrust_coefficient
from identification.steps.lag_fit import two_lags
from identification.steps.run import StepRun
from vpp_fmu.app.paper.control import StepTest
from vpp_fmu.app.paper.published import COST_END, COST_START, ITERATIONS, REACHED
from vpp_fmu.app.paper.study import OPERATING_PITCH, PAPER_UNITS, FineTuning, Statics, paper_thrust
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.record import Record
from vpp_fmu.report import map_lines, style
from vpp_fmu.report.coefficients import thrust_coefficients
from vpp_fmu.report.steps import step_responses
from vpp_fmu.response import steps

SPAN = 25
"""Readings in a mean of the speed: the mark's jitter hides the dip."""

BACK = 0.01
"""Share of the speed within which it counts as back."""

NEAR = 0.4, 1.2
"""s around a step that are drawn."""


def _add(fig: go.Figure, x, y, name: str, line: dict, mode: str = "lines", **more) -> None:
    fig.add_scatter(x=x, y=y, mode=mode, name=name, line=line, **more)


def _published(dash: str, width: float = 2) -> dict:
    """A line of what the paper published."""
    return {"color": style.PUBLISHED, "width": width, "dash": dash}


def static_map(s: Statics, title: str) -> go.Figure:
    """The rig's points, the map fitted to them at each speed, and the paper's at every other of these speeds."""
    used = s.rig.used
    points = s.points.omega[used], s.points.beta_ref[used], s.points.thrust[used]
    speeds, beta = np.unique(s.points.omega_ref[used]), np.linspace(*OPERATING_PITCH, 25)
    omega, pitches = (grid.ravel() for grid in np.meshgrid(speeds, beta, indexing="ij"))
    fitted = design(omega, pitches, PAPER_UNITS) @ np.array(list(s.rig.coefficients.values()))
    fig = map_lines(speeds, beta, fitted.reshape(-1, 25), points, title)
    for k, values in enumerate(paper_thrust(omega, pitches).reshape(-1, 25)[::2]):
        _add(fig, beta, values, "paper's map", _published("dot"), legendgroup="paper's map", showlegend=k == 0)
    return fig


def coefficient(s: Statics, title: str) -> go.Figure:
    """C_T of all the rig's points over the pitch, and by the paper's map at its lowest, middle and highest speed."""
    fig = thrust_coefficients(*coefficient_grid(s.points), title)
    beta = np.linspace(*OPERATING_PITCH, 31)
    for speed, dash in ((2000.0, "dot"), (4000.0, "dash"), (6000.0, "solid")):
        at = np.full_like(beta, speed)
        _add(fig, beta, thrust_coefficient(paper_thrust(at, beta), at), f"paper, {speed:.0f} rpm", _published(dash))
    return fig


def step_panels(runs: Sequence[StepRun], paper: tuple[float, float], title: str, unit: str, level_unit: str) -> go.Figure:
    """Every step of a channel with its fit, and in each panel the response of the paper's averaged lags (slow, fast) s."""
    fig, time = step_responses(runs, title, unit, level_unit), np.linspace(-0.2, 1.5, 86)
    shares, name = np.round(two_lags(time, *paper)[:, 0], 4), f"paper: {paper[0]:g} and {paper[1]:g} s"
    panels = dict.fromkeys((trace.xaxis or "x", trace.yaxis or "y") for trace in fig.data)
    for k, (x, y) in enumerate(panels):
        shared = {"legendgroup": name, "showlegend": k == 0, "legendrank": 4, "xaxis": x, "yaxis": y}
        _add(fig, time, shares, name, _published("dash", 1.8), **shared)
    return fig


def learning_curves(rig: FineTuning, model: FineTuning, noise_cost: float, title: str) -> go.Figure:
    """The paper's cost over iterations: its own two numbers, its descent on the rig's record and on its model's, our search."""
    fig = style.figure(title, 460)
    marker = {"size": 11, "color": style.PUBLISHED, "symbol": "diamond"}
    fig.add_scatter(x=[0, ITERATIONS], y=[COST_START, COST_END], mode="markers", name="paper, published", marker=marker)
    for name, tuned, colour in (("emulated rig", rig, style.AFTER), ("paper's model", model, style.OTHERS[1])):
        line, ours = {"color": colour, "width": 2}, np.array(tuned.ours.curve) / tuned.ours.problem.size
        _add(fig, np.arange(len(tuned.costs)), tuned.costs, f"{name}, the paper's descent", line)
        _add(fig, np.arange(len(ours)), ours, f"{name}, our search", line | {"dash": "dot"}, "lines+markers")
    line = {"color": style.MEASURED, "width": 1.2, "dash": "dash"}
    fig.add_hline(y=noise_cost, line=line, name="noise of the rig alone", showlegend=True)
    fig.update_xaxes(title_text="iterations [-]")
    fig.update_yaxes(title_text="cost mean(e²)/2 [-]", type="log", dtick="D2", tickformat=".0e")
    return fig


def mark_reached(fig: go.Figure, step: float) -> None:
    """A line where the paper's step has reached its set-point; `step`: its time, s."""
    name = f"paper: reached about {REACHED:g} s after the step"
    fig.add_vline(x=step + REACHED, line=_published("dash", 1.8), name=name, showlegend=True)


def speed_dips(found: Mapping[float, tuple[np.ndarray, np.ndarray]], title: str) -> go.Figure:
    """Speed less its command [rpm] over the time [s] from a step of pitch, by the level of speed [rpm]."""
    fig = style.figure(title, 380)
    colours = style.colours(f"{level:g} rpm" for level in found)
    for (time, dip), (name, colour) in zip(found.values(), colours.items(), strict=True):
        _add(fig, time, dip, name, {"color": colour, "width": 1.6, "shape": "hv"})
    fig.update_xaxes(title_text="time from the step [s]", range=[-0.5, 3.0])
    fig.update_yaxes(title_text="speed less its command [rpm]")
    return fig


def dips(records: Sequence[Record]) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """By speed [rpm]: (time from the step [s], mean speed over SPAN readings less command [rpm]) of the largest step of pitch
    upwards."""
    largest = {}
    for record in records:
        size, level = float(np.diff(record["beta_ref"]).max()), float(record["omega_ref"][0])
        if np.ptp(record["omega_ref"]) == 0.0 and size > largest.get(level, (0.0,))[0]:
            largest[level] = size, record
    found = {}
    for level, (_, record) in sorted(largest.items()):
        dip = np.convolve(record["omega"] - record["omega_ref"], np.full(SPAN, 1.0 / SPAN), "valid")
        row = int(np.argmax(np.diff(record["beta_ref"]))) + 1
        found[level] = record.time[SPAN // 2 : SPAN // 2 + len(dip)] - record.time[row], dip
    return found


def worst_dip(found: Mapping[float, tuple[np.ndarray, np.ndarray]]) -> tuple[float, float, float]:
    """(level rpm, rpm by which the speed falls there, s until it stays within BACK of the level) of the deepest dip."""
    level = min(found, key=lambda k: float(found[k][1][found[k][0] > 0.0].min()))
    time, dip = found[level]
    outside = np.flatnonzero((np.abs(dip) > BACK * level) & (time > 0.0))
    back = float(time[min(outside[-1] + 1, len(time) - 1)]) if len(outside) else 0.0
    return level, -float(dip[time > 0.0].min()), back


def terms(test: StepTest) -> tuple[np.ndarray, dict[str, dict[str, np.ndarray]]]:
    """(time [s], panel -> term -> normalised share of the command) that the controller adds up around the step upwards.

    The controller once more over what the loop showed: its states are error, integrals and filtered rate.
    """
    run, values = test.mean, CONTROLLER.values(test.settings)
    again, states = Simulation(CONTROLLER, values), []
    again.start({"thrust_set": run["thrust_set"][0], "thrust": run["thrust"][0]})
    for wanted, thrust in zip(run["thrust_set"].tolist(), run["thrust"].tolist(), strict=True):
        again.advance({"thrust_set": wanted, "thrust": thrust}, values["sample_time"])
        states.append(dict(again.states))
    step = steps(run)[0].time
    near, panels = (run.time >= step - NEAR[0]) & (run.time <= step + NEAR[1]), {}
    for channel, name in (("omega", "speed"), ("beta", "pitch")):
        parts = {"P": ("kp", "error"), "I": ("ki", f"{channel}_integral"), "D": ("kd", "rate")}
        panels[f"{name}, share of its scale [-]"] = {
            term: values[f"{gain}_{channel}"] * np.array([found[state] for found in states])[near]
            for term, (gain, state) in parts.items()
        }
    return run.time[near], panels
