"""The induced inflow lags behind a change of thrust. Until it has built up, the blades meet more air and thrust leads.

    d inflow/dt = (q - inflow) / time_constant,   lead = gain (q - inflow)        (paper, eq. 2)
    form 1: thrust += thrust_scale w^2 lead                                       q = b
    form 2: thrust += thrust_scale (h(w, b + lead) - h(w, b))                     q = b, through the whole map h
    form 3: thrust += thrust_scale lead                                           q = thrust / thrust_scale

Form 3 leads with speed as well as with pitch. Physical time constants are 3 to 30 ms: 0.849 / (4 lambda Omega), or the
transit time of the disk. q is nearly linear over a step, and the lag is exact for a ramp.
"""

from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.types import Effect, Parameter, State


def _source(ops, s, p):
    return ops.where(p.form < 2.5, s.b, s.thrust / s.thrust_scale)


def _step(ops, s, x, p, dt):
    q = _source(ops, s, p)
    inflow = ops.lag_ramp(x.inflow, x.before, q, p.time_constant, dt)
    lead = p.gain * (q - inflow)
    mapped = normalised_thrust(s, s.w, s.b + lead) - normalised_thrust(s, s.w, s.b)
    more = ops.where(p.form < 1.5, s.w * s.w * lead, ops.where(p.form < 2.5, mapped, lead))
    return {"thrust": s.thrust + s.thrust_scale * more}, {"inflow": inflow, "before": q}


EFFECT = Effect(
    "inflow_lag",
    "thrust leads while the inflow builds up",
    _step,
    parameters=(
        Parameter("gain", "1", 0.0, 0.0, 1.0, "lead over the remaining change of inflow: thrust overshoots", 0.1),
        Parameter("time_constant", "s", 0.2, 0.006, 2.0, "time constant of the inflow", 0.2, scale="time"),
        Parameter(
            "form", "1", 1.0, 1.0, 3.0, "1 pitch by w^2, 2 pitch through the map, 3 thrust itself", choices=(1.0, 2.0, 3.0)
        ),
    ),
    states=(
        State("inflow", "1", "what the inflow has taken up", _source),
        State("before", "1", "what the inflow follows, at the start of the step", _source),
    ),
    off={"gain": 0.0},
    probe={"gain": 0.3, "time_constant": 0.2},
    largest_step=0.002,
    says="the thrust overshoots by a gain of {gain} while the inflow builds up",
)
