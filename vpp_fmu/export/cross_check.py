"""Inputs and reference outputs of an FMU, by the FMI cross-check rules, for users to test importers with."""

from collections.abc import Iterable, Mapping, Sequence

from vpp_fmu.errors import BadInput
from vpp_fmu.export.description import Experiment
from vpp_fmu.kernel.schedule import DelayFull
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import INTEGER, REAL, STRING, Model, Signal

LEVELS = (0.6, 0.35, 0.8, 0.5)  # of an input's nominal value
TOLERANCE = 1e-6
LONGEST = 10.0  # s; long enough to show an importer's errors


def reference_files(model: Model, values: Mapping[str, float], experiment: Experiment) -> dict[str, str]:
    """`{name}_in.csv`, `{name}_ref.csv`, `{name}_ref.opt` by name, from the model's own functions.

    Each input starts at its start value and takes a few levels in turn, at different times than the other inputs.
    """
    count = round(min(experiment.stop, LONGEST) / experiment.step)
    simulation, held = Simulation(model, values), course(model, count)
    shown = [simulation.start(held[0])]
    for k, inputs in enumerate(held[:-1]):
        try:
            shown.append(simulation.advance(inputs, experiment.step))
        except (ArithmeticError, ValueError, DelayFull) as error:
            found = f"{type(error).__name__} ({error}) at {k * experiment.step:.6g} s"
            raise BadInput(model.name, "the run for the reference outputs", found, "numbers") from error
    time = [i * experiment.step for i in range(count + 1)]
    options = {"StartTime": 0.0, "StopTime": time[-1], "StepSize": experiment.step, "RelTol": TOLERANCE}
    return {
        f"{model.name}_in.csv": _csv(model.inputs, time, held),
        f"{model.name}_ref.csv": _csv(model.outputs, time, shown),
        f"{model.name}_ref.opt": "".join(f"{name}, {value!r}\n" for name, value in options.items()),
    }


COMMAND = (
    "fmpy simulate {name}.fmu --input-file {name}_in.csv --stop-time {stop:g} --output-interval {step:g}"
    " --output-file {name}_out.csv"
)
READ_ME = """# {name}: how to check an importer against it

`{name}_ref.csv` holds the outputs at each communication point under the inputs of `{name}_in.csv`, from the model's own
functions; `{name}_ref.opt` holds start, stop and step. fmpy meets them:

    {command}

The inputs are discrete: each row's values hold from its time to the next row's, and act in the step that begins there.

- FMU Compliance Checker (fmuCheck 2.0.4) fills discrete inputs from the first column of the table, which is time: its outputs
  differ from `{name}_ref.csv` through no fault of the FMU. Run it without `-i`, which checks the calls and the description, and
  take fmpy or any other importer for the numbers.
- An importer that interpolates inputs, continuous ones being its only kind, meets the values within a step of each change only.
"""


def cross_check_folder(
    name: str, experiment: Experiment, references: Mapping[str, str], fmu: bytes, tool: str, platform: str
) -> dict[str, bytes]:
    """The files that the FMI project's cross-check requires of an exporting tool, by path in its repository: a model's FMU,
    its reference files, and how to check them. `tool`: name and version as folders; `platform`: FMI 2.0's name."""
    stop = round(min(experiment.stop, LONGEST) / experiment.step) * experiment.step
    read_me = READ_ME.format(name=name, command=COMMAND.format(name=name, stop=stop, step=experiment.step))
    files = {f"{name}.fmu": fmu, "README.md": read_me.encode()} | {file: text.encode() for file, text in references.items()}
    return {f"fmus/2.0/cs/{platform}/{tool}/{name}/{file}": content for file, content in files.items()}


def course(model: Model, count: int) -> list[dict[str, float]]:
    """The inputs by name at each of `count` + 1 communication points."""
    return [{u.name: _level(u, k, i / count) for k, u in enumerate(model.inputs)} for i in range(count + 1)]


def _level(u: Signal, k: int, share: float) -> float:
    """Input number `k` at a share of the time. A Boolean and the first items alternate, an Integer has whole numbers."""
    if u.kind == STRING:
        return u.start
    at = int(len(LEVELS) * share - 0.1 - 0.3 * k)
    if len(LEVELS) * share < 0.1 + 0.3 * k:
        return u.start
    level = LEVELS[(at + k) % len(LEVELS)]
    wanted = u.nominal * level if u.kind == REAL else round(u.nominal * level) if u.kind == INTEGER else at % 2 + bool(u.items)
    return float(min(max(wanted, u.minimum), u.maximum))


def _csv(signals: Sequence[Signal], time: Iterable[float], rows: Iterable[Mapping[str, float]]) -> str:
    names = [s.name for s in signals]
    lines = [",".join(f'"{name}"' for name in ("time", *names))]
    whole = {s.name for s in signals if s.kind != REAL}
    lines += [
        ",".join([repr(t), *(str(round(row[n])) if n in whole else repr(row[n]) for n in names)])
        for t, row in zip(time, rows, strict=True)
    ]
    return "\n".join(lines) + "\n"
