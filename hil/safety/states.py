"""The states of a rig that can hurt someone, and the only moves between them.

    SAFE --tared, arm--> ARMED --run--> RUN --ramp_down--> RAMPDOWN --stopped--> SAFE
      any state --fault--> FAULT (from RUN through RAMPDOWN where the fault allows it) --stopped, reset--> SAFE

A tare is good for one run. A fault stays until it is reset, which needs the idle pulse on the outputs.
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
    """The state and what led there: this run's `tare`, the `faults` since the last reset in order, `reason` of the last move.

    `idle` is True while the outputs are known to stand at the idle pulse: nothing spins then that the loop drives.
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
        """The first fault since the last reset: those behind it are often its children."""
        return self.faults[0] if self.faults else None

    def tared(self, tare: Tare) -> None:
        """The load cell's zero is known. Only in SAFE; a later tare takes the earlier one's place."""
        self._only_in("tare", SafetyState.SAFE)
        self.tare = tare

    def arm(self) -> None:
        """Ready to run. Only in SAFE, only with a tare."""
        self._only_in("arm", SafetyState.SAFE)
        if self.tare is None:
            raise IllegalMove("arm: found no tare since the last run, expected one")
        self._move(SafetyState.ARMED, "armed")

    def run(self) -> None:
        """Commands pass from now on. Only in ARMED."""
        self._only_in("run", SafetyState.ARMED)
        self.idle = False
        self._move(SafetyState.RUN, "run")

    def ramp_down(self, reason: str) -> None:
        """The run ends in order. Only in RUN."""
        self._only_in("ramp down", SafetyState.RUN)
        self._move(SafetyState.RAMPDOWN, reason)

    def fault(self, fault: Fault) -> None:
        """Something is wrong. In RUN a fault that allows it ramps down first; any other, and any outside RUN, ends at once.

        In RAMPDOWN a fault that allows a ramp lets it go on. The end is FAULT either way.
        """
        self.faults.append(fault)
        ramp = self.driving and fault.kind.reaction is Reaction.RAMP_DOWN
        self._move(SafetyState.RAMPDOWN if ramp else SafetyState.FAULT, str(fault))

    def stopped(self) -> None:
        """The idle pulse is on every output. Ends RAMPDOWN (in FAULT if there was one), disarms ARMED."""
        self._only_in("stopped", SafetyState.RAMPDOWN, SafetyState.ARMED, SafetyState.FAULT)
        self.idle, self.tare = True, None
        self.state = SafetyState.FAULT if self.faults else SafetyState.SAFE

    def reset(self) -> None:
        """Someone has looked at the fault. Only in FAULT, only with the idle pulse standing."""
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
