"""Columns of a tick in the log, and of the live view."""

from collections.abc import Mapping, Sequence

from hil.log import Column
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
"""Prefix of the adaptive twin's outputs: the last columns, which have values only while a loop is closed."""

RUN = ("thrust_set", "omega_ref", "beta_ref", "thrust", "omega", "omega_wanted", "beta_wanted")
"""Columns of `run.csv`, beside `time`."""

SHOWN = (
    ("state", "s", ""),
    ("thrust", "6.2f", "N"),
    ("set-point", "6.2f", "N"),
    ("speed", "5.0f", "rpm"),
    ("pitch command", "5.1f", "deg"),
    ("throttle", "4.2f", ""),
    ("off its twin", "+6.2f", "N"),
    ("twin", "s", ""),
    ("adaptive twin", "s", ""),
    ("adapted", "#7.4g", ""),
    ("voltage", "5.1f", "V"),
    ("current", "5.1f", "A"),
    ("temperature", "4.0f", "degC"),
    ("torque", "6.3f", "N.m"),
    ("missed", "3.0f", ""),
    ("done", "3.0f", "%"),
    ("page", "s", ""),
    ("disk", "s", ""),
)
"""Columns of the live view: name, format, unit."""

WORDS = {
    "state": STATES,
    "twin": ("", "ALARM: not as its model"),
    "adaptive twin": ("",),
    "page": ("", "the page is gone"),
    "disk": ("", "THE DISK IS NEARLY FULL"),
}
"""Words for coded numbers of SHOWN."""


def shown_beside(adapted: Mapping[str, str]) -> tuple[tuple[tuple[str, str, str], ...], dict[str, Sequence[str]]]:
    """SHOWN and WORDS if an adaptive twin runs with the rig. `adapted`: units of its parameters by name, in its order.

    The line has room for the first parameter only, by default the thrust gain. The parameter that changed most would be a lag,
    even without a fault, because motor and actuator are not exact lags.
    """
    name, unit = next(iter(adapted.items()))
    own = {"adapted": (name, "#7.4g", "" if unit == "1" else unit)}
    alarms = ("", *(f"adaptive twin: most like {cause}" for cause in ("no parameter", *adapted)))
    return tuple(own.get(label[0], label) for label in SHOWN), {**WORDS, "adaptive twin": alarms}
