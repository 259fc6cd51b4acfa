"""The thrust is read late: averaging and frames of the load cell's amplifier, and the logger's clock (dead_time.py).

Measured speed is not; that tells it from a rotor that moves late. A logger's time goes with no scale of the rig.
"""

from vpp_fmu.kernel.effects.dead_time import dead_time, states
from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    late, ahead = dead_time(ops, s.thrust, x, p.delay, dt)
    return {"thrust": late}, ahead


EFFECT = Effect(
    "reading_delay",
    "dead time of the thrust reading",
    _step,
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.3, "time by which thrust is read late", 0.03),),
    states=states("thrust", "N"),
    off={"delay": 0.0},
    probe={"delay": 0.03},
    largest_step=0.002,
    reading="thrust",
)
