"""A rotor at rest starts late: its controller must first find the poles. Later commands are not delayed.

    from the command that leaves rest on, the motor does nothing for `wait` seconds

At rest: speed and command below a hundredth of the speed that is 1 when normalised.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

REST = 0.01


def _at_rest(ops, s):
    rest = REST * s.omega_scale
    return ops.where(s.omega_inner > rest, 0.0, ops.where(s.omega_ref > rest, 0.0, 1.0)) > 0.5


def _step(ops, s, x, p, dt):
    idle = ops.clip(p.wait - x.since, 0.0, dt)
    share = ops.gain(s.tau_omega_2, dt - idle) / ops.gain(s.tau_omega_2, dt)
    at_rest = _at_rest(ops, s)
    acts = ops.where(at_rest, 1.0, share)
    return {"omega_error": s.omega_error * acts}, {"since": ops.where(at_rest, 0.0, ops.minimum(x.since + dt, LONG))}


LONG = 1000.0  # s; a rotor that turns at the start of a record was started long before


EFFECT = Effect(
    "start_from_rest",
    "a rotor at rest starts late",
    _step,
    parameters=(Parameter("wait", "s", 0.0, 0.0, 0.6, "time for which the motor waits before it turns", 0.05, scale="time"),),
    states=(State("since", "s", "time since the rotor left rest", lambda ops, s, p: ops.where(_at_rest(ops, s), 0.0, LONG)),),
    off={"wait": 0.0},
    probe={"wait": 0.05},
    largest_step=0.002,
    channels=("omega",),
    says="a rotor at rest starts {wait} late",
)
