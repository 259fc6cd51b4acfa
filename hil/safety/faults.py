"""All faults of the rig, by name, and the loop's reaction to each."""

from dataclasses import dataclass
from enum import Enum

from vpp_fmu.errors import VppError


class Reaction(Enum):
    """How the loop leaves RUN."""

    RAMP_DOWN = "ramp down"
    """The loop can still ramp down: commands and throttle go to idle at limited rates."""
    IDLE = "idle now"
    """Further thrust is dangerous, or a ramp is impossible: the idle pulse at once."""


class FaultKind(Enum):
    """A kind of fault: its name in logs and in `hil.json`, the reaction, and what it is."""

    # Reported by a device, after its retries.
    SILENT = "silent", Reaction.RAMP_DOWN, "no valid answer within the time allowed"
    GARBLED = "garbled", Reaction.RAMP_DOWN, "answers arrive, but none passes its checks"
    UNPLUGGED = "unplugged", Reaction.RAMP_DOWN, "the device has gone from the system"
    RESTARTED = "restarted", Reaction.RAMP_DOWN, "the device came up anew while it was in use"
    REFUSED = "refused", Reaction.RAMP_DOWN, "the bus or the kernel refused the transfer"
    TIMEOUT = "timeout", Reaction.RAMP_DOWN, "the bus did not finish the transfer in time"
    RECONFIGURED = "reconfigured", Reaction.RAMP_DOWN, "the device has lost its settings, as after a brown-out"
    RELAY_OPEN = "relay open", Reaction.IDLE, "the ESC's supply is cut by the board that watches the loop"
    OUTPUT_LOST = "output lost", Reaction.IDLE, "a pulse could not be written or is not what was written"
    NOT_READY = "not ready", Reaction.IDLE, "the device could not be set up before arming"

    # Found by comparing a reading with physics.
    FROZEN = "frozen", Reaction.RAMP_DOWN, "the reading stands still where noise must move it"
    SATURATED = "saturated", Reaction.RAMP_DOWN, "the reading is at the end of its range"
    NO_ROTATION = "no rotation", Reaction.IDLE, "no revolutions although the throttle is open"
    SPEED_JUMP = "speed jump", Reaction.RAMP_DOWN, "the speed changed faster than torque and inertia allow"
    OVER_SPEED = "over-speed", Reaction.IDLE, "the rotor is faster than allowed"
    OVER_THRUST = "over-thrust", Reaction.IDLE, "the thrust is larger than allowed"
    SUPPLY = "supply beyond its limit", Reaction.RAMP_DOWN, "voltage, current, power or temperature is where it must not be"
    STUCK_ACTUATOR = "stuck actuator", Reaction.RAMP_DOWN, "the thrust does not follow the commanded pitch"
    POLARITY = "wrong polarity", Reaction.RAMP_DOWN, "thrust or pitch has the wrong sign"
    SLOPE = "wrong slope", Reaction.RAMP_DOWN, "pitch changes the thrust by something else than the map says"
    STALE = "stale", Reaction.RAMP_DOWN, "the newest reading is too old"

    # Found by the loop on itself.
    TWIN = "twin's alarm", Reaction.RAMP_DOWN, "the rig is not its model, and that is to end the run"
    TWIN_NOW = "twin's alarm, at once", Reaction.IDLE, "the same, where it is to end it at once"
    FAILED = "failed", Reaction.RAMP_DOWN, "the controller gave an error instead of commands"
    LOG_LOST = "log lost", Reaction.RAMP_DOWN, "what is measured no longer reaches the disk"
    NOT_A_NUMBER = "not a number", Reaction.RAMP_DOWN, "a command or a reading is not a finite number"
    TIME_BACKWARDS = "time backwards", Reaction.RAMP_DOWN, "the clock did not move forward"
    OVERRUN = "overrun", Reaction.RAMP_DOWN, "too many deadlines missed"
    RUN_TIME = "run time", Reaction.RAMP_DOWN, "the run has lasted as long as allowed"
    SUPERVISOR_LOST = "supervisor lost", Reaction.RAMP_DOWN, "nobody would stop the rotor if the loop died"
    SUPERVISOR_TRIPPED = "supervisor tripped", Reaction.IDLE, "the supervisor has taken the outputs to idle"
    TERMINATED = "terminated", Reaction.IDLE, "the process was asked to end"
    INTERRUPTED = "interrupted", Reaction.RAMP_DOWN, "stopped by the operator"
    INTERRUPTED_TWICE = "interrupted twice", Reaction.IDLE, "stopped by the operator, at once"

    def __init__(self, label: str, reaction: Reaction, meaning: str):
        self.label, self.reaction, self.meaning = label, reaction, meaning


@dataclass(frozen=True)
class Fault:
    """One fault: its `device` (such as "adc", "tachometer", "esc", "loop"), its kind, and the numbers found."""

    device: str
    kind: FaultKind
    detail: str

    def __str__(self) -> str:
        return f"{self.device}: {self.kind.label}: {self.detail}"


class DeviceFault(VppError):
    """A device failed after all its retries. `fault` is the same as a value."""

    def __init__(self, device: str, kind: FaultKind, detail: str):
        self.fault = Fault(device, kind, detail)
        self.device, self.kind, self.detail = device, kind, detail
        super().__init__(str(self.fault))
