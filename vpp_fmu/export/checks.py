"""Check whether a user's kernel model can become an FMU; if not, name the invalid declaration in one line."""

import ast
import inspect
import itertools
import keyword
import math
import re
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace

import vpp_fmu
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel import types
from vpp_fmu.kernel.integration import LARGEST_EXACT, METHODS
from vpp_fmu.kernel.ops import NUMBERS, Unseen
from vpp_fmu.kernel.types import BOOLEAN, ENUMERATION, INTEGER, REAL, STRING, Effect, Model, Parameter, Signal, State, no_step
from vpp_fmu.kernel.vector import Vector
from vpp_fmu.tracer.graph import Graph
from vpp_fmu.units import check_unit

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

HERE = Path(vpp_fmu.__file__).parent
STANDARD = sysconfig.get_paths()["stdlib"]
TRY_STEP = 0.01  # s; arbitrary: the check needs only the names that a function reads and sets


def check_model(where: str, model: Model) -> None:
    """BadInput(where, declaration, found, allowed) for the first fault; `where`: the user's name of the model.

    The functions are run on numbers and on symbols, as in the trace; nothing is compiled.
    """
    _Check(where, model).all()


def check_traced(where: str, model: Model) -> None:
    """BadInput for the first function that cannot be run on symbols, as the trace does."""
    _Check(where, model).chain(graph=True)


def at_line(field: str, error: Exception) -> str:
    """The field, with the line of the user's code that raised the error."""
    own = _own_frame(error)
    return f"{field}, {Path(own.filename).name} line {own.lineno}" if own else field


def _own_frame(error: Exception) -> traceback.FrameSummary | None:
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if not Path(f.filename).is_relative_to(HERE) and Path(f.filename).suffix == ".py"]
    own = [f for f in own if "site-packages" not in f.filename and not f.filename.startswith(STANDARD)]
    return own[-1] if own else None


def _spelled(error: Unseen) -> str:
    """The construct in the user's line that raised the error: Python calls the same method for `if` and `and`."""
    own = _own_frame(error)
    try:
        tree = ast.parse(Path(own.filename).read_text(encoding="utf-8")) if own else ast.Module([], [])
    except (OSError, ValueError, SyntaxError):
        return error.what
    found = []
    for node in ast.walk(tree):
        name, place = _asking(node, error.method)
        if name and place.lineno <= own.lineno <= place.end_lineno and _holds(place, own):
            size = place.end_lineno - place.lineno, place.end_col_offset - place.col_offset
            found.append((*size, name in ("if", "while", "assert"), name))  # in `if a and b`, the `and` is evaluated first
    return min(found)[-1] if found else error.what


def _asking(node: ast.AST, method: str) -> tuple[str, ast.AST]:
    """The Python construct that calls `method` of a value, if this node is one, and its position."""
    if method in ("__bool__", "__float__", "__int__", "__abs__", "__round__") and isinstance(node, ast.Call):
        name = ast.unparse(node.func)
        return ("" if name.startswith("ops.") else f"{name}()"), node
    if method != "__bool__":
        return "", node
    match node:
        case ast.If() | ast.IfExp():
            return "if", node.test
        case ast.While():
            return "while", node.test
        case ast.Assert():
            return "assert", node.test
        case ast.BoolOp():
            return ("and" if isinstance(node.op, ast.And) else "or"), node
        case ast.UnaryOp(op=ast.Not()):
            return "not", node
        case ast.Compare() if len(node.ops) > 1:
            return "a chain of comparisons", node
    return "", node


def _holds(place: ast.AST, frame: traceback.FrameSummary) -> bool:
    """Whether the failed instruction is there; Python 3.10 knows only its line."""
    at = getattr(frame, "colno", None)
    return at is None or (place.lineno, place.col_offset) <= (frame.lineno, at) <= (place.end_lineno, place.end_col_offset)


