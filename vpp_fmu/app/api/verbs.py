"""The command's verbs as functions. They take paths or objects, and write files only on request."""

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from identification.assessment.information import read_knowledge, read_noise
from identification.assessment.prediction import predict
from identification.diagnose import diagnose as diagnosing
from identification.fit.problem import Prior
from identification.gate.finding import check_accepted
from identification.identify import identify as identified
from identification.plan.plan import plan as planned
from identification.plan.plan import step_of
from identification.power.allocation import allocate as allocated
from identification.power.model import PowerModel
from identification.tune.controllers import controllers, rig_controller
from identification.tune.learn import learn as learned
from identification.tune.profile import rig_profile
from identification.tune.tune import TuningTask, chain_of
from identification.tune.tune import tune as tuned
from vpp_fmu.app.api.objects import PathLike, as_campaign, as_gains, as_parameters, as_record, changed
from vpp_fmu.app.api.results import (
    AllocateResult,
    CheckResult,
    DiagnoseResult,
    IdentifyResult,
    LearnResult,
    LoopResult,
    PlanResult,
    Result,
    SimulateResult,
    TuneResult,
)
from vpp_fmu.app.cli.check import checked
from vpp_fmu.app.cli.export import ABOUT, about, exported, tried
from vpp_fmu.app.cli.learn import task_of
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.export.own_model import as_model
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.types import Model
from vpp_fmu.loop import run
from vpp_fmu.own_effects import library_with, named
from vpp_fmu.parameters import ParameterSet, beside, parameters_file
from vpp_fmu.plants import USUAL_STEP, Controller, FmuController, FmuPlant, KernelController, KernelPlant, Plant
from vpp_fmu.policy import Policy, read_policy
from vpp_fmu.rig import Rig, declared_rig

FLAVOURS = {"python": ("python",), "native": ("native",), "both": ("python", "native")}


def check(campaign: PathLike | Campaign, accept: Iterable[str] = ()) -> CheckResult:
    """Check a campaign: its files, missing data and quality problems. Run it first on new data.

    `accept`: codes of findings to ignore (`vpp check --help` lists them). Problems of the data are in the result (`ok`,
    `findings`); BadInput is for files that can't be read, and for unknown codes.

    >>> vpp.check(vpp.example_campaign()).ok
    True
    """
    return CheckResult(checked(as_campaign(campaign), check_accepted(accept)))


def identify(
    campaign: PathLike | Campaign,
    records: Mapping[str, Any] | None = None,
    starts: int = 8,
    seed: int = 0,
    accept: Iterable[str] = (),
) -> IdentifyResult:
    """Identify the parameters: lags in s, coefficients of the map in normalised units, each with its standard deviation.

    `records`: further ones to fit, by name (paths, Records or frames). `starts` of the search. BadInput: data that
    the quality gate refuses, or no identifiable parameter.

    >>> found = vpp.identify(vpp.example_campaign(), starts=1)
    >>> found.parameters.values["tau_beta_1"] > found.parameters.values["tau_beta_2"]
    True
    >>> found.to_dict()["rmse_thrust"]["validation"] < 0.2
    True
    >>> found.save("out").name
    'out'
    """
    needed = ("time", "omega_ref", "beta_ref", "thrust")
    named = {name: as_record(record, needed) for name, record in (records or {}).items()}
    whole = as_campaign(campaign)
    found = identified(whole, starts=starts, seed=seed, records=named, accept=accept)
    return IdentifyResult(found, found.parameters)


