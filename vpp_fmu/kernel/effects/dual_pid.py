"""Sampled control laws from thrust error to speed and pitch commands, in normalised quantities.

Mode 0, two PIDs on one error (paper, section 3.3):

    e = (thrust_set - thrust) / thrust_scale
    I[k] = I[k-1] + (e[k-1] + e[k]) dt / 2                      trapezoidal, one integral a channel
    D[k] = (1 - delta) D[k-1] + delta (e[k] - e[k-1]) / dt,     delta = dt / t_filter
    w_ref = kp e + ki I + kd D,   held within the limits

Mode 1 commands only speed, at a fixed pitch. Mode 2, allocated: a table gives the best pair (w*, b*) for thrust_set. Pitch, the
fast actuator, corrects the error; speed changes until pitch is back at b* (mid-ranging: Allison and Isaksson 1998):

    b_ref = b* + kp e + ki I + kd D
    w_ref = w* + kp e + k_mid M + kd D,    M[k] = M[k-1] + (b_ref - b*) dt

While speed is within its limits, I and M of mode 2 continue beyond the limits of pitch, by at most its range. The best pitch
of many rotors is at a limit; there only the unlimited pitch command makes speed correct the error.

Clamping is separate for each channel: an integral stops if its sum is outside of its limits and the step would increase the
excess. With a shared integral, or a shared test, a channel within its limits would stop with the other. When the mode changes
during a run, the integrals are set such that the commands are continuous; only a fixed pitch jumps.
Departs from the paper: delta is limited to 1 where t_filter < dt, since the form is unstable there.
"""

from collections.abc import Iterator

from vpp_fmu.kernel.effects.normalisation import scales
from vpp_fmu.kernel.types import BOOLEAN, INTEGER, Effect, Parameter, State

SWITCH = {"kind": BOOLEAN, "tunable": True}

DUAL, SPEED_ONLY, ALLOCATED = 0.0, 1.0, 2.0
"""Values of `mode`."""

PAIRS = 9
"""Number of knots of the table of best pairs, evenly from pairs_thrust_min to pairs_thrust_max; linear between them."""


def _channel(ops, e, move, integral, rate, kp, ki, kd, low, high):
    """One PID in normalised units: (sum, next integral). `low`, `high`: the channel's limits."""
    so_far = kp * e + ki * integral + kd * rate
    above = ops.where(ki * move > 0.0, integral, integral + move)
    below = ops.where(ki * move < 0.0, integral, integral + move)
    kept = ops.where(so_far > high, above, ops.where(so_far < low, below, integral + move))
    return kp * e + ki * kept + kd * rate, kept


NARROWEST = 1e-6
"""Minimum span of the table, as a share of the thrust scale: no division by zero, whatever an importer sets."""


def _best_pair(ops, thrust_set, p):
    """The table's (speed [rpm], pitch [deg]) for a wanted thrust [N]; constant beyond its ends."""
    span = ops.maximum(p.pairs_thrust_max - p.pairs_thrust_min, NARROWEST * p.thrust_scale)
    at = (PAIRS - 1) * (thrust_set - p.pairs_thrust_min) / span
    pair = []
    for knots in ([getattr(p, f"pair_{u}_{k}") for k in range(PAIRS)] for u in ("omega", "beta")):
        value = knots[0]
        for k in range(PAIRS - 1):
            value = value + (knots[k + 1] - knots[k]) * ops.clip(at - k, 0.0, 1.0)
        pair.append(value)
    return pair


def _mode(ops, p):
    return ops.whole(ops.where(p.speed_only > 0.5, SPEED_ONLY, p.mode))


def _continued(ops, switched, integral, ki, before, rest):
    """The integral; after a switch the one for which the sum `rest + ki integral` equals the command `before`."""
    return ops.where(switched, ops.where(ki > 0.0, (before - rest) / ops.where(ki > 0.0, ki, 1.0), 0.0), integral)


