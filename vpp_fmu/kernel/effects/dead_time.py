"""Dead time of a signal as three states, for readings: the schedule can delay commands only.

    late(s) / signal(s) = (1 - x/2 + x^2/12) / (1 + x/2 + x^2/12),   x = s delay

the Pade approximant of order 2 (Baker and Graves-Morris, Pade Approximants, 1996). Its gain is 1 at all frequencies, and its
delay is `delay` to 1 % up to 2 / delay rad/s; the lags of a rotor attenuate higher frequencies. It is the signal less `delay`
times the rate of a second-order lag of it, exact for a signal that is linear over the step.
"""

from math import sqrt

from vpp_fmu.kernel.types import Effect, Parameter, State


def dead_time(ops, signal, x, delay, dt):
    """(delayed signal, next states) of a `signal` at the end of the step; `x`: the states of `states`."""
    there = delay > 0.0
    d = ops.where(there, delay, 1.0)
    a, wd = 3.0 / d, sqrt(3.0) / d
    left, c, r = ops.exp(-a * dt), ops.cos(wd * dt), ops.sin(wd * dt) / wd
    slope = (signal - x.before) / dt
    lagging = 0.5 * d * slope
    z, v = x.behind - (x.before - lagging), x.rate - slope
    behind = signal - lagging + left * (c * z + r * (v + a * z))
    rate = slope + left * (c * v - r * (12.0 / (d * d) * z + a * v))
    late = ops.where(there, signal - d * rate, signal)
    return late, {"before": signal, "behind": ops.where(there, behind, signal), "rate": ops.where(there, rate, 0.0)}


def states(signal: str, unit: str) -> tuple[State, ...]:
    """The states that delay a `signal`, in its `unit`."""

    def settled(ops, s, p):
        return getattr(s, signal)

    return (
        State("before", unit, f"{signal} at the start of the step", settled),
        State("behind", unit, f"{signal} behind two lags", settled),
        State("rate", f"{unit}/s", "rate of that", lambda ops, s, p: 0.0),
    )


def late_reading(name: str, reading: str, signal: str, unit: str) -> Effect:
    """The dead time of the `reading` "thrust" or "speed" of a `signal`, in its `unit`.

    The delay of a logger does not depend on the size of the rig, so it has no scale.
    """

    def step(ops, s, x, p, dt):
        late, ahead = dead_time(ops, getattr(s, signal), x, p.delay, dt)
        return {signal: late}, ahead

    return Effect(
        name,
        f"dead time of the {reading} reading",
        step,
        parameters=(Parameter("delay", "s", 0.0, 0.0, 0.3, f"time by which {reading} is read late", 0.03),),
        states=states(signal, unit),
        off={"delay": 0.0},
        probe={"delay": 0.03},
        largest_step=0.002,
        reading=reading,
        says=f"the {reading} is read {{delay}} late (dead time)",
    )


THRUST = late_reading("reading_delay", "thrust", "thrust", "N")
"""Averaging and frames of the load cell's amplifier. If the rotor itself were late, the speed reading would be late, too."""

SPEED = late_reading("speed_reading_delay", "speed", "omega", "rpm")
"""Averaging of a display, or waiting of a frame; the thrust is not late."""
