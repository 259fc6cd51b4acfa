"""What can be hidden in the studies' rig: effects of the contract's list, and others that are in no list.

Sizes are drawn from what was tried on a rig, in normalised units. `kernel` says which parameters of the project's effect the
drawn size should come out as, in the project's units: pitch is 15 deg, speed 6000 rpm, thrust 15 N where it is 1 here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from .physics import ROW

DEG, RPM, NEWTON = 15.0, 6000.0, 15.0


@dataclass(frozen=True)
class Hidden:
    """One effect. `draw(rng)`: settings of the physics, or a force from outside `(w_ref, b_ref) -> N` under "extra".

    `kernel(settings)`: true values of the project's parameters, by bare name; {}: no one number corresponds.
    `relatives`: names in the list of which it is another form or a special case; without its own name there, naming one of
    them is no mistake.
    `special`: of relatives, their settings for the same sizes: where these can't be told from the effect, their name is right.
    """

    name: str
    draw: Callable[[np.random.Generator], Mapping]
    kernel: Callable[[Mapping], Mapping[str, float]] = lambda s: {}
    relatives: tuple[str, ...] = ()
    special: Mapping[str, Callable[[Mapping], Mapping[str, float]]] = field(default_factory=dict)


def size(rng, low, high):
    """Log-uniform: small ones as often as large ones."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def signed(rng, low, high):
    """As `size`, of either sign."""
    return float(rng.choice([-1.0, 1.0])) * size(rng, low, high)


def _some(name, low, high, draw=size):
    return lambda rng: {name: draw(rng, low, high)}


def _either_lag(which, name, low, high, draw=size):
    """In the first or the last of a channel's lags."""
    return lambda rng: {name: draw(rng, low, high), which: float(rng.random() < 0.5)}


def _same(setting, parameter, unit=1.0):
    return lambda s: {parameter: unit * s[setting]}


def _rate(rng):
    """Of the first lag, the last lag, or the command."""
    if rng.random() < 1.0 / 3.0:
        return {"slew": size(rng, 0.5, 1.2)}
    return {"rate": size(rng, 0.5, 1.2), "last_stage": float(rng.random() < 0.5)}


def _map_term(rng):
    name, low, high = [("map_w", 0.04, 0.1), ("map_w2b2", 0.1, 0.25), ("map_wb3", 0.1, 0.25)][rng.integers(3)]
    return {name: signed(rng, low, high)}


def _sag(rng):
    """Of the speed that a loop can hold, or of speed itself."""
    if rng.random() < 0.5:
        return {"droop": size(rng, 0.05, 0.2)}
    return {"speed_max_w": rng.uniform(0.98, 1.05), "sag": size(rng, 0.1, 0.2)}


def _sag_parameters(s):
    if "droop" in s:
        return {"sag": RPM / DEG * s["droop"]}
    return {"limit": RPM * s["speed_max_w"], "sag": RPM / DEG * s["sag"]}


def _voltage(rng):
    return {"volt_share": rng.uniform(0.2, 1.0), "discharge": size(rng, 0.05, 0.25)}


def _fade(rng):
    """In a line with time, towards an end, or with load."""
    form, there = rng.integers(3), {"fade": -size(rng, 0.03, 0.08)}
    if form == 0:
        return there
    return there | {"fade_time": size(rng, 15.0, 60.0), "fade_load": float(form == 2)}


def _drift(rng):
    return {"bias": signed(rng, 0.01, 0.03), "drift": signed(rng, 0.02, 0.05)}


