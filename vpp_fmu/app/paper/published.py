"""Every number and every figure of the paper, with its place (Grasev and Mendez, "Nonlinear System Identification of
Variable-Pitch Propellers Using a Wiener Model", 2026)."""

from dataclasses import dataclass

from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED

STATIC_MAP = {"c20": 0.21e-6, "c11": -5.7e-6, "c21": 0.023e-6, "c12": -1.25e-6, "c30": -2.15e-12}
"""Coefficients of the static map in rpm, deg and N (section 4.1)."""

UNITS = {"c20": "N/rpm²", "c11": "N/(rpm deg)", "c21": "N/(rpm² deg)", "c12": "N/(rpm deg²)", "c30": "N/rpm³"}
"""Units of these coefficients."""

R2_ADJUSTED = 0.996
COST_START, COST_END, ITERATIONS = 5.19e-4, 3.2e-4, 350
ASSUMED = {"tau_beta_2": 0.05}
"""The paper's controllers were designed for its fine-tuned model with this faster pitch actuator (section 4.2)."""

STEP_FROM, STEP_TO, STEP_AT, REACHED = 0.1, 0.8, 3.33, 0.5
"""The step test: normalised thrust, time of the step [s] and time until the set-point is reached [s] (section 4.3)."""


@dataclass(frozen=True)
class Row:
    """A number or statement of the paper, `value` in `unit`, and ours in the same unit.

    `place`: section or figure. `rig`: ours on the emulated rig, with its standard deviation `std` if it is an estimate;
    `model`: ours on the paper's model; None: there is none. `why` they differ from the paper's, or why there is none.
    """

    name: str
    what: str
    place: str
    value: float | str
    unit: str = ""
    rig: float | str | None = None
    model: float | str | None = None
    why: str = ""
    std: float | None = None

    def cells(self) -> tuple:
        """Cells of a table with COLUMNS."""
        what = f"{self.what} [{self.unit}]" if self.unit else self.what
        place = self.place.replace("section ", "§ ").replace("figures", "fig.").replace("figure", "fig.")
        rig = shown(self.rig) if self.std is None else f"{shown(self.rig)} ± {self.std:.1g}"
        return what, place, shown(self.value), rig, shown(self.model), self.why


COLUMNS = ("what", "place", "paper", "ours, rig", "ours, paper's model", "why they differ")


def shown(value: float | str | None) -> str | None:
    """A value as a cell: exact numbers stay short, others get four digits."""
    return value if value is None or isinstance(value, str) else f"{value:.4g}"


LAGS = {"omega": ("tau_omega_1", "tau_omega_2"), "beta": ("tau_beta_2", "tau_beta_1")}
"""The paper's names of the slower and of the faster lag, by channel."""

_LAGS = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2")

