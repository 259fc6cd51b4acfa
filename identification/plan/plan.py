"""Plan the next experiment: commands within a rig's ranges that are most informative about a model (A-optimal, see `search`).

The design is locally optimal, at the given values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.assessment.information import Forecast, Information
from identification.fit.problem import Prior
from identification.fit.refine import BASE_PARAMETERS
from identification.plan.excitation import FASTEST, STEP, paper_plan
from identification.plan.search import PlanSearch
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.types import Model
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig, rounded

EVALUATIONS, DRAWS = 1000, 9
"""Number of plans that are tried; number of plans of the paper's kind for comparison."""

DURATION, LENGTH = (10.0, 7200.0), 120.0
"""Allowed and default duration of an experiment, in time scales: 5 s to an hour, and a minute, for the paper's rig."""

STEPS = (1e-4, 0.1)
"""Time between commands: least in s, most in time scales."""

NOISE = 0.02
"""Default standard deviation of a thrust reading, as a share of the thrust scale: the paper's 0.3 N."""


def step_of(period: float | None, rig: Rig) -> float | None:
    """Time between commands [s] for readings `period` [s] apart: at most what STEPS allows for the rig; None: unknown."""
    return None if period is None else min(period, STEPS[1] * rig.scales.time_scale)


@dataclass(frozen=True, eq=False)
class Plan:
    """An experiment. `commands`: a record of time, omega_ref, beta_ref, every `step` s; `thrust` (rows,) N predicted by the
    model; `rig`: its ranges and slew rates limit the commands.

    Forecasts of standard errors: `before` the experiment (None: no prior), `after` it, and after a plan of the `paper` of the
    same length (median of DRAWS). `not_identifiable`: parameters that are held fixed, with the reason; `units`
    of all parameters by name.
    """

    commands: Record
    thrust: np.ndarray
    rig: Rig
    step: float
    noise_std: float
    seed: int
    before: Forecast | None
    after: Forecast
    paper: Forecast
    not_identifiable: Mapping[str, str]
    units: Mapping[str, str]

    @property
    def gain(self) -> float:
        """Standard deviation of the weakest direction with the paper's plan, over that with this plan."""
        return self.paper.weakest()[1] / self.after.weakest()[1]

    def summary(self) -> dict:
        """The content of `plan.json`."""
        forecasts = {"before": self.before, "after": self.after, "paper_plan": self.paper}
        return {
            "format": "vpp-plan/1",
            "seconds": float(self.commands.time[-1]),
            "step": self.step,
            "rig": self.rig.summary(),
            "noise_thrust": self.noise_std,
            "seed": self.seed,
            "gain_over_paper_plan": self.gain,
            **{name: forecast and _summary(forecast) for name, forecast in forecasts.items()},
            "not_identifiable": dict(self.not_identifiable),
        }


def free_parameters(model: Model) -> tuple[str, ...]:
    """Default parameters of a plan: nine of the base model, and those of effects except choices of a form."""
    effects = [e for e in model.effects if e.off is not None]
    return (*BASE_PARAMETERS, *(e.full(p.name) for e in effects for p in e.parameters if not p.choices))


def plan(
    model: Model,
    values: Mapping[str, float],
    rig: Rig,
    seconds: float | None = None,
    noise_std: float | None = None,
    knowledge: Prior | None = None,
    seed: int = 0,
    names: Sequence[str] | None = None,
    omega_std: float | None = None,
    evaluations: int = EVALUATIONS,
    step: float | None = None,
) -> Plan:
    """Plan `seconds` of commands for `model` at `values` (changes to its defaults); the same seed gives the same plan.

    Commands keep the ranges and slew rates of `rig`, and change on its time scale. `step` s: time between commands and between
    readings. `noise_std` N: white noise of a thrust reading; `omega_std` rpm: of a speed reading, None: speed is not measured.
    `knowledge`: prior from earlier data. `names`: parameters to estimate, default `free_parameters`. BadInput for invalid
    arguments, NotIdentifiable if no parameter is identifiable.
    """
    unit = rig.scales.time_scale
    seconds = rounded(LENGTH * max(unit, FASTEST)) if seconds is None else seconds
    noise_std = NOISE * rig.scales.thrust_scale if noise_std is None else noise_std
    step = rounded(max(STEP * unit, STEPS[0])) if step is None else step
    shortest, longest = (unit * end for end in DURATION)
    if not shortest <= seconds <= longest:
        raise BadInput("experiment", "seconds", f"{seconds:g} s", f"{shortest:g} to {longest:g} s")
    if not STEPS[0] <= step <= STEPS[1] * unit:
        allowed = f"{STEPS[0]:g} to {STEPS[1] * unit:g} s for a rig that takes {unit:g} s"
        raise BadInput("experiment", "step", f"{step:g} s", allowed, "--step S within it")
    for field, std in (("noise of thrust", noise_std), ("noise of speed", omega_std)):
        if std is not None and not 0.0 < std < np.inf:
            raise BadInput("experiment", field, f"{std:g}", "a number above 0")
    names = free_parameters(model) if names is None else tuple(names)
    information = Information(model, values, names, noise_std, step, omega_std)
    search = PlanSearch(information, rig, step, seconds, knowledge, np.random.default_rng(seed))
    search.assemble()
    unidentifiable = search.give_up()
    search.improve(evaluations)
    information, commands = search.information, search.commands()
    time = np.round(np.arange(len(commands)) * step, 9)
    return Plan(
        commands=Record({"time": time, "omega_ref": commands[:, 0], "beta_ref": commands[:, 1]}, "vpp plan"),
        thrust=information.thrust(commands, step),
        rig=rig,
        step=step,
        noise_std=noise_std,
        seed=seed,
        before=None if knowledge is None else information.forecast(search.known),
        after=information.forecast(search.known + information.of(commands, step)),
        paper=_paper(search, np.random.default_rng([seed, 1])),
        not_identifiable=unidentifiable,
        units={p.name: p.unit for p in model.parameters},
    )


def _paper(search: PlanSearch, rng: np.random.Generator) -> Forecast:
    """Forecast of the median of DRAWS plans of the paper's kind."""
    plans = [paper_plan(rng, len(search.targets), search.step, search.rig) for _ in range(DRAWS)]
    found = [search.information.forecast(search.of(each)) for each in plans]
    return sorted(found, key=lambda forecast: forecast.typical)[DRAWS // 2]


def _summary(forecast: Forecast) -> dict:
    direction, spread = forecast.weakest()
    rows = zip(forecast.names, forecast.values.tolist(), forecast.std.tolist(), forecast.intervals.tolist(), strict=True)
    return {
        "parameters": {name: {"value": value, "std": std, "interval": interval} for name, value, std, interval in rows},
        "rms_relative_std": forecast.typical,
        "weakest_direction": dict(zip(forecast.names, direction.tolist(), strict=True)) | {"relative_std": spread},
        "covariance": forecast.covariance.tolist(),
    }
