"""The supply voltage sags under load, and with it the speed that the motor reaches.

    form 1: u = min(omega_ref, limit - sag lift)                 a speed loop holds the command until its voltage ends
    form 2: u = omega_ref - sag lift (omega / full_speed)^2      no speed loop: speed droops with the torque

lift = beta + beta_offset is the pitch from which thrust and torque grow (the normalised b is lift / beta_scale), not below 0
in form 2; full_speed = omega_scale. Torque is proportional to the square of the reached speed, so in form 2 the
rotor's lags are in a feedback loop, and a loaded rotor responds faster. The step uses the mean pitch, and the speed
extrapolated by half a step from its last change.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

UNLIMITED = 1e6  # rpm; no rotor gets there


def _step(ops, s, x, p, dt):
    lift = 0.5 * (x.beta_before + s.beta) + s.beta_offset
    limit = ops.maximum(p.limit - p.sag * lift, 0.0)
    speed = (1.5 * x.speed - 0.5 * x.speed_before) / s.omega_scale
    drooped = s.omega_ref - p.sag * ops.maximum(lift, 0.0) * speed * speed
    wanted = ops.where(p.form < 1.5, ops.minimum(s.omega_ref, limit), drooped)
    return {"omega_ref": wanted}, {"beta_before": s.beta, "speed_before": x.speed}


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
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 a limit that falls with pitch, 2 a droop with load", choices=(1.0, 2.0)),
    ),
    states=(
        State("beta_before", "deg", "blade pitch at the start of the step", lambda ops, s, p: s.beta),
        State("speed", "rpm", "rotor speed at the start of the step", _at_rest, closed_by="omega_outer_ahead"),
        State("speed_before", "rpm", "rotor speed a step earlier", _at_rest),
    ),
    off={"limit": UNLIMITED, "sag": 0.0},
    probe={"limit": 31.0 / 30.0, "sag": 0.15},
    largest_step=0.002,
    contains={"speed_saturation": {"limit": "maximum"}},
    channels=("omega",),
    says="the rotor loses speed to pitch as the supply sags, by {sag}",
)
