"""Columns of a tick in the log."""

from hil.loop.log import Column
from hil.safety.states import SafetyState

STATES = tuple(state.value for state in SafetyState)

COLUMNS = (
    Column("time"),
    Column("state", words=STATES),
    Column("thrust_set", exact=True),
    Column("omega_wanted", exact=True),
    Column("beta_wanted", exact=True),
    Column("omega_ref", exact=True),
    Column("beta_ref", exact=True),
    Column("thrust", exact=True),
    Column("omega", exact=True),
    Column("thrust_age"),
    Column("omega_age"),
    Column("counts"),
    Column("pulses"),
    Column("throttle"),
    Column("cut"),
    Column("residual"),
    Column("alarm"),
    Column("late"),
    Column("busy"),
    Column("missed"),
    Column("voltage"),
    Column("current"),
    Column("temperature"),
    Column("torque"),
)
"""A tick's row, in s, N, rpm, deg: readings at its time; the controller's commands, and the limited ones that act from then on;
throttle [1]; bits of `hil.safety.limits.Cut`; the twin's residual [N] and alarm; the tick's lateness and computing time, and
the slots missed before it; readings of the motor's supply [V, A, degC] and the rotor's torque [N.m]."""

LEARNED = "twin."
"""Prefix of the twin's outputs: the last columns, which have values only while a loop is closed."""

RUN = ("thrust_set", "omega_ref", "beta_ref", "thrust", "omega", "omega_wanted", "beta_wanted")
"""Columns of `run.csv`, beside `time`."""