_ROWS = (
    ("full_parameters", "parameters of the full model beside its maps", "section 2.1", 13.0),
    ("order", "order of the Wiener model", "section 2.2", 4.0),
    ("time_constants", "time constants to identify", "section 2.2", 4.0),
    ("fitted_parameters", "parameters of the fine-tuning", "section 3.2", 9.0),
    ("kv", "motor's speed per volt", "section 3.1", 550.0, "rpm/V"),
    ("supply", "motor's supply", "section 3.1", 24.0, "V"),
    ("actuator_supply", "pitch actuator's supply", "section 3.1", 15.0, "V"),
    ("supplies", "power of the two supplies", "section 3.1", "600 and 300", "W"),
    ("esc", "speed controller", "section 3.1", 70.0, "A"),
    ("propeller", "blades", "section 3.1", "cut from a 1045"),
    ("actuator", "pitch actuator", "section 3.1", "P8-25-50-12-P"),
    ("load_cell", "load cell", "section 3.1", 10.0, "kg"),
    ("capacitors", "capacitors against noise", "section 3.1", "3 and 1 of 100 nF"),
    ("adc", "converter", "section 3.1", 16.0, "bit"),
    ("largest_thrust", "largest thrust", "section 3.1", 14.0, "N"),
    ("rpm_bits", "speed value sent by the Uno", "section 3.1", "first 4 bits"),
    ("kp_rpm", "speed PI, proportional gain", "section 3.1", 1e-4),
    ("ki_rpm", "speed PI, integral gain", "section 3.1", 2e-3),
    ("kp_lac", "pitch PD, proportional gain", "section 3.1", 10.0),
    ("kd_lac", "pitch PD, derivative gain", "section 3.1", 10.0),
    ("speeds", "range of speed", "section 3.1", "2000 to 6000", "rpm"),
    ("pitches", "range of pitch", "section 3.1", "-10 to 10", "deg"),
    ("grid", "grid of the static map", "section 3.1", "10 x 10"),
    ("settle", "time to settle at a point", "section 3.1", 3.0, "s"),
    ("rate", "sampling rate", "section 3.1", 250.0, "Hz"),
    ("samples", "readings a point", "section 3.1", 5000.0),
    ("steps", "steps of each input from each state", "section 3.2", "5 up, 5 down"),
    ("states", "initial steady states", "section 3.2", 5.0),
    ("speed_up", "speed steps up", "section 3.2", "2000 to 2500 ... 6000", "rpm"),
    ("speed_down", "speed steps down", "section 3.2", "6000 to 5500 ... 2000", "rpm"),
    ("pitch_up", "pitch steps up", "section 3.2", "-10 to -6 ... 10", "deg"),
    ("pitch_down", "pitch steps down", "section 3.2", "10 to 6 ... -10", "deg"),
    ("before", "recorded before a step", "section 3.2", 5.0, "s"),
    ("after", "recorded after a step", "section 3.2", 5.0, "s"),
    ("sections", "parts of the open loop", "section 3.2", "speed, pitch, both"),
    ("region", "operating region of the pitch", "section 4.1", "-5 to 10", "deg"),
    ("r2_adjusted", "adjusted R² of the static map", "section 4.1, figure 4a", R2_ADJUSTED),
    ("ct_speed", "what speed does to C_T", "section 4.1, figure 4b", "minor"),
    *((f"static.{name}", f"static map, {name}", "section 4.1", c, UNITS[name]) for name, c in STATIC_MAP.items()),
    *((f"averaged.{lag}", f"averaged {lag}", "section 4.2, figures 5, 6", AVERAGED[lag], "s") for lag in _LAGS),
    ("excluded", "steps that are left out", "section 4.2, figures 5, 6", "small, noisy ones"),
    ("overshoots", "pitch steps that overshoot", "section 4.2, figure 6", "evident at 6000 rpm"),
    ("omega_scale", "normalised by: speed", "section 4.2", 6000.0, "rpm"),
    ("beta_offset", "normalised by: pitch, offset", "section 4.2", 5.0, "deg"),
    ("beta_scale", "normalised by: pitch", "section 4.2", 15.0, "deg"),
    ("thrust_scale", "normalised by: thrust", "section 4.2", 15.0, "N"),
    *((f"fine_tuned.{n}", f"fine-tuned {n}", "section 4.2", v, "s" if n in _LAGS else "") for n, v in FINE_TUNED.items()),
    ("iterations", "iterations of the fine-tuning", "section 4.2, figure 7", float(ITERATIONS)),
    ("cost_start", "cost before", "section 4.2, figure 7", COST_START),
    ("cost_end", "cost after", "section 4.2, figure 7", COST_END),
    ("cost_fall", "reduction of the cost", "section 4.2, figure 7", 38.3, "%"),
    ("improved", "where fine-tuning improves most", "section 4.2, figure 8", "pitch only, both"),
    ("assumed", "tau_beta_2 assumed for the control design", "section 4.2", ASSUMED["tau_beta_2"], "s"),
    ("t_filter", "derivative filter", "section 3.3", 0.02, "s"),
    ("step_from", "step test, from", "section 4.3, figure 9", STEP_FROM),
    ("step_to", "step test, to", "section 4.3, figure 9", STEP_TO),
    ("step_at", "step test, time of the step", "section 4.3, figure 9", STEP_AT, "s"),
    ("reached", "set-point reached after", "section 4.3, figure 9", REACHED, "s"),
    ("overshoot", "overshoot, both actuators", "section 4.3, figure 9", 0.0, "%"),
    ("up", "step up, both actuators against speed alone", "section 4.3, figure 10", "superior"),
    ("down", "step down, both actuators against speed alone", "section 4.3, figure 10", "superior, especially"),
    ("beta_fixed", "pitch of the speed-only controller", "section 4.3, figure 10", SPEED_ONLY["beta_fixed"], "deg"),
    *(
        (f"{prefix}.{name}", f"{name}, {text}", "section 4.3", value)
        for prefix, text, gains in (("dual", "both actuators", DUAL), ("speed_only", "speed alone", SPEED_ONLY))
        for name, value in gains.items()
        if name[:2] in ("kp", "ki", "kd")
    ),
)

NUMBERS = {row[0]: Row(*row) for row in _ROWS}
"""Rows by name, in the paper's order."""

KEY = (
    "r2_adjusted",
    *(f"{kind}.{lag}" for kind in ("averaged", "fine_tuned") for lag in _LAGS),
    *("overshoots", "cost_fall", "improved", "reached", "overshoot", "up", "down"),
)
"""The most important numbers."""

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
"""Content of each figure of the paper, by its number."""
