"""Parameter files: values with their uncertainty as JSON, read and checked against a model; and as SSP parameter values."""

import difflib
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from vpp_fmu.errors import BadInput
from vpp_fmu.files import InFolder, OutputFolder
from vpp_fmu.kernel.plant import ADDS_POWER, LIBRARY
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.types import BOOLEAN, REAL, Model, Parameter
from vpp_fmu.notebook import table_html
from vpp_fmu.rig import Rig, rig_of
from vpp_fmu.structured import as_json, read_object, shown
from vpp_fmu.units import base_unit

FORMAT = "vpp-parameters/1"

FILE, GAINS, KNOWLEDGE, POLICY = "parameters.json", "gains.json", "identification.json", "policy.json"

parameters_file, gains_file, knowledge_file, policy_file = (InFolder((name,)) for name in (FILE, GAINS, KNOWLEDGE, POLICY))

LONGEST = 1e6
"""Maximum duration of a record, and of its sampling period [s]: eleven days."""

_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation, both in `unit`; None: unknown, or never estimated."""

    value: float
    std: float | None
    unit: str


@dataclass(frozen=True)
class ParameterSet:
    """A model and its parameters that are set; `source`: origin of the values (files, method, dates of the data).

    >>> parameters = vpp.identify(vpp.example_campaign(), starts=1).parameters
    >>> parameters
    ParameterSet(VppPlant, 13 of 13 parameters set)
    >>> faster = parameters.replaced({"tau_beta_2": 0.05})
    >>> faster.values["tau_beta_2"]
    0.05
    >>> parameters.replaced({"tau_gamma": 0.05})
    Traceback (most recent call last):
        ...
    KeyError: 'tau_gamma'
    """

    model: Model
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    source: Mapping = field(default_factory=dict)

    def __repr__(self) -> str:
        effects = f" with {', '.join(self.model.optional)}" if self.model.optional else ""
        return f"ParameterSet({self.model.name}{effects}, {len(self.estimates)} of {len(self.model.parameters)} parameters set)"

    def _repr_html_(self) -> str:
        unset, values = Estimate(0.0, None, ""), self.values
        rows = [(p.name, values[p.name], self.estimates.get(p.name, unset).std, p.unit) for p in self.model.parameters]
        return table_html(repr(self), ("parameter", "value", "std", "unit"), rows)

    def to_dict(self) -> dict[str, Any]:
        """The content of a parameter file."""
        content: dict[str, Any] = json.loads(to_json(self))
        return content

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write parameters.json and parameters.ssv into a folder; returns that. BadInput."""
        target = OutputFolder(folder)
        target.write(FILE, to_json(self))
        target.write("parameters.ssv", to_ssv(self, "parameters"))
        return target.path

    @property
    def values(self) -> dict[str, float]:
        """All of the model's parameter values by full name; defaults if not set."""
        return self.model.values({name: estimate.value for name, estimate in self.estimates.items()})

    @property
    def identity(self) -> str:
        """Twelve hex digits of a hash of model, effects and values; independent of their source and date."""
        content = [self.model.name, list(self.model.optional), self.values]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:12]

    @property
    def label(self) -> str:
        """Campaign and date of the set, for the head of a report."""
        campaign, date = self.source.get("campaign"), self.source.get("date")
        said = [f"campaign {campaign}"] if isinstance(campaign, str) else []
        return ", ".join([*said, f"parameters of {date[:10]}"] if isinstance(date, str) else said)

    @property
    def rig(self) -> Rig:
        """The rig that the set is for: from `source`, else the ranges of the model's scales."""
        return rig_of(_scales(self.source, self.values), self.source)

    @property
    def sample_period(self) -> float | None:
        """Sampling period [s] of the record that the set was identified from; None if `source` does not have it."""
        found = self.source.get("sample_period")
        return float(found) if isinstance(found, int | float) and _is_number(found) and found > 0.0 else None

    @property
    def without_power(self) -> "ParameterSet":
        """This set without the effects that only add torque and power to the outputs: thrust is the same to the bit."""
        effects = tuple(e for e in self.model.effects if e.name not in ADDS_POWER)
        if len(effects) == len(self.model.effects):
            return self
        outputs = tuple(y for y in self.model.outputs if y not in [y for e in self.model.effects for y in e.outputs])
        model = replace(self.model, effects=effects, outputs=outputs)
        known = {p.name for p in model.parameters}
        return ParameterSet(model, {n: e for n, e in self.estimates.items() if n in known}, self.source)

    def with_power_of(self, other: "ParameterSet") -> "ParameterSet":
        """This set with the torque and power of another set of the same scales: unchanged if that has none."""
        brought = tuple(e for e in other.model.effects if e.name in ADDS_POWER)
        if not brought:
            return self
        outputs = self.without_power.model.outputs + tuple(y for e in brought for y in e.outputs)
        model = replace(self.model, effects=self.without_power.model.effects + brought, outputs=outputs)
        own = {e.full(p.name) for e in brought for p in e.parameters}
        return ParameterSet(model, dict(self.estimates) | {n: e for n, e in other.estimates.items() if n in own}, self.source)

    def replaced(self, values: Mapping[str, float], std: Mapping[str, float] | None = None) -> "ParameterSet":
        """This set with other values, in the model's units, and their standard deviations if known. KeyError: unknown name."""
        units = {p.name: p.unit for p in self.model.parameters}
        new = {name: Estimate(float(value), (std or {}).get(name), units[name]) for name, value in values.items()}
        return replace(self, estimates={**self.estimates, **new})


