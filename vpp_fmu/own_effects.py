"""User-defined effects: Python files beside the library, which `--effects-from` reads.

The file is executed. It defines EFFECT, a kernel Effect, and its place in the chain: PORT, the name of a port
(`vpp_fmu.kernel.learned.PORTS`), or BEFORE, the name of an effect of the library; neither: the end of the chain.
`vpp diagnose` writes such a file for a learned term. An installed package provides effects by entry points of the group
`vpp.effects`: each names an Effect, or a module with the same content as such a file.
"""

import importlib.util
import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType

from vpp_fmu.errors import BadInput, near
from vpp_fmu.export.checks import check_traced
from vpp_fmu.files import read_text
from vpp_fmu.invariants import Broken, Trial, declared
from vpp_fmu.kernel.learned import PORTS, placed
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect, Parameter, Signal, State
from vpp_fmu.units import check_unit

GROUP = "vpp.effects"

KINDS: Mapping[object, tuple[type, ...]] = {str: (str,), float: (float, int), bool: (bool,)}
"""Allowed types of the fields of a parameter, state or signal, by their declared type."""


def library_with(paths: Iterable[str | os.PathLike], library: Iterable[Effect] = LIBRARY) -> tuple[Effect, ...]:
    """The library with the effects of these files, each in its place. BadInput."""
    for entry in entry_points(group=GROUP):
        library = _with(f"entry point {entry.name} of {GROUP}", _loaded(entry), tuple(library))
    for path in paths:
        library = _with(path, _run(path), tuple(library))
    return library if isinstance(library, tuple) else tuple(library)


def named(
    library: tuple[Effect, ...], names: Iterable[str] | None, kept: Iterable[str], where: str, field: str
) -> tuple[Effect, ...]:
    """The effects of a library that are always on, those among `names` (None: all), and those `kept` for a given model.
    BadInput, from `where` and its `field`, for unknown names."""
    if names is None:
        return library
    chosen, known = list(names), [e.name for e in library if e.off is not None]
    if unknown := [name for name in chosen if name not in known]:
        allowed = f"names, separated by commas, of {', '.join(known)}{near(unknown[0], known)}"
        raise BadInput(where, field, ", ".join(unknown) or "none", allowed)
    return tuple(e for e in library if e.off is None or e.name in {*chosen, *kept})


def _loaded(entry: EntryPoint) -> Mapping:
    """The object of an entry point of an installed package."""
    try:
        found = entry.load()
    except Exception as error:  # somebody else's package may raise anything
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise BadInput(
            f"entry point {entry.name} of {GROUP}", entry.value, said, "an Effect, or a module with EFFECT"
        ) from error
    return vars(found) if isinstance(found, ModuleType) else {"EFFECT": found}


def _with(path: str | os.PathLike, content: Mapping, library: tuple[Effect, ...]) -> tuple[Effect, ...]:
    effect, names = content.get("EFFECT"), [e.name for e in library]
    if not isinstance(effect, Effect) or not effect.off or not effect.probe:
        found = "nothing" if effect is None else f"a {type(effect).__name__}"
        raise BadInput(path, "EFFECT", found, "a vpp_fmu.kernel.types.Effect with off and probe")
    if effect.name in names or not effect.name.isidentifier():
        raise BadInput(path, "EFFECT, name", repr(effect.name), "a name that no other effect has, of letters, digits and _")
    for name, kind in (("parameters", Parameter), ("states", State), ("inputs", Signal)):
        listed = getattr(effect, name)
        if not isinstance(listed, tuple) or not all(isinstance(each, kind) for each in listed):
            raise BadInput(path, f"EFFECT, {name}", _brief(listed), f"a tuple of vpp_fmu.kernel.types.{kind.__name__}")
    quantities: tuple[Parameter | State | Signal, ...] = (*effect.parameters, *effect.states, *effect.inputs)
    for quantity in quantities:
        for field in fields(quantity):
            given = getattr(quantity, field.name)
            if field.type in KINDS and not isinstance(given, KINDS[field.type]):
                raise BadInput(
                    path, f"EFFECT, {_brief(quantity.name)}, {field.name}", _brief(given), KINDS[field.type][0].__name__
                )
        check_unit(path, f"EFFECT, {quantity.name}, unit", quantity.unit)
    for name in ("off", "probe"):
        given = getattr(effect, name)
        if not isinstance(given, Mapping) or not all(isinstance(value, float | int) for value in given.values()):
            raise BadInput(path, f"EFFECT, {name}", _brief(given), "the numbers of parameters by their names")
    try:
        effect.says.format_map(dict.fromkeys((q.name for q in effect.parameters), ""))
    except (AttributeError, KeyError, ValueError) as error:
        allowed = f"a sentence with parameters in braces, of {', '.join(q.name for q in effect.parameters)}"
        raise BadInput(path, "EFFECT, says", f"{_brief(effect.says)} ({error})", allowed) from error
    port, before = content.get("PORT"), content.get("BEFORE")
    if port is not None:
        if port not in tuple(PORTS):
            raise BadInput(path, "PORT", repr(port), f"one of {', '.join(PORTS)}")
        whole = placed(library, effect, PORTS[port])
    else:
        if before is not None and before not in names:
            raise BadInput(path, "BEFORE", repr(before), f"one of {', '.join(names)}")
        at = len(library) if before is None else names.index(before)
        whole = (*library[:at], effect, *library[at:])
    trial = Trial(effect, whole)
    try:
        declared(trial)
    except Broken as why:
        raise BadInput(path, "EFFECT", str(why), "parameters, off and probe within bounds, each described") from why
    check_traced(str(path), trial.model)
    return whole


def _brief(found: object) -> str:
    text = " ".join(repr(found).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def _run(path: str | os.PathLike) -> dict:
    """The global names that a Python file defines."""
    read_text(path)  # whether there is such a file, and it is text
    spec = importlib.util.spec_from_file_location("own_effects", path)
    if spec is None or spec.loader is None:
        raise BadInput(path, "file", "not a Python file", "a file that ends in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # it is anybody's code, and may fail in any way
        raise BadInput(
            path, "file", f"{type(error).__name__}: {error}".splitlines()[0], "Python that defines EFFECT"
        ) from error
    return vars(module)
