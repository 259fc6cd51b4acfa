"""The actuator's motor stops near its goal, and starts again only when the error has grown beyond a wider band.

    stops where |e| < stop, starts where |e| > restart;   tau dx/dt = e while it runs;   e = input - x

The hysteresis keeps a position loop with friction from hunting. Both edges are resolved between samples. A restart below
the stop counts as equal to it.
"""

from typing import Any

from vpp_fmu.kernel.effects.stage import WHICH_LAG, Stage, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter, State


def driven_between(ops, lag: Stage, running, stop, restart, dt) -> tuple[Any, Any]:
    """(distance of a lag, 1 if its motor still runs): the motor stops at `stop`, starts at `restart`, 0 <= stop <= restart.

    `running`: 1 if the motor ran before. If the error exceeds `restart` within the step, a stopped motor starts.
    """
    runs = ops.where(ops.abs(lag.before) > restart, 1.0, running) > 0.5
    side = ops.where(ops.where(runs, lag.before, lag.after) < 0.0, -1.0, 1.0)
    before, after, free = side * lag.before, side * lag.after, side * lag.distance

    end = after - free
    stops = end < stop
    span = ops.where(end < before, before - end, 1.0)
    at_edge = ops.maximum(ops.maximum(free * (before - stop) / span, after - restart), 0.0)
    on = ops.where(stops, at_edge, free)

    starts = after > restart
    span = ops.where(starts, ops.where(runs, 1.0, after - before), 1.0)
    begun = 0.5 * ops.gain(lag.tau, dt) * (restart + after) * (after - restart) / span
    from_rest = ops.where(starts, ops.minimum(begun, after - stop), 0.0)

    runs_on = ops.where(runs, ops.where(stops, 0.0, 1.0), ops.where(starts, ops.where(begun < after - stop, 1.0, 0.0), 0.0))
    distance = side * ops.where(runs, on, from_rest)
    return ops.where(restart > 0.0, distance, lag.distance), runs_on


def _step(ops, s, x, p, dt):
    lag = stage(ops, s, "beta", p.form)
    distance, running = driven_between(ops, lag, x.running, p.stop, ops.maximum(p.stop, p.restart), dt)
    return with_distance(ops, s, "beta", p.form, distance, dt), {"running": running}


EFFECT = Effect(
    "pitch_stop_restart",
    "the pitch motor stops near its goal and restarts farther off",
    _step,
    parameters=(
        Parameter("stop", "deg", 0.0, 0.0, 0.05, "pitch error at which the running motor stops", 0.01, scale="pitch"),
        Parameter("restart", "deg", 0.0, 0.0, 0.3, "pitch error at which the stopped motor starts", scale="pitch"),
        WHICH_LAG,
    ),
    states=(State("running", "1", "1 while the motor runs, else 0", lambda ops, s, p: 0.0),),
    off={"stop": 0.0, "restart": 0.0},
    probe={"stop": 0.01, "restart": 0.06},
    largest_step=0.002,
    contains={"pitch_stop_band": {"stop": "half_width", "restart": "half_width"}},
    channels=("beta",),
    says="the pitch motor stops within {stop} of its goal and restarts beyond {restart}",
)
