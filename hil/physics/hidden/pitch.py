"""Hidden effects between the pitch command and the blades.

The LAC reads its command in counts of its converter, and ignores a change of up to `half_width`. Play is a spring with a dead
zone between rod and damped blades (Nordin and Gutman, Automatica 38, 2002).
"""

from math import pi

from hil.physics.linear import Pair, moved
from hil.physics.pitch_actuator import full_speed
from vpp_fmu.kernel.types import INSTANT, Effect, Parameter, State

NEVER = 1e6  # s
UNLIMITED = 1000.0  # deg/s

COUNTS = 1024
"""Counts of the LAC's converter over the actuator's travel."""

WHOLE = 1.5 * 2.0**52
"""Adding and subtracting it rounds a number to a whole one."""

CONTACT = 0.002
"""Time constant, s, with which a pushed linkage moves the damped blades, since it is not rigid."""


COMMAND_DELAY = Effect(
    "lac_command_delay",
    "a pitch command acts later",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.5, "delay; four pulses of 20 ms, the LAC's default, last 0.08 s", 0.1),),
    off={"delay": 0.0},
    probe={"delay": 0.08},
    delays={"beta_ref": "delay"},
)


def _average(ops, s, x, p, dt):
    counts, clock = p.frame > 0.0, x.clock + dt
    due = ops.where(counts, clock, -1.0) > p.frame - INSTANT
    seen = s.beta_ref, x.first, x.second, x.third
    kept = x.first, x.second, x.third, x.fourth
    first, second, third, fourth = (ops.where(due, new, old) for new, old in zip(seen, kept, strict=True))
    mean = ops.where(counts, 0.25 * (first + second + third + fourth), s.beta_ref)
    memory = {"first": first, "second": second, "third": third, "fourth": fourth}
    return {"beta_ref": mean}, {**memory, "clock": ops.where(due, clock - p.frame, ops.where(counts, clock, 0.0))}


def _pulse(name: str) -> State:
    return State(name, "deg", f"{name} of the last pulses", lambda ops, s, p: s.beta_ref)


PULSE_AVERAGE = Effect(
    "lac_pulse_average",
    "the LAC takes the mean of its last four pulses",
    _average,
    parameters=(Parameter("frame", "s", 0.0, 0.0, 0.1, "time from pulse to pulse; 0.02 is a servo signal's; 0: none", 0.01),),
    states=(*map(_pulse, ("first", "second", "third", "fourth")), State("clock", "s", "time since a pulse", 0.0)),
    off={"frame": 0.0},
    probe={"frame": 0.02},
)


def _ignore(ops, s, x, p, dt):
    count = (s.actuator.beta_high - s.actuator.beta_low) / COUNTS
    counts = (s.beta_ref - x.heard) / count + WHOLE - WHOLE
    obeyed = ops.where(ops.abs(counts) * count > p.half_width, counts, 0.0)
    heard = ops.where(p.half_width > 0.0, x.heard + obeyed * count, s.beta_ref)
    return {"beta_ref": heard}, {"heard": heard}


COMMAND_DEADBAND = Effect(
    "lac_command_deadband",
    "the LAC ignores small changes of its command",
    _ignore,
    parameters=(Parameter("half_width", "deg", 0.0, 0.0, 5.0, "largest change of the command that is ignored"),),
    states=(State("heard", "deg", "command that the LAC heard last", lambda ops, s, p: s.beta_ref),),
    off={"half_width": 0.0},
    probe={"half_width": 1.0},
)


def _stop(ops, s, x, p, dt):
    return {"drive": ops.where(ops.abs(s.pitch_error) < p.half_width, 0.0, s.drive)}, {}


STOP_BAND = Effect(
    "lac_stop_band",
    "the LAC switches its motor off close to the command",
    _stop,
    parameters=(
        Parameter("half_width", "deg", 0.0, 0.0, 5.0, "distance within which the motor is off; the LAC's default is 0.12 deg"),
    ),
    off={"half_width": 0.0},
    probe={"half_width": 0.6},
)


def _limit(ops, s, x, p, dt):
    most = p.rate / full_speed(s.actuator)
    return {"drive": ops.clip(s.drive, -most, most)}, {}


ROD_SPEED_LIMIT = Effect(
    "rod_speed_limit",
    "the LAC's speed potentiometer holds the actuator back",
    _limit,
    parameters=(Parameter("rate", "deg/s", UNLIMITED, 0.5, UNLIMITED, "greatest rate of pitch; 1000: none", 10.0),),
    off={"rate": UNLIMITED},
    probe={"rate": 8.0},
)


def _stick(ops, s, x, p, dt):
    return {"rod_stuck": ops.where(x.clock < p.after, 0.0, 1.0)}, {"clock": x.clock + dt}


ROD_STUCK = Effect(
    "rod_stuck",
    "the actuator gets stuck",
    _stick,
    parameters=(Parameter("after", "s", NEVER, 0.0, NEVER, "time at which it gets stuck; 1e6: never", 10.0),),
    states=(State("clock", "s", "time since the start", 0.0),),
    off={"after": NEVER},
    probe={"after": 1.0},
)


def _play(ops, s, x, p, dt):
    ahead = s.beta - x.driven
    pressed = ahead - ops.clip(ahead, -p.half_gap, p.half_gap)
    driven = ops.where(p.half_gap > 0.0, x.driven + ops.gain(CONTACT, dt) * pressed, s.beta)
    return {"beta": driven}, {"driven": driven}


LINKAGE_PLAY = Effect(
    "linkage_play",
    "play between rod and blades",
    _play,
    parameters=(Parameter("half_gap", "deg", 0.0, 0.0, 5.0, "half of the play"),),
    states=(State("driven", "deg", "pitch behind the play", lambda ops, s, p: s.beta),),
    off={"half_gap": 0.0},
    probe={"half_gap": 0.5},
)


def swung(ops, reading, rate, before, after, frequency, damping, dt):
    """(reading, rate) of a spring and mass after a step in which its input goes from `before` to `after`."""
    w = 2.0 * pi * frequency
    pair = Pair(0.0, 1.0, 0.0, -w * w, -2.0 * damping * w, w * w * 0.5 * (before + after))
    return moved(ops, pair, reading, rate, dt)


def _twang(ops, s, x, p, dt):
    soft = p.frequency > 0.0
    beta, rate = swung(ops, x.blade, x.rate, x.before, s.beta, ops.where(soft, p.frequency, 1.0), p.damping, dt)
    beta = ops.where(soft, beta, s.beta)
    return {"beta": beta}, {"blade": beta, "rate": ops.where(soft, rate, 0.0), "before": s.beta}


def _beta(ops, s, p):
    return s.beta


LINKAGE_RESONANCE = Effect(
    "linkage_resonance",
    "blades swing on a soft linkage",
    _twang,
    parameters=(
        Parameter("frequency", "Hz", 0.0, 0.0, 60.0, "natural frequency of the linkage; 0: rigid", 10.0),
        Parameter("damping", "1", 0.1, 0.01, 0.9, "damping ratio", 0.1),
    ),
    states=(
        State("blade", "deg", "pitch of the blades", _beta),
        State("rate", "deg/s", "rate of the blades' pitch", 0.0),
        State("before", "deg", "pitch that drives them, at the start of the step", _beta),
    ),
    off={"frequency": 0.0},
    probe={"frequency": 4.0},
)
