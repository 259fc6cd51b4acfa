"""The supply voltage sags under load, and with it the speed that the motor reaches.

    form 1: u = min(omega_ref, limit - lost),   load = lift                            a speed loop, until its voltage ends
    form 2: u = omega_ref - lost,               load = lift (omega / full_speed)^2     no speed loop: speed droops with torque
    time_constant d lost/dt = sag load - lost;   time_constant = 0: lost = sag load

lift = beta + beta_offset is the pitch from which thrust and torque grow (the normalised b is lift / beta_scale), not below 0
in form 2; full_speed = omega_scale. Torque is proportional to the square of the reached speed, so in form 2 the
rotor's lags are in a feedback loop, and a loaded rotor responds faster. A battery has the lag: the resistance and capacitance
of its equivalent circuit (Thevenin), 0.2 to 3 s. The step uses the mean pitch, and the speed extrapolated by half a step from
its last change. The load is nearly linear from step to step, and the lag is exact for a ramp.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

UNLIMITED = 1e6  # rpm; no rotor gets there


def _steady(ops, s, p, beta, speed):
    """Speed [rpm] that is lost in the end, at this pitch and speed."""
    lift, share = beta + s.beta_offset, speed / s.omega_scale
    return ops.where(p.form < 1.5, p.sag * lift, p.sag * ops.maximum(lift, 0.0) * share * share)


def _step(ops, s, x, p, dt):
    steady = _steady(ops, s, p, 0.5 * (x.beta_before + s.beta), 1.5 * x.speed - 0.5 * x.speed_before)
    slow = p.time_constant > 0.0
    lagged = ops.lag_ramp(x.lost, x.steady, steady, ops.where(slow, p.time_constant, 1.0), dt)
    # Without a lag the value is `steady` to the bit. The other term is 0 there, but its derivative is that of a short lag.
    lost = ops.where(slow, lagged, steady - p.time_constant * (steady - x.steady) / dt)
    limited = ops.minimum(s.omega_ref, ops.maximum(p.limit - lost, 0.0))
    wanted = ops.where(p.form < 1.5, limited, s.omega_ref - lost)
    return {"omega_ref": wanted}, {"beta_before": s.beta, "speed_before": x.speed, "lost": lost, "steady": steady}


def _lost_at_rest(ops, s, p):
    return _steady(ops, s, p, s.beta, _at_rest(ops, s, p))


def _at_rest(ops, s, p):
    bend = p.sag * ops.maximum(s.beta + s.beta_offset, 0.0) / (s.omega_scale * s.omega_scale)
    return 2.0 * s.omega_ref / (1.0 + ops.sqrt(1.0 + 4.0 * bend * s.omega_ref))


EFFECT = Effect(
    "supply_sag",
    "speed is lost to pitch as the supply sags",
    _step,
    parameters=(
        Parameter(
            "limit",
            "rpm",
            UNLIMITED,
            0.3,
            UNLIMITED,
            "form 1: top speed where pitch is 0 when normalised; 1000000: none",
            1.0,
            scale="speed",
            unlimited=UNLIMITED,
        ),
        Parameter(
            "sag",
            "rpm/deg",
            0.0,
            0.0,
            0.4,
            "speed lost per pitch: off the limit, or (form 2) at full speed",
            0.15,
            scale="speed/pitch",
        ),
        Parameter(
            "time_constant", "s", 0.0, 0.0, 10.0, "time constant of sag and recovery; 0: none", 0.5, limit_form="at once"
        ),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 a limit that falls with pitch, 2 a droop with load", choices=(1.0, 2.0)),
    ),
    states=(
        State("beta_before", "deg", "blade pitch at the start of the step", lambda ops, s, p: s.beta),
        State("speed", "rpm", "rotor speed at the start of the step", _at_rest, closed_by="omega_outer_ahead"),
        State("speed_before", "rpm", "rotor speed a step earlier", _at_rest),
        State("lost", "rpm", "speed that is lost to the sag", _lost_at_rest),
        State("steady", "rpm", "speed that would be lost in the end, a step earlier", _lost_at_rest),
    ),
    off={"limit": UNLIMITED, "sag": 0.0},
    probe={"limit": 31.0 / 30.0, "sag": 0.15, "time_constant": 0.5},
    largest_step=0.002,
    contains={"speed_saturation": {"limit": "maximum"}},
    channels=("omega",),
    says="the rotor loses speed to pitch as the supply sags, by {sag} with a time constant of {time_constant}",
)
