"""The pitch command acts after a dead time: u(t) = beta_ref(t - delay), exact at any communication step.

A linear actuator control board in RC-PWM mode averages pulses before it moves. The schedule delays the command, between steps.
"""

from vpp_fmu.kernel.types import Effect, Parameter

EFFECT = Effect(
    "pitch_delay",
    "dead time between the pitch command and the actuator",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.6, "time by which the pitch command acts late", 0.1, scale="time"),),
    off={"delay": 0.0},
    probe={"delay": 0.08},
    delays={"beta_ref": "delay"},
    channels=("beta",),
    says="the pitch command acts {delay} late (dead time)",
)
