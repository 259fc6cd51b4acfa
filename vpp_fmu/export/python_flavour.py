"""The Python FMU: one generated file under pythonfmu."""

import ast
import inspect
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import distribution, version
from importlib.resources import files
from pathlib import Path

from vpp_fmu.export.archive import archive
from vpp_fmu.export.c_text import is_exact
from vpp_fmu.export.description import (
    TEN_SECONDS,
    Experiment,
    Flavour,
    allowed,
    guid,
    in_unit,
    model_description,
    start_values,
    variable_names,
    variable_types,
)
from vpp_fmu.export.documentation import documents
from vpp_fmu.export.location import decoding
from vpp_fmu.kernel.types import Model
from vpp_fmu.tracer import Layout, python_source, trace


def python_fmu(
    model: Model,
    parameters: Mapping[str, float] | None = None,
    experiment: Experiment = TEN_SECONDS,
    origins: Mapping[str, str] | None = None,
) -> bytes:
    """An FMU of `model` that runs under Python; its bytes depend on the arguments and versions alone.

    `parameters`: changes to the defaults (KeyError names an unknown one); they become the start values. `origins`: sources of
    values, by name, for the FMU's documentation.
    """
    values = model.values(parameters)
    source, packed = module_source(model, values), {}
    if model.black_box is not None:
        name, text = black_box_file(model)
        packed[f"resources/{name}.py"] = text.encode()
    # Python modules share one namespace in a process, so modules of different content need different names.
    module = f"{model.name.lower()}_{sha256(source.encode()).hexdigest()[:16]}"
    flavour = Flavour(f"pythonfmu {version('pythonfmu')}", {"needsExecutionTool": True})
    identity = guid(source, model_description(model, values, "", flavour, experiment))
    return archive(
        {
            "modelDescription.xml": model_description(model, values, identity, flavour, experiment),
            "resources/slavemodule.txt": module.encode(),
            # The binary executes its file for each instance and keeps the classes; an imported file is executed once.
            f"resources/{module}.py": f"from {module}_model import GeneratedSlave, own\n\nown(globals())\n".encode(),
            f"resources/{module}_model.py": source.encode(),
            **packed,
            **_pythonfmu(model.name),
            **documents(model, values, origins, packages=["pythonfmu"]),
        }
    )


def _pythonfmu(name: str) -> dict[str, bytes]:
    """pythonfmu's binaries and modules, by their place in an FMU.

    They are those that pythonfmu's builder packs, with a mend (`location`). The builder is not used: it takes the imported
    pythonfmu, which may be that of a loaded FMU, without binaries; and it runs the script once more.
    """
    folder = Path(distribution("pythonfmu").locate_file("pythonfmu"))
    modules = {f"resources/pythonfmu/{file.name}": file.read_bytes() for file in folder.glob("*.py")}
    libraries = [file for file in folder.glob("resources/binaries/*/*") if file.suffix in (".so", ".dll", ".dylib")]
    return modules | {f"binaries/{file.parent.name}/{name}{file.suffix}": decoding(file.read_bytes()) for file in libraries}


def module_source(model: Model, values: Mapping[str, float]) -> str:
    """The FMU's Python file: schedule, table of calls, slave, generated functions and their class."""
    layout = Layout.of(model)
    at = layout.index
    way = "BlackBox" if model.black_box else "Sampled" if model.sample_time else "Exact" if is_exact(model) else "Scheduled"
    declared = {
        "NAME": model.name,
        "VARIABLES": tuple(variable_names(model)),
        "TYPES": tuple(variable_types(model)),
        "ITEMS": (*(q.items for q in (*model.inputs, *model.outputs, *model.parameters)), *((),) * len(model.states)),
        "START": tuple(start_values(model, values)),
        "RANGES": tuple((p.minimum, p.maximum, in_unit(p), allowed(p)) for p in model.parameters),
        "TUNABLE": tuple(p.tunable for p in model.parameters),
        "N_INPUTS": len(layout.inputs),
        "N_OUTPUTS": len(layout.outputs),
        "N_PARAMETERS": len(layout.parameters),
        "DELAYS": tuple((at["input", u], at["parameter", p]) for u, p in model.delays),
        "SAMPLES": tuple((at["state", x], at["parameter", p]) for x, p in model.sampled),
        "SAMPLE_TIME": at["parameter", model.sample_time] if model.sample_time else None,
    }
    generated = _black_box(model) if model.black_box else python_source(trace(model))
    generated += f"\n\ndef total(v):\n    return {' + '.join(f'v[{i}]' for i in layout.moving)}\n"
    declared["TAG"] = sha256(repr((declared, generated)).encode()).hexdigest()[:16]
    generated, called = _alone(generated)
    functions = (
        ("start", "black_box", "total") if model.black_box else ("start", "prepare", "step", "largest_step", "show", "total")
    )
    lines = [f"class GeneratedSlave({way}, TracedSlave):", f"    {model.description!r}", ""]
    lines += [f"    {name} = {value!r}" for name, value in declared.items()]
    lines += [f"    {name} = staticmethod({name})" for name in ("start", *functions, "total")]
    return "\n\n".join(
        (
            _text("vpp_fmu.kernel", "schedule.py"),
            _text("vpp_fmu.kernel", "calls.py"),
            _text("fmu_src", "slave.py"),
            *(_text("vpp_fmu.kernel", f"{module.rpartition('.')[2]}.py") for module in called),
            generated,
            "\n".join(lines) + "\n",
        )
    )


def black_box_file(model: Model) -> tuple[str, str]:
    """Name and text of the module in which a model's black box is; the name depends on the text."""
    text = Path(inspect.getsourcefile(model.black_box)).read_text(encoding="utf-8")
    return f"{model.name.lower()}_box_{sha256(text.encode()).hexdigest()[:16]}", text


def _black_box(model: Model) -> str:
    """The functions of a model with a black box: outputs are start values until its first step."""
    first, starts = len(model.inputs), [float(y.start) for y in model.outputs]
    imported = f"from {black_box_file(model)[0]} import {model.black_box.__name__} as black_box\n"
    return f"{imported}\n\ndef start(v, d):\n    v[{first}:{first + len(starts)}] = {starts!r}\n"


def _text(package: str, name: str) -> str:
    """A source file without its imports of this project, whose code is in the same file."""
    return _alone((files(package) / name).read_text(encoding="utf-8"))[0]


def _alone(text: str) -> tuple[str, list[str]]:
    """Python text without its imports of this project, and the modules that it imported."""
    lines, modules = text.splitlines(keepends=True), []
    for statement in ast.parse(text).body:
        if isinstance(statement, ast.ImportFrom) and statement.module.startswith("vpp_fmu"):
            modules.append(statement.module)
            for i in range(statement.lineno - 1, statement.end_lineno):
                lines[i] = ""
    return "".join(lines), modules
