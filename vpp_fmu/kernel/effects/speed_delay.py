"""The speed command acts after a dead time: u(t) = omega_ref(t - delay), exact at any communication step.

Causes are frames of the command link, the control period and the speed controller's own filter. The schedule delays the
command, between steps.
"""

from vpp_fmu.kernel.types import Effect, Parameter

EFFECT = Effect(
    "speed_delay",
    "dead time between the speed command and the motor",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.6, "time by which the speed command acts late", 0.1, scale="time"),),
    off={"delay": 0.0},
    probe={"delay": 0.08},
    delays={"omega_ref": "delay"},
    channels=("omega",),
    says="the speed command acts {delay} late (dead time)",
)
