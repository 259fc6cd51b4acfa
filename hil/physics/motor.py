"""ESC, motor circuit and shaft (paper, eqs. 3 and 4), solved together over a step.

    L dI/dt     = duty V - R I - k_i omega
    J d omega/dt = k_Q I - drag omega - dry_friction - q omega^2

q omega^2 is the blades' torque with inflow and pitch at the middle of the step, linearised at the speed at its start. Circuit
and shaft are then two linear equations, solved exactly (`hil.physics.linear`), so that the electric time constant (0.4 ms)
requires no shorter steps. As in the paper, the ESC is an average voltage, and brakes as well as it drives.
"""

from math import pi

from hil.physics.linear import Pair, moved
from hil.physics.propeller import RPM, drag_factor
from hil.physics.rotor import motor_constant
from vpp_fmu.kernel.types import Effect, Parameter, Signal

VOLTS = Signal("supply", "V", "voltage of the motor's supply", 1.0, 100.0, 24.0, start=24.0)


def supply(measured: bool) -> Effect:
    """The motor's supply, ideal. `measured`: its voltage is an input of the model, else a parameter (paper: 24 V)."""

    def step(ops, s, x, p, dt):
        return {"supply": s.supply if measured else p.supply_voltage, "supply_resistance": 0.0}, {}

    volts = Parameter("supply_voltage", "V", 24.0, 1.0, 100.0, "voltage of the motor's supply (paper)", 10.0)
    inputs, parameters = ((VOLTS,), ()) if measured else ((), (volts,))
    return Effect("supply", "the motor's supply", step, parameters, inputs=inputs)


def _esc(ops, s, x, p, dt):
    return {"duty": s.machine.full_duty * ops.clip(s.throttle, 0.0, 1.0), "esc_brakes": 1.0}, {}


ESC = Effect("esc", "throttle to duty cycle", _esc)


def _coasted(ops, pair: Pair, speed, dt):
    """Speed after dt without a current: a lag, in a form that also holds without losses."""
    return speed + (pair.a22 * speed + pair.b2) * dt * ops.relaxation(-pair.a22 * dt)


def _stalled(ops, pair: Pair, current, dt):
    """Current after dt in a motor that stands still."""
    return ops.lag(current, -pair.b1 / pair.a11, -1.0 / pair.a11, dt)


def _step(ops, s, x, p, dt):
    m, before, duty = s.machine, s.shaft_speed, s.duty
    k = motor_constant(m) * s.motor_strength
    load = drag_factor(ops, s.blades, s.beta_between, s.inflow_between)
    pair = Pair(
        a11=-(s.winding_resistance + m.lead_resistance + duty * duty * s.supply_resistance) / m.inductance,
        a12=-k / m.inductance,
        b1=duty * s.supply / m.inductance,
        a21=k / m.inertia,
        a22=-(m.drag + 2.0 * load * before) / m.inertia,
        b2=(load * before * before - m.dry_friction) / m.inertia,
    )
    current, speed = moved(ops, pair, s.motor_current, before, dt)
    open_circuit = ops.where(s.esc_brakes < 0.5, current, 1.0) < 0.0
    current = ops.where(open_circuit, 0.0, current)
    speed = ops.where(open_circuit, _coasted(ops, pair, before, dt), speed)
    turns = speed > 0.0
    speed, current = ops.where(turns, speed, 0.0), ops.where(turns, current, _stalled(ops, pair, s.motor_current, dt))
    rate = (k * current - m.drag * speed - m.dry_friction - load * speed * speed) / m.inertia
    return {
        "current": current,
        "shaft_speed_ahead": speed,
        "omega": speed / RPM,
        "acceleration_ahead": ops.where(turns, rate, 0.0),
        "angle": s.shaft_angle + 0.5 * (before + speed) * dt / (2.0 * pi),
        "torque": load * speed * speed,
        "supply_current": duty * current,
    }, {}


MOTOR = Effect("motor", "motor circuit and shaft", _step, largest_step=0.001)