def beside(path: str | os.PathLike) -> Path:
    """The identification.json of a parameter file: noise, model error and covariance of the same campaign."""
    return Path(path).with_name(KNOWLEDGE)


def read_parameters(path: str | os.PathLike, build: Callable[[tuple[str, ...]], Model]) -> ParameterSet:
    """Read a parameter file for the model that `build` returns for its effects' names. BadInput names file and field.

    `build` is `vpp_fmu.kernel.plant.plant`, or `lambda effects: CONTROLLER`. It may raise KeyError(name of an effect).
    """
    content = _content(path)
    model = _model(path, content.get("effects", []), build)
    entries = _mapping(path, "parameters", content.get("parameters", {}))
    source = _source(path, content.get("source", {}))
    model = _sized(model, entries, source)
    known = {p.name: p for p in model.parameters}
    estimates = {}
    for name, entry in entries.items():
        if name not in known:
            owner, dot, _ = name.partition(".")
            near = _near(name, known)
            allowed = f"{near}, or {shown(owner)} among the effects" if dot and owner not in model.optional else near
            raise BadInput(path, f"parameters, {shown(name)}", f"a name that {model.name} does not have", allowed)
        estimates[name] = _estimate(path, known[name], entry)
    return ParameterSet(model, estimates, source)


def check_same_model(path: str | os.PathLike, parameters: ParameterSet, of: str | os.PathLike) -> None:
    """BadInput if the identification.json at `path` is of another model than the parameters that were read from `of`: its
    covariance belongs to the values and effects that it names. Names that it does not have are not compared."""
    content = read_object(path, allowed="an identification.json")
    effects, entries = content.get("effects", list(parameters.model.optional)), content.get("parameters", {})
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise BadInput(path, "effects", shown(effects), "a list of effects' names")
    fitted: dict[str, Any] = {
        name: _mapping(path, f"parameters, {shown(name)}", entry).get("value")
        for name, entry in _mapping(path, "parameters", entries).items()
    }
    if set(effects) - ADDS_POWER != set(parameters.model.optional) - ADDS_POWER:
        raise BadInput(path, "effects", _listed(effects), f"{_listed(parameters.model.optional)}, the model of {of}")
    for name, value in fitted.items():
        known = parameters.values.get(name)
        if known is None or not _is_number(value) or not math.isclose(value, known, rel_tol=1e-9, abs_tol=1e-12):
            allowed = f"a name in {of}" if known is None else f"{known!r}, the value in {of}"
            raise BadInput(path, f"parameters, {shown(name)}", shown(value), f"{allowed}: both must be of one model")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(str, names)) or "no effects"


def _sized(model: Model, entries: Mapping, source: Mapping) -> Model:
    """The model with the scales that the file names."""
    scales = _scales(source, {name: entry.get("value") for name, entry in entries.items() if isinstance(entry, dict)})
    return model if scales == PAPER else model.sized(scales)


def _scales(source: Mapping, values: Mapping) -> Scales:
    """The scales among `values`, else those of the rig in `source`, else the paper's."""
    rig = source.get("rig")
    given = rig.get("scales") if isinstance(rig, dict) else None
    named = {**(given if isinstance(given, dict) else {}), **values}
    return PAPER.with_values({n: v for n, v in named.items() if _is_number(v) and (v > 0.0 or n == "beta_offset")})


def _content(path: str | os.PathLike) -> dict:
    content = read_object(path, FORMAT, "a parameter file in JSON")
    for name in content:
        if name not in ("format", "parameters", "effects", "source"):
            raise BadInput(path, shown(name), "an unknown field", "format, parameters, effects, source")
    return content


def _model(path: str | os.PathLike, effects: object, build: Callable[[tuple[str, ...]], Model]) -> Model:
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise BadInput(path, "effects", shown(effects), "a list of effects' names")
    try:
        model = build(tuple(effects))
    except KeyError as error:
        name = error.args[0]
        if name not in effects:
            raise
        library = [effect.name for effect in LIBRARY if effect.off is not None]
        raise BadInput(
            path, "effects", shown(name), _near(name, library), "--effects-from FILE.py for an effect of your own"
        ) from error
    for name in effects:
        if name not in model.optional:
            raise BadInput(path, "effects", shown(name), f"no effects: {model.name} has none to choose")
    return model


