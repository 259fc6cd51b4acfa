"""The speed is read late, and the thrust is not: a display that averages, a frame that waits (dead_time.py)."""

from vpp_fmu.kernel.effects.dead_time import dead_time, states
from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    late, ahead = dead_time(ops, s.omega, x, p.delay, dt)
    return {"omega": late}, ahead


EFFECT = Effect(
    "speed_reading_delay",
    "dead time of the speed reading",
    _step,
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.3, "time by which speed is read late", 0.03),),
    states=states("omega", "rpm"),
    off={"delay": 0.0},
    probe={"delay": 0.03},
    largest_step=0.002,
    reading="speed",
)