def diagnose(
    campaign: PathLike | Campaign,
    parameters: Any = None,
    effects: Iterable[str] | None = None,
    records: Mapping[str, Any] | None = None,
    smallest: float | None = None,
    smallest_speed: float | None = None,
    seed: int = 0,
    workers: int = 2,
    accept: Iterable[str] = (),
    effects_from: Iterable[PathLike] = (),
    budget: float | None = None,
) -> DiagnoseResult:
    """Find the effects that the model lacks, and add them.

    `parameters`: initial and reference model (a file, a set, a result); None: the campaign is identified first. `effects`:
    names of the candidates; None: the whole library. `smallest` N, `smallest_speed` rpm: minimum rms changes of thrust and
    speed of interest. `effects_from`: Python files with user-defined effects. `budget` s: time after which no further step of
    the search begins; None: no limit. BadInput: no record to fit, data that the gate refuses, an unknown effect.

    >>> found = vpp.diagnose(vpp.example_campaign(), effects=["pitch_command_deadband", "pitch_backlash"])
    >>> found.verdict, found.effects
    ('attributed', ('pitch_command_deadband',))
    >>> 1.6 < found.parameters.values["pitch_command_deadband.half_width"] < 1.8
    True
    """
    library = library_with(effects_from)
    given = None if parameters is None else as_parameters(parameters, effects_from)
    needed = ("time", "omega_ref", "beta_ref", "thrust")
    found = diagnosing.diagnose(
        as_campaign(campaign),
        named(library, effects, given.model.optional if given else (), "diagnose", "effects"),
        workers,
        seed,
        given=given,
        smallest=smallest,
        smallest_speed=smallest_speed,
        records={name: as_record(record, needed) for name, record in (records or {}).items()},
        accept=accept,
        budget=budget,
    )
    return DiagnoseResult(found, found.parameters(found.final))


def plan(
    parameters: Any,
    rig: PathLike | Rig | None = None,
    seconds: float | None = None,
    noise: float | None = None,
    step: float | None = None,
    knowledge: PathLike | IdentifyResult | None = None,
    seed: int = 0,
    effects_from: Iterable[PathLike] = (),
) -> PlanResult:
    """Plan the next experiment: the most informative commands within the range and slew rates of the `rig`.

    `rig`: a Rig, or a rig.json; None: that of the parameters' campaign. `seconds` of commands, `step` s between them and
    between readings, `noise` N of one reading. `knowledge`: prior information (an identification.json, or the result).
    BadInput: a range is neither measured nor declared, or an argument is invalid for this rig.

    >>> found = vpp.plan(vpp.identify(vpp.example_campaign(), starts=1), seconds=30)
    >>> found.commands
    Record(7501 rows, 30 s every 4 ms: time, omega_ref, beta_ref)
    """
    held = as_parameters(parameters, effects_from).without_power
    if not isinstance(rig, Rig):
        rig = held.rig if rig is None else declared_rig(rig, held.rig)
    if rig.unknown:
        raise BadInput("plan", f"range of {' and '.join(rig.unknown)}", "none", "a measured range, or one that `rig` declares")
    prior, inflation, floor = None, 1.0, None
    if isinstance(knowledge, IdentifyResult):
        uncertainty = knowledge.found.uncertainty
        prior, inflation = (
            Prior(uncertainty.names, uncertainty.values, uncertainty.covariance),
            float(np.median(uncertainty.inflation)),
        )
        floor = knowledge.found.noise.std if knowledge.found.noise else None
    elif knowledge is not None:
        prior, inflation = read_knowledge(knowledge)
    step = step if step is not None else step_of(held.sample_period, rig)
    found = planned(held.model, held.values, rig, seconds, noise if noise is not None else floor, prior, seed, step=step)
    return PlanResult(found, held, inflation)


