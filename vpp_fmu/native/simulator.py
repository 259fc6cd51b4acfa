"""Whole records through a traced model: compiled where there is a compiler, else as generated Python; the same numbers."""

import ctypes
import warnings
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.schedule import NUDGE, SLOTS, DelayFull, DelayLine, run_held, run_sampled
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled
from vpp_fmu.tracer import Program, c_source, python_source, trace


class Simulator:
    """A model ready to run records, with sensitivities in the parameters `wrt`."""

    def __init__(self, model: Model, wrt: Iterable[str] = ()):
        self.model, self.wrt = model, tuple(wrt)
        self._inputs = [s.name for s in model.inputs]
        self.outputs = tuple(s.name for s in model.outputs)
        memo, made = model.memo, ("simulator", self.wrt)
        if made not in memo:
            memo[made] = _runner(model, self.wrt)
        self._run = memo[made]

    def simulate(self, parameters: Mapping[str, float], inputs: Mapping[str, np.ndarray], steps: np.ndarray) -> np.ndarray:
        """Outputs (rows, outputs) at each row, sampled before the row's inputs act.

        `parameters`: changes to the defaults, by name. `inputs`: one array (rows,) for each of the model's inputs, held from
        its row to the next; measured ones that effects brought may be missing. `steps` (rows - 1,): seconds from row to row.
        """
        return self._go(parameters, inputs, steps)[0]

    def sensitivities(self, parameters, inputs, steps) -> tuple[np.ndarray, np.ndarray]:
        """As `simulate`, and the outputs' derivatives (rows, outputs, wrt) in the parameters `wrt`, exact to rounding."""
        return self._go(parameters, inputs, steps)

    def _go(self, parameters, inputs, steps):
        values = np.array(list(self.model.values(parameters).values()))
        inputs = {n: np.full(len(steps) + 1, v) for n, v in self.model.measured_inputs.items()} | dict(inputs)
        rows = {name: len(inputs[name]) for name in self._inputs}
        if set(rows.values()) != {len(steps) + 1}:
            told = ", ".join(f"{name} has {count}" for name, count in rows.items())
            raise SimulationFailed(f"{self.model.name}: {len(steps)} steps need {len(steps) + 1} rows, {told}")
        columns = np.column_stack([inputs[name] for name in self._inputs]).astype(float, order="C", copy=False)
        steps = np.ascontiguousarray(steps, float)
        outputs = np.empty((len(columns), len(self.outputs)))
        tangents = np.empty((len(columns), len(self.outputs), len(self.wrt)))
        self._run(values, columns, steps, outputs, tangents)
        return outputs, tangents


def _runner(model: Model, wrt: tuple[str, ...]):
    try:
        return _compiled(trace(model, wrt))
    except CompilerMissing as missing:
        _say_once(str(missing))
        return _interpreted(trace(model, wrt))


def _compiled(program: Program):
    source = c_source(program) + (files("vpp_fmu.kernel") / "schedule.c").read_text()
    source += (files("vpp_fmu.native") / "simulate.c").read_text()
    function = ctypes.CDLL(str(compiled(source))).simulate
    vector = np.ctypeslib.ndpointer(float, flags="C")
    function.argtypes = [vector, vector, vector, ctypes.c_long, vector, vector]
    failures = {1: "out of memory", 2: f"more than {SLOTS} command changes wait in one delay: take longer communication steps"}

    def run(values, inputs, steps, outputs, tangents):
        if code := function(values, inputs, steps, len(inputs), outputs, tangents):
            raise SimulationFailed(f"{program.model.name}: {failures[code]}")

    return run


def _interpreted(program: Program):
    layout, model = program.layout, program.model
    n_in, n_out, width = len(layout.inputs), len(layout.outputs), len(program.wrt)
    code: dict = {}
    exec("from math import exp, expm1, sqrt, sin, cos, tanh\n" + python_source(program), code)

    def run(values, inputs, steps, outputs, tangents):
        v = [*inputs[0].tolist(), *[0.0] * n_out, *values.tolist(), *[0.0] * len(layout.states)]
        d = [0.0] * (width * len(layout.moving))
        delays = [None] * n_in
        for name, parameter in model.delays:
            delays[layout.inputs.index(name)] = v[layout.index["parameter", parameter]]
        lines = [None if delay is None else DelayLine(u) for u, delay in zip(v, delays, strict=False)]
        largest = code["largest_step"](v)
        columns = [program.wrt.index(p) if p in program.wrt else None for _, p in model.delays]
        still = (0.0,) * len(columns)
        prepared = (None, None, None)

        def step(acting, dt, dt_tangent=still):
            nonlocal prepared
            v[:n_in] = acting
            if prepared[:2] != (dt, dt_tangent):
                prepared = dt, dt_tangent, code["prepare"](v, dt, dt_tangent)
            code["step"](v, prepared[2], d)

        def nudge(k, old, new):
            if columns[k] is None:
                return
            kept, tangents, gained = v[:], d[:], [0.0] * len(d)
            for acting, sign in ((old, 1.0), (new, -1.0)):
                d[:] = [0.0] * len(d)
                step(acting, NUDGE, tuple(sign if other == k else 0.0 for other in range(len(columns))))
                gained = [a + b for a, b in zip(gained, d, strict=True)]
                v[:] = kept
            d[:] = tangents
            for i in range(columns[k], len(d), width):
                d[i] += gained[i]

        code["start"](v, d)
        wait = 0.0
        for row, held in enumerate(inputs.tolist()):
            outputs[row] = v[n_in : n_in + n_out]
            tangents[row].flat = d[: n_out * width]
            if row == len(steps):
                return
            span = float(steps[row])
            if model.sample_time is None:
                try:
                    run_held(lines, delays, held, span, largest, step, nudge if width else None)
                except DelayFull as full:
                    raise SimulationFailed(f"{model.name}: {full}") from full
            else:
                period = v[layout.index["parameter", model.sample_time]]
                wait = run_sampled(wait, period, span, lambda dt, held=held: step(held, dt))

    return run


@cache
def _say_once(what: str) -> None:
    warnings.warn(f"{what}: the same numbers, more slowly, as generated Python", RuntimeWarning, stacklevel=3)
