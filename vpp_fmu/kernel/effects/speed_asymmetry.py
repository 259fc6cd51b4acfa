"""The rotor speeds up faster than it slows down, or the other way round.

    tau d omega/dt = (input - omega) exp(-asymmetry) rising, (input - omega) exp(asymmetry) falling

The speed controller accelerates the motor, but mostly lets drag decelerate it, unless it brakes. The form is that of
`pitch_asymmetry`.
"""

from vpp_fmu.kernel.effects.pitch_asymmetry import asymmetry

EFFECT = asymmetry("omega", "speed_asymmetry", "speed rises and falls with different time constants", -0.35)
