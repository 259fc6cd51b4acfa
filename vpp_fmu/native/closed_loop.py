"""The closed loop of `vpp_fmu.loop` in one compiled function: plant, measurement chain and controller over a profile.

For searches and many sets of parameters. The numbers equal those of `vpp_fmu.loop.run` to the bit.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.schedule import FULL, DelayFull
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.native.part import CompiledPart, InterpretedPart
from vpp_fmu.native.simulator import _say_once
from vpp_fmu.record import Record, held

JUMP = 0.05
"""Changes of the wanted thrust below this share of its span are not evaluated as steps."""

ROW = ("omega_ref", "beta_ref", "thrust", "omega", "beta")
"""Outputs of a run at each communication point."""

FAILURES = {1: "out of memory", 2: FULL}


@dataclass(frozen=True, eq=False)
class Course:
    """Inputs of a loop: `wanted` thrust and `noise` of its reading (points,) N, one communication point every `dt` seconds. The
    plant is at rest on the commands `rest` [rpm, deg] before. Errors are divided by `scale` [N]."""

    wanted: np.ndarray
    noise: np.ndarray
    dt: float
    scale: float
    rest: tuple[float, float] = (0.0, 0.0)

    @property
    def jump(self) -> float:
        """Minimum change of `wanted` that counts as a step, N."""
        return JUMP * float(np.ptp(self.wanted))

    @classmethod
    def of(cls, references: Record, dt: float, scale: float, noise: np.ndarray | None = None, **more) -> "Course":
        """The course of a profile (`time` [s], `thrust_set` [N], each held to the next row), as in `vpp_fmu.loop.run`."""
        _, wanted = held(references, dt)
        return cls(wanted, np.zeros(len(wanted)) if noise is None else noise, dt, scale, **more)


class ClosedLoop:
    """A plant with the project's controller, or another of its inputs and outputs, ready to run. Measured inputs of the
    plant's effects keep their start values."""

    def __init__(self, plant: Model, controller: Model = CONTROLLER):
        if len(plant.outputs) != len(ROW) - 2:
            raise ValueError(f"a plant with {[y.name for y in plant.outputs]}: the loop has room for {ROW[2:]}")
        self.models = plant, MEASUREMENT, controller
        self._extra = tuple(plant.measured_inputs.values())
        memo, made = plant.memo, ("closed_loop", id(controller))  # the runner keeps the controller, and so its id
        if made not in memo:
            memo[made] = _runner(self.models)
        self._run = memo[made]

    def vectors(self, plant: Mapping, chain: Mapping, gains: Mapping) -> tuple[np.ndarray, ...]:
        """Complete parameter sets (parameters,) of plant, measurement chain and controller, from changes to the defaults."""
        changes = zip(self.models, (plant, chain, gains), strict=True)
        return tuple(np.array(list(model.values(change).values())) for model, change in changes)

    def run(self, sets: Sequence[np.ndarray], course: Course) -> Record:
        """One run with the sets of `vectors`, as the record of `vpp_fmu.loop.run`. SimulationFailed."""
        rows = self.rows(sets, course)[1]
        time = np.arange(len(rows)) * course.dt
        columns = dict(zip(ROW, rows.T, strict=True))
        return Record({"time": time, "thrust_set": course.wanted, **columns}, source="closed loop")

    def rows(self, sets: Sequence[np.ndarray], course: Course) -> tuple[np.ndarray, np.ndarray]:
        """One run: its `merits` (2,), and its outputs at each communication point (points, ROW). SimulationFailed."""
        merits, rows = np.empty((1, 2)), np.empty((len(course.wanted), len(ROW)))
        self._run(_batch(sets), course, (*course.rest, *self._extra), merits, rows)
        return merits[0], rows

    def merits(self, sets: Sequence[np.ndarray], course: Course) -> np.ndarray:
        """(count, 2), one row for each row of the sets, which are (count, parameters) or shared. The columns are the integral
        of the squared error over `scale` [s], and the largest overshoot of a step as a share of it. SimulationFailed.

        Infinite if a run diverged.
        """
        sets = _batch(sets)
        merits = np.empty((max(len(each) for each in sets), 2))
        self._run(sets, course, (*course.rest, *self._extra), merits, None)
        return merits


