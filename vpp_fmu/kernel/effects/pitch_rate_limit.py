"""Blade pitch can't move faster than the actuator's motor at full voltage.

    form 1, 2: dx/dt = clip((input - x) / tau, -rate, rate)      in the inner or the outer lag
    form 3:    the command changes by `rate` at most, before the lags

The limit may end between samples: until that instant the lag moves at constant rate, after it the lag relaxes. The lags are
linear, so form 3 subtracts their response to the difference between the command and the limited command.
"""

from vpp_fmu.kernel.effects.stage import INNER, stage, with_distance
from vpp_fmu.kernel.types import Effect, Parameter, State

UNLIMITED = 10000.0  # deg/s; no blade turns 30 times a second


def _step(ops, s, x, p, dt):
    before_lags = p.form > 2.5
    form = ops.where(before_lags, INNER, p.form)
    lag = stage(ops, s, "beta", form)
    error = ops.abs(lag.distance) / ops.gain(lag.tau, dt)
    relaxes_at = p.rate * lag.tau
    ahead = ops.clip((error - relaxes_at) / p.rate, 0.0, dt)
    covered = p.rate * ahead + ops.gain(lag.tau, dt - ahead) * relaxes_at
    limited = ops.where(error > relaxes_at, ops.where(lag.distance < 0.0, -covered, covered), lag.distance)

    before = s.beta_ref - x.led
    after = before - ops.clip(before, -p.rate * dt, p.rate * dt)
    led = s.beta_move - ops.lag_ramp(0.0, before, after, lag.tau, dt)

    distance = ops.where(p.rate < UNLIMITED, ops.where(before_lags, led, limited), lag.distance)
    return with_distance(ops, s, "beta", form, distance, dt), {"led": s.beta_ref - after}


EFFECT = Effect(
    "pitch_rate_limit",
    "blade pitch moves no faster than a limit",
    _step,
    parameters=(
        Parameter(
            "rate",
            "deg/s",
            UNLIMITED,
            0.05,
            UNLIMITED,
            "greatest rate of pitch; 10000: no limit",
            0.3,
            scale="pitch/time",
            unlimited=UNLIMITED,
        ),
        Parameter(
            "form", "1", 1.0, 1.0, 3.0, "1 limits the inner lag, 2 the outer lag, 3 the command", choices=(1.0, 2.0, 3.0)
        ),
    ),
    states=(State("led", "deg", "pitch command as the limit lets it through", lambda ops, s, p: s.beta_ref),),
    off={"rate": UNLIMITED},
    probe={"rate": 1.0 / 3.0},
    largest_step=0.002,
    channels=("beta",),
    says="the blade pitch moves no faster than {rate} (rate limit)",
)
