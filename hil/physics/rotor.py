"""The shaft: inertia and friction of rotor, hub and motor (paper, eq. 3), and its steady state.

    J d omega/dt = k_Q I - drag omega - dry_friction - Q_a

The shaft's state is published before the step, for the speed loop, the inflow and the supply; `hil.physics.motor` integrates
it. The paper has viscous losses only; dry friction makes a motor's no-load current nearly constant. It holds the shaft until
the motor overcomes it; the rig's shaft does not turn backwards.
"""

from math import pi

from hil.physics.propeller import RPM, drag_factor, settled_inflow
from vpp_fmu.kernel.types import Effect, Parameter, State


def motor_constant(machine):
    """k_Q [N m/A] = k_i [V s/rad] from the speed constant in rpm/V."""
    return 30.0 / (pi * machine.kv)


def settled_speed(ops, s, machine, duty):
    """Speed [rad/s] at which the torques balance at a duty cycle: the positive root of a quadratic equation."""
    load = drag_factor(ops, s.blades, s.beta, settled_inflow(ops, s.blades, s.beta))
    k = motor_constant(machine)
    resistance = machine.resistance + machine.lead_resistance + duty * duty * s.supply_resistance
    b = machine.drag + k * k / resistance
    c = k * duty * s.supply / resistance - machine.dry_friction
    return 2.0 * ops.maximum(c, 0.0) / (b + ops.sqrt(b * b + 4.0 * load * ops.maximum(c, 0.0)))


def settled_duty(ops, s, machine, omega):
    """Duty cycle that holds a speed [rad/s], 0 at standstill: the smaller root of duty V = R I + k_i omega + duty^2 R_s I."""
    current = settled_current(ops, s, machine, omega)
    needed = (machine.resistance + machine.lead_resistance) * current + motor_constant(machine) * omega
    left = s.supply * s.supply - 4.0 * s.supply_resistance * current * needed
    return ops.where(omega > 0.0, 2.0 * needed / (s.supply + ops.sqrt(ops.maximum(left, 0.0))), 0.0)


def settled_current(ops, s, machine, omega):
    """Motor current [A] that holds a speed [rad/s]; 0 at standstill."""
    load = drag_factor(ops, s.blades, s.beta, settled_inflow(ops, s.blades, s.beta))
    torque = machine.drag * omega + machine.dry_friction + load * omega * omega
    return ops.where(omega > 0.0, torque / motor_constant(machine), 0.0)


def shaft(commanded: bool) -> Effect:
    """The shaft's states. `commanded`: it starts at `omega_ref` (a speed loop holds it), else at the speed of `throttle`."""

    def speed(ops, s, p):
        if commanded:
            return ops.clip(s.omega_ref * RPM, 0.0, settled_speed(ops, s, p, p.full_duty))
        return settled_speed(ops, s, p, p.full_duty * ops.clip(s.throttle, 0.0, 1.0))

    def current(ops, s, p):
        omega = speed(ops, s, p)
        resistance = p.resistance + p.lead_resistance
        stalled = 0.0 if commanded else p.full_duty * ops.clip(s.throttle, 0.0, 1.0) * s.supply / resistance
        return ops.where(omega > 0.0, settled_current(ops, s, p, omega), stalled)

    def step(ops, s, x, p, dt):
        return {
            "machine": p,
            "shaft_speed": x.shaft_speed,
            "shaft_acceleration": x.shaft_acceleration,
            "motor_current": x.motor_current,
            "shaft_angle": x.shaft_angle,
            "motor_strength": 1.0,
            "winding_resistance": p.resistance,
        }, {}

    return Effect(
        "shaft",
        "motor, hub and rotor on one shaft",
        step,
        parameters=(
            Parameter("full_duty", "1", 1.0, 0.05, 1.0, "duty cycle of the ESC at full throttle (paper: u in [0, 1])"),
            Parameter("kv", "rpm/V", 550.0, 50.0, 5000.0, "no-load speed per volt (data sheet: AT3520 KV 550)", 500.0),
            Parameter("resistance", "Ohm", 0.045, 0.005, 1.0, "winding resistance (chosen, usual for this size)", 0.05),
            Parameter("lead_resistance", "Ohm", 0.025, 0.0, 1.0, "ESC, leads and plugs (chosen)", 0.05),
            Parameter("inductance", "H", 2.5e-5, 1e-6, 1e-3, "winding inductance (chosen, usual for this size)", 1e-5),
            Parameter("dry_friction", "N.m", 0.0104, 0.0, 0.1, "dry friction; half of 1.2 A at no load (chosen)", 0.01),
            Parameter("drag", "N.m.s/rad", 1.8e-5, 0.0, 1e-3, "viscous losses; the other half at 10 V (chosen)", 1e-5),
            Parameter(
                "inertia",
                "kg.m.m",
                4e-4,
                1e-6,
                1e-2,
                "bell, hub with levers, blades (chosen: the paper's time constants)",
                1e-4,
            ),
        ),
        states=(
            State("shaft_speed", "rad/s", "speed of the shaft", speed, closed_by="shaft_speed_ahead"),
            State("motor_current", "A", "motor current", current, closed_by="current"),
            State("shaft_angle", "1", "turns since the start", 0.0, closed_by="angle"),
            State("shaft_acceleration", "rad/s/s", "acceleration at the end of a step", 0.0, closed_by="acceleration_ahead"),
        ),
    )
