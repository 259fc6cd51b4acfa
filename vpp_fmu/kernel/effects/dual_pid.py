"""Two PIDs on one thrust error command speed and pitch (paper, section 3.3), sampled, in normalised quantities.

    e = (thrust_set - thrust) / thrust_scale
    I[k] = I[k-1] + (e[k-1] + e[k]) dt / 2                      trapezoidal, one integral a channel
    D[k] = (1 - delta) D[k-1] + delta (e[k] - e[k-1]) / dt,     delta = dt / t_filter
    w_ref = kp e + ki I + kd D,   held within the limits

Clamping is separate for each channel: an integral stops if its sum is outside of its limits and the step would increase the
excess. With a shared integral, or a shared test, a channel within its limits would stop with the other.
Departs from the paper: delta is held to 1 where t_filter < dt, since the form is unstable there.
"""

from vpp_fmu.kernel.effects.normalisation import scales
from vpp_fmu.kernel.types import BOOLEAN, Effect, Parameter, State

SWITCH = {"kind": BOOLEAN, "tunable": True}


def _channel(ops, e, move, integral, rate, kp, ki, kd, low, high):
    """One PID in normalised units: (sum, next integral). `low`, `high`: the channel's limits."""
    so_far = kp * e + ki * integral + kd * rate
    above = ops.where(ki * move > 0.0, integral, integral + move)
    below = ops.where(ki * move < 0.0, integral, integral + move)
    kept = ops.where(so_far > high, above, ops.where(so_far < low, below, integral + move))
    return kp * e + ki * kept + kd * rate, kept


def _step(ops, s, x, p, dt):
    running = x.running > 0.5  # the first sample has no predecessor: it adds nothing to the integrals, and has no rate
    e = (s.thrust_set - s.thrust) / p.thrust_scale
    before = ops.where(running, x.error, e)
    move = ops.where(running, 0.5 * (before + e) * dt, 0.0)
    delta = dt / ops.maximum(p.t_filter, dt)
    rate = (1.0 - delta) * x.rate + delta * ((e - before) / dt)
    low, high = p.omega_min / p.omega_scale, p.omega_max / p.omega_scale
    w, omega_integral = _channel(ops, e, move, x.omega_integral, rate, p.kp_omega, p.ki_omega, p.kd_omega, low, high)
    low, high = (p.beta_min + p.beta_offset) / p.beta_scale, (p.beta_max + p.beta_offset) / p.beta_scale
    b, beta_integral = _channel(ops, e, move, x.beta_integral, rate, p.kp_beta, p.ki_beta, p.kd_beta, low, high)
    # Limits are held in rpm and deg: scaled back and forth they would be off by a rounding.
    omega = ops.clip(p.omega_scale * w, p.omega_min, p.omega_max)
    beta = ops.clip(p.beta_scale * b - p.beta_offset, p.beta_min, p.beta_max)
    commands = {"omega_ref": omega, "beta_ref": ops.where(p.speed_only > 0.5, p.beta_fixed, beta)}
    memory = {"omega_integral": omega_integral, "beta_integral": beta_integral, "error": e, "rate": rate, "running": 1.0}
    return commands, memory


def _gain(name: str, default: float, unit: str, text: str) -> Parameter:
    return Parameter(name, unit, default, 0.0, 1e4, f"{text} gain, normalised", nominal=10.0, tunable=True)


def _nothing(ops, s, p):
    return 0.0


DUAL_PID = Effect(
    "dual_pid",
    "two PIDs on the thrust error",
    _step,
    parameters=(
        _gain("kp_omega", 9.82, "1", "proportional speed"),
        _gain("ki_omega", 115.3, "1/s", "integral speed"),
        _gain("kd_omega", 0.318, "s", "derivative speed"),
        _gain("kp_beta", 9.0, "1", "proportional pitch"),
        _gain("ki_beta", 70.44, "1/s", "integral pitch"),
        _gain("kd_beta", 0.25, "s", "derivative pitch"),
        Parameter("t_filter", "s", 0.02, 0.0, 10.0, "time constant of the derivative's filter", 0.02, tunable=True),
        Parameter("sample_time", "s", 0.004, 1e-5, 10.0, "period at which the controller samples", 0.004),
        Parameter("omega_min", "rpm", 1.0 / 3.0, 0.0, 5.0, "lowest speed that is commanded", 1.0, scale="speed", tunable=True),
        Parameter("omega_max", "rpm", 1.0, 0.0, 5.0, "highest speed that is commanded", 1.0, scale="speed", tunable=True),
        Parameter("beta_min", "deg", 0.0, -5.0, 5.0, "lowest pitch that is commanded", 1.0, scale="position", tunable=True),
        Parameter("beta_max", "deg", 1.0, -5.0, 5.0, "highest pitch that is commanded", 1.0, scale="position", tunable=True),
        Parameter("speed_only", "1", 0.0, 0.0, 1.0, "only speed is controlled, pitch stays at beta_fixed", **SWITCH),
        Parameter("beta_fixed", "deg", 1.0, -5.0, 5.0, "pitch in speed-only mode", 1.0, scale="position", tunable=True),
        *scales(),
    ),
    states=(
        State("omega_integral", "s", "integral of the normalised thrust error, speed channel", _nothing),
        State("beta_integral", "s", "integral of the normalised thrust error, pitch channel", _nothing),
        State("error", "1", "normalised thrust error at the last sample", _nothing),
        State("rate", "1/s", "filtered rate of the normalised thrust error", _nothing),
        State("running", "1", "0 before the first sample, then 1", _nothing),
    ),
)