def tune(
    parameters: Any,
    assume: Mapping[str, float] | None = None,
    gains: Any = None,
    profile: Any = None,
    noise: float = 0.0,
    robust: str | None = None,
    seed: int = 0,
    workers: int = 1,
    effects_from: Iterable[PathLike] = (),
) -> TuneResult:
    """Tune gains for a model: both actuators, and speed alone.

    `assume`: parameters that the design replaces, as the paper does with tau_beta_2 = 0.05 s. `gains`: limits, filter, sample
    time and initial gains of the controller. `profile`: `time` [s], `thrust_set` [N]; None: 0.1 to 0.8 of the thrust scale and
    back, within the rig's reach. `noise` N of a reading. `robust`: "worst" or "mean" over plants drawn from the parameters'
    uncertainty. BadInput: unknown names, or a profile that is too short.

    >>> found = vpp.tune(vpp.identify(vpp.example_campaign(), starts=1), assume={"tau_beta_2": 0.05})
    >>> sorted(found.gains), found.save("gains").joinpath("gains.json").exists()
    (['dual', 'speed_only'], True)
    """
    files = tuple(os.fspath(path) for path in effects_from)
    held = changed(as_parameters(parameters, files), assume or {})
    if unknown := set(held.model.optional) - {e.name for e in library_with(files)}:
        raise BadInput(
            "tune", "effects_from", "nothing", f"the file of {', '.join(sorted(unknown))}, which every process reads anew"
        )
    if robust not in (None, "worst", "mean"):
        raise BadInput("tune", "robust", robust, "None, worst or mean")
    own = controllers(held, None if gains is None else as_gains(gains), source="gains")
    period = next(iter(own.settings.values()))["sample_time"]
    wanted = rig_profile(held, own.settings) if profile is None else as_record(profile, ("time", "thrust_set"))
    if wanted.time[-1] < 10.0 * period:
        raise BadInput(wanted.source, "time", f"{wanted.time[-1]:g} s", f"{10.0 * period:g} s or more")
    task = TuningTask(
        parameters=held,
        profile=wanted,
        assumed=tuple(assume or ()),
        chain=chain_of(held, period),
        noise_std=noise,
        reference=own.reference,
        robust=robust,
        seed=seed,
        left_out=own.left_out,
        lowered=own.scaled,
        effects_from=files,
    )
    return TuneResult(tuned(task, own.settings, workers), task.parameters)


def allocate(parameters: Any, weight: float = 0.0, points: int = 41, seed: int = 0) -> AllocateResult:
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
    for name, value, low, high in (("weight", weight, 0.0, 1.0), ("points", points, 2, 1000)):
        if not low <= value <= high:
            raise BadInput("allocate", name, value, f"{low:g} to {high:g}")
    held = as_parameters(parameters)
    fit = getattr(getattr(parameters, "found", None), "power", None)
    file = beside(parameters_file(parameters)) if isinstance(parameters, str | os.PathLike) else None
    power = PowerModel(held, fit.names, fit.covariance) if fit else PowerModel.of(held, file)
    return AllocateResult(allocated(held, power, weight, points, seed), held)


def learn(
    parameters: Any,
    generations: int = 1000,
    hidden: int = 6,
    plants: int = 100,
    gains: Any = None,
    seed: int = 0,
    effects_from: Iterable[PathLike] = (),
) -> LearnResult:
    """Learn a control law, a network of `hidden` units, on plants drawn from the parameters' uncertainty; compare it with the
    tuned PID on `plants` held-out ones.

    `parameters`: a file, a set or a result of identify, whose covariance and noise are used. `generations` of the search: 1000
    take a minute. `gains`: the PID to compare with and to fall back on; None: tuned here. BadInput: an argument out of its
    range, or parameters without a range of speed or pitch.

    >>> found = vpp.learn(vpp.identify(vpp.example_campaign(), starts=1), generations=2, plants=2, gains={})
    >>> found.save("policy").joinpath("policy.json").exists(), found.policy.size
    (True, (8, 6, 2))
    """
    for name, value, low, high in (
        ("generations", generations, 1, 10**6),
        ("hidden", hidden, 1, 64),
        ("plants", plants, 2, 10**4),
    ):
        if not low <= value <= high:
            raise BadInput("learn", name, value, f"{low:g} to {high:g}")
    files = tuple(os.fspath(path) for path in effects_from)
    held, prior, noise = as_parameters(parameters, files), None, 0.0
    if isinstance(parameters, IdentifyResult):
        own = parameters.found.uncertainty
        prior = Prior(own.names, own.values, own.covariance)
        noise = parameters.found.noise.std if parameters.found.noise else 0.0
    elif isinstance(parameters, str | os.PathLike) and (known := beside(parameters_file(parameters))).is_file():
        prior, noise = read_knowledge(known)[0], (read_noise(known) or (0.0,))[0]
    given = None if gains is None else as_gains(gains)
    task, settings = task_of(
        *(held, (given, "gains")), knowledge=prior, noise_std=noise, overshoot=0.05, seed=seed, effects_from=files
    )
    return LearnResult(learned(task, settings, hidden, generations, plants), held)


