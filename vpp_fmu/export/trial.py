"""Test an FMU before it is written: an importer reads it, and its outputs are compared with the model's functions."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from vpp_fmu.errors import BadInput, SimulationFailed
from vpp_fmu.export.cross_check import LEVELS, TOLERANCE, course
from vpp_fmu.export.description import Experiment
from vpp_fmu.fmu import Fmu, FmuInstance, problems, steps_in_fmi_3
from vpp_fmu.kernel.schedule import DelayFull
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import BOOLEAN, INTEGER, STRING, Model
from vpp_fmu.scratch import Scratch

STEPS = 100


def expected(where: str, model: Model, values: Mapping[str, float], experiment: Experiment) -> list[list[float]]:
    """The outputs of the model's own functions at STEPS + 1 communication points. BadInput if they are not finite."""
    held, shown = course(model, STEPS), []
    try:
        simulation = Simulation(model, values)
        shown.append(list(simulation.start(held[0]).values()))
        for inputs in held[:-1]:
            shown.append(list(simulation.advance(inputs, experiment.step).values()))
    except (ArithmeticError, ValueError, DelayFull) as error:
        inputs = held[max(len(shown) - 1, 0)]
        found = f"{type(error).__name__} ({error}) in step {len(shown)} with {_words(inputs)}"
        raise BadInput(where, "the first 100 steps", found, "numbers") from error
    for k, row in enumerate(shown):
        for output, value in zip(model.outputs, row, strict=True):
            found = f"{value} after step {k} with {_words(held[max(k - 1, 0)])}"
            if value - value != 0.0:
                raise BadInput(where, "the first 100 steps", f"{output.name} = {found}", "finite numbers")
            if output.kind == BOOLEAN and value not in (0.0, 1.0):
                raise BadInput(where, f"output {output.name}", found, "0 or 1, since it is a Boolean")
            if output.items and value not in range(1, len(output.items) + 1):
                raise BadInput(where, f"output {output.name}", found, f"1 to {len(output.items)}, the number of its item")
            if output.kind == INTEGER and value != round(value):
                raise BadInput(where, f"output {output.name}", found, "whole numbers, since it is an Integer")
    return shown


COMMUNICATION_STEPS = (0.004, 0.4, 40.0)
"""s; of loops with rigs, of vehicles, of buildings."""


def step_dependence(model: Model, values: Mapping[str, float]) -> str:
    """Difference, in words, between one step and two half steps of a model that declares no largest step. "": both agree to
    TOLERANCE of an output's nominal value, or the model declares its steps."""
    if model.sample_time is not None or any(e.largest_step is not None or e.sample_time for e in model.effects):
        return ""
    for step in COMMUNICATION_STEPS:
        simulations = [Simulation(model, values), Simulation(model, values)]
        for inputs in course(model, 2 * len(LEVELS)):
            try:
                whole = simulations[0].advance(inputs, step)
                halves = [simulations[1].advance(inputs, 0.5 * step) for _ in range(2)][-1]
            except (ArithmeticError, ValueError, DelayFull):
                break  # such long steps give no finite numbers
            for s in model.outputs:
                one, two = whole[s.name], halves[s.name]
                if abs(one - two) > TOLERANCE * max(s.nominal, abs(two)):
                    unit = "" if s.unit == "1" else f" {s.unit}"
                    return f"{s.name} is {one:.6g}{unit} by one step of {step:g} s, {two:.6g}{unit} by two of {0.5 * step:g} s"
    return ""


def try_fmu(where: str, model: Model, values: Mapping[str, float], experiment: Experiment, fmu: bytes, fmi: str) -> None:
    """BadInput if fmpy rejects the FMU, or if its outputs differ from the functions', compared to the bit."""
    held, numbers = course(model, STEPS), [k for k, s in enumerate(model.outputs) if s.kind != STRING]
    exact = [[row[k] for k in numbers] for row in expected(where, model, values, experiment)]
    scratch = Scratch()
    path = Path(scratch.path, f"{model.name}.fmu")
    try:
        path.write_bytes(fmu)
        for problem in problems(path):
            raise BadInput(where, "fmpy validate", " ".join(problem.split()), "an FMU without a problem")
        shown = _stepped(path, model, held, experiment.step) if fmi == "2.0" else _simulated(path, model, held, experiment.step)
    except SimulationFailed as failure:
        raise BadInput(
            where, "the first 100 steps", str(failure).removeprefix(f"{path}: "), "steps that are taken"
        ) from failure
    finally:
        scratch.close()
    for k, (found, right) in enumerate(zip(shown, exact, strict=True)):
        if found != right:
            raise BadInput(where, "the first 100 steps", f"{found} after step {k}", f"{right}, as the functions have it")


def _stepped(path: Path, model: Model, held: Sequence[Mapping[str, float]], step: float) -> list[list[float]]:
    names = [u.name for u in model.inputs if u.kind != STRING]
    with contextlib.closing(Fmu(path)) as unpacked:
        instance = FmuInstance(unpacked, names, [s.name for s in model.outputs if s.kind != STRING])
        shown = [instance.start([held[0][n] for n in names])]
        take = instance.stepper(step)
        shown += [take([inputs[n] for n in names]) for inputs in held[:-1]]
        instance.close()
    return shown


def _simulated(path: Path, model: Model, held: Sequence[Mapping[str, float]], step: float) -> list[list[float]]:
    """FMI 3.0 has vectors as arrays."""
    given, shown = (
        [
            (s.name, s.size) if not s.place else (s.name.removesuffix("[1]"), s.size)
            for s in signals
            if s.kind != STRING and s.place < 2
        ]
        for signals in (model.inputs, model.outputs)
    )
    arrays = [
        {name: tuple(inputs[f"{name}[{i}]"] for i in range(1, size + 1)) if size else inputs[name] for name, size in given}
        for inputs in held
    ]
    return steps_in_fmi_3(path, arrays, step, [name for name, _ in shown]).tolist()


def _words(inputs: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in inputs.items()) or "no inputs"
