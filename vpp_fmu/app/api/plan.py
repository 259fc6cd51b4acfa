"""Plan the next experiment: range, noise and time step from what is asked, known or measured."""

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from identification.assessment.prediction import predict
from identification.assessment.reading_noise import reading_noise
from identification.plan.plan import NOISE, step_of
from identification.plan.plan import plan as planned
from vpp_fmu.app.api.objects import PathLike, as_campaign, as_parameters, knowledge_of
from vpp_fmu.app.report.pages.plan import PlanResult
from vpp_fmu.app.report.result import Knowledge
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import ARGUMENT, BadInput
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.rig import RANGES, SLEWS, Rig, declared_rig

ASKED = "as asked"
"""Origin of a range or noise that the caller named."""

Span = tuple[float, float] | None


def plan(
    parameters: Any,
    knowledge: Any = None,
    campaign: PathLike | Campaign | None = None,
    rig: PathLike | Rig | None = None,
    seconds: float | None = None,
    omega: Span = None,
    pitch: Span = None,
    omega_slew: float | None = None,
    pitch_slew: float | None = None,
    step: float | None = None,
    noise: float | None = None,
    omega_noise: float | None = None,
    seed: int = 0,
    effects_from: Iterable[PathLike] = (),
    go_on: Callable[[str], bool] = lambda found: False,
) -> PlanResult:
    """Plan the next experiment: the most informative commands within the range and slew rates of the rig.

    `knowledge`: prior information (an identification.json, or a result); None: that of the parameters. `campaign`: range,
    sampling and noise are of this one; None: of the parameters' own. `rig`: a Rig, or a rig.json that goes before what was
    measured. `omega` rpm, `pitch` deg: ranges within the rig's; `omega_slew` rpm/s, `pitch_slew` deg/s. `seconds` of commands,
    `step` s between them and between readings, `noise` N, `omega_noise` rpm of one reading. `go_on`: asked if the thrust hardly
    changes over a named range. BadInput: a range is unknown, or an argument is invalid for this rig.

    >>> found = vpp.plan(vpp.identify(vpp.example_campaign(), starts=1), seconds=30)
    >>> found.commands
    Record(7501 rows, 30 s every 4 ms: time, omega_ref, beta_ref)
    """
    held = as_parameters(parameters, effects_from).without_power
    known = knowledge_of(parameters, held, knowledge)
    measured = None if campaign is None else as_campaign(campaign)
    wanted = held.rig if measured is None else replace(measured.rig, scales=held.rig.scales)  # scales are of the map
    if rig is not None:
        wanted = rig if isinstance(rig, Rig) else declared_rig(rig, wanted)
    wanted = _narrowed(wanted, {"omega": omega, "pitch": pitch}, {"omega_slew": omega_slew, "pitch_slew": pitch_slew})
    if wanted.unknown:
        where = parameters if isinstance(parameters, str | os.PathLike) else "parameters"
        hint = "--campaign DIR, --rig FILE, or --omega and --pitch"
        raise BadInput(where, f"range of {' and '.join(wanted.unknown)}", "none", "a measured or declared range", hint)
    std, origin = (noise, ASKED) if noise is not None else _noise(held, known, measured, knowledge is not None)
    if step is None:
        records = (measured.open_loop, measured.repeat, measured.validation) if measured else ()
        periods = [record.period for record in records if record is not None]
        step = step_of(periods[0] if periods else held.sample_period, wanted)
    if omega is not None or pitch is not None:
        _check_signal(held, wanted, std, "pitch" if omega is None else "omega", go_on)
    found = planned(held.model, held.values, wanted, seconds, std, known.prior, seed, omega_std=omega_noise, step=step)
    return PlanResult(found, held, known.inflation, f"noise of a thrust reading {std:.3g} N ({origin})")


def _narrowed(rig: Rig, ranges: dict[str, Span], slews: dict[str, float | None]) -> Rig:
    """The rig with the named ranges, which must lie within known ranges. BadInput."""
    changes: dict[str, Any] = {}
    origin = dict(rig.origin)
    for name, (argument, span) in zip(("speed", "pitch"), ranges.items(), strict=True):
        if span is None:
            continue
        known, unit = name not in rig.unknown, RANGES[name].unit
        low, high = getattr(rig, name) if known else (RANGES[name].minimum, RANGES[name].maximum)
        if not low <= span[0] <= span[1] <= high:
            where, wider = (f" ({origin[name]})", "--rig FILE, which declares a wider range") if known else ("", "")
            within = f"within {low:.6g} to {high:.6g} {unit}, the lower first{where}"
            raise BadInput(ARGUMENT, argument, f"{span[0]:g} to {span[1]:g} {unit}", within, wider)
        changes[name] = tuple(span)
        origin[name] = f"{ASKED}, within {low:.6g} to {high:.6g} of {origin[name]}" if known else ASKED
    for name, (argument, slew) in zip(("speed", "pitch"), slews.items(), strict=True):
        if slew is None:
            continue
        most, unit = getattr(rig, f"{name}_slew"), SLEWS[name]
        if not 0.0 < slew <= most:
            allowed = f"more than 0 and at most {most:g} {unit}" if np.isfinite(most) else f"more than 0 {unit}"
            raise BadInput(ARGUMENT, argument, f"{slew:g} {unit}", allowed)
        changes[f"{name}_slew"], origin[f"{name}_slew"] = slew, ASKED
    return replace(rig, **changes, origin=origin)


def _noise(held: ParameterSet, known: Knowledge, campaign: Campaign | None, named: bool) -> tuple[float, str]:
    """(standard deviation of a thrust reading [N], its source). `named`: the knowledge was; else a campaign goes before it."""
    if known.noise and known.noise[0] > 0.0 and (named or campaign is None):
        return known.noise
    if campaign is not None:
        records = [record for record in (campaign.open_loop, campaign.repeat) if record is not None]
        shown = [predict(held.model, held.values, record) for record in records]
        if found := reading_noise(shown, campaign.static, held.values):
            return found.std, found.source
    return NOISE * held.values["thrust_scale"], f"{NOISE:g} of the thrust scale, not measured"


def _check_signal(held: ParameterSet, rig: Rig, noise: float, argument: str, go_on: Callable[[str], bool]) -> None:
    """BadInput if the static thrust changes by less than one reading's noise over a range that was named: such an experiment
    has almost no information."""
    corners = [{**held.model.measured_inputs, "omega_ref": w, "beta_ref": b} for w in rig.speed for b in rig.pitch]
    thrust = [Simulation(held.model, held.values).start(inputs)["thrust"] for inputs in corners]
    change = max(thrust) - min(thrust)
    found = f"a range over which the thrust changes by {change:.2g} N, less than the {noise:.2g} N of noise of a reading"
    if change < noise and not go_on(f"--{argument}: {found}"):
        raise BadInput(ARGUMENT, argument, found, "a wider range", "--yes to go on")
