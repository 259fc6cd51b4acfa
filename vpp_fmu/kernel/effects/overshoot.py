"""A channel overshoots: its outer lag has inertia, as a servo's mass or a speed controller's integrator.

    inertia tau_1^2 d2u/dt2 + tau_1 du/dt = x - u,    damping ratio = 0.5 / sqrt(inertia)

It overshoots above an inertia of 0.25. Exact for an inner stage x that is linear over the step.
"""

from vpp_fmu.kernel.effects.stage import OUTER, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter, State

SMALLEST = 1e-3
"""Least inertia: two poles with a ratio of 1000."""


def _overshoot(u: str, name: str, what: str, unit: str) -> Effect:
    """The effect for channel `u` ("omega" or "beta")."""

    def step(ops, s, x, p, dt):
        lag = stage(ops, s, u, OUTER)
        moving = p.inertia > SMALLEST
        tau, inertia = lag.tau, ops.where(moving, p.inertia, 1.0)
        a, w0_squared = 0.5 / (inertia * tau), 1.0 / (inertia * tau * tau)
        swing = w0_squared - a * a
        rings = swing > 0.0
        w = ops.sqrt(ops.maximum(ops.abs(swing), 1e-12 * w0_squared))
        slow, fast = ops.exp((w - a) * dt), ops.exp(-(w + a) * dt)
        left = ops.exp(-a * dt)
        c = ops.where(rings, left * ops.cos(w * dt), 0.5 * (slow + fast))
        r = ops.where(rings, left * ops.sin(w * dt), 0.5 * (slow - fast)) / w
        slope = (lag.after - lag.before) / dt
        z, v = tau * slope - lag.before, x.rate - slope
        distance = lag.after - tau * slope + c * z + r * (v + a * z)
        rate = slope + c * v - r * (w0_squared * z + a * v)
        distance = ops.where(moving, distance, lag.distance)
        return with_distance(ops, s, u, OUTER, distance, dt), {"rate": rate}

    return Effect(
        name,
        f"{what} overshoots",
        step,
        parameters=(
            Parameter("inertia", "1", 0.0, 0.0, 25.0, "0.25 over the square of the damping ratio; 0: a first-order lag", 0.1),
        ),
        states=(State("rate", unit, f"rate of {what}", 0.0),),
        off={"inertia": 0.0},
        probe={"inertia": 0.6},
        largest_step=0.002,
        channels=(u,),
        says=f"{what} overshoots: its lag has an inertia of {{inertia}}",
    )


PITCH = _overshoot("beta", "pitch_overshoot", "the blade pitch", "deg/s")
SPEED = _overshoot("omega", "speed_overshoot", "the rotor speed", "rpm/s")
