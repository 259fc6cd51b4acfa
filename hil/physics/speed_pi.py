"""The speed loop of the rig: a PI from speed error to throttle (paper, section 3.1: 1e-4 and 2e-3).

    throttle = clip(kp e + I),   dI/dt = ki e,   e = omega_ref - omega

The same function serves an effect of the full model and the rig's software at 250 Hz (`SpeedPi`). An output that is held over a
step uses the integral at the middle of the step. The integral stops if the throttle is at a limit and the error would drive it
further.

The paper states no units. The mean lag of the loop is 1 / K_I (`hil.physics.reduction`): with throttle per rpm, a motor of
550 rpm/V on 24 V would have 0.04 s, while the published time constants add up to 0.19 s (averaged) and 0.225 s (fine-tuned).
These require a fifth of the gain, so one unit of the PI's output is UNIT = 0.2 of the throttle's range (chosen).
"""

from hil.physics.propeller import RPM
from hil.physics.rotor import settled_duty
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.types import Effect, Parameter, State

KP, KI, UNIT = 1e-4, 2e-3, 0.2


def speed_pi(ops, error, integral, kp, ki, low, high, dt):
    """(throttle that holds for dt [s], next integral) from the speed error [rpm]; gains in 1/rpm and 1/(rpm s)."""
    moved = integral + ki * error * dt
    wanted = kp * error + 0.5 * (integral + moved)
    stuck_high = ops.where(error > 0.0, integral, moved)
    stuck_low = ops.where(error < 0.0, integral, moved)
    kept = ops.where(wanted > high, stuck_high, ops.where(wanted < low, stuck_low, moved))
    return ops.clip(wanted, low, high), kept


class SpeedPi:
    """The PI controller with its state, for a loop in software. Gains in output units per rpm, `unit` throttle per unit."""

    def __init__(self, kp: float = KP, ki: float = KI, unit: float = UNIT, low: float = 0.0, high: float = 1.0):
        self.kp, self.ki, self.low, self.high = kp * unit, ki * unit, low, high
        self.reset()

    def reset(self, throttle: float = 0.0) -> None:
        """Reset the state; without an error the output is then `throttle`."""
        self.integral = self.throttle = min(max(throttle, self.low), self.high)

    def update(self, omega_ref: float, omega: float, dt: float, frozen: bool = False) -> float:
        """Throttle for the next dt seconds. `frozen`: the speed is not known, so throttle and integral stay as they are."""
        if not frozen:
            error = omega_ref - omega
            law = speed_pi(NUMBERS, error, self.integral, self.kp, self.ki, self.low, self.high, dt)
            self.throttle, self.integral = law
        return self.throttle


def _step(ops, s, x, p, dt):
    ahead = s.shaft_speed + 0.5 * dt * s.shaft_acceleration
    error = s.omega_ref - ahead / RPM
    kp, ki = p.kp_rpm * p.throttle_unit, p.ki_rpm * p.throttle_unit
    throttle, integral = speed_pi(ops, error, x.throttle_integral, kp, ki, 0.0, 1.0, dt)
    return {"throttle": throttle}, {"throttle_integral": integral}


def _settled(ops, s, p):
    return settled_duty(ops, s, s.machine, s.shaft_speed) / s.machine.full_duty


EFFECT = Effect(
    "speed_pi",
    "the rig's speed loop",
    _step,
    parameters=(
        Parameter("kp_rpm", "1/rpm", KP, 0.0, 1.0, "proportional gain of the speed loop (paper)", 1e-4),
        Parameter("ki_rpm", "1/rpm/s", KI, 0.0, 1.0, "integral gain of the speed loop (paper)", 1e-3),
        Parameter("throttle_unit", "1", UNIT, 0.001, 10.0, "throttle per unit of the speed loop's output (chosen)"),
    ),
    states=(State("throttle_integral", "1", "integral of the speed loop, as throttle", _settled),),
    largest_step=0.001,
)
