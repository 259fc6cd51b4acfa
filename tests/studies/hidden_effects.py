"""Hidden effects of the studies' rig: those of the contract's list, and others that are in no list.

Sizes are shares of the rig's own scales, times those of the paper's rig (`physics.in_time` converts them). Each effect has a
full size, about the largest in use, and a least size, about where it becomes negligible; a case draws between them. `kernel`
gives the true values of the project's parameters for a drawn size, in the project's units.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter

import numpy as np

from .rig import Size


@dataclass(frozen=True)
class Draw:
    """A source of sizes: `strength` from 0, the least, to 1, full size."""

    rng: np.random.Generator
    strength: float

    def size(self, least: float, full: float) -> float:
        """Interpolated by the strength, on a logarithmic scale."""
        return float(least ** (1.0 - self.strength) * full**self.strength)

    def signed(self, least: float, full: float) -> float:
        """As `size`, of either sign."""
        return float(self.rng.choice([-1.0, 1.0])) * self.size(least, full)

    def any(self, low: float, high: float) -> float:
        """A setting that does not depend on the strength: log-uniform."""
        return float(np.exp(self.rng.uniform(*np.log([low, high]))))

    def one(self, *of):
        """One of several forms."""
        return of[self.rng.integers(len(of))]


@dataclass(frozen=True)
class Hidden:
    """One effect. `draw(Draw)`: settings of the physics, or an external force (`rig.Rig.extra`) under "extra".

    `kernel(settings, size)`: true values of the project's parameters, by bare name; {} if no single number corresponds.
    `relatives`: names in the list of which it is another form or a special case; if its own name is missing there, naming one
    of them is correct.
    `special`: special cases, with settings of about the same size, from which their fits start. If the records cannot
    distinguish a special case from the effect, the name of the special case is correct.
    """

    name: str
    draw: Callable[[Draw], Mapping]
    kernel: Callable[[Mapping, Size], Mapping[str, float]] = lambda s, size: {}
    relatives: tuple[str, ...] = ()
    special: Mapping[str, Callable[[Mapping], Mapping[str, float]]] = field(default_factory=dict)


def _some(name, least, full):
    return lambda g: {name: g.size(least, full)}


def _either_lag(which, name, least, full, signed=False):
    """The effect acts in the first or the last of a channel's lags."""
    return lambda g: {name: (g.signed if signed else g.size)(least, full), which: g.one(0.0, 1.0)}


def _same(setting, parameter, unit=lambda size: 1.0):
    return lambda s, size: {parameter: unit(size) * s[setting]}


_deg, _rpm = attrgetter("span"), attrgetter("speed")


def _rpm_per_deg(size):
    return size.speed / size.span


def _rate(g):
    """A rate limit of the first lag, the last lag, or the command."""
    rate = g.size(1.6, 0.5)
    return g.one({"slew": rate}, {"rate": rate, "last_stage": 0.0}, {"rate": rate, "last_stage": 1.0})


def _map_term(g):
    name, least, full = g.one(("map_w", 0.02, 0.1), ("map_w2b2", 0.05, 0.25), ("map_wb3", 0.05, 0.25))
    return {name: g.signed(least, full)}


def _sag(g):
    """A sag of the speed that a loop can hold, or of the speed itself."""
    return g.one({"droop": g.size(0.02, 0.2)}, {"speed_max_w": g.rng.uniform(0.98, 1.05), "sag": g.size(0.07, 0.2)})


def _sag_parameters(s, size):
    if "droop" in s:
        return {"sag": _rpm_per_deg(size) * s["droop"]}
    return {"limit": size.speed * s["speed_max_w"], "sag": _rpm_per_deg(size) * s["sag"]}


def _fade(g):
    """A fade linear in time, towards an end, or with load."""
    form, there = g.one(0, 1, 2), {"fade": -g.size(0.015, 0.08)}
    if form == 0:
        return there
    return there | {"fade_time": g.any(15.0, 60.0), "fade_load": float(form == 2)}


def _fade_parameters(s, size):
    if "fade_time" not in s:
        return {"rate": s["fade"] / 100.0}
    return {"rate": s["fade"] / s["fade_time"], "time_constant": s["fade_time"]}


