"""Every number of the paper, and every figure, each with its place (Grasev and Mendez, "Nonlinear System Identification of
Variable-Pitch Propellers Using a Wiener Model", 2026)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED

STATIC_MAP = {"c20": 0.21e-6, "c11": -5.7e-6, "c21": 0.023e-6, "c12": -1.25e-6, "c30": -2.15e-12}
"""Of the static map in rpm, deg and N (section 4.1)."""

R2_ADJUSTED = 0.996
COST_START, COST_END, ITERATIONS = 5.19e-4, 3.2e-4, 350
ASSUMED = {"tau_beta_2": 0.05}
"""What the paper's controllers were designed for: its fine-tuned model with a faster pitch actuator (section 4.2)."""

STEP_FROM, STEP_TO, STEP_AT, REACHED = 0.1, 0.8, 3.33, 0.5
"""The step test: normalised thrust, when it comes and how long the set-point takes to be reached, s (section 4.3)."""


@dataclass(frozen=True)
class Published:
    """A number or statement of the paper under a name of ours. `place`: section or figure; `value` in `unit`."""

    name: str
    what: str
    place: str
    value: float | str
    unit: str = ""


def _setup() -> Iterator[Published]:
    rows = (
        ("kv", "motor's speed per volt", 550.0, "rpm/V"),
        ("supply", "motor's supply", 24.0, "V"),
        ("actuator_supply", "pitch actuator's supply", 15.0, "V"),
        ("supplies", "power of the two supplies", "600 and 300", "W"),
        ("esc", "speed controller", 70.0, "A"),
        ("propeller", "blades", "cut from a 1045", ""),
        ("actuator", "pitch actuator", "P8-25-50-12-P", ""),
        ("load_cell", "load cell", 10.0, "kg"),
        ("capacitors", "capacitors against noise", "3 and 1 of 100 nF", ""),
        ("adc", "converter", 16.0, "bit"),
        ("largest_thrust", "largest thrust", 14.0, "N"),
        ("rpm_bits", "speed value sent by the Uno", "first 4 bits", ""),
        ("kp_rpm", "speed PI, proportional gain", 1e-4, ""),
        ("ki_rpm", "speed PI, integral gain", 2e-3, ""),
        ("kp_lac", "pitch PD, proportional gain", 10.0, ""),
        ("kd_lac", "pitch PD, derivative gain", 10.0, ""),
        ("speeds", "range of speed", "2000 to 6000", "rpm"),
        ("pitches", "range of pitch", "-10 to 10", "deg"),
        ("grid", "grid of the static map", "10 x 10", ""),
        ("settle", "time to settle at a point", 3.0, "s"),
        ("rate", "sampling rate", 250.0, "Hz"),
        ("samples", "readings a point", 5000.0, ""),
    )
    return (Published(name, what, "section 3.1", value, unit) for name, what, value, unit in rows)


def _models() -> Iterator[Published]:
    rows = (
        ("full_parameters", "parameters of the full model beside its maps", "section 2.1", 13.0),
        ("order", "order of the Wiener model", "section 2.2", 4.0),
        ("time_constants", "time constants to identify", "section 2.2", 4.0),
        ("fitted_parameters", "parameters of the fine-tuning", "section 3.2", 9.0),
    )
    return (Published(name, what, place, value) for name, what, place, value in rows)


def _protocol() -> Iterator[Published]:
    rows = (
        ("steps", "steps of each input from each state", "5 up, 5 down", ""),
        ("states", "initial steady states", 5.0, ""),
        ("speed_up", "speed steps up", "2000 to 2500 ... 6000", "rpm"),
        ("speed_down", "speed steps down", "6000 to 5500 ... 2000", "rpm"),
        ("pitch_up", "pitch steps up", "-10 to -6 ... 10", "deg"),
        ("pitch_down", "pitch steps down", "10 to 6 ... -10", "deg"),
        ("before", "recorded before a step", 5.0, "s"),
        ("after", "recorded after a step", 5.0, "s"),
        ("sections", "parts of the open loop", "speed, pitch, both", ""),
    )
    return (Published(name, what, "section 3.2", value, unit) for name, what, value, unit in rows)


