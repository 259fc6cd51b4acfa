"""Moving the blades disturbs the rotor speed until the speed loop has corrected it (paper, eqs. 9-12: K_beta).

    form 1: d_omega = -gain s / ((tau_omega_1 s + 1)(tau_omega_2 s + 1)) beta      the loop's two lags
    form 2: d_omega = -gain s / (tau_omega_1 s + 1) beta                           one lag

Pitch loads the rotor; the loop's integrator compensates a constant load, so only the rate of pitch has an effect. In the
paper's symbols gain = K_beta / K_I in form 1, for the whole loop; a loop whose gain is far above its integral gain has one lag.
Pitch is nearly linear over a step, and the lags here are exact for a ramp.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State


def _step(ops, s, x, p, dt):
    trail = ops.lag_ramp(x.trail, x.beta_before, s.beta, s.tau_omega_1, dt)
    rate_before = (x.beta_before - x.trail) / s.tau_omega_1
    rate_after = (s.beta - trail) / s.tau_omega_1
    rate = ops.lag_ramp(x.rate, rate_before, rate_after, s.tau_omega_2, dt)
    shown = ops.where(p.form < 1.5, rate, rate_after)
    return {"omega": s.omega - p.gain * shown}, {"beta_before": s.beta, "trail": trail, "rate": rate}


def _at_pitch(ops, s, p):
    return s.beta


EFFECT = Effect(
    "pitch_speed_coupling",
    "rotor speed dips while the pitch rises",
    _step,
    parameters=(
        Parameter("gain", "rpm.s/deg", 0.0, -0.6, 0.6, "speed lost per rate of pitch", 0.1, scale="speed.time/pitch"),
        Parameter("form", "1", 1.0, 1.0, 2.0, "1 through both lags of the speed loop, 2 through one", choices=(1.0, 2.0)),
    ),
    states=(
        State("beta_before", "deg", "blade pitch at the start of the step", _at_pitch),
        State("trail", "deg", "blade pitch after the speed loop's outer lag", _at_pitch),
        State("rate", "deg/s", "rate of pitch as the speed loop passes it", lambda ops, s, p: 0.0),
    ),
    off={"gain": 0.0},
    probe={"gain": 0.125},
    largest_step=0.002,
    channels=("beta", "omega"),
    says="the rotor slows down while the pitch rises, by {gain}",
)