LISTED = (
    Hidden("pitch_command_deadband", _some("deadband", 0.015, 0.15), _same("deadband", "half_width", _deg)),
    Hidden("pitch_error_deadzone", _either_lag("last_stage", "deadzone", 0.008, 0.06), _same("deadzone", "half_width", _deg)),
    Hidden(
        "pitch_stop_band",
        _some("stop_band", 0.008, 0.05),
        _same("stop_band", "half_width", _deg),
        relatives=("pitch_stop_restart", "pitch_speed_limits"),
    ),
    Hidden(
        "pitch_stop_restart",
        lambda g: {"stop": g.any(0.005, 0.012), "restart": g.size(0.015, 0.08)},
        lambda s, size: {"stop": size.span * s["stop"], "restart": size.span * s["restart"]},
    ),
    Hidden(
        "pitch_speed_limits",
        lambda g: {"speed_min": g.any(0.1, 0.3), "speed_max": g.size(1.6, 0.6)},
        lambda s, size: {"slowest": size.span * s["speed_min"], "full": size.span * s["speed_max"]},
        relatives=("pitch_rate_limit",),
        special={"pitch_rate_limit": lambda s: {"rate": s["speed_max"]}},  # equivalent if no move is slow enough
    ),
    Hidden(
        "pitch_stall_latch",
        lambda g: {"stall_speed": g.size(0.05, 0.3), "stall_time": g.any(0.05, 0.2), "stall_band": 0.005},
        lambda s, size: {"speed": size.span * s["stall_speed"], "time": s["stall_time"]},
    ),
    Hidden("pitch_backlash", _some("backlash", 0.008, 0.06), _same("backlash", "half_gap", _deg)),
    Hidden(
        "pitch_rate_limit",
        _rate,
        lambda s, size: {"rate": size.span * s.get("rate", s.get("slew"))},
        relatives=("pitch_speed_limits",),
    ),
    Hidden("pitch_asymmetry", _either_lag("last_stage", "pitch_asym", 0.05, 0.4, True), _same("pitch_asym", "asymmetry")),
    Hidden(
        "pitch_travel_limit",
        _either_lag("travel_stop", "travel_max", 0.92, 0.65),
        lambda s, size: {"maximum": size.span * s["travel_max"] - size.offset},
    ),
    Hidden("pitch_delay", _some("pitch_delay", 0.01, 0.1), _same("pitch_delay", "delay")),
    Hidden("speed_delay", _some("speed_delay", 0.005, 0.06), _same("speed_delay", "delay")),
    Hidden(
        "speed_asymmetry",
        lambda g: {"speed_asym": -g.size(0.05, 0.5), "speed_last": g.one(0.0, 1.0)},
        _same("speed_asym", "asymmetry"),
    ),
    Hidden(
        "speed_overshoot",
        lambda g: {"hunt_hz": g.size(3.0, 1.5), "hunt_zeta": g.size(0.4, 0.15)},
        lambda s, size: {"inertia": 0.25 / s["hunt_zeta"] ** 2},
    ),
    Hidden(
        "speed_dependent_lag",
        _either_lag("speed_last", "damping", 0.15, 1.2),
        _same("damping", "sensitivity", lambda size: 1.0 / size.speed),
    ),
    Hidden(
        "speed_saturation", _some("speed_max_w", 0.96, 0.8), _same("speed_max_w", "maximum", _rpm), relatives=("supply_sag",)
    ),
    Hidden(
        "supply_sag",
        _sag,
        _sag_parameters,
        special={
            "speed_saturation": lambda s: {"speed_max_w": 0.9 * s.get("speed_max_w", 1.0)}
        },  # equivalent if it acts at one load only
    ),
    Hidden(
        "supply_voltage",
        lambda g: {"volt_share": g.size(0.1, 1.0), "discharge": g.any(0.05, 0.25)},
        _same("volt_share", "share"),
    ),
    Hidden(
        "pitch_speed_coupling", _either_lag("coupling_stiff", "coupling", 0.005, 0.1), _same("coupling", "gain", _rpm_per_deg)
    ),
    Hidden("thrust_gain_drift", _fade, _fade_parameters),
    Hidden(
        "inflow_lag",
        lambda g: {"inflow": g.size(0.1, 0.5), "inflow_time": g.any(0.08, 0.25)},
        lambda s, size: {"gain": s["inflow"], "time_constant": s["inflow_time"]},
    ),
    Hidden(
        "pitch_rate_feedthrough",
        _some("feedthrough", 0.005, 0.06),
        _same("feedthrough", "gain", lambda size: size.thrust / size.span),
    ),
    Hidden(
        "recirculation",
        lambda g: {"wash": g.size(0.015, 0.1), "wash_time": g.any(1.5, 4.0)},
        lambda s, size: {"share": s["wash"], "time_constant": s["wash_time"]},
    ),
    Hidden("map_terms", _map_term),
    Hidden("sensor_lag", _some("cell_time", 0.01, 0.08), _same("cell_time", "time_constant")),
    Hidden(
        "stand_resonance",
        lambda g: {"ring_hz": g.size(5.0, 1.5), "ring_zeta": g.any(0.03, 0.1)},
        lambda s, size: {"frequency": s["ring_hz"], "damping": s["ring_zeta"]},
    ),
    Hidden("rotor_vibration", _some("vibration", 0.008, 0.04), lambda s, size: {"amplitude": size.thrust * s["vibration"]}),
    # A drift without end: the project's parameter is its rate at the start.
    Hidden(
        "sensor_drift",
        lambda g: {"bias": g.signed(0.004, 0.03), "drift": g.signed(0.01, 0.05)},
        lambda s, size: {"offset": size.thrust * s["bias"], "rate": size.thrust * s["drift"] / 100.0},
    ),
    Hidden("reading_delay", _some("reading_delay", 0.008, 0.06), _same("reading_delay", "delay")),
    Hidden("speed_reading_delay", _some("speed_late", 0.008, 0.06), _same("speed_late", "delay")),
)