def _static() -> Iterator[Published]:
    units = {"c20": "N/rpm²", "c11": "N/(rpm deg)", "c21": "N/(rpm² deg)", "c12": "N/(rpm deg²)", "c30": "N/rpm³"}
    yield Published("region", "operating region of the pitch", "section 4.1", "-5 to 10", "deg")
    yield Published("r2_adjusted", "adjusted R² of the static map", "section 4.1, figure 4a", R2_ADJUSTED)
    yield Published("ct_speed", "what speed does to C_T", "section 4.1, figure 4b", "minor")
    for name, value in STATIC_MAP.items():
        yield Published(f"static.{name}", f"static map, {name}", "section 4.1", value, units[name])


def _dynamic() -> Iterator[Published]:
    place = "section 4.2"
    for name in ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2"):
        yield Published(f"averaged.{name}", f"averaged {name}", f"{place}, figures 5, 6", AVERAGED[name], "s")
    yield Published("excluded", "steps that are left out", f"{place}, figures 5, 6", "small, noisy ones")
    yield Published("overshoots", "pitch steps that overshoot", f"{place}, figure 6", "evident at 6000 rpm")
    yield Published("omega_scale", "normalised by: speed", place, 6000.0, "rpm")
    yield Published("beta_offset", "normalised by: pitch, offset", place, 5.0, "deg")
    yield Published("beta_scale", "normalised by: pitch", place, 15.0, "deg")
    yield Published("thrust_scale", "normalised by: thrust", place, 15.0, "N")
    for name, value in FINE_TUNED.items():
        unit = "s" if name.startswith("tau_") else ""
        yield Published(f"fine_tuned.{name}", f"fine-tuned {name}", place, value, unit)
    yield Published("iterations", "iterations of the fine-tuning", f"{place}, figure 7", float(ITERATIONS))
    yield Published("cost_start", "cost before", f"{place}, figure 7", COST_START)
    yield Published("cost_end", "cost after", f"{place}, figure 7", COST_END)
    yield Published("cost_fall", "fall of the cost", f"{place}, figure 7", 38.3, "%")
    yield Published("improved", "where fine-tuning improves most", f"{place}, figure 8", "pitch only, both")
    yield Published("assumed", "tau_beta_2 assumed for the control design", place, ASSUMED["tau_beta_2"], "s")


def _control() -> Iterator[Published]:
    place = "section 4.3"
    yield Published("t_filter", "derivative filter", "section 3.3", 0.02, "s")
    yield Published("step_from", "step test, from", f"{place}, figure 9", STEP_FROM)
    yield Published("step_to", "step test, to", f"{place}, figure 9", STEP_TO)
    yield Published("step_at", "step test, time of the step", f"{place}, figure 9", STEP_AT, "s")
    yield Published("reached", "set-point reached after", f"{place}, figure 9", REACHED, "s")
    yield Published("overshoot", "overshoot, both actuators", f"{place}, figure 9", 0.0, "%")
    yield Published("up", "step up, both actuators against speed alone", f"{place}, figure 10", "superior")
    yield Published("down", "step down, both actuators against speed alone", f"{place}, figure 10", "superior, especially")
    yield Published("beta_fixed", "pitch of the speed-only controller", f"{place}, figure 10", SPEED_ONLY["beta_fixed"], "deg")
    for prefix, text, gains in (("dual", "both actuators", DUAL), ("speed_only", "speed alone", SPEED_ONLY)):
        for name, value in gains.items():
            if name[:2] in ("kp", "ki", "kd"):
                yield Published(f"{prefix}.{name}", f"{name}, {text}", place, value)


NUMBERS: Mapping[str, Published] = {
    p.name: p for part in (_models, _setup, _protocol, _static, _dynamic, _control) for p in part()
}
"""By name, in the paper's order."""

FIGURES = {
    "1a": "photo of the stand",
    "1b": "CAD model of the pitch mechanism",
    "2": "block diagram of the speed and pitch loops",
    "3": "block diagram of the thrust loop",
    "4a": "static thrust map",
    "4b": "thrust coefficient",
    "5": "speed steps",
    "6": "pitch steps",
    "7": "learning curve of the fine-tuning",
    "8a": "fine-tuned model, speed in action",
    "8b": "fine-tuned model, pitch in action",
    "8c": "fine-tuned model, both in action",
    "9": "step test of both actuators: thrust, pitch, speed",
    "10": "both actuators against speed alone: thrust, pitch, speed",
}
"""What each figure of the paper shows, by its number."""
