"""The Python FMU: one generated file under pythonfmu."""

import ast
import sys
import tempfile
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from pythonfmu import FmuBuilder

from vpp_fmu.export.archive import archive, contents
from vpp_fmu.export.description import TEN_SECONDS, Experiment, guid, model_description, variable_names
from vpp_fmu.kernel.types import Model
from vpp_fmu.tracer import Layout, python_source, trace


def python_fmu(model: Model, parameters: Mapping[str, float] | None = None, experiment: Experiment = TEN_SECONDS) -> bytes:
    """An FMU of `model` that runs under Python; its bytes depend on the arguments and versions alone.

    `parameters`: changes to the defaults (KeyError names an unknown one); they become the start values.
    """
    values = model.values(parameters)
    source = module_source(model, values)
    # Python modules share one namespace in a process: the name must tell apart whatever differs in content.
    module = f"{model.name.lower()}_{sha256(source.encode()).hexdigest()[:16]}"
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder, f"{module}.py")
        script.write_text(source, encoding="utf-8")
        try:
            built = contents(FmuBuilder.build_FMU(script, dest=folder))
        finally:  # the builder imports the script and leaves its folder on the path
            sys.modules.pop(module, None)
            sys.path[:] = [entry for entry in sys.path if Path(entry) != Path(folder)]
    tool = f"pythonfmu {version('pythonfmu')}"
    built["modelDescription.xml"] = model_description(model, values, guid(source + tool + repr(experiment)), tool, experiment)
    return archive(built)


def module_source(model: Model, values: Mapping[str, float]) -> str:
    """The one file that travels: schedule, slave, generated functions and the class that ties them."""
    program, layout = trace(model), Layout.of(model)
    at = layout.index
    ways = {True: "Sampled", False: "Scheduled" if _has_schedule(model) else "Exact"}
    start = [*(u.start for u in model.inputs), *[0.0] * len(layout.outputs), *(values[n] for n in layout.parameters)]
    declared = {
        "NAME": model.name,
        "VARIABLES": tuple(variable_names(model)),
        "START": (*start, *[0.0] * len(layout.states)),
        "RANGES": tuple((p.minimum, p.maximum, p.unit) for p in model.parameters),
        "N_INPUTS": len(layout.inputs),
        "N_OUTPUTS": len(layout.outputs),
        "N_PARAMETERS": len(layout.parameters),
        "DELAYS": tuple((at["input", u], at["parameter", p]) for u, p in model.delays),
        "SAMPLE_TIME": at["parameter", model.sample_time] if model.sample_time else None,
    }
    functions = ("start", "prepare", "step", "largest_step")
    lines = [f"class {model.name}({ways[model.sample_time is not None]}, TracedSlave):", f"    {model.description!r}", ""]
    lines += [f"    {name} = {value!r}" for name, value in declared.items()]
    lines += [f"    {name} = staticmethod({name})" for name in functions]
    return "\n\n".join(
        (
            _text("vpp_fmu.kernel", "schedule.py"),
            _text("fmu_src", "slave.py"),
            "from math import cos, exp, expm1, sin, sqrt, tanh\n",
            python_source(program),
            "\n".join(lines) + "\n",
        )
    )


def _has_schedule(model: Model) -> bool:
    return bool(model.delays) or any(e.largest_step is not None for e in model.effects)


def _text(package: str, name: str) -> str:
    """A source file without its imports of this project: what they bring stands in the same file."""
    text = (files(package) / name).read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    for statement in ast.parse(text).body:
        if isinstance(statement, ast.ImportFrom) and statement.module.startswith("vpp_fmu"):
            for i in range(statement.lineno - 1, statement.end_lineno):
                lines[i] = ""
    return "".join(lines)
