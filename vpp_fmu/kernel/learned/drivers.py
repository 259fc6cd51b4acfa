"""Drivers of a learned term: signals of the chain at the start and the end of a step.

A signal that arises after the port is extrapolated from its values at the start of this step and of the last one. So all
feedback runs through a state.
"""

from dataclasses import dataclass

from vpp_fmu.kernel.effects.stage import stage
from vpp_fmu.kernel.learned.ports import CHAIN, Port
from vpp_fmu.kernel.types import State


@dataclass(frozen=True)
class Driver:
    """A driver. `signal`: its signal of the chain; "": it has none. `behind`: the effect of CHAIN after which the signal is
    known; "": it is an input. `guess`: the input that approximates its settled value; "": 0. `scale`: of the rig. `signed`: it
    changes its sign, and 0 means rest."""

    name: str
    unit: str
    words: str
    signal: str = ""
    behind: str = ""
    guess: str = ""
    scale: str = ""
    signed: bool = False
    channel: str = ""

    def known(self, port: Port) -> bool:
        """Whether this step's value is available at a port."""
        return not self.behind or 2 * CHAIN.index(self.behind) < port.position

    def settled(self, s, p, port: Port):
        """Its settled value, from the signals that reach the port."""
        if not self.signal or self.own_stage(port):
            return 0.0
        return getattr(s, self.signal if self.known(port) else f"settled_{self.signal}")

    def own_stage(self, port: Port) -> bool:
        """Whether it is the remaining error of the lag that the port changes."""
        return port.staged and self.name.endswith("to_go") and self.channel == port.channel

    def states(self, port: Port) -> tuple[State, ...]:
        """Its states."""
        if not self.signal:
            return (State("driver", self.unit, "since the record's start", 0.0),)
        if not self.behind or self.own_stage(port):
            return ()

        def start(ops, s, p):
            return self.settled(s, p, port)

        first = State("driver", self.unit, f"{self.words} at the start of the step", start, closed_by=self.signal)
        if self.known(port):
            return (first,)
        return first, State("driver_before", self.unit, f"{self.words} a step earlier", start)

    def ahead(self, port: Port) -> dict[str, str]:
        """Signals at the end of the chain from which its states start, each with the input that is the first guess."""
        if not self.behind or self.own_stage(port) or self.known(port):
            return {}
        return {self.signal: self.guess}

    def course(self, ops, s, x, p, dt, port: Port):
        """(value at the start of the step, value at its end, its next states)."""
        if not self.signal:
            return x.driver, x.driver + dt, {"driver": x.driver + dt}
        if not self.behind:
            command = getattr(s, self.signal)  # held
            return command, command, {}
        if self.own_stage(port):
            lag = stage(ops, s, self.channel, p.form)
            return lag.before, lag.after - lag.distance, {}
        if self.known(port):
            now = getattr(s, self.signal)
            if self.signal.endswith("_rate"):  # a mean over the step, valid at its middle
                return 0.5 * (x.driver + now), now + 0.5 * (now - x.driver), {}
            return x.driver, now, {}
        return x.driver, 2.0 * x.driver - x.driver_before, {"driver_before": x.driver}


_PITCH = {"behind": "beta_reach", "channel": "beta"}
_SPEED = {"behind": "omega_reach", "channel": "omega"}

DRIVERS = {
    driver.name: driver
    for driver in (
        Driver("speed_command", "rpm", "the speed command", "omega_ref", scale="speed", channel="omega"),
        Driver("pitch_command", "deg", "the pitch command", "beta_ref", scale="pitch", channel="beta"),
        Driver("speed", "rpm", "speed", "omega", guess="omega_ref", scale="speed", **_SPEED),
        Driver("pitch", "deg", "pitch", "beta", guess="beta_ref", scale="pitch", **_PITCH),
        Driver("thrust", "N", "thrust", "thrust", "thrust_map", scale="thrust"),
        Driver("speed_rate", "rpm/s", "the rate of speed", "omega_rate", scale="speed/time", signed=True, **_SPEED),
        Driver("pitch_rate", "deg/s", "the rate of pitch", "beta_rate", scale="pitch/time", signed=True, **_PITCH),
        Driver("speed_to_go", "rpm", "the speed still to go", "omega_to_go", scale="speed", signed=True, **_SPEED),
        Driver("pitch_to_go", "deg", "the pitch still to go", "beta_to_go", scale="pitch", signed=True, **_PITCH),
        Driver("time", "s", "time"),
    )
}
"""All drivers by name."""
