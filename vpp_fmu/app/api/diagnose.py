"""Find the effects that a model lacks."""

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from threadpoolctl import threadpool_limits

from identification.diagnose.diagnose import diagnose as diagnosed
from vpp_fmu.app.api.objects import PathLike, as_campaign, as_parameters, as_records
from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import ARGUMENT
from vpp_fmu.kernel.types import Effect
from vpp_fmu.own_effects import library_with, named
from vpp_fmu.parameters import ParameterSet


def candidates(
    parameters: Any, effects: Iterable[str] | None, effects_from: Iterable[PathLike]
) -> tuple[ParameterSet | None, tuple[Effect, ...]]:
    """(the initial model, the library of candidates) of a diagnosis. BadInput."""
    given = None if parameters is None else as_parameters(parameters, effects_from)
    return given, named(library_with(effects_from), effects, given.model.optional if given else (), ARGUMENT, "effects")


def diagnose(
    campaign: PathLike | Campaign,
    parameters: Any = None,
    effects: Iterable[str] | None = None,
    records: Mapping[str, Any] | Iterable[PathLike] = (),
    smallest: float | None = None,
    smallest_speed: float | None = None,
    seed: int = 0,
    workers: int = 2,
    accept: Iterable[str] = (),
    effects_from: Iterable[PathLike] = (),
    budget: float | None = None,
    stage: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int, str], None] = lambda done, total, best: None,
) -> DiagnoseResult:
    """Find the effects that the model lacks, and add them.

    `parameters`: initial and reference model (a file, a set, a result); None: the campaign is identified first. `effects`:
    names of the candidates; None: the whole library. `records`: further ones to fit: paths, or paths, Records and frames by
    name. `smallest` N, `smallest_speed` rpm: minimum rms changes of thrust and speed of interest. `effects_from`: Python files
    with user-defined effects. `budget` s: time after which no further step of the search begins; None: no limit. `stage` and
    `progress` are called with the name of each stage, and with the number of candidates done, of all, and the best. BadInput:
    no record to fit, data that the gate refuses, an unknown effect.

    >>> found = vpp.diagnose(vpp.example_campaign(), effects=["pitch_command_deadband", "pitch_backlash"])
    >>> found.verdict, found.effects
    ('attributed', ('pitch_command_deadband',))
    >>> 1.6 < found.parameters.values["pitch_command_deadband.half_width"] < 1.8
    True
    """
    given, library = candidates(parameters, effects, effects_from)
    whole, more = as_campaign(campaign), as_records(records)
    with threadpool_limits(limits=1):  # the same digits in a fleet, whose campaigns are diagnosed in parallel
        found = diagnosed(
            whole,
            library,
            workers,
            seed,
            stage=stage,
            progress=progress,
            given=given,
            smallest=smallest,
            smallest_speed=smallest_speed,
            records=more,
            accept=accept,
            budget=budget,
        )
    return DiagnoseResult(found, file=parameters if isinstance(parameters, str | os.PathLike) else None)
