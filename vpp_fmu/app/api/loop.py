"""The response of a model: open loop to the commands of a record, closed loop over a profile."""

import os
from collections.abc import Callable, Iterable
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

from identification.assessment.prediction import predict
from identification.tune.controllers import rig_controller
from vpp_fmu.app.api.objects import PathLike, as_gains, as_parameters, as_profile, as_record
from vpp_fmu.app.report.pages.loop import LoopResult, SimulateResult
from vpp_fmu.errors import ARGUMENT, BadInput
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.loop import STANDSTILL, run
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import USUAL_STEP, Controller, FmuController, FmuPlant, FmuTwin, KernelController, KernelPlant, Plant
from vpp_fmu.reach import warn_beyond_reach


def simulate(record: Any, parameters: Any = None, effects_from: Iterable[PathLike] = ()) -> SimulateResult:
    """The model's open-loop response to the commands of a record: thrust [N], speed [rpm], pitch [deg], each (n,).

    `record`: a path, a Record, or a frame with `time`, `omega_ref`, `beta_ref`; with `thrust` the result has the error.
    `parameters`: a file, a set or a result; None: the paper's. BadInput: invalid arguments.

    >>> found = vpp.simulate({"time": [0.0, 1.0, 2.0], "omega_ref": [4000, 5000, 5000], "beta_ref": [5, 5, 5]}, vpp.identify(
    ...     vpp.example_campaign(), starts=1))
    >>> found.record["thrust"].shape, found.rmse_thrust
    ((3,), None)
    """
    wanted, held = as_record(record), as_parameters(parameters, effects_from)
    return SimulateResult(predict(held.model, held.values, wanted), held)


def run_loop(
    plant: Any,
    controller: Any,
    profile: Any,
    dt: float | None = None,
    start: tuple[float, float] = STANDSTILL,
    twin: PathLike | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> LoopResult:
    """The closed loop over a profile of `time` [s] and set-points `thrust_set` [N], each held to the next row.

    `plant`, `controller`: paths of FMUs, parameters (run in Python), or any object with the methods of `vpp_fmu.plants.Plant`
    and `Controller`, such as a user's rig. Gains with parameters are limited to the range of the parameters' rig. `dt` s: the
    communication step; None: the controller's sample time, else 0.004. `start`: commands [rpm, deg] on which the plant is
    initially at rest. `twin`: an FMU that monitors the loop, whose outputs are in the record. `progress` receives the share
    that is done. A set-point that an FMU cannot reach gives a RecordWarning. BadInput: a file that is no such FMU;
    SimulationFailed names the step.

    >>> profile = {"time": [0.0, 1.0, 4.0], "thrust_set": [1.5, 12.0, 12.0]}
    >>> found = vpp.run_loop(vpp.identify(vpp.example_campaign(), starts=1), {}, profile, dt=0.004)
    >>> found.record["thrust"].shape, found.steps[0].after
    ((1001,), 12.0)
    """
    if dt is not None and not 1e-6 <= dt <= 1.0:
        raise BadInput(ARGUMENT, "dt", f"{dt:g} s", "1e-06 to 1 s")
    references = as_profile(profile)
    rig = None if _is_fmu(plant) or hasattr(plant, "step") else as_parameters(plant)
    with closing(_plant(plant)) as left, closing(_controller(controller, dt, rig)) as right:
        dt, limits = dt or getattr(right, "sample_time", None) or USUAL_STEP, getattr(right, "limits", None)
        if left is not plant:
            left.dt = dt
        with closing(FmuTwin(Path(twin), dt)) if twin else nullcontext() as beside:
            if isinstance(left, FmuPlant) and limits:
                warn_beyond_reach(references, left, limits)
            record = run(left, right, references, start, progress)
            watched = (beside.beside(record, start), beside.units) if beside else None
    parts = "".join(f"{given} {word} " for given, word in ((plant, "under"), (controller, "over")) if _is_fmu(given))
    return LoopResult(record, f"{parts or 'Over '}{references.source}.", limits, watched)


def _plant(given: Any) -> Plant:
    if _is_fmu(given):
        return FmuPlant(given)
    if hasattr(given, "step") and hasattr(given, "dt"):
        made: Plant = given
        return made
    held = as_parameters(given)
    return KernelPlant(held.model, held.values)


def _controller(given: Any, dt: float | None, plant: ParameterSet | None) -> Controller:
    """The controller of `run_loop`. `plant`: parameters whose rig limits the commands, if known."""
    if _is_fmu(given):
        return FmuController(given, dt=dt)
    if hasattr(given, "step") and hasattr(given, "start"):
        made: Controller = given
        return made
    own = as_gains(given) or ParameterSet(CONTROLLER)
    values = own.values if plant is None else rig_controller(plant, own if own.estimates else None, "gains").values
    return KernelController(values, dt or values["sample_time"])


def _is_fmu(given: Any) -> bool:
    return isinstance(given, str | os.PathLike) and str(given).endswith(".fmu")
