"""The pitch actuator is slower in one direction: the blades' twisting moment helps it one way and loads it the other.

    tau dx/dt = (input - x) exp(-asymmetry) rising, (input - x) exp(asymmetry) falling

`asymmetry` builds the effect for either channel. The inner lag keeps its direction while the command is held, and is exact. If
the outer lag reverses within a step, the times before and after the reversal have their own time constants.
"""

from vpp_fmu.kernel.effects.stage import WHICH_LAG, OneOf, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter


def asymmetry(u: str, name: str, description: str, probe: float) -> Effect:
    """The effect for channel `u` ("omega" or "beta")."""

    def step(ops, s, x, p, dt):
        lag = stage(ops, s, u, p.form)
        plain = ops.gain(lag.tau, dt)
        slower, faster = lag.tau * ops.exp(p.asymmetry), lag.tau * ops.exp(-p.asymmetry)
        rising, falling = ops.gain(slower, dt) / plain - 1.0, ops.gain(faster, dt) / plain - 1.0
        end = lag.after - lag.distance
        turns = lag.before * end < 0.0
        left = ops.where(turns, end / ops.where(turns, end - lag.before, 1.0), 0.0)  # share of the step after the turn
        behind = 0.5 * plain * left * end
        begins = ops.where(turns, lag.before, lag.before + end)
        more = ops.where(begins < 0.0, falling, rising) * (lag.distance - behind)
        more = more + ops.where(end < 0.0, falling, rising) * behind
        return with_distance(ops, s, u, p.form, lag.distance + more, dt, OneOf(begins < 0.0, faster, slower)), {}

    text = "logarithm of the factor on the time constant while rising; its inverse while falling; above 0: slower up"
    return Effect(
        name,
        description,
        step,
        parameters=(Parameter("asymmetry", "1", 0.0, -1.2, 1.2, text), WHICH_LAG),
        off={"asymmetry": 0.0},
        probe={"asymmetry": probe},
        largest_step=0.002,
        channels=(u,),
        says=f"{description}, by a relative {{asymmetry}}",
    )


EFFECT = asymmetry("beta", "pitch_asymmetry", "pitch rises and falls with different time constants", 0.3)
