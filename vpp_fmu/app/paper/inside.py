"""Signals inside the loops of the paper's study: dips of the speed after steps of the pitch, and the controller's terms."""

from collections.abc import Mapping, Sequence

import numpy as np

from vpp_fmu.app.paper.control import StepTest
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.record import Record
from vpp_fmu.response import steps

SPAN = 25
"""Readings in a mean of the speed: in single ones the mark's jitter hides the dip."""

BACK = 0.01
"""Share of the speed within which it counts as recovered."""

NEAR = 0.4, 1.2
"""Seconds drawn before and after a step."""


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
    """The deepest dip: (level rpm, rpm below the command, s until the speed stays within BACK of the level)."""
    level = min(found, key=lambda k: float(found[k][1][found[k][0] > 0.0].min()))
    time, dip = found[level]
    outside = np.flatnonzero((np.abs(dip) > BACK * level) & (time > 0.0))
    back = float(time[min(outside[-1] + 1, len(time) - 1)]) if len(outside) else 0.0
    return level, -float(dip[time > 0.0].min()), back


def terms(test: StepTest) -> tuple[np.ndarray, dict[str, dict[str, np.ndarray]]]:
    """(time [s], panel -> term -> its normalised share of the command) around the step upwards.

    The controller is run again on the loop's set-point and thrust; its states are error, integrals and filtered rate.
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