def simulate(record: Any, parameters: Any, effects_from: Iterable[PathLike] = ()) -> SimulateResult:
    """The model's open-loop response to the commands of a record: thrust [N], speed [rpm], pitch [deg], each (n,).

    `record`: a path, a Record, or a frame with `time`, `omega_ref`, `beta_ref`; with `thrust` the result has the error.
    BadInput: invalid arguments.

    >>> found = vpp.simulate({"time": [0.0, 1.0, 2.0], "omega_ref": [4000, 5000, 5000], "beta_ref": [5, 5, 5]}, vpp.identify(
    ...     vpp.example_campaign(), starts=1))
    >>> found.record["thrust"].shape, found.rmse_thrust
    ((3,), None)
    """
    held = as_parameters(parameters, effects_from)
    return SimulateResult(predict(held.model, held.values, as_record(record)), held)


def export_fmu(
    parameters: Any,
    folder: PathLike,
    gains: Any = None,
    flavour: str = "python",
    platforms: str = "host",
    fmi: str = "2.0",
    author: str | None = None,
    effects_from: Iterable[PathLike] = (),
    policy: PathLike | Policy | LearnResult | None = None,
    values: Mapping[str, float] | None = None,
    **fields: Any,
) -> dict[str, Path]:
    """Write VppPlant and VppController as FMUs, with parameter values (.ssv) and their loop (.ssp); or a model of your
    own.

    `parameters`: a file, a set or a result; or a Model or Slave, with `values` of its parameters by name. `author`, and
    `fields` (version, license, copyright, description, stop_time, step_size, tolerance) replace what the model declares.
    `policy`: a learned law in the controller's place, as VppPolicy; `gains` are then those of its fallback.

    `gains`: the controller's (a file, a set, values by name; None: the published ones, scaled to the rig's time constant),
    within the limits of the parameters' rig. `flavour`: "python", "native" (compiled C without Python) or "both".
    `platforms`: "host", or "all" for Linux, Windows and macOS (native, needs the extra `cross`). `fmi`: "2.0" or "3.0"
    (native). Returns the paths by name. BadInput: options that do not fit together; CompilerMissing: no compiler for native
    FMUs.

    >>> files = vpp.export_fmu(vpp.identify(vpp.example_campaign(), starts=1), "fmus")
    >>> [name for name in files if name.endswith(".fmu")]
    ['VppPlant.fmu', 'VppController.fmu']
    """
    for name, found, allowed in (
        ("flavour", flavour, tuple(FLAVOURS)),
        ("platforms", platforms, ("host", "all") if flavour != "python" else ("host",)),
        ("fmi", fmi, ("2.0", "3.0") if flavour == "native" else ("2.0",)),
    ):
        if found not in allowed:
            raise BadInput("export_fmu", name, found, f"{' or '.join(allowed)} with flavour {flavour}")
    fields["author"] = author
    if unknown := set(fields) - set(ABOUT):
        raise BadInput("export_fmu", "argument", ", ".join(sorted(unknown)), f"one of {', '.join(ABOUT)}")
    if isinstance(parameters, Model | type):
        if gains is not None or policy is not None:
            raise BadInput("export_fmu", "gains, policy", "those of a controller with a model of your own", "neither")
        model = as_model(parameters.__name__ if isinstance(parameters, type) else parameters.name, parameters)
        parts = [changed(ParameterSet(model), values or {})]
    else:
        held = as_parameters(parameters, effects_from)
        controller = rig_controller(held, None if gains is None else as_gains(gains), "gains")
        if policy is not None:
            law = policy.policy if isinstance(policy, LearnResult) else policy
            controller = (law if isinstance(law, Policy) else read_policy(law)).in_place_of(controller)
        parts = [changed(held, values or {}), controller]
    target = OutputFolder(folder)
    parts = [about(part, fields) for part in parts]
    files = exported(parts, FLAVOURS[flavour], platforms, fmi)
    if len(parts) == 1:
        tried(parts[0].model.name, parts[0], files, FLAVOURS[flavour], fmi)
    return {name: target.write(name, content) for name, content in files.items()}


