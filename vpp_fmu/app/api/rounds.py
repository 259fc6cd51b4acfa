"""The rounds of a rig's day (`vpp twin`): run, diagnose, tune, and compare on the rig."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.loop.rig import RunEnded
from hil.loop.session import Setup
from hil.run import Run, profile_start
from hil.twin.band import Band
from hil.twin.twin import Twin, twin_of
from identification.assessment.prediction import predict
from identification.diagnose.diagnose import diagnose
from identification.tune.profile import common_reach, rig_profile
from vpp_fmu.app.api.control import tune
from vpp_fmu.app.day import PRESENT, Day, Round, best_of, costs_of, fly, mission, repeated
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

POLICIES = FIXED, MODEL_BASED = "fixed", "model-based"

TIMES = 4
"""Repetitions of the profile. The cost scatters by 2 % between them; the best and fair gains differ by as much."""

Rig = Callable[[int, int, str], Setup]
"""Access to the rig: for a round, a flight of it, and what it is, waits for the operator's consent, and returns the set-up."""


def new_day(parameters: ParameterSet, settings: Mapping[str, float]) -> Day:
    """A day that begins with this model and this controller."""
    return Day(parameters, dict(settings), rig_profile(parameters, {"dual": settings}))


def next_round(
    day: Day, rig: Rig, band: Band, policy: str, folder: Path, seed: int, workers: int, stage: Callable[[str], None]
) -> Round:
    """Fly one round; its logs go to `folder`. BadInput; RunEnded for a flight that ended early, after which none begins."""
    number, settings, model, flown = len(day.rounds) + 1, day.settings, day.parameters, 0
    here = f"round {number}"
    hidden: tuple[str, ...] = ()

    def flight(what: str, own: Mapping[str, float], profile: Record, twin: Twin | None = None) -> Run:
        nonlocal flown, hidden
        flown += 1
        setup = rig(number, flown, f"{here}: {what}")
        hidden = setup.emulated.hidden if setup.emulated else ()
        try:
            return fly(setup, own, profile, folder / f"flight_{flown:02d}", twin)
        except RunEnded as ended:
            raise RunEnded(f"{here}: {what}: {ended}") from ended

    stage(f"{here}: mission")
    low, high = common_reach(model, {"dual": settings})
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    pace = max(model.rig.scales.time_scale / PAPER.time_scale, 1.0)
    twin = Twin(twin_of(model, band))
    first = flight("mission", settings, mission(low, high, pace, 1000 * seed + number), twin)
    stage(f"{here}: diagnose")
    record = Record({name: first.record[name] for name in ("time", "omega_ref", "beta_ref", "thrust", "omega")}, "mission")
    # The rig waits, and a mission is too short to learn a term of unknown form.
    campaign = Campaign(folder, None, (), record, None, None, rig=model.rig)
    found = diagnose(campaign, given=model, workers=workers, thorough=False)
    named = tuple(e for e in found.final.effects if e not in model.model.optional)
    adapted = found.parameters(found.final)
    adapted = replace(adapted, source={**model.source, **adapted.source})
    candidates = {PRESENT: settings}
    if policy == MODEL_BASED:
        stage(f"{here}: tune")
        tuned = tune(adapted, gains=gains_of(settings), profile=day.profile, noise=band.noise, seed=seed)
        candidates[policy] = tuned.gains["dual"].values
    stage(f"{here}: compare on the rig")
    costs = {}
    for name, own in candidates.items():
        done = flight(name, own, repeated(day.profile, TIMES))
        costs[name] = costs_of(done.record, day.profile, TIMES, own)
    winner = best_of(costs)
    return Round(
        number=number,
        hidden=hidden,
        mission=first,
        alarms=tuple(one._replace(time=one.time - profile_start(first.log)) for one in twin.alarms),
        verdict=found.verdict,
        named=named,
        parameters=adapted,
        before=error(model, record),
        after=error(adapted, record),
        costs=costs,
        winner=winner,
        settings=candidates[winner],
    )


def gains_of(settings: Mapping[str, float]) -> ParameterSet:
    """Settings as those of the controller."""
    return ParameterSet(CONTROLLER).replaced({p.name: settings[p.name] for p in CONTROLLER.parameters})


def error(parameters: ParameterSet, record: Record) -> float:
    """rms error of the model's thrust for a record's commands, N."""
    off = predict(parameters.model, parameters.values, record).thrust - record["thrust"]
    return float(np.sqrt(np.nanmean(off**2)))
