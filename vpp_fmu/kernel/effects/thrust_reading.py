"""The measurement chain from the thrust to the controller's input, once per sample.

    time_constant d filtered/dt = thrust - filtered        low-pass of the load cell's amplifier; 0: none
    late = filtered, `delay` sampling periods ago          linear between samples
    reading = resolution round((late + noise) / resolution)     the converter's steps; 0: none

Thrust is nearly linear over a sample, and the low-pass is exact for a ramp. Ties round to even.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

LONGEST = 8
"""Maximum delay of the reading, in sampling periods."""

_WHOLE = 1.5 * 2.0**52
"""Adding and subtracting it rounds to a whole number: doubles of this size have no fraction."""


def _past(k: int) -> str:
    return f"past_{k}"


def _step(ops, s, x, p, dt):
    slow = p.time_constant > 0.0
    lagged = ops.lag_ramp(x.filtered, x.thrust_before, s.thrust, ops.where(slow, p.time_constant, 1.0), dt)
    filtered = ops.where(slow, lagged, s.thrust)
    samples = [filtered, *(getattr(x, _past(k)) for k in range(1, LONGEST + 1))]
    late = 0.0
    for k, sample in enumerate(samples):
        late = late + ops.maximum(1.0 - ops.abs(p.delay - float(k)), 0.0) * sample
    raw = late + s.noise
    stepped = p.resolution > 0.0
    counts = raw / ops.where(stepped, p.resolution, 1.0) + _WHOLE - _WHOLE
    reading = ops.where(stepped, counts * p.resolution, raw)
    memory = {_past(k): samples[k - 1] for k in range(1, LONGEST + 1)}
    return {"reading": reading}, {"filtered": filtered, "thrust_before": s.thrust, **memory}


def _at_thrust(ops, s, p):
    return s.thrust


THRUST_READING = Effect(
    "thrust_reading",
    "load cell, amplifier and converter",
    _step,
    parameters=(
        Parameter("time_constant", "s", 0.0, 0.0, 1.0, "time constant of the thrust reading; 0: none", 0.01),
        Parameter("delay", "1", 0.0, 0.0, float(LONGEST), "how late the reading is, in sampling periods"),
        Parameter("resolution", "N", 0.0, 0.0, 10.0, "step of the converter; 0: none", 0.01),
        Parameter("sample_time", "s", 0.004, 1e-5, 10.0, "period at which the thrust is read", 0.004),
    ),
    states=(
        State("filtered", "N", "thrust behind the low-pass", _at_thrust),
        State("thrust_before", "N", "thrust at the last sample", _at_thrust),
        *(State(_past(k), "N", f"thrust behind the low-pass, {k} samples ago", _at_thrust) for k in range(1, LONGEST + 1)),
    ),
)
