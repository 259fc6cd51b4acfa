"""Documentation of an FMU: a page with equations and parameters, licences, an icon."""

import importlib
import inspect
from collections.abc import Iterable, Mapping
from html import escape
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent

from vpp_fmu.files import as_bytes
from vpp_fmu.kernel.types import REAL, Effect, Model, Parameter, Signal, no_step

EFFECTS = "vpp_fmu.kernel.effects"

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.25em .6em;border-bottom:1px solid #ddd;"
    "vertical-align:top}pre{background:#f4f4f2;padding:.8em;overflow:auto}"
)

USE = """\
Initialise on the commands that stand: the model starts at rest on the inputs at the end of the initialisation, so that a
record that begins in the middle of things has no artificial transient. Without any input set, it starts on the start values.
A state that is set before that (`state.NAME`) begins there instead. A sampled law has not run yet then: its first outputs are
start values.

Inputs are held over a communication step and act in it; at a communication point no output depends on an input directly. A
step begins where the last one ended, and holds 100 000 of the model's own steps at most.

Parameters can be set until the initialisation ends, tunable ones at any time, within the ranges below. States can be read,
saved and restored.

A call that can't be carried out is refused after one message that says why. Values can still be read then, and a reset or a
saved state brings the instance back. Natively that is fmi2Error; pythonfmu's binary makes it fmi2Fatal.

In the native flavour, directional derivatives of outputs and states are given with respect to inputs and parameters in
initialisation mode. At a communication point those with respect to inputs are zero, as outputs depend on them in the next step
only. If a derivative with respect to any parameter was asked for in initialisation mode, they are carried along from then on,
which costs time at each step: those with respect to parameters since the start, those with respect to inputs over the last
communication step. There is no early return, event mode, intermediate update or adjoint derivative."""


def documents(
    model: Model, values: Mapping[str, float], origins: Mapping[str, str] | None = None, packages: Iterable[str] = ()
) -> dict[str, bytes]:
    """The files by their place in an FMU.

    `values`: every parameter's start value. `origins`: known sources of values, by name; the others are defaults, or were set
    at the export. `packages`: other packages whose code is in the FMU beside this one's, with their licences.
    """
    licences = {f"documentation/licenses/{name}.txt": _licence(name).encode() for name in ("vpp-fmu", *packages)}
    icon = Path(__file__).with_name("propeller.png") if model.icon == "propeller" else model.icon
    pictures = {"model.png": Path(icon).read_bytes()} if icon else {}
    said = "\n\n".join(filter(None, (model.copyright, model.license and f"Licence: {model.license}")))
    return {
        "documentation/index.html": as_bytes(_page(model, values, origins or {})),
        **({"documentation/licenses/license.txt": as_bytes(said + "\n")} if said else {}),
        **licences,
        **pictures,
    }


def _page(model: Model, values: Mapping[str, float], origins: Mapping[str, str]) -> str:
    def signals(kind, quantities):
        return [(q.name, kind, _unit(q), f"{q.minimum:g} to {q.maximum:g}", q.description) for q in quantities]

    parameters = [
        (
            p.name,
            repr(values[p.name]),
            _unit(p),
            f"{p.minimum:g} to {p.maximum:g}{', tunable' * p.tunable}",
            _origin(model, p, values, origins),
            p.description,
        )
        for p in model.parameters
    ]
    states = [(f"state.{x.name}", x.unit, x.description) for x in model.states]
    parts = [
        f"<h1>{escape(model.name)}</h1><p>{escape(model.description)}</p>",
        "<h2>Variables</h2>",
        _table(("name", "", "unit", "range", "meaning"), signals("input", model.inputs) + signals("output", model.outputs)),
        "<h2>Use</h2>",
        _prose(USE),
        "<h2>Equations</h2><p>In the order in which they act.</p>",
        *_equations(model),
        "<h2>Parameters</h2>",
        _table(("name", "value", "unit", "range", "origin", "meaning"), parameters),
        "<h2>States</h2>",
        _table(("name", "unit", "meaning"), states),
    ]
    head = f'<meta charset="utf-8"><title>{escape(model.name)}</title><style>{STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(parts) + "\n</body></html>\n"


def _unit(q: Signal | Parameter) -> str:
    return q.unit if q.kind == REAL else q.kind


def _origin(model: Model, parameter, values: Mapping[str, float], origins: Mapping[str, str]) -> str:
    value = values[parameter.name]
    if parameter.name in origins:
        return origins[parameter.name]
    if value != parameter.default:
        return "set at the export"
    named = [name for name, given in model.sets.items() if given.get(parameter.name) == value]
    return f"default ({named[0].replace('_', ' ')} set)" if named else "default"


def _equations(model: Model) -> list[str]:
    """One part for each file that defines effects, with its docstring."""
    parts: dict[str, list[str]] = {}
    if model.black_box is not None:
        parts[inspect.getdoc(model.black_box) or model.description] = [model.black_box.__name__]
    for effect in model.effects:
        parts.setdefault(_theory(effect), []).append(effect.name)
    return [f"<h3>{escape(', '.join(names))}</h3>{_prose(text)}" for text, names in parts.items()]


def _theory(effect: Effect) -> str:
    """The docstring of the file with an effect's equation, of the library or user-defined; a delay has no equation."""
    function = effect.derivative or (effect.step if effect.step is not no_step else effect.output)
    if function is not None:
        return inspect.unwrap(function).__globals__.get("__doc__") or effect.description
    own = f"{EFFECTS}.{effect.name}"
    return (find_spec(own) and importlib.import_module(own).__doc__) or effect.description


def _prose(text: str) -> str:
    """Paragraphs; equations, which are indented or have an equals sign in each line, unchanged."""
    out = []
    for part in text.strip("\n").split("\n\n"):
        equations = all(line.startswith("    ") or " = " in line for line in part.split("\n"))
        out.append(f"<pre>{escape(dedent(part))}</pre>" if equations else f"<p>{escape(part)}</p>")
    return "\n".join(out)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    def row(cells, tag):
        return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"

    return "<table>\n" + row(head, "th") + "\n" + "\n".join(row(cells, "td") for cells in rows) + "\n</table>"


def _licence(package: str) -> str:
    """The licence of an installed package."""
    for file in distribution(package).files or ():
        if file.name == "LICENSE":
            return file.read_text(encoding="utf-8")
    raise LookupError(f"{package} was installed without its licence")
