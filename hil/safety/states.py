"""The safety states of the rig, and the only moves between them.

    SAFE --tared, arm--> ARMED --run--> RUN --ramp_down--> RAMPDOWN --stopped--> SAFE
      any state --fault--> FAULT (from RUN through RAMPDOWN where the fault allows it) --stopped, reset--> SAFE

A tare is valid for one run. A fault stays until it is reset, which needs the idle pulse on the outputs.
"""

from enum import Enum

from hil.safety.faults import Fault, Reaction
from hil.safety.tare import Tare
from vpp_fmu.errors import VppError


class SafetyState(Enum):
    """SAFE: idle pulse. ARMED: idle pulse, tared, may run. RUN: driven. RAMPDOWN: driven down. FAULT: idle pulse, latched."""

    SAFE = "safe"
    ARMED = "armed"
    RUN = "run"
    RAMPDOWN = "ramp down"
    FAULT = "fault"


class IllegalMove(VppError):
    """A move that the state does not allow."""


class StateMachine:
    """The state, this run's `tare`, the `faults` since the last reset in order, and the `reason` of the last move.

    `idle`: whether the outputs are known to be at the idle pulse, so that the loop drives nothing.
    """

    def __init__(self):
        self.state, self.idle, self.reason = SafetyState.SAFE, True, "start"
        self.tare: Tare | None = None
        self.faults: list[Fault] = []

    @property
    def driving(self) -> bool:
        """Whether anything but the idle pulse may be written."""
        return self.state in (SafetyState.RUN, SafetyState.RAMPDOWN)

    @property
    def cause(self) -> Fault | None:
        """The first fault since the last reset: later ones are often its consequences."""
        return self.faults[0] if self.faults else None

    def tared(self, tare: Tare) -> None:
        """Set the load cell's zero. Only in SAFE; a later tare replaces an earlier one."""
        self._only_in("tare", SafetyState.SAFE)
        self.tare = tare

    def arm(self) -> None:
        """Get ready to run. Only in SAFE, only with a tare."""
        self._only_in("arm", SafetyState.SAFE)
        if self.tare is None:
            raise IllegalMove("arm: found no tare since the last run, expected one")
        self._move(SafetyState.ARMED, "armed")

    def run(self) -> None:
        """Pass commands from now on. Only in ARMED."""
        self._only_in("run", SafetyState.ARMED)
        self.idle = False
        self._move(SafetyState.RUN, "run")

    def ramp_down(self, reason: str) -> None:
        """End the run normally. Only in RUN."""
        self._only_in("ramp down", SafetyState.RUN)
        self._move(SafetyState.RAMPDOWN, reason)

    def fault(self, fault: Fault) -> None:
        """Add a fault. In RUN and RAMPDOWN, one that allows a ramp leads to RAMPDOWN; any other leads to FAULT at once.

        The final state is FAULT either way.
        """
        self.faults.append(fault)
        ramp = self.driving and fault.kind.reaction is Reaction.RAMP_DOWN
        self._move(SafetyState.RAMPDOWN if ramp else SafetyState.FAULT, str(fault))

    def stopped(self) -> None:
        """Note that the idle pulse is on every output. Ends RAMPDOWN (in FAULT if there was a fault), disarms ARMED."""
        self._only_in("stopped", SafetyState.RAMPDOWN, SafetyState.ARMED, SafetyState.FAULT)
        self.idle, self.tare = True, None
        self.state = SafetyState.FAULT if self.faults else SafetyState.SAFE

    def reset(self) -> None:
        """Clear the faults, after someone has looked at them. Only in FAULT, only at the idle pulse."""
        self._only_in("reset", SafetyState.FAULT)
        if not self.idle:
            raise IllegalMove("reset: found no idle pulse yet, expected it")
        self.faults, self.tare = [], None
        self._move(SafetyState.SAFE, "reset")

    def _only_in(self, move: str, *allowed: SafetyState) -> None:
        if self.state not in allowed:
            raise IllegalMove(f"{move}: found the rig in {self.state.name}, expected {' or '.join(s.name for s in allowed)}")

    def _move(self, state: SafetyState, reason: str) -> None:
        self.state, self.reason = state, reason