def _batch(sets: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.ascontiguousarray(np.atleast_2d(each), float) for each in sets]


def _runner(models: Sequence[Model]):
    try:
        return _compiled(models)
    except CompilerMissing as missing:
        _say_once(str(missing))
        return _interpreted(models)


class _Profile(ctypes.Structure):
    _fields_ = (
        ("points", ctypes.c_long),
        ("dt", ctypes.c_double),
        ("scale", ctypes.c_double),
        ("jump", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("wanted", "noise", "rest")),
        ("inputs", ctypes.c_long),
    )


def _compiled(models: Sequence[Model]):
    parts = [_part(model) for model in models]
    run_loops = compiled((files("vpp_fmu.native") / "loop.c").read_text()).run_loops
    pointers, longs, vector = ctypes.c_void_p * 3, ctypes.c_long * 3, ctypes.c_void_p
    run_loops.argtypes = [vector, pointers, longs, ctypes.c_long, ctypes.POINTER(_Profile), vector, vector]
    table = (ctypes.c_void_p * 9)(*(address for part in parts for address in part.addresses))

    def run(sets, course, inputs, merits, rows):
        wanted, noise = (np.ascontiguousarray(column, float) for column in (course.wanted, course.noise))
        if len(noise) != len(wanted):
            raise SimulationFailed(f"closed loop: noise: found {len(noise)} values, expected {len(wanted)}")
        rest = np.array(inputs)
        pointed = (each.ctypes.data for each in (wanted, noise, rest))
        profile = _Profile(len(wanted), course.dt, course.scale, course.jump, *pointed, len(rest))
        strides = longs(*(each.shape[1] if len(each) > 1 else 0 for each in sets))
        starts = pointers(*(each.ctypes.data for each in sets))
        shown = None if rows is None else rows.ctypes.data
        if code := run_loops(table, starts, strides, len(merits), profile, merits.ctypes.data, shown):
            raise SimulationFailed(f"closed loop of {models[0].name}: {FAILURES[code]}")

    return run


def _part(model: Model) -> CompiledPart:
    if "part" not in model.memo:
        model.memo["part"] = CompiledPart(model)
    return model.memo["part"]


def _interpreted(models: Sequence[Model]):
    plant, chain, controller = (InterpretedPart(model) for model in models)

    def run_one(sets, course, inputs, rows):
        sample, total, change, over = plant.begin(sets[0], inputs), 0.0, 0.0, 0.0
        (reading,) = chain.begin(sets[1], (sample[0], 0.0))
        controller.begin(sets[2], (course.wanted[0], reading))
        before = course.wanted[0]
        for k, (wanted, noise) in enumerate(zip(course.wanted.tolist(), course.noise.tolist(), strict=True)):
            (reading,) = chain.advance((sample[0], noise), course.dt)
            commands = controller.advance((wanted, reading), course.dt)
            if rows is not None:
                rows[k] = *commands, *sample
            if wanted != before:
                change, before = (wanted - before if abs(wanted - before) >= course.jump else 0.0), wanted
            over = max(over, (sample[0] - wanted) / change) if change else 0.0
            if k + 1 == len(course.wanted):
                return total * course.dt, over
            e = (wanted - sample[0]) / course.scale
            total += e * e
            sample = plant.advance((*commands, *inputs[2:]), course.dt)

    def run(sets, course, inputs, merits, rows):
        for n in range(len(merits)):
            own = [each[n if len(each) > 1 else 0].tolist() for each in sets]
            try:
                merits[n] = run_one(own, course, inputs, rows)
            except DelayFull as full:
                raise SimulationFailed(f"closed loop of {models[0].name}: {full}") from full
            except (OverflowError, ZeroDivisionError, ValueError):
                merits[n] = np.inf

    return run
