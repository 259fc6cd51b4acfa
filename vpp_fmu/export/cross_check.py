"""Inputs and the outputs they must give, beside an FMU, as the FMI cross-check rules ask: for users to test importers with."""

from collections.abc import Iterable, Mapping

from vpp_fmu.export.description import Experiment
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model, Signal

LEVELS = (0.6, 0.35, 0.8, 0.5)  # of an input's nominal value
TOLERANCE = 1e-6
LONGEST = 10.0  # s; enough to see an importer go wrong


def reference_files(model: Model, values: Mapping[str, float], experiment: Experiment) -> dict[str, str]:
    """`{name}_in.csv`, `{name}_ref.csv`, `{name}_ref.opt` by name, from the model's own functions.

    Each input starts at its start value and takes a few levels in turn, at other times than the other inputs.
    """
    count = round(min(experiment.stop, LONGEST) / experiment.step)
    simulation = Simulation(model, values)
    held = [{u.name: _level(u, k, i / count) for k, u in enumerate(model.inputs)} for i in range(count + 1)]
    shown = [simulation.start(held[0]), *(simulation.advance(inputs, experiment.step) for inputs in held[:-1])]
    time = [i * experiment.step for i in range(count + 1)]
    options = {"StartTime": 0.0, "StopTime": time[-1], "StepSize": experiment.step, "RelTol": TOLERANCE}
    return {
        f"{model.name}_in.csv": _csv(model.inputs, time, held),
        f"{model.name}_ref.csv": _csv(model.outputs, time, shown),
        f"{model.name}_ref.opt": "".join(f"{name}, {value!r}\n" for name, value in options.items()),
    }


def _level(u: Signal, k: int, share: float) -> float:
    """Input number `k` at a share of the time."""
    at = int(len(LEVELS) * share - 0.1 - 0.3 * k)
    if len(LEVELS) * share < 0.1 + 0.3 * k:
        return u.start
    return min(max(u.nominal * LEVELS[(at + k) % len(LEVELS)], u.minimum), u.maximum)


def _csv(signals: Iterable[Signal], time: Iterable[float], rows: Iterable[Mapping[str, float]]) -> str:
    names = [s.name for s in signals]
    lines = [",".join(f'"{name}"' for name in ("time", *names))]
    lines += [",".join([repr(t), *(repr(row[n]) for n in names)]) for t, row in zip(time, rows, strict=True)]
    return "\n".join(lines) + "\n"
