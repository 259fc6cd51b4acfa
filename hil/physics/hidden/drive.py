"""Hidden effects between supply and shaft."""

from math import pi

from vpp_fmu.kernel.types import Effect, Parameter, State

LEAST_VOLTS = 1.0
RATED = 20.0  # A; about the current at full thrust


def _droop(ops, s, x, p, dt):
    charge = x.charge + x.drawn * dt
    volts = ops.maximum(s.supply - p.discharge * charge, LEAST_VOLTS)
    return {"supply": volts, "supply_resistance": s.supply_resistance + p.resistance}, {"charge": charge}


SUPPLY_DROOP = Effect(
    "supply_droop",
    "the supply gives way under load, and a battery runs down",
    _droop,
    parameters=(
        Parameter("resistance", "Ohm", 0.0, 0.0, 1.0, "resistance of supply and cables", 0.1),
        Parameter("discharge", "V/A/s", 0.0, 0.0, 0.1, "voltage lost per charge drawn", 0.001),
    ),
    states=(
        State("charge", "A.s", "charge drawn since the start", 0.0),
        State("drawn", "A", "current drawn from the supply", 0.0, closed_by="supply_current"),
    ),
    off={"resistance": 0.0, "discharge": 0.0},
    probe={"resistance": 0.2, "discharge": 0.002},
)


def _heat(ops, s, x, p, dt):
    load = s.motor_current / RATED
    signals = {
        "motor_strength": s.motor_strength * (1.0 - p.flux_loss * x.heat),
        "winding_resistance": s.winding_resistance * (1.0 + p.resistance_rise * x.heat),
    }
    return signals, {"heat": ops.lag(x.heat, load * load, p.time_constant, dt)}


MOTOR_HEATING = Effect(
    "motor_heating",
    "magnets weaken and windings gain resistance as the motor warms up",
    _heat,
    parameters=(
        Parameter("flux_loss", "1", 0.0, 0.0, 0.3, "share of k_Q and k_i lost when warm at 20 A", 0.1),
        Parameter("resistance_rise", "1", 0.0, 0.0, 1.0, "share that the winding's resistance gains when warm at 20 A"),
        Parameter("time_constant", "s", 60.0, 5.0, 1000.0, "time constant of warming up", 100.0),
    ),
    states=(State("heat", "1", "warmth over that at 20 A; cold at the start", 0.0),),
    off={"flux_loss": 0.0, "resistance_rise": 0.0},
    probe={"flux_loss": 0.08, "resistance_rise": 0.3, "time_constant": 20.0},
)


def _wobble(ops, s, x, p, dt):
    phase = x.phase + p.frequency * dt
    middle = 2.0 * pi * (x.phase + 0.5 * p.frequency * dt)
    return {"throttle": s.throttle + p.amplitude * ops.sin(middle)}, {"phase": ops.where(phase > 1.0, phase - 1.0, phase)}


SPEED_HUNTING = Effect(
    "speed_hunting",
    "the ESC hunts: its output swings slowly",
    _wobble,
    parameters=(
        Parameter("amplitude", "1", 0.0, 0.0, 0.1, "amplitude, as throttle", 0.01),
        Parameter("frequency", "Hz", 1.5, 0.05, 20.0, "frequency"),
    ),
    states=(State("phase", "1", "turns of the swing", 0.0),),
    off={"amplitude": 0.0},
    probe={"amplitude": 0.01},
)


def _coast(ops, s, x, p, dt):
    return {"esc_brakes": 1.0 - p.freewheel}, {}


ESC_FREEWHEEL = Effect(
    "esc_freewheel",
    "the ESC does not brake: a motor faster than its voltage coasts",
    _coast,
    parameters=(Parameter("freewheel", "1", 0.0, 0.0, 1.0, "1: current never flows back", choices=(0.0, 1.0)),),
    off={"freewheel": 0.0},
    probe={"freewheel": 1.0},
)