class _Check:
    def __init__(self, where: str, model: Model):
        self.where, self.model = where, model

    def refuse(self, field: str, found: str, allowed: str):
        raise BadInput(self.where, field, found, allowed)

    def all(self) -> None:
        model = self.model
        self.tuples("", model, ("inputs", "outputs", "effects"))
        for effect in model.effects:
            if isinstance(effect, Effect):
                self.tuples(f"effect {effect.name}, ", effect, ("parameters", "states", "inputs"))
        self.names()
        for signal in (*model.inputs, *model.outputs):
            computed = signal not in model.inputs and model.sample_time is None  # its start value is never used
            self.number(f"signal {signal.name}", signal, "start", None if computed else signal.start)
        for effect in model.effects:
            self.effect(effect)
        self.schedule()
        if model.black_box is not None:
            self.black_box(model.black_box)
            return
        for graph in (False, True):
            self.chain(graph)

    def tuples(self, where: str, declared: Model | Effect, fields: Iterable[str]) -> None:
        """Refuse fields that are no tuple, as after a missing comma: effects=(ROOM)."""
        for name in fields:
            value = getattr(declared, name)
            if not isinstance(value, tuple | list):
                self.refuse(
                    f"{where}{name}",
                    f"one {type(value).__name__}",
                    "a tuple, which ends in a comma where it has one member: (A,)",
                )

    def names(self) -> None:
        model = self.model
        if not NAME.fullmatch(model.name) or keyword.iskeyword(model.name):
            self.refuse("name", repr(model.name), "letters, digits and _, not beginning with a digit, no word of Python")
        if not model.outputs:
            self.refuse("outputs", "none", "a Signal at least")
        for name in ("description", "author", "version", "license", "copyright", "icon"):
            if not isinstance(text := getattr(model, name), str):
                self.refuse(name, repr(text), "a text")
        if model.icon not in ("", "propeller") and not Path(model.icon).is_file():
            self.refuse("icon", model.icon, "the path of a PNG, or propeller")
        for name in ("stop_time", "step_size", "tolerance"):
            number = getattr(model, name)
            if number is not None and not (isinstance(number, float | int) and 0.0 < number < math.inf):
                self.refuse(name, repr(number), "a number above 0, or None")
        kinds = [("input", model.inputs), ("output", model.outputs), ("effect", model.effects)]
        kinds += [(f"parameter of effect {e.name}", e.parameters) for e in model.effects]
        kinds += [(f"state of effect {e.name}", e.states) for e in model.effects]
        for kind, declared in kinds:
            for one in declared:
                if not isinstance(one, Signal | Effect | Parameter | State):
                    self.refuse(kind, f"a {type(one).__name__}", f"a {kind.split()[0].capitalize()}")
                dotted = one.name.removesuffix(f"[{one.place}]" if getattr(one, "place", 0) else "").split(".")
                if not all(NAME.fullmatch(part) and not keyword.iskeyword(part) for part in dotted):
                    self.refuse(f"{kind} {one.name!r}", "no identifier", "letters, digits and _, not beginning with a digit")
        self.once("variable", [q.name for q in (*model.inputs, *model.outputs, *model.parameters)])
        self.once("state", [x.name for x in model.states])
        self.once("effect", [e.name for e in model.effects])

    def once(self, what: str, names: Iterable[str]) -> None:
        seen = set()
        for name in names:
            if name in seen:
                self.refuse(f"{what} {name}", "declared twice", "each name once")
            seen.add(name)

    def number(self, field: str, q: Signal | Parameter, what: str, value: float | None) -> None:
        """A quantity's unit, range and start value, if it has one."""
        for name, number in (("minimum", q.minimum), ("maximum", q.maximum), ("nominal", q.nominal), (what, value)):
            if not isinstance(number, float | int | None):
                texts = "a number; a text is one of the `items` of a kind STRING or ENUMERATION"
                self.refuse(f"{field}, {name}", repr(number), texts)
        check_unit(self.where, f"{field}, unit", q.unit)
        if q.kind not in (kinds := (REAL, INTEGER, BOOLEAN, ENUMERATION, STRING)):
            self.refuse(f"{field}, kind", repr(q.kind), f"one of {', '.join(kinds)}")
        if (q.kind in (ENUMERATION, STRING)) != bool(q.items) or len(set(q.items)) < len(q.items):
            self.refuse(
                f"{field}, items", ", ".join(q.items) or "none", f"different texts, of an {ENUMERATION} or a {STRING} only"
            )
        if not q.description:
            self.refuse(f"{field}, description", "nothing", "what it is, in words")
        if not (math.isfinite(q.nominal) and q.nominal > 0.0):
            self.refuse(f"{field}, nominal", str(q.nominal), "a number above 0")
        if not q.minimum < q.maximum:
            self.refuse(f"{field}, range", f"{q.minimum} to {q.maximum}", "a minimum below its maximum")
        if q.kind == BOOLEAN and (q.minimum, q.maximum) != (0.0, 1.0):
            self.refuse(f"{field}, range", f"{q.minimum} to {q.maximum}", "0 to 1, since it is a Boolean")
        if value is not None and not (math.isfinite(value) and q.minimum <= value <= q.maximum):
            self.refuse(f"{field}, {what}", str(value), f"{q.minimum} to {q.maximum}")
        if value is not None and q.kind != REAL and value != round(value):
            self.refuse(f"{field}, {what}", str(value), "0 or 1" if q.kind == BOOLEAN else "a whole number")

    def effect(self, effect: Effect) -> None:
        for q in (*effect.parameters, *effect.states):
            value = q.default if isinstance(q, Parameter) else q.start
            if q.size and isinstance(value, Sequence) and len(value) != q.size:
                self.refuse(
                    f"{type(q).__name__.lower()} {effect.full(q.name)}, size", str(len(value)), f"{q.size} values, or one"
                )
        for p in types.scalars(effect.parameters):
            self.number(f"parameter {effect.full(p.name)}", p, "default", p.default)
        for x in types.scalars(effect.states):
            check_unit(self.where, f"state {effect.full(x.name)}, unit", x.unit)
            if not callable(x.start) and not isinstance(x.start, float | int):
                self.refuse(f"state {effect.full(x.name)}, start", repr(x.start), "a function of (ops, s, p), or a number")
        self.forms(effect)
        known = [p.name for p in effect.parameters]
        for what, names in (("off", effect.off or {}), ("probe", effect.probe), ("delays", effect.delays.values())):
            for name in names:
                if name not in known:
                    self.refuse(f"effect {effect.name}, {what}", f"a parameter {name}", f"one of {', '.join(known) or 'none'}")
        if effect.largest_step is not None and not effect.largest_step > 0.0:
            self.refuse(f"effect {effect.name}, largest_step", str(effect.largest_step), "seconds above 0, or None")

    def forms(self, effect: Effect) -> None:
        """Step or derivative, and what each needs."""
        field, moves = f"effect {effect.name}", [x for x in effect.states if x.closed_by is None and x.name != effect.wait]
        if effect.derivative is not None:
            if effect.step is not no_step or effect.sample_time:
                self.refuse(f"{field}, derivative", "a step or a sample_time as well", "only one of them")
            if effect.method not in METHODS:
                self.refuse(f"{field}, method", repr(effect.method), f"one of {', '.join(METHODS)}")
            if effect.method == "exact" and sum(x.size or 1 for x in moves) > LARGEST_EXACT:
                self.refuse(f"{field}, method", f"exact with {len(moves)} states", f"rk4, or {LARGEST_EXACT} states at most")
            if effect.method != "exact" and effect.largest_step is None:
                self.refuse(f"{field}, largest_step", "None", f"the longest step [s] of {effect.method}")
        if effect.step is no_step and effect.derivative is None and effect.states and effect.output is None:
            self.refuse(field, "states without a step", "a step or a derivative")
        if effect.sample_time:
            if effect.sample_time not in (by_name := {p.name: p for p in effect.parameters}):
                allowed = f"one of {', '.join(by_name) or 'none'}"
                self.refuse(f"{field}, sample_time", f"a parameter {effect.sample_time}", allowed)
            if self.model.sample_time is not None:
                self.refuse(f"{field}, sample_time", "one of the model as well", "only one of them")
            self.period(effect.full(effect.sample_time), by_name[effect.sample_time])

    def black_box(self, function: Callable) -> None:
        """A function in a file of its own, which runs where this project is not installed."""
        file = inspect.getsourcefile(function) if inspect.isfunction(function) else None
        if file is None or "." in function.__qualname__ or function.__name__ == "<lambda>":
            self.refuse("black_box", repr(function), "a function at the top of a Python file")
        nodes = [*ast.walk(ast.parse(Path(file).read_text(encoding="utf-8")))]
        modules = [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]
        modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        if any(module.split(".")[0] == "vpp_fmu" for module in modules):
            self.refuse("black_box", f"{Path(file).name}, which imports vpp_fmu", "a file of its own, as the FMU has it alone")
        if any(e.step is not no_step or e.derivative or e.output or e.states for e in self.model.effects):
            self.refuse("black_box", "effects with steps as well", "effects with parameters only")
        inputs = {u.name: u.start for u in self.model.inputs} | self.model.values()
        arguments = ({}, inputs, TRY_STEP)
        shown = self.call("black_box", function, arguments, function, *arguments)
        missing = [y.name for y in self.model.outputs if not isinstance(shown, Mapping) or y.name not in shown]
        if missing:
            self.refuse("black_box", f"no {', '.join(missing)} returned", "all outputs by name")

    def period(self, name: str, p: Parameter) -> None:
        if not p.minimum > 0.0:
            self.refuse(f"parameter {name}, minimum", "0 or less", "above 0, since it is a period")
        if p.tunable:
            self.refuse(f"parameter {name}", "tunable", "fixed: the schedule is made from it once")

    def schedule(self) -> None:
        model = self.model
        by_name, inputs = {p.name: p for p in model.parameters}, [u.name for u in model.inputs]
        if model.sample_time is not None:
            if model.sample_time not in by_name:
                self.refuse("sample_time", f"a parameter {model.sample_time}", f"one of {', '.join(by_name) or 'none'}")
            self.period(model.sample_time, by_name[model.sample_time])
        for name, delay in model.delays:
            if name not in inputs:
                self.refuse(f"delay {delay}", f"an input {name}", f"one of {', '.join(inputs) or 'none'}")
            if model.sample_time is not None:
                self.refuse(f"delay {delay}", "a delay in a sampled model", "delays in models without a sample time")
            if by_name[delay].minimum < 0.0:
                self.refuse(f"parameter {delay}, minimum", "below 0", "0 or more, since it is a delay")
            if by_name[delay].tunable:
                self.refuse(f"parameter {delay}", "tunable", "fixed: the schedule is made from it once")

    def chain(self, graph: bool) -> None:
        """Start and step of each effect in turn, on numbers or on symbols."""
        model = self.model
        ops, unused = Graph() if graph else NUMBERS, itertools.count(len(model.inputs) + len(model.parameters))

        def value(i: int, number: float):
            return ops.node("v", i) if graph else number

        signals = {u.name: value(i, u.start) for i, u in enumerate(model.inputs)}
        for e in model.effects:
            for name, guess in e.ahead.items():
                if guess and guess not in signals:
                    self.refuse(f"effect {e.name}, ahead", repr(guess), f"an input, of {', '.join(signals)}, or ''")
                signals[f"settled_{name}"] = signals[guess] if guess else 0.0
        given = {p.name: value(len(model.inputs) + k, p.default) for k, p in enumerate(model.parameters)}
        dt = ops.node("dt") if graph else TRY_STEP
        for starting in (True, False):
            s = types.input_signals(model, signals)
            for e, _, _, its_parameters, _, vectors in model.links:
                try:
                    seen = types.view(e, s)
                except KeyError as missing:
                    known = f"one of the signals that are known there: {', '.join(vars(s))}"
                    self.refuse(f"effect {e.name}, wired", f"no signal {missing.args[0]}", known)
                p = types.own_values(given, its_parameters, vectors)
                own = {
                    q.name: self.call(f"state {e.full(q.name)}, start", q.start, (ops, seen, p), types.started, q, ops, seen, p)
                    for q in e.states
                }
                if graph and not starting:
                    own = {
                        n: Vector(ops.node("v", next(unused)) for _ in x)
                        if isinstance(x, Vector)
                        else ops.node("v", next(unused))
                        for n, x in own.items()
                    }
                field, main, more = f"effect {e.name}, step", e.step, (types.INSTANT if starting else dt,)
                if e.derivative is not None:
                    field, main, more = f"effect {e.name}, derivative", e.derivative, ()
                x = SimpleNamespace(**own)
                returned = self.call(field, main, (ops, seen, x, p, *more), main, ops, seen, x, p, *more)
                self.returned(e, field, returned)
                if starting and not graph and isinstance(returned, tuple) and model.sample_time is None and e.output is None:
                    self.at_rest(e, own, returned[1])
                if starting:
                    set_ = self.call(f"effect {e.name}, output", e.output, (ops, seen, x, p), types.begun, e, ops, seen, x, p)
                elif types.is_integrated(e):
                    set_ = self.call(f"effect {e.name}, output", e.output, (ops, seen, x, p), types.shown, e, ops, seen, x, p)
                else:
                    set_, _ = self.call(
                        f"effect {e.name}, output", e.output, (ops, seen, x, p), types.moved, e, ops, seen, x, p, dt
                    )
                self.numbers(f"effect {e.name}, {'output' if e.output else 'step'}", set_)
                types.set_signals(e, s, set_)
            self.end(s)

    def call(self, field: str, function: Callable | None, given: tuple, doing: Callable, *arguments):
        """The result of `doing`, which calls a model's `function` with what is `given`; an exception becomes a message."""
        try:
            if callable(function):
                inspect.signature(function).bind(*given)
        except TypeError as error:
            wanted = {3: "(ops, s, p)", 4: "(ops, s, x, p)"}.get(len(given), "(ops, s, x, p, dt)")
            raise BadInput(self.where, field, f"{error}", f"a function of {wanted}") from error
        try:
            return doing(*arguments)
        except AttributeError as error:
            raise self.missing(field, error, given) from error
        except Unseen as error:
            spelled = _spelled(error)
            instead = {"max()": "ops.maximum(x, y)", "min()": "ops.minimum(x, y)"}.get(spelled, error.instead)
            raise BadInput(self.where, at_line(field, error), f"{spelled}, which can't be traced", instead) from error
        except TypeError as error:
            found = f"what can't be traced ({' '.join(str(error).split())[:120]})"
            allowed = "operators, ops.where, ops.exp ... instead of if, and, max, math or numpy"
            raise BadInput(self.where, at_line(field, error), found, allowed) from error
        except Exception as error:  # user code may raise any exception
            found = f"{type(error).__name__}: {error}"
            raise BadInput(self.where, at_line(field, error), found, "a function that works on start values") from error

    def missing(self, field: str, error: AttributeError, given: tuple) -> BadInput:
        """The message for an unknown name in one of a function's arguments."""
        kinds = ("signal", "parameter") if len(given) == len("osp") else ("signal", "state", "parameter")
        for kind, namespace in zip(kinds, given[1:], strict=False):
            if error.obj is namespace:
                known = f"{kind}s that are known there: {', '.join(vars(namespace)) or 'none'}"
                return BadInput(self.where, at_line(field, error), f"no {kind} {error.name}", known)
        said, _, allowed = str(error).partition("; ")
        return BadInput(self.where, at_line(field, error), said, allowed or "an attribute that exists")

    def returned(self, effect: Effect, field: str, returned: object) -> None:
        pair = isinstance(returned, tuple) and len(returned) == 2 and all(isinstance(part, Mapping) for part in returned)
        if not pair and not isinstance(returned, Mapping):
            allowed = "next states by name, or a pair: signals by name, next states by name"
            allowed = "derivatives by the names of their states" if effect.derivative else allowed
            self.refuse(field, f"a {type(returned).__name__} returned", allowed)
        if pair and returned != ({}, {}) and (effect.output is not None or effect.derivative or effect.sample_time):
            self.refuse(field, "a pair returned", "states only: the signals come from `output`, or are the states")
        states = returned[1] if pair else returned
        for part in returned if pair else (returned,):
            self.numbers(field, part)
        own = {x.name: x for x in effect.states if x.name != effect.wait}
        for name, value in states.items():
            if name not in own:
                self.refuse(field, f"a state {name} returned", f"its declared states: {', '.join(own) or 'none'}")
            size = len(value) if isinstance(value, tuple | list) else 0
            if size != own[name].size:
                self.refuse(field, f"{size or 'no'} elements of {name}", f"{own[name].size or 'a number'}, as declared")
        for x in own.values():
            if x.name not in states and x.closed_by is None:
                what = "derivative" if effect.derivative else "step"
                self.refuse(
                    f"state {effect.full(x.name)}", f"never returned by its {what}", "a next value, or closed_by a signal"
                )

    def at_rest(self, effect: Effect, states: Mapping, moved: Mapping) -> None:
        """Refuse signals at the start that would be those of a step which moves the states."""
        for x in effect.states:
            pairs = zip(*(v if x.size else (v,) for v in (states[x.name], moved.get(x.name, states[x.name]))), strict=True)
            for before, after in pairs:
                if abs(after - before) > 1e-6 * max(abs(before), x.nominal or 1.0):
                    found = (
                        f"signals and states together, while {x.name} moves by {abs(after - before):g} at the start, in 1e-9 s"
                    )
                    allowed = "next states alone, for a start without a step; `output`, if needed, gives the signals from them"
                    self.refuse(f"effect {effect.name}, step", found, allowed)

    def numbers(self, field: str, values: Mapping) -> None:
        for name, value in values.items():
            if isinstance(value, SimpleNamespace):  # an effect may pass its own parameters to later effects
                continue
            for number in value if isinstance(value, tuple | list) else (value,):
                if not isinstance(number, float | int) and type(number).__name__ not in ("Node", "Dual"):
                    self.refuse(field, f"{name} is a {type(number).__name__}", "numbers")

    def end(self, s: SimpleNamespace) -> None:
        known = list(types.flat(self.model, s))
        for output in self.model.outputs:
            if output.name not in known:
                self.refuse(f"output {output.name}", "set by no effect", f"one of the signals {', '.join(known)}")
        for e in self.model.effects:
            for x in e.states:
                if x.closed_by is not None and x.closed_by not in vars(types.view(e, s)):
                    self.refuse(f"state {e.full(x.name)}, closed_by", x.closed_by, f"one of the signals {', '.join(known)}")
