"""What happens inside the loops: how the speed loop bears a step of pitch, what each term of the PIDs commands."""

from collections.abc import Mapping

import numpy as np

from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.paper.control import Control, Loop
from vpp_fmu.record import Record

SPAN = 25
"""Readings in a mean of the speed: the mark's jitter hides the dip."""

BACK = 0.01
"""Share of the speed within which it counts as back."""

NEAR = 0.4, 1.2
"""s around a step that are drawn."""


def dips(records: list[Record] | tuple[Record, ...]) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """By speed [rpm]: (time from the step [s], mean speed over SPAN readings less command [rpm]) of the largest step of pitch
    upwards."""
    found: dict[float, tuple[float, np.ndarray, np.ndarray]] = {}
    for record in records:
        moves = np.diff(record["beta_ref"])
        row = int(np.argmax(moves)) + 1
        level, size = float(record["omega_ref"][0]), float(moves[row - 1])
        if np.ptp(record["omega_ref"]) == 0.0 and size > found.get(level, (0.0,))[0]:
            dip = np.convolve(record["omega"] - record["omega_ref"], np.full(SPAN, 1.0 / SPAN), "valid")
            middle = slice(SPAN // 2, SPAN // 2 + len(dip))
            found[level] = size, record.time[middle] - record.time[row], dip
    return {level: (time, dip) for level, (_, time, dip) in sorted(found.items())}


def worst_dip(found: Mapping[float, tuple[np.ndarray, np.ndarray]]) -> tuple[float, float, float]:
    """(level rpm, rpm by which the speed falls there, s until it stays within BACK of the level) of the deepest dip."""
    level = min(found, key=lambda k: float(found[k][1][found[k][0] > 0.0].min()))
    time, dip = found[level]
    outside = np.flatnonzero((np.abs(dip) > BACK * level) & (time > 0.0))
    back = float(time[min(outside[-1] + 1, len(time) - 1)]) if len(outside) else 0.0
    return level, -float(dip[time > 0.0].min()), back


def terms(control: Control, loop: Loop) -> tuple[np.ndarray, dict[str, dict[str, np.ndarray]]]:
    """(time [s], panel -> term -> normalised share of the command) that the controller adds up around the step upwards.

    The controller once more over what the loop showed: its states are error, integrals and filtered rate.
    """
    run, values = control.runs[loop], CONTROLLER.values(control.settings[loop])
    again = Simulation(CONTROLLER, values)
    again.start({"thrust_set": run["thrust_set"][0], "thrust": run["thrust"][0]})
    names = ("error", "omega_integral", "beta_integral", "rate")
    states = np.empty((len(run), len(names)))
    for k, (wanted, thrust) in enumerate(zip(run["thrust_set"].tolist(), run["thrust"].tolist(), strict=True)):
        again.advance({"thrust_set": wanted, "thrust": thrust}, values["sample_time"])
        states[k] = [again.states[name] for name in names]
    error, omega_integral, beta_integral, rate = states.T
    step = run.time[np.argmax(np.abs(np.diff(run["thrust_set"])) > 0.0) + 1]
    near = (run.time >= step - NEAR[0]) & (run.time <= step + NEAR[1])
    panels = {}
    for channel, integral in (("omega", omega_integral), ("beta", beta_integral)):
        parts = {"P": ("kp", error), "I": ("ki", integral), "D": ("kd", rate)}
        label = f"{'speed' if channel == 'omega' else 'pitch'}, share of its scale [-]"
        panels[label] = {f"{name}": values[f"{kind}_{channel}"] * of for name, (kind, of) in parts.items()}
        panels[label] = {name: line[near] for name, line in panels[label].items()}
    return run.time[near], panels