@dataclass(frozen=True)
class Gusts:
    """A gust after each large step of a command, the same whenever the commands are repeated."""

    amplitude: float
    seed: int

    def __call__(self, clock, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """(rows,) share of full thrust."""
        steps = (np.abs(np.diff(speed)) > 0.05) | (np.abs(np.diff(pitch)) > 0.07)
        sign = np.random.default_rng(self.seed).choice([-1.0, 1.0], len(speed))
        pulse = self.amplitude * 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, clock.rows(0.8))))
        kicks, late = np.zeros(len(speed)), clock.rows(0.25)
        kicks[late + 1 :] = (steps * sign[1:])[: len(speed) - late - 1]
        return np.convolve(kicks, pulse)[: len(speed)]


@dataclass(frozen=True)
class Tone:
    """A force of one frequency [Hz], its phase locked to the record's start."""

    amplitude: float
    frequency: float
    phase: float

    def __call__(self, clock, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """(rows,) share of full thrust."""
        return self.amplitude * np.sin(2.0 * np.pi * self.frequency * clock.row * np.arange(len(speed)) + self.phase)


def _tone(least, full, frequencies):
    return lambda g: {"extra": Tone(g.size(least, full), g.one(*frequencies), g.rng.uniform(0.0, 2.0 * np.pi))}


OUTSIDE = (
    Hidden("voltage_ceiling", lambda g: {"volt_gain": g.size(1.02, 0.95), "discharge": g.any(0.1, 0.25)}),
    # Stribeck friction of the linkage, against the actuator's pull: a dead zone that is narrower in motion.
    Hidden(
        "stick_slip", _some("friction", 0.02, 0.06), relatives=("pitch_error_deadzone", "pitch_stop_band", "pitch_stop_restart")
    ),
    # Thrust twists the blade back; at rest this is a change of the map.
    Hidden("blade_torsion", _some("torsion", 0.08, 0.25), relatives=("map_terms",)),
    Hidden("warming_actuator", _some("warm", 0.4, 1.2)),  # the pitch becomes slower within 40 s
    # The servo has whole steps of about 1 deg, counted from a normalised pitch of 0, not from 0 deg.
    Hidden("servo_steps", _some("pitch_step", 0.05, 0.1), relatives=("pitch_command_resolution",)),
    Hidden("one_sided_delay", lambda g: {"late_up": g.signed(0.05, 0.15)}),  # only steps up, or only steps down, are late
    Hidden("speed_ramp", _some("ramp", 2.0, 0.8)),  # the speed controller limits acceleration
    Hidden("stall_hysteresis", _some("stall", 0.06, 0.2)),  # thrust falls at high pitch and low speed, and recovers late
    # The load cell creeps with the logarithm of time: like several recirculations of the other sign.
    Hidden("cell_creep", _some("creep", 0.04, 0.12), relatives=("recirculation",)),
    Hidden("gusts", lambda g: {"extra": Gusts(g.size(0.013, 0.04), int(g.rng.integers(1 << 30)))}),
    Hidden("mains_hum", _tone(0.003, 0.01, (50.0, 100.0))),  # locked to the record's start
    Hidden("slow_swell", _tone(0.003, 0.008, (0.3, 0.5, 0.8))),  # ventilation, as above
)

UNLISTED = (
    Hidden("torque_limit", lambda g: {"torque": g.size(2.2, 0.9), "torque_load": g.any(0.3, 0.6)}),
    Hidden("coasting", _some("coast", 4.0, 1.5)),
    Hidden("loaded_servo", _some("servo_load", 0.5, 3.0)),
    Hidden("slow_untwist", lambda g: {"untwist": g.size(0.03, 0.12), "untwist_time": g.any(0.8, 3.0)}),
    Hidden("speed_surge", _some("surge", 0.008, 0.05)),
    Hidden("eccentric_wheel", lambda g: {"gear": g.size(0.006, 0.025), "gear_pitch": g.any(0.3, 0.6)}),
    Hidden("blocked_speed", _some("notch", 0.03, 0.12)),
    Hidden("sticking_mount", _some("friction_cell", 0.006, 0.03)),
    Hidden("soft_stop", _some("bend", 0.05, 0.25)),
    Hidden(
        "draining_battery", lambda g: {"drain": g.size(0.03, 0.12), "drain_time": g.any(2.0, 8.0)}, relatives=("supply_sag",)
    ),
    Hidden("coarse_controller", _some("esc_step", 0.012, 0.06)),
    Hidden("parting_flow", _some("parting", 0.04, 0.15)),
)
"""Further effects in no list, chosen before any learning existed, for the study of learned terms."""

HIDDEN = {h.name: h for h in (*LISTED, *OUTSIDE, *UNLISTED)}

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
"""Effects that are plausible on one rig."""
