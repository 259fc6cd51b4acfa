"""Simulate whole records with a traced model: compiled, or without a compiler as generated Python; the same numbers."""

import ctypes
import hashlib
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from importlib.resources import files
from weakref import WeakKeyDictionary

import numpy as np

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.kernel.effects import measured_speed
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.schedule import FULL, NUDGE, DelayFull, DelayLine, next_sample, run_held, run_sampled
from vpp_fmu.kernel.types import Model
from vpp_fmu.native.compiler import compiled, compiled_as
from vpp_fmu.record import FixedInputs
from vpp_fmu.tracer import LANES, Program, c_lanes, c_source, python_source, trace

PIECE = 4096
"""Rows per piece if a record's sensitivities need not be held at once: few enough for a core's cache, which is three times as
fast as memory, and enough to make the overhead of a piece negligible."""


class Simulator:
    """A model ready to run records, with sensitivities in the parameters `wrt`."""

    def __init__(self, model: Model, wrt: Iterable[str] = ()):
        self.model, self.wrt = model, tuple(wrt)
        self._inputs = tuple(s.name for s in model.inputs)
        self.outputs = tuple(s.name for s in model.outputs)
        self._run, self._side_by_side = _runner(_Chain(model), self.wrt)

    def simulate(
        self,
        parameters: Mapping[str, float],
        inputs: Mapping[str, np.ndarray],
        steps: np.ndarray,
        late: float = 0.0,
        tangents: Mapping[int, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Outputs (rows, outputs) at each row, sampled before the row's inputs act.

        `parameters`: changes to the defaults, by name. `inputs`: one array (rows,) for each of the model's inputs, held from
        its row to the next; those of effects may be missing. `steps` (rows - 1,): seconds from row to row. `late`: share of its
        row, from 0 to below 1, after which a command acts. `tangents`: arrays (rows, wrt), by the index of an output, that get
        its derivatives in the parameters `wrt`, exact to rounding.
        """
        outputs = np.empty((len(steps) + 1, len(self.outputs)))
        for _ in self._run_pieces(parameters, inputs, steps, late, outputs, tangents or {}):
            pass
        return outputs

    def simulate_all(
        self,
        points: Sequence[Mapping[str, float]],
        inputs: Mapping[str, np.ndarray],
        steps: np.ndarray,
        late: float = 0.0,
    ) -> np.ndarray:
        """The same for several sets of parameters: outputs (rows, outputs, points), equal to `simulate` to the bit.

        A step is a chain of dependent operations, so LANES parallel runs take little longer than one.
        """
        found = np.empty((len(self.outputs), len(steps) + 1, -(-len(points) // LANES) * LANES))
        done = np.zeros(found.shape[2] // LANES, bool)
        if self._side_by_side is not None and len(points) > 1:
            first, columns, seconds = self._prepared(points[0], inputs, steps)
            values = [first, *(np.array(list(self.model.values(point).values())) for point in points[1:])]
            values += values[-1:] * (found.shape[2] - len(points))
            self._side_by_side(np.array(values), columns, seconds, late, found, done)
        for k in np.flatnonzero(~np.repeat(done, LANES)[: len(points)]).tolist():
            found[:, :, k] = self.simulate(points[k], inputs, steps, late).T
        return np.moveaxis(found[:, :, : len(points)], 0, 1)

    def sensitivities(self, parameters, inputs, steps, late: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """As `simulate`, and the derivatives of all outputs (rows, outputs, wrt)."""
        ((_, outputs, tangents),) = self.pieces(parameters, inputs, steps, late, len(steps) + 1)
        return outputs, tangents

    def pieces(
        self, parameters, inputs, steps, late: float = 0.0, rows: int = PIECE, of: Sequence[int] | None = None
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """The same in pieces of `rows` rows, each (its rows, outputs, derivatives), to save memory.

        The next piece overwrites both. `of`: indices of the outputs whose derivatives are wanted; None: all.
        """
        size, of = min(rows, len(steps) + 1), range(len(self.outputs)) if of is None else of
        outputs, tangents = np.empty((size, len(self.outputs))), np.empty((len(of), size, len(self.wrt)))
        for at in self._run_pieces(parameters, inputs, steps, late, outputs, dict(zip(of, tangents, strict=True))):
            count = at.stop - at.start
            yield at, outputs[:count], np.moveaxis(tangents[:, :count], 0, 1)

    def _run_pieces(self, parameters, inputs, steps, late, outputs, tangents) -> Iterator[slice]:
        """Fill `outputs` (size, outputs) and `tangents`, by output (size, wrt), repeatedly; yields the rows in them."""
        values, columns, steps = self._prepared(parameters, inputs, steps)
        rows, size = len(columns), len(outputs)
        pieces = [slice(first, min(first + size, rows)) for first in range(0, rows, size)]
        # Without parameters the runner may be one of more, which would write derivatives beyond arrays without columns.
        return self._run(values, columns, steps, late, pieces, outputs, tangents if self.wrt else {})

    def _prepared(self, parameters, inputs, steps):
        """Parameters, inputs (rows, inputs) and steps, contiguous, in the model's order."""
        values = np.array(list(self.model.values(parameters).values()))
        known = inputs.memo if isinstance(inputs, FixedInputs) and inputs.steps is steps else {}
        key = (self._inputs, *self.model.measured_inputs.values())
        if key not in known:
            known[key] = self._stacked(inputs, steps)
        return values, known[key], np.ascontiguousarray(steps, float)

    def _stacked(self, inputs, steps) -> np.ndarray:
        """Inputs (rows, inputs), contiguous, in the model's order."""
        inputs = completed(self.model, inputs, steps)
        rows = {name: len(inputs[name]) for name in self._inputs}
        if set(rows.values()) != {len(steps) + 1}:
            counts = ", ".join(f"{count} rows of {name}" for name, count in rows.items())
            raise SimulationFailed(f"{self.model.name}: inputs: found {counts}, expected {len(steps) + 1} rows each")
        return np.column_stack([inputs[name] for name in self._inputs]).astype(float, order="C", copy=False)


def completed(model: Model, inputs: Mapping[str, np.ndarray], steps: np.ndarray) -> dict[str, np.ndarray]:
    """Inputs by name, each (rows,), completed by unmeasured inputs of effects; rows last `steps` (rows - 1,) s."""
    rows = len(steps) + 1
    own = {name: np.full(rows, value) for name, value in model.measured_inputs.items()}
    own |= {u.name: np.append(steps, steps[-1:])[:rows] for u in model.inputs if u.clock and rows > 1}
    return own | dict(inputs)


class _Chain:
    """Cache key of a model: models with the same effects have the same trace, whatever their scales. An effect that is always
    on takes short steps at any size."""

    def __init__(self, model: Model):
        self.model = model
        self._effects = tuple(e.declared or e for e in model.effects)
        names = (tuple(s.name for s in signals) for signals in (model.inputs, model.outputs))
        on = [e.off is None for e in model.effects]
        self._key = (model.name, *names, model.sample_time, *on, *map(id, self._effects))

    def __eq__(self, other):
        return self._key == other._key

    def __hash__(self):
        return hash(self._key)

    @property
    def text(self) -> str:
        """The traced content, in names; "" if an effect is not of the library, since its name does not determine its text.

        Tracing a model takes as long as some twenty runs of a record, and compiled models are cached between diagnoses.
        """
        if not {id(e) for e in self._effects} <= {id(measured_speed.EFFECT), *(id(e.declared) for e in LIBRARY)}:
            return ""
        names = [e.name for e in self._effects]
        return json.dumps([_library_text(), *map(str, self._key[: -len(names)]), names])


@cache
def _library_text() -> str:
    """A hash of all files that determine the effects, their trace and the C."""
    folders = [files("vpp_fmu.kernel"), files("vpp_fmu.kernel.effects"), files("vpp_fmu.tracer"), files("vpp_fmu.native")]
    parts = sorted((path.name, path.read_bytes()) for folder in folders for path in folder.iterdir() if path.is_file())
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _commanded(model: Model) -> list[bool]:
    """Whether each input of a model is a command."""
    return [u.name not in model.measured_inputs for u in model.inputs]


def rows_source(model: Model) -> str:
    """C that advances a model by rows of a record; comes after its step."""
    flags = ", ".join(str(int(is_command)) for is_command in _commanded(model)) or "0"
    schedule, rows = files("vpp_fmu.kernel") / "schedule.c", files("vpp_fmu.native") / "rows.c"
    return "".join([schedule.read_text(), f"static const int COMMANDED[] = {{{flags}}};\n", rows.read_text()])


_any_runner: WeakKeyDictionary = WeakKeyDictionary()
"""One runner of each model that is in use: it runs without its sensitivities, too, to the same bits."""


@lru_cache(maxsize=1024)
def _runner(chain: _Chain, wrt: tuple[str, ...]):
    """(run, side_by_side). `run(parameters, inputs, steps, late, pieces, outputs (size, outputs), tangents {output: (size,
    wrt)})`: fills both with one piece (a slice of at most `size` rows) after the other, and yields it. `side_by_side(parameters
    (runs, n), inputs, steps, late, outputs (outputs, rows, runs), done (runs / LANES,))`: fills the outputs of LANES runs each
    if they take the same steps, and sets `done`; None if no runs do."""
    if not wrt and (found := _any_runner.get(chain)):
        return found
    try:
        found = _compiled(chain, wrt)
    except CompilerMissing as missing:
        _say_once(str(missing))
        return _interpreted(trace(chain.model, wrt)), None
    _any_runner.setdefault(chain, found)
    return found


def _compiled(chain: _Chain, wrt: tuple[str, ...]):
    def source() -> str:
        program, last = trace(chain.model, wrt), files("vpp_fmu.native") / "simulate.c"
        lanes = c_lanes(program)
        begin = "#define KEEPS_LENGTHS\n" + "#define PREPARED ONCE\n" * bool(lanes)
        return "".join((begin, c_source(program), lanes, rows_source(chain.model), last.read_text()))

    known = chain.text
    library = compiled_as(f"{known} {wrt}", source) if known else compiled(source())
    vector = np.ctypeslib.ndpointer(float, flags="C")
    library.begin.argtypes, library.begin.restype = [vector, vector, ctypes.c_int], ctypes.c_void_p
    real, whole, address = ctypes.c_double, ctypes.c_long, ctypes.c_void_p
    library.proceed.argtypes = [address, vector, vector, real, whole, whole, whole, vector, address]
    library.end.argtypes, library.end.restype = [ctypes.c_void_p], None
    name = chain.model.name

    def run(values, inputs, steps, late, pieces, outputs, tangents):
        begun = library.begin(values, inputs[0], not tangents)
        if not begun:
            raise MemoryError
        places = (ctypes.c_void_p * len(chain.model.outputs))()
        for i, part in tangents.items():
            places[i] = part.ctypes.data
        try:
            for at in pieces:
                if library.proceed(begun, inputs, steps, late, at.start, at.stop, len(inputs), outputs, places):
                    raise SimulationFailed(f"{name}: {FULL}")
                yield at
        finally:
            library.end(begun)

    if not hasattr(library, "side_by_side"):
        return run, None
    library.side_by_side.argtypes = [vector, whole, vector, vector, real, whole, vector, address]
    library.side_by_side.restype = None

    def side_by_side(values, inputs, steps, late, outputs, done) -> None:
        library.side_by_side(values, len(done), inputs, steps, late, len(inputs), outputs, done.ctypes.data)

    return run, side_by_side


def _interpreted(program: Program):
    layout, model = program.layout, program.model
    n_in, n_out, width = len(layout.inputs), len(layout.outputs), len(program.wrt)
    code: dict = {}
    exec(python_source(program), code)
    commanded, columns = _commanded(model), [program.wrt.index(p) if p in program.wrt else None for _, p in model.delays]
    still, delay_at = (0.0,) * len(columns), {name: layout.index["parameter", p] for name, p in model.delays}
    samples = [(layout.index["state", x], layout.index["parameter", p]) for x, p in model.sampled]

    def run(values, inputs, steps, late, pieces, outputs, tangents):
        v = [*inputs[0].tolist(), *[0.0] * n_out, *values.tolist(), *[0.0] * len(layout.states)]
        d = [0.0] * (width * len(layout.moving))
        delays = [v[delay_at[name]] if name in delay_at else None for name in layout.inputs]
        lines = [None if delay is None else DelayLine(u) for u, delay in zip(v, delays, strict=False)]
        largest = code["largest_step"](v)
        prepared: tuple = (None, None, None)

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

        def advance(wait, held, span):
            """The remaining time to the next sample after a time under inputs."""
            if model.sample_time is None:
                try:
                    run_held(lines, delays, held, span, largest, step, nudge if width else None, partial(_waits, v, samples))
                except DelayFull as full:
                    raise SimulationFailed(f"{model.name}: {full}") from full
                return wait
            return run_sampled(wait, v[layout.index["parameter", model.sample_time]], span, lambda dt: step(held, dt))

        code["start"](v, d)
        wait, last = 0.0, inputs[0].tolist()
        for at in pieces:
            for row, held in enumerate(inputs[at].tolist(), at.start):
                outputs[row - at.start] = v[n_in : n_in + n_out]
                for i, part in tangents.items():
                    part[row - at.start] = d[i * width : (i + 1) * width]
                if row == len(steps):
                    break
                span, before = float(steps[row]), [b if u else now for b, now, u in zip(last, held, commanded, strict=True)]
                if late and before != held:
                    wait, span = advance(wait, before, late * span), (1.0 - late) * span
                wait, last = advance(wait, held, span), held
            yield at

    return run


def _waits(v: Sequence[float], samples: Iterable[tuple[int, int]]) -> list[float]:
    """For each sampled effect the time until its next sample; `samples`: indices of its countdown and its period."""
    return [next_sample(v[wait], v[period]) for wait, period in samples]


@cache
def _say_once(what: str) -> None:
    warnings.warn(f"{what}: the same numbers, more slowly, as generated Python", RuntimeWarning, stacklevel=3)
