"""Arguments of the verbs: a path, or the object that is read from it; and the uncertainty that comes with parameters."""

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

from identification.assessment.information import read_knowledge, read_noise
from vpp_fmu import campaign as campaigns
from vpp_fmu import parameters as parameter_files
from vpp_fmu import record as records
from vpp_fmu.app.report.result import Knowledge
from vpp_fmu.campaign import NAMES, NEED, Campaign
from vpp_fmu.errors import ARGUMENT, BadInput, RecordWarning
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import COMMANDS, Record

PathLike: TypeAlias = str | os.PathLike[str]

PAPERS = "the paper's fine-tuned set"
"""Default parameters."""


def example_campaign() -> Path:
    """The folder of the campaign that ships with the project: 100 steady points, 40 steps, 90 s and a repeat, 60 s of hold-out.

    >>> sorted(file.name for file in vpp.example_campaign().glob("*.csv.gz"))
    ['open_loop.csv.gz', 'repeat.csv.gz', 'static.csv.gz', 'steps.csv.gz', 'validation.csv.gz']
    """
    return Path(str(files("identification") / "example"))


def read_campaign(folder: PathLike) -> Campaign:
    """Read a campaign: a folder with any of static, steps, open_loop, repeat and validation (.csv or .csv.gz), and rig.json.

    Speed in rpm, pitch in deg, thrust in N, time in s from 0. BadInput: no folder, none of the files, an invalid file (with
    column and line), a repeat with other commands than the open loop.

    >>> vpp.read_campaign(vpp.example_campaign()).open_loop["thrust"].shape
    (22500,)
    >>> vpp.read_campaign("nowhere")
    Traceback (most recent call last):
        ...
    vpp_fmu.errors.BadInput: nowhere: campaign folder: found no such folder, expected a folder with any of static.csv, ...
    """
    return campaigns.read_campaign(folder)


def read_record(path: PathLike, need: Sequence[str] = COMMANDS) -> Record:
    """Read a record, a CSV with at least the columns `need`: columns by name, each (n,), in s, rpm, deg, N, V, A.

    BadInput names column and line; a RecordWarning names unknown columns, which are kept.

    >>> record = vpp.read_record(vpp.example_campaign() / "validation.csv.gz")
    >>> float(record.time[-1]), record.period
    (59.996, 0.004)
    """
    return records.read_record(path, need)


def read_parameters(path: PathLike, effects_from: Iterable[PathLike] = ()) -> ParameterSet:
    """Read a parameters.json of a plant, with the effects it names, or a gains.json of the controller: values with their
    standard deviations. `effects_from`: files of user-defined effects. BadInput names a field that is unknown, out of range, or
    in another unit.

    >>> saved = vpp.identify(vpp.example_campaign(), starts=1).save("out")
    >>> vpp.read_parameters("out/parameters.json").estimates["tau_beta_1"].unit
    's'
    """
    return as_parameters(path, effects_from)


def as_campaign(given: PathLike | Campaign) -> Campaign:
    """A campaign, read if a path is given."""
    return given if isinstance(given, Campaign) else read_campaign(given)


def as_record(given: Any, need: Sequence[str] = COMMANDS) -> Record:
    """A record: unchanged, read from a path, or converted from a frame."""
    if isinstance(given, Record):
        for name in need:
            if name not in given:
                raise BadInput(
                    given.source, f"column {name}", f"only {', '.join(given.columns)}", f"a record with {', '.join(need)}"
                )
        return given
    if isinstance(given, str | os.PathLike):
        return records.read_record(given, need, holes=("thrust",))
    return Record.from_frame(given, need=need)


def as_profile(given: Any) -> Record:
    """A profile of `time` [s] and `thrust_set` [N], read if a path is given."""
    return records.read_profile(given) if isinstance(given, str | os.PathLike) else as_record(given, records.PROFILE)


def as_records(given: Mapping[str, Any] | Iterable[PathLike]) -> dict[str, Record]:
    """Further records to fit, by name: that of the file, or its path if the name occurs twice."""
    if isinstance(given, Mapping):
        return {name: as_record(record, NEED) for name, record in given.items()}
    found: dict[str, Record] = {}
    for path in (os.fspath(each) for each in given):
        name = Path(path).name.removesuffix(".gz").removesuffix(".csv")
        found[path if name in (*NAMES, *found) else name] = as_record(path, NEED)
    return found


def as_parameters(given: Any, effects_from: Iterable[PathLike] = ()) -> ParameterSet:
    """Parameters: a set, a file, or the result of a verb; None: the paper's."""
    library = library_with(effects_from)
    if given is None:
        return ParameterSet(plant())
    if isinstance(given, ParameterSet):
        return given
    if isinstance(given, str | os.PathLike):
        file = parameter_files.parameters_file(given)
        return parameter_files.read_parameters(file, lambda names: plant(names, library))
    if isinstance(found := getattr(given, "parameters", None), ParameterSet):
        return found
    allowed = "a ParameterSet, the path of a parameters.json, or what identify and diagnose give"
    raise BadInput("parameters", "type", f"a {type(given).__name__}", allowed)


def file_of(given: Any) -> str | None:
    """The file that parameters were read from, for the provenance of results; None: there is none."""
    return PAPERS if given is None else os.fspath(given) if isinstance(given, str | os.PathLike) else None


def knowledge_of(given: Any, held: ParameterSet, named: Any = None) -> Knowledge:
    """The uncertainty of parameters that were `given`: of the `named` identification.json or result, else of the given result,
    else of the identification.json beside the given file.

    BadInput for a named file that can't be read, or is of another model. Such a file that is not named is ignored with a note.
    """
    source = given if named is None else named
    if not isinstance(source, str | os.PathLike):
        found = getattr(source, "knowledge", None)
        return found if isinstance(found, Knowledge) else Knowledge()
    file = parameter_files.knowledge_file(source)
    if named is None and not (beside := parameter_files.beside(parameter_files.parameters_file(source))).is_file():
        return Knowledge()
    try:
        file = file if named is not None else str(beside)
        parameter_files.check_same_model(file, held, given if isinstance(given, str | os.PathLike) else PAPERS)
        return Knowledge(*read_knowledge(file), read_noise(file))
    except BadInput as error:
        if named is not None:
            raise
        warnings.warn(f"not used: {' '.join(str(error).split())}", RecordWarning, stacklevel=2)
        return Knowledge()


def as_gains(given: Any) -> ParameterSet | None:
    """A controller's values: a set, a gains.json or its folder, values by name; None: none are given."""
    if given is None:
        return None
    if isinstance(given, str | os.PathLike):
        return parameter_files.read_parameters(parameter_files.gains_file(given), lambda _: CONTROLLER)
    if isinstance(given, Mapping):
        return changed(ParameterSet(CONTROLLER), given, "gains")
    return as_parameters(given)


def changed(parameters: ParameterSet, values: Mapping[str, float], argument: str = "values") -> ParameterSet:
    """The set with other values. BadInput names the `argument` with an unknown name, or with a value out of its range."""
    known = {p.name: p for p in parameters.model.parameters}
    for name, value in values.items():
        if name not in known:
            raise BadInput(ARGUMENT, argument, f"{name}={value}", f"NAME=VALUE with one of {', '.join(known)}")
        p = known[name]
        if not isinstance(value, float | int) or not p.minimum <= value <= p.maximum:
            raise BadInput(ARGUMENT, f"{argument} {name}", value, f"a number from {p.minimum:g} to {p.maximum:g} {p.unit}")
    return parameters.replaced(values)