def run_loop(
    plant: Any,
    controller: Any,
    profile: Any,
    dt: float | None = None,
    start: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] = lambda share: None,
) -> LoopResult:
    """The closed loop over a profile of `time` [s] and set-points `thrust_set` [N], each held to the next row.

    `plant`, `controller`: paths of FMUs, parameters (run in Python), or any object with the methods of `vpp_fmu.plants.Plant`
    and `Controller`, such as a user's rig. Gains with parameters are limited to the range of the parameters' rig. `dt` s: the
    communication step; None: the controller's sample time, else 0.004. `start`: commands [rpm, deg] on which the plant is
    initially at rest. BadInput: a file that is no such FMU; SimulationFailed names the step.

    >>> profile = {"time": [0.0, 1.0, 4.0], "thrust_set": [1.5, 12.0, 12.0]}
    >>> found = vpp.run_loop(vpp.identify(vpp.example_campaign(), starts=1), {}, profile, dt=0.004)
    >>> found.record["thrust"].shape, found.steps[0].after
    ((1001,), 12.0)
    """
    if dt is not None and not 1e-6 <= dt <= 1.0:
        raise BadInput("run_loop", "dt", f"{dt:g} s", "1e-06 to 1 s")
    references = as_record(profile, ("time", "thrust_set"))
    rig = None if _is_fmu(plant) or hasattr(plant, "step") else as_parameters(plant)
    with closing(_controller(controller, dt, rig)) as right:
        dt = dt or getattr(right, "sample_time", None) or USUAL_STEP
        with closing(_plant(plant, dt)) as left:
            record = run(left, right, references, start, progress)
    return LoopResult(record, f"Over {references.source}.", getattr(right, "limits", None))


def _plant(given: Any, dt: float) -> Plant:
    if _is_fmu(given):
        return FmuPlant(given, dt=dt)
    if hasattr(given, "step") and hasattr(given, "dt"):
        made: Plant = given
        return made
    held = as_parameters(given)
    return KernelPlant(held.model, held.values, dt)


def _controller(given: Any, dt: float | None, plant: ParameterSet | None) -> Controller:
    """The controller of `run_loop`. `plant`: parameters whose rig limits the commands, if known."""
    if _is_fmu(given):
        return FmuController(given, dt=dt)
    if hasattr(given, "step") and hasattr(given, "start"):
        made: Controller = given
        return made
    own = as_gains(given)
    values = own.values if plant is None else rig_controller(plant, own if own.estimates else None, "gains").values
    return KernelController(values, dt or values["sample_time"])


def _is_fmu(given: Any) -> bool:
    return isinstance(given, str | Path) and str(given).endswith(".fmu")


def write_report(result: Result, path: PathLike) -> Path:
    """Write a result's report, a self-contained HTML file; returns its path. BadInput.

    >>> vpp.write_report(vpp.check(vpp.example_campaign()), "check.html").name
    'check.html'
    """
    target = Path(path)
    return OutputFolder(target.parent).write(target.name, result.page().html())
