"""The supply gives way under load, and with it the speed that the motor reaches.

    form 1: u = min(omega_ref, limit - sag lift)                 a speed loop holds the command until its voltage ends
    form 2: u = omega_ref - sag lift (omega / full_speed)^2      no speed loop: speed droops with the torque

lift = beta + 5 deg is the pitch from which thrust and torque grow (the paper's normalisation; its b is lift / 15 deg), not
below 0 in form 2; full_speed = 6000 rpm. Torque goes with the square of the speed that is reached, so in form 2 the rotor's
lags are part of a loop, and a loaded rotor answers faster. Pitch counts by its mean over the step, speed by where the last
step's change takes it half a step on.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

FULL_SPEED = 6000.0  # rpm
UNLOADED = -5.0  # deg
UNLIMITED = 60000.0  # rpm


def _step(ops, s, x, p, dt):
    lift = 0.5 * (x.beta_before + s.beta) - UNLOADED
    limit = ops.maximum(p.limit - p.sag * lift, 0.0)
    speed = (1.5 * x.speed - 0.5 * x.speed_before) / FULL_SPEED
    drooped = s.omega_ref - p.sag * ops.maximum(lift, 0.0) * speed * speed
    wanted = ops.where(p.form < 1.5, ops.minimum(s.omega_ref, limit), drooped)
    return {"omega_ref": wanted}, {"beta_before": s.beta, "speed_before": x.speed}


def _at_rest(ops, s, p):
    bend = p.sag * ops.maximum(s.beta - UNLOADED, 0.0) / (FULL_SPEED * FULL_SPEED)
    return 2.0 * s.omega_ref / (1.0 + ops.sqrt(1.0 + 4.0 * bend * s.omega_ref))


EFFECT = Effect(
    "supply_sag",
    "speed is lost to pitch as the supply sags",
    _step,
    parameters=(
        Parameter("limit", "rpm", UNLIMITED, 4200.0, UNLIMITED, "form 1: top speed at -5 deg of pitch; 60000: none", 6000.0),
        Parameter("sag", "rpm/deg", 0.0, 0.0, 160.0, "speed lost per pitch: off the limit, or (form 2) at 6000 rpm", 60.0),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 a limit that falls with pitch, 2 a droop with load", choices=(1.0, 2.0)),
    ),
    states=(
        State("beta_before", "deg", "blade pitch at the start of the step", lambda ops, s, p: s.beta),
        State("speed", "rpm", "rotor speed at the start of the step", _at_rest, closed_by="omega_outer_ahead"),
        State("speed_before", "rpm", "rotor speed a step earlier", _at_rest),
    ),
    off={"limit": UNLIMITED, "sag": 0.0},
    probe={"limit": 6200.0, "sag": 60.0},
    largest_step=0.002,
    contains={"speed_saturation": {"limit": "maximum"}},
)
