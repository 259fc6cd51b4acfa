"""Controllers for a model: tuned gains, pairs of least power, a learned law."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from identification.power.allocation import allocate as allocated
from identification.power.allocation import allocated_controller
from identification.power.model import PowerModel
from identification.tune.controllers import POWERS, controllers
from identification.tune.learn import learn as learned
from identification.tune.learn import random_steps
from identification.tune.objective import ALPHA
from identification.tune.profile import common_reach, rig_profile
from identification.tune.summary import NAMES
from identification.tune.tune import TuningTask, chain_of
from identification.tune.tune import tune as tuned
from vpp_fmu.app.api.objects import PathLike, as_gains, as_parameters, as_profile, changed, file_of, knowledge_of
from vpp_fmu.app.report.pages.allocation import AllocateResult
from vpp_fmu.app.report.pages.learning import LearnResult
from vpp_fmu.app.report.pages.tuning import TuneResult
from vpp_fmu.errors import ARGUMENT, BadInput
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, ALLOCATION
from vpp_fmu.kernel.effects.thrust_reading import LONGEST
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet, beside, parameters_file
from vpp_fmu.rig import ASSUMED

Settings = Mapping[str, Mapping[str, float]]


def tune(
    parameters: Any = None,
    assume: Mapping[str, float] | Iterable[tuple[str, float]] = (),
    gains: Any = None,
    objective: float | None = None,
    profile: Any = None,
    sample_time: float | None = None,
    alpha: float = ALPHA,
    overshoot: float = 1.0,
    sensitivity: float = 2.0,
    noise: float | None = None,
    delay: float | None = None,
    lag: float = 0.0,
    resolution: float | None = None,
    robust: str | None = None,
    draws: int = 200,
    spread: float = 0.1,
    knowledge: Any = None,
    seed: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    effects_from: Iterable[PathLike] = (),
) -> TuneResult:
    """Tune gains for a model: both actuators, and speed alone.

    `parameters`: a file, a set or a result; None: the paper's. `assume`: values that the design replaces, as the paper does
    with tau_beta_2 = 0.05 s. `gains`: limits, filter, sample time and initial gains of the controller. `objective`: weight as
    of `allocate`; the law on its pairs is tuned instead. `profile`: `time` [s], `thrust_set` [N]; None: 0.1 to 0.8 of the
    thrust scale and back, within the rig's reach. `sample_time` s. Limits: `overshoot` in % of a step, `sensitivity`; `alpha`
    weighs the squared norm of the gains. Readings of thrust: `noise` N (None: that of `knowledge`), `delay` s, `lag` s,
    `resolution` N. `robust`: "worst" or "mean" over `draws` plants; `spread`: relative standard deviation of parameters without
    one. `knowledge`: their correlation, as of `plan`. BadInput: unknown names, a profile that is too short.

    >>> found = vpp.tune(vpp.identify(vpp.example_campaign(), starts=1), assume={"tau_beta_2": 0.05})
    >>> sorted(found.gains), found.save("gains").joinpath("gains.json").exists()
    (['dual', 'speed_only'], True)
    """
    if robust not in (None, "worst", "mean"):
        raise BadInput(ARGUMENT, "robust", robust, "None, worst or mean")
    files, given = tuple(os.fspath(file) for file in effects_from), as_gains(gains)
    read = as_parameters(parameters, files)
    known, assumed = knowledge_of(parameters, read, knowledge), dict(assume)
    held = _rebuildable(changed(read, assumed, "assume"), files)
    own = controllers(held, given, sample_time, _named(gains))
    period = next(iter(own.settings.values()))["sample_time"]
    if delay is not None and delay > LONGEST * period:
        allowed = f"0 to {LONGEST * period:g} s, {LONGEST} samples of the controller"
        raise BadInput(ARGUMENT, "delay", f"{delay:g} s", allowed)
    starts = own.settings
    if objective is not None:
        pairs = allocated_controller(allocated(held, _power(parameters, held), objective), held).values
        kept = {} if given is None else {name: e.value for name, e in given.estimates.items() if name[:3] in POWERS}
        starts = {"allocated": {**starts["dual"], **{n: pairs[n] for n in (*ALLOCATION, "ki_beta")}, **kept}}
    elif given is not None and given.values["mode"] == ALLOCATED and "dual" in starts:
        starts = {"allocated": dict(starts["dual"])}
    wanted = rig_profile(held, starts) if profile is None else as_profile(profile)
    if wanted.time[-1] < 10.0 * period:
        raise BadInput(wanted.source, "time", f"{wanted.time[-1]:g} s", f"{10.0 * period:g} s or more")
    chain = chain_of(held, period) | {"time_constant": lag}
    chain |= {} if delay is None else {"delay": delay / period}
    task = TuningTask(
        parameters=held,
        profile=wanted,
        assumed=tuple(assumed),
        chain=chain if resolution is None else chain | {"resolution": resolution},
        noise_std=noise if noise is not None else known.noise[0] if known.noise else 0.0,
        alpha=alpha,
        overshoot=overshoot / 100.0,
        sensitivity=sensitivity,
        reference=own.reference,
        robust=robust,
        draws=draws,
        spread=spread,
        knowledge=known.prior,
        seed=seed,
        left_out=own.left_out,
        lowered=own.scaled,
        effects_from=files,
    )
    setting = _setting(task, starts)
    return TuneResult(tuned(task, starts, workers, scheduler), read, file_of(parameters), setting)


def _setting(task: TuningTask, starts: Settings) -> list[str]:
    """Conditions from the rig: limits, sampling, the profile, and controllers that it does not allow."""
    rig, settings = task.parameters.rig, next(iter(starts.values()))
    ends = (
        (f"{settings[f'{u}_min']:.6g}", f"{settings[f'{u}_max']:.6g}", unit) for u, unit in (("omega", "rpm"), ("beta", "deg"))
    )
    limits = (f"{low} {unit}" if low == high else f"{low} to {high} {unit}" for low, high, unit in ends)
    where = ", ".join(dict.fromkeys(rig.origin.get(name, ASSUMED) for name in ("speed", "pitch")))
    lines = [f"limits: {', '.join(limits)} (rig: {where}); sampled every {1e3 * settings['sample_time']:.4g} ms"]
    lines.append(f"noise of a thrust reading: {task.noise_std:.3g} N")
    low, high = common_reach(task.parameters, starts)
    wanted = task.profile["thrust_set"]
    line = f"{task.profile.source}: {wanted.min():.4g} to {wanted.max():.4g} N; in reach are {low:.4g} to {high:.4g} N"
    beyond = wanted.min() < low or wanted.max() > high
    lines.append(line + (", so that a part of it can't be followed" if beyond else ""))
    return lines + [f"no gains for {NAMES[name]}: {why}" for name, why in task.left_out.items()]


def _named(gains: Any) -> str:
    return file_of(gains or "gains") or "gains"


def _rebuildable(held: ParameterSet, files: tuple[str, ...]) -> ParameterSet:
    """The set, if each process can build its model anew. BadInput for effects of a file that is not named."""
    if unknown := set(held.without_power.model.optional) - {e.name for e in library_with(files)}:
        allowed = f"the file of {', '.join(sorted(unknown))}, which every process reads anew"
        raise BadInput(ARGUMENT, "effects_from", "nothing", allowed)
    return held


def _power(given: Any, held: ParameterSet) -> PowerModel:
    """The power of a plant, with the covariance of the given result, or of the identification.json beside the given file."""
    fit = getattr(getattr(given, "found", None), "power", None)
    if fit is not None and hasattr(fit, "covariance"):
        return PowerModel(held, fit.names, fit.covariance)
    return PowerModel.of(held, beside(parameters_file(given)) if isinstance(given, str | os.PathLike) else None)


def allocate(
    parameters: Any, weight: float = 0.0, points: int = 41, seed: int = 0, effects_from: Iterable[PathLike] = ()
) -> AllocateResult:
    """Find for each thrust the pair of speed and pitch of least power, from parameters with torque or power.

    `parameters`: a file, a set or a result; the covariance of the power's parameters is that of the identification.json beside
    the file, or of the result. `weight`: 0 for the least power, 1 for the largest reserve of thrust by pitch alone, between:
    both. `points`: number of thrusts. BadInput: parameters without power, or an argument out of its range.

    >>> from vpp_fmu.kernel.plant import plant
    >>> known = vpp.ParameterSet(plant(("power_map",))).replaced({"power_map.p30": 40.0, "power_map.p32": 160.0})
    >>> found = vpp.allocate(known, points=20)
    >>> len(found.pairs["power"]), found.gains.values["mode"]
    (20, 2.0)
    """
    _check_range(weight=(weight, 0.0, 1.0), points=(points, 2, 1000))
    held = as_parameters(parameters, effects_from)
    return AllocateResult(allocated(held, _power(parameters, held), weight, points, seed), held, file_of(parameters))


def learn(
    parameters: Any,
    gains: Any = None,
    knowledge: Any = None,
    generations: int = 1000,
    hidden: int = 6,
    plants: int = 100,
    overshoot: float = 5.0,
    spread: float = 0.1,
    seed: int = 0,
    effects_from: Iterable[PathLike] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> LearnResult:
    """Learn a control law, a network of `hidden` units, on plants drawn from the parameters' uncertainty; compare it with the
    tuned PID on `plants` held-out ones.

    `parameters`: a file, a set or a result. `knowledge`: their covariance and noise, as of `plan`. `generations` of the search:
    1000 take a minute. `gains`: the PID to compare with and to fall back on; None: tuned here. `overshoot` in % of a step that
    costs nothing; `spread` as of `tune`. `progress` receives the share that is done. BadInput: an argument out of its range, or
    parameters without a range of speed or pitch.

    >>> found = vpp.learn(vpp.identify(vpp.example_campaign(), starts=1), generations=2, plants=2, gains={})
    >>> found.save("policy").joinpath("policy.json").exists(), found.policy.size
    (True, (8, 6, 2))
    """
    _check_range(generations=(generations, 1, 10**6), hidden=(hidden, 1, 64), plants=(plants, 2, 10**4))
    files, given = tuple(os.fspath(file) for file in effects_from), as_gains(gains)
    held = _rebuildable(as_parameters(parameters, files), files)
    known = knowledge_of(parameters, held, knowledge)
    own = controllers(held, given, source=_named(gains))
    name, settings = next(iter(own.settings.items()))
    task = TuningTask(
        parameters=held,
        profile=rig_profile(held, own.settings),
        chain=chain_of(held, settings["sample_time"]),
        noise_std=known.noise[0] if known.noise else 0.0,
        overshoot=overshoot / 100.0,
        reference=own.reference,
        spread=spread,
        knowledge=known.prior,
        seed=seed,
        lowered=own.scaled,
        effects_from=files,
    )
    if given is None:  # tuned on set-points of the same kind
        pid = tuned(replace(task, profile=random_steps(task, settings)), {name: settings}).tuned[name]
        settings = pid.objective.with_gains(pid.final)
    return LearnResult(learned(task, settings, hidden, generations, plants, progress), held)


def _check_range(**arguments: tuple[float, float, float]) -> None:
    """BadInput for the first of the arguments, each (value, least, most), that is out of its range."""
    for name, (value, low, high) in arguments.items():
        if not low <= value <= high:
            raise BadInput(ARGUMENT, name, value, f"{low:g} to {high:g}")