LISTED = (
    Hidden("pitch_command_deadband", _some("deadband", 0.03, 0.15), _same("deadband", "half_width", DEG)),
    Hidden("pitch_error_deadzone", _either_lag("last_stage", "deadzone", 0.015, 0.06), _same("deadzone", "half_width", DEG)),
    Hidden(
        "pitch_stop_band",
        _some("stop_band", 0.015, 0.05),
        _same("stop_band", "half_width", DEG),
        relatives=("pitch_stop_restart", "pitch_speed_limits"),
    ),
    Hidden(
        "pitch_stop_restart",
        lambda g: {"stop": size(g, 0.005, 0.015), "restart": size(g, 0.03, 0.08)},
        lambda s: {"stop": DEG * s["stop"], "restart": DEG * s["restart"]},
    ),
    Hidden(
        "pitch_speed_limits",
        lambda g: {"speed_min": size(g, 0.1, 0.3), "speed_max": size(g, 0.6, 1.5)},
        lambda s: {"slowest": DEG * s["speed_min"], "full": DEG * s["speed_max"]},
        relatives=("pitch_rate_limit",),
        special={"pitch_rate_limit": lambda s: {"rate": s["speed_max"]}},  # all of it where nothing moves slowly enough
    ),
    Hidden(
        "pitch_stall_latch",
        lambda g: {"stall_speed": size(g, 0.1, 0.3), "stall_time": size(g, 0.05, 0.2), "stall_band": 0.005},
        lambda s: {"speed": DEG * s["stall_speed"], "time": s["stall_time"]},
    ),
    Hidden("pitch_backlash", _some("backlash", 0.015, 0.06), _same("backlash", "half_gap", DEG)),
    Hidden(
        "pitch_rate_limit", _rate, lambda s: {"rate": DEG * s.get("rate", s.get("slew"))}, relatives=("pitch_speed_limits",)
    ),
    Hidden("pitch_asymmetry", _either_lag("last_stage", "pitch_asym", 0.1, 0.4, signed), _same("pitch_asym", "asymmetry")),
    Hidden(
        "pitch_travel_limit",
        _either_lag("travel_stop", "travel_max", 0.65, 0.88),
        lambda s: {"maximum": DEG * s["travel_max"] - 5.0},
    ),
    Hidden("pitch_delay", _some("pitch_delay", 0.01, 0.1), _same("pitch_delay", "delay")),
    Hidden("speed_delay", _some("speed_delay", 0.01, 0.06), _same("speed_delay", "delay")),
    Hidden(
        "speed_asymmetry",
        _either_lag("speed_last", "speed_asym", -0.5, -0.1, lambda g, a, b: -size(g, -b, -a)),
        _same("speed_asym", "asymmetry"),
    ),
    Hidden("speed_dependent_lag", _either_lag("speed_last", "damping", 0.3, 1.2), _same("damping", "sensitivity", 1.0 / RPM)),
    Hidden(
        "speed_saturation", _some("speed_max_w", 0.8, 0.95), _same("speed_max_w", "maximum", RPM), relatives=("supply_sag",)
    ),
    Hidden("supply_sag", _sag, _sag_parameters),
    Hidden("supply_voltage", _voltage, _same("volt_share", "share")),
    Hidden("pitch_speed_coupling", _either_lag("coupling_stiff", "coupling", 0.01, 0.1), _same("coupling", "gain", RPM / DEG)),
    Hidden("thrust_gain_drift", _fade),
    Hidden(
        "inflow_lag",
        lambda g: {"inflow": size(g, 0.2, 0.5), "inflow_time": size(g, 0.08, 0.25)},
        lambda s: {"gain": s["inflow"], "time_constant": s["inflow_time"]},
    ),
    Hidden("pitch_rate_feedthrough", _some("feedthrough", 0.01, 0.06), _same("feedthrough", "gain", NEWTON / DEG)),
    Hidden(
        "recirculation",
        lambda g: {"wash": size(g, 0.03, 0.1), "wash_time": size(g, 1.5, 4.0)},
        lambda s: {"share": s["wash"], "time_constant": s["wash_time"]},
    ),
    Hidden("map_terms", _map_term),
    Hidden("sensor_lag", _some("cell_time", 0.02, 0.08), _same("cell_time", "time_constant")),
    Hidden(
        "stand_resonance",
        lambda g: {"ring_hz": size(g, 1.5, 4.0), "ring_zeta": size(g, 0.03, 0.1)},
        lambda s: {"frequency": s["ring_hz"], "damping": s["ring_zeta"]},
    ),
    # A drift without end: the project's parameter is its rate at the start.
    Hidden("sensor_drift", _drift, lambda s: {"offset": NEWTON * s["bias"], "rate": NEWTON * s["drift"] / 100.0}),
)


