"""The places of the chain at which a term may enter, each declared once.

A port names the effect before or after which it is, the unit of a term f, and its action. Commands and rates act during the
whole step and use f at its middle; the others act at its end.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from vpp_fmu.kernel.effects.stage import stage, with_distance
from vpp_fmu.kernel.types import Effect

CHAIN = ("normalisation", "beta_drive", "beta_reach", "omega_drive", "omega_reach", "thrust_map")
"""Effects that every plant has, in their order."""


@dataclass(frozen=True)
class Port:
    """A place in the chain. `adds(ops, s, p, f, dt)`: the signals that a term `f` [unit] sets there.

    `words`: its description. `before`, `behind`: the effect before or after which it is; neither: the end of the chain.
    `scale`: the rig's scale of f; `limit`: the largest f, as a share of it. `channel`: "beta" or "omega", in which it acts;
    `staged`: in one of that channel's two lags. `whole`: it acts during the whole step.
    """

    name: str
    unit: str
    words: str
    adds: Callable
    scale: str = ""
    limit: float = 1.0
    before: str = ""
    behind: str = ""
    channel: str = ""
    staged: bool = False
    whole: bool = False
    reading: str = ""

    @property
    def position(self) -> int:
        """Along the chain; the effect number k of CHAIN is at 2 k."""
        if self.before:
            return 2 * CHAIN.index(self.before) - 1
        return 2 * CHAIN.index(self.behind) + 1 if self.behind else 2 * len(CHAIN)


def _added(signal: str) -> Callable:
    return lambda ops, s, p, f, dt: {signal: getattr(s, signal) + f}


def _multiplied(signal: str) -> Callable:
    return lambda ops, s, p, f, dt: {signal: getattr(s, signal) * (1.0 + f)}


def _rate(u: str) -> Callable:
    def adds(ops, s, p, f, dt):
        return with_distance(ops, s, u, p.form, stage(ops, s, u, p.form).distance + f * dt, dt)

    return adds


def _rate_share(u: str) -> Callable:
    def adds(ops, s, p, f, dt):
        factor = ops.maximum(1.0 + f, 0.0)  # below zero the lag would run away from its target
        return with_distance(ops, s, u, p.form, stage(ops, s, u, p.form).distance * factor, dt)

    return adds


_PITCH = {"channel": "beta", "whole": True}
_SPEED = {"channel": "omega", "whole": True}
_PITCH_RATE = {**_PITCH, "before": "beta_reach", "staged": True}
_SPEED_COMMAND = {**_SPEED, "before": "omega_drive"}
_SPEED_RATE = {**_SPEED, "before": "omega_reach", "staged": True}
_MAP = {"behind": "thrust_map"}

PORTS = {
    port.name: port
    for port in (
        Port("pitch_command", "deg", "the pitch command", _added("beta_ref"), "pitch", 0.5, before="beta_drive", **_PITCH),
        Port("pitch_rate", "deg/s", "the pitch rate", _rate("beta"), "pitch/time", 10.0, **_PITCH_RATE),
        Port("pitch_rate_share", "1", "the pitch rate, as a factor", _rate_share("beta"), "", 3.0, **_PITCH_RATE),
        Port("speed_command", "rpm", "the speed command", _added("omega_ref"), "speed", 0.5, **_SPEED_COMMAND),
        Port("speed_command_share", "1", "the speed command, as a factor", _multiplied("omega_ref"), "", 0.5, **_SPEED_COMMAND),
        Port("motor_acceleration", "rpm/s", "the motor's acceleration", _rate("omega"), "speed/time", 10.0, **_SPEED_RATE),
        Port(
            "motor_acceleration_share",
            "1",
            "the motor's acceleration, as a factor",
            _rate_share("omega"),
            "",
            3.0,
            **_SPEED_RATE,
        ),
        Port("rotor_speed", "rpm", "the rotor speed", _added("omega"), "speed", 0.3, before="thrust_map", channel="omega"),
        Port(
            "effective_pitch", "deg", "the pitch in the map", _added("beta"), "pitch", 0.5, before="thrust_map", channel="beta"
        ),
        Port("thrust", "N", "the thrust", _added("thrust"), "thrust", 0.5, **_MAP),
        Port("thrust_share", "1", "the thrust, as a factor", _multiplied("thrust"), "", 0.8, **_MAP),
        Port("reading", "N", "the reading of thrust", _added("thrust"), "thrust", 0.5, reading="thrust"),
    )
}
"""All ports by name."""


def placed(library: Iterable[Effect], effect: Effect, port: Port) -> tuple[Effect, ...]:
    """The library with an effect at a port, after effects that are there already."""
    library = tuple(library)
    names = [e.name for e in library]
    behind = names.index(port.behind) + 1 if port.behind else len(names)
    at = names.index(port.before) if port.before else behind
    return (*library[:at], effect, *library[at:])