def _estimate(path: str | os.PathLike, parameter: Parameter, entry: object) -> Estimate:
    name = f"parameters, {parameter.name}"
    entry = _mapping(path, name, entry)
    for key in entry:
        if key not in ("value", "std", "unit"):
            raise BadInput(path, f"{name}, {shown(key)}", "an unknown field", "value, std, unit")
    for key in ("value", "unit"):
        if key not in entry:
            raise BadInput(path, f"{name}, {key}", "nothing", "a value and its unit for each parameter")
    if entry["unit"] != parameter.unit:
        raise BadInput(path, f"{name}, unit", shown(entry["unit"]), f'"{parameter.unit}"')
    value, std = entry["value"], entry.get("std")
    allowed = f"a number from {parameter.minimum:g} to {parameter.maximum:g} {parameter.unit}".removesuffix(" 1")
    if parameter.kind != REAL:
        allowed = "0 or 1" if parameter.kind == BOOLEAN else allowed.replace("a number", "a whole number")
    in_range = _is_number(value) and parameter.minimum <= value <= parameter.maximum
    if not in_range or (parameter.kind != REAL and value != round(value)):
        raise BadInput(path, f"{name}, value", shown(value), allowed)
    if std is not None and (not _is_number(std) or std < 0.0):
        raise BadInput(path, f"{name}, std", shown(std), "a number from 0, or null")
    return Estimate(float(value), None if std is None else float(std), parameter.unit)


def _source(path: str | os.PathLike, found: object) -> dict:
    """BadInput if an entry of `source` that a verb uses has the wrong type."""
    source = _mapping(path, "source", found)
    for name in ("record_seconds", "sample_period"):
        if name in source and not (_is_number(source[name]) and 0.0 < source[name] <= LONGEST):
            raise BadInput(path, f"source, {name}", shown(source[name]), f"a number of seconds, above 0 and up to {LONGEST:g}")
    if "rig" in source:
        _mapping(path, "source, rig", source["rig"])
        rig_of(PAPER, source, f"{path}: source, rig")
    return source


def _mapping(path: str | os.PathLike, name: str, found: object) -> dict:
    if not isinstance(found, dict):
        raise BadInput(path, name, shown(found), "an object in braces { }")
    return found


def _is_number(found: object) -> bool:
    if isinstance(found, bool) or not isinstance(found, int | float):
        return False
    return -1e300 < found < 1e300  # false for NaN, and for whole numbers too large for a float


def _near(name: str, known: Iterable[str]) -> str:
    known = tuple(known)
    return " or ".join(difflib.get_close_matches(name, known)) or f"one of {', '.join(known)}"


def to_json(parameters: ParameterSet) -> str:
    """The parameter file: all of the model's parameters in its order, exact to the bit when read back."""
    values, entries = parameters.values, {}
    for p in parameters.model.parameters:
        set_to = parameters.estimates.get(p.name)
        std = None if set_to is None or set_to.std is None else float(set_to.std)
        entries[p.name] = {"value": values[p.name], "std": std, "unit": p.unit}
    effects = list(parameters.model.optional)
    content = {"format": FORMAT, "parameters": entries, "effects": effects, "source": dict(parameters.source)}
    return as_json(content)


def to_ssv(parameters: ParameterSet, name: str) -> str:
    """The same values as SSP 1.0 parameter values, under the FMU's variable names and types. UnknownUnit."""
    root = ElementTree.Element("ssv:ParameterSet", {"xmlns:ssv": _SSV, "xmlns:ssc": _SSC, "version": "1.0", "name": name})
    values = ElementTree.SubElement(root, "ssv:Parameters")
    units = ElementTree.SubElement(root, "ssv:Units")
    for p in parameters.model.parameters:
        element = ElementTree.SubElement(values, "ssv:Parameter", {"name": p.name})
        ElementTree.SubElement(element, f"ssv:{p.kind}", _typed(parameters.values[p.name], p))
    for unit in dict.fromkeys(p.unit for p in parameters.model.parameters if p.kind == REAL):
        element = ElementTree.SubElement(units, "ssc:Unit", {"name": unit})
        ElementTree.SubElement(element, "ssc:BaseUnit", base_unit(unit))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _typed(value: float, parameter: Parameter) -> dict[str, str]:
    if parameter.kind == BOOLEAN:
        return {"value": str(value != 0.0).lower()}
    if parameter.kind == REAL:
        return {"value": repr(value), "unit": parameter.unit}
    return {"value": parameter.items[round(value) - 1] if parameter.items else str(round(value))}