def _gusts(rng):
    """After each large step of a command, a puff of wind, the same each time the commands are given."""
    amplitude, seed = size(rng, 0.2, 0.6), int(rng.integers(1 << 30))

    def force(speed, pitch):
        steps = (np.abs(np.diff(speed)) > 300.0) | (np.abs(np.diff(pitch)) > 1.0)
        sign = np.random.default_rng(seed).choice([-1.0, 1.0], len(speed))
        pulse = amplitude * 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, round(0.8 / ROW))))
        kicks = np.zeros(len(speed))
        kicks[1:] = steps * sign[1:]
        return np.convolve(np.roll(kicks, round(0.25 / ROW)), pulse)[: len(speed)]

    return {"extra": force}


def _tone(low, high, frequencies):
    def draw(rng):
        amplitude, frequency, phase = size(rng, low, high), rng.choice(frequencies), rng.uniform(0.0, 2.0 * np.pi)
        return {"extra": lambda speed, _: amplitude * np.sin(2.0 * np.pi * frequency * ROW * np.arange(len(speed)) + phase)}

    return draw


OUTSIDE = (
    Hidden("voltage_ceiling", lambda g: {"volt_gain": g.uniform(0.95, 1.02), "discharge": size(g, 0.1, 0.25)}),
    # Stribeck friction of the linkage, against the actuator's pull: a dead-zone whose width falls once it moves.
    Hidden(
        "stick_slip",
        _some("friction", 0.02, 0.06),
        relatives=("pitch_error_deadzone", "pitch_stop_band", "pitch_stop_restart"),
    ),
    # Thrust turns the blade back: in rest a bend of the map.
    Hidden("blade_torsion", _some("torsion", 0.08, 0.25), relatives=("map_terms",)),
    Hidden("warming_actuator", _some("warm", 0.4, 1.2)),  # pitch grows slower within 40 s
    Hidden("servo_steps", _some("pitch_step", 0.05, 0.1)),  # the servo knows whole steps of about 1 deg only
    Hidden("speed_hunting", lambda g: {"hunt_hz": size(g, 1.5, 3.0), "hunt_zeta": size(g, 0.15, 0.4)}),
    Hidden("one_sided_delay", _some("late_up", 0.05, 0.15, signed)),  # only steps up, or only steps down, are late
    Hidden("speed_ramp", _some("ramp", 0.8, 2.0)),  # the speed controller limits acceleration
    Hidden("stall_hysteresis", _some("stall", 0.06, 0.2)),  # thrust falls at high pitch and low speed, and comes back late
    # The load cell creeps with the logarithm of time: several recirculations of the other sign.
    Hidden("cell_creep", _some("creep", 0.04, 0.12), relatives=("recirculation",)),
    Hidden("gusts", _gusts),
    Hidden("mains_hum", _tone(0.05, 0.15, [50.0, 100.0])),  # locked to the record's start
    Hidden("slow_swell", _tone(0.05, 0.12, [0.3, 0.5, 0.8])),  # ventilation, as above
)

HIDDEN = {h.name: h for h in (*LISTED, *OUTSIDE)}

PAIRS = (
    ("pitch_command_deadband", "pitch_speed_coupling"),
    ("pitch_delay", "sensor_drift"),
    ("pitch_command_deadband", "stand_resonance"),
    ("pitch_speed_coupling", "sensor_drift"),
    ("pitch_backlash", "speed_asymmetry"),
    ("pitch_rate_limit", "recirculation"),
    ("pitch_error_deadzone", "speed_saturation"),
    ("pitch_asymmetry", "map_terms"),
    ("pitch_travel_limit", "speed_delay"),
    ("speed_dependent_lag", "thrust_gain_drift"),
    ("pitch_delay", "supply_sag"),
    ("pitch_backlash", "sensor_lag"),
)
"""Effects that may well be on one rig."""

_SMALL_PITCH = "deadband deadzone stop_band backlash pitch_asym pitch_delay"
_SMALL_SPEED = "speed_delay speed_asym damping coupling"
_SMALL_THRUST = "fade inflow feedthrough wash map_w map_w2b2 map_wb3 cell_time bias drift"
SIZES = frozenset(" ".join([_SMALL_PITCH, _SMALL_SPEED, _SMALL_THRUST]).split())
"""Settings in which an effect grows from nothing."""

SCALABLE = tuple(h.name for h in LISTED if SIZES & set(h.draw(np.random.default_rng(0))))
"""Effects whose size can be made as small as one likes."""