def _step(ops, s, x, p, dt):
    running = x.running > 0.5  # the first sample has no predecessor: it adds nothing to the integrals, and has no rate
    e = (s.thrust_set - s.thrust) / p.thrust_scale
    before = ops.where(running, x.error, e)
    move = ops.where(running, 0.5 * (before + e) * dt, 0.0)
    delta = dt / ops.maximum(p.t_filter, dt)
    rate = (1.0 - delta) * x.rate + delta * ((e - before) / dt)
    mode = _mode(ops, p)
    allocated = mode > 1.5
    last = ops.where(running, x.mode, mode)
    switched = (mode - last) * (mode - last) > 0.25
    best = _best_pair(ops, s.thrust_set, p)
    w_best = ops.where(allocated, best[0] / p.omega_scale, 0.0)
    b_best = ops.where(allocated, (best[1] + p.beta_offset) / p.beta_scale, 0.0)

    low, high = (p.beta_min + p.beta_offset) / p.beta_scale, (p.beta_max + p.beta_offset) / p.beta_scale
    rest = b_best + p.kp_beta * e + p.kd_beta * rate
    integral = _continued(ops, switched, x.beta_integral, p.ki_beta, x.pitch, rest)
    span = ops.where(allocated, high - low, 0.0)
    low = low - b_best - ops.where(x.speed > p.omega_min / p.omega_scale, span, 0.0)
    high = high - b_best + ops.where(x.speed < p.omega_max / p.omega_scale, span, 0.0)
    b, beta_integral = _channel(ops, e, move, integral, rate, p.kp_beta, p.ki_beta, p.kd_beta, low, high)
    away = ops.clip(b, low, high)

    low, high = p.omega_min / p.omega_scale - w_best, p.omega_max / p.omega_scale - w_best
    ki = ops.where(allocated, p.k_mid, p.ki_omega)
    rest = w_best + p.kp_omega * e + p.kd_omega * rate
    integral = _continued(ops, switched, x.omega_integral, ki, x.speed, rest)
    move = ops.where(allocated, ops.where(running, away * dt, 0.0), move)
    w, omega_integral = _channel(ops, e, move, integral, rate, p.kp_omega, ki, p.kd_omega, low, high)

    # Limits are applied in rpm and deg: scaling them would add rounding errors.
    w, b = ops.where(allocated, w_best + w, w), ops.where(allocated, b_best + b, b)
    omega = ops.clip(p.omega_scale * w, p.omega_min, p.omega_max)
    beta = ops.clip(p.beta_scale * b - p.beta_offset, p.beta_min, p.beta_max)
    beta = ops.where(mode > 0.5, ops.where(allocated, beta, p.beta_fixed), beta)
    memory = {
        "omega_integral": omega_integral,
        "beta_integral": beta_integral,
        "error": e,
        "rate": rate,
        "running": 1.0,
        "mode": mode,
        "speed": omega / p.omega_scale,
        "pitch": (beta + p.beta_offset) / p.beta_scale,
    }
    return {"omega_ref": omega, "beta_ref": beta}, memory


def _gain(name: str, default: float, unit: str, text: str) -> Parameter:
    return Parameter(name, unit, default, 0.0, 1e4, f"{text} gain, normalised", nominal=10.0, tunable=True)


def _table() -> Iterator[Parameter]:
    """The table of best pairs. Its defaults do not use power: full pitch, and speed by the square law of thrust."""
    for end, share in (("min", 0.0), ("max", 1.0)):
        text = f"mode 2: thrust of the table's {'first' if end == 'min' else 'last'} pair"
        yield Parameter(f"pairs_thrust_{end}", "N", share, -100.0, 100.0, text, 1.0, scale="thrust")
    for k in range(PAIRS):
        share = max(1.0 / 3.0, (k / (PAIRS - 1)) ** 0.5)
        text = f"mode 2: best {{}} at thrust {k} of {PAIRS - 1} of the table"
        yield Parameter(f"pair_omega_{k}", "rpm", share, 0.0, 5.0, text.format("speed"), 1.0, scale="speed", tunable=True)
        yield Parameter(f"pair_beta_{k}", "deg", 1.0, -5.0, 5.0, text.format("pitch"), 1.0, scale="position", tunable=True)


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
        Parameter(
            "mode",
            "1",
            DUAL,
            DUAL,
            ALLOCATED,
            "law: 0 dual PID, 1 speed only, 2 allocated (best pair of speed and pitch)",
            choices=(DUAL, SPEED_ONLY, ALLOCATED),
            kind=INTEGER,
            tunable=True,
        ),
        Parameter("speed_only", "1", 0.0, 0.0, 1.0, "only speed is controlled, pitch stays at beta_fixed (mode 1)", **SWITCH),
        Parameter("beta_fixed", "deg", 1.0, -5.0, 5.0, "pitch in speed-only mode", 1.0, scale="position", tunable=True),
        Parameter("k_mid", "1/s", 0.5, 0.0, 1e4, "mode 2: gain by which speed brings pitch back to its best", tunable=True),
        *_table(),
        *scales(),
    ),
    states=(
        State("omega_integral", "s", "integral of the normalised thrust error; mode 2: of pitch less its best", _nothing),
        State("beta_integral", "s", "integral of the normalised thrust error, pitch channel", _nothing),
        State("error", "1", "normalised thrust error at the last sample", _nothing),
        State("rate", "1/s", "filtered rate of the normalised thrust error", _nothing),
        State("running", "1", "0 before the first sample, then 1", _nothing),
        State("mode", "1", "mode at the last sample", lambda ops, s, p: _mode(ops, p)),
        State("speed", "1", "commanded speed at the last sample, normalised", _nothing),
        State("pitch", "1", "commanded pitch at the last sample, normalised", _nothing),
    ),
)

ALLOCATION = {p.name: p.default for p in DUAL_PID.parameters if p.name in ("mode", "k_mid") or p.name[:4] == "pair"}
"""Parameters for the selection of the mode and for mode 2, with their defaults (mode 0)."""
