"""Check whether a user's kernel model can become an FMU; if not, name the invalid declaration in one line."""

import ast
import inspect
import itertools
import keyword
import math
import re
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace

import vpp_fmu
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.ops import NUMBERS, Unseen
from vpp_fmu.kernel.types import BOOLEAN, INSTANT, INTEGER, REAL, Effect, Model, Parameter, Signal, State, no_step
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


class _Missing(AttributeError):
    """A function used an unknown name."""


class _Given(SimpleNamespace):
    """Arguments of an effect's function, with their description for the message about an unknown name."""

    __slots__ = ("_what",)

    def __init__(self, what: str, **values):
        super().__init__(**values)
        self._what = what

    def __getattr__(self, name):
        known = list(vars(self))
        raise _Missing(f"{self._what} {name}", f"{self._what}s that are known there: {', '.join(known) or 'none'}")


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
            self.number(f"signal {signal.name}", signal, "start", signal.start)
        for effect in model.effects:
            self.effect(effect)
        self.schedule()
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
        kinds = [("input", model.inputs), ("output", model.outputs), ("effect", model.effects)]
        kinds += [(f"parameter of effect {e.name}", e.parameters) for e in model.effects]
        kinds += [(f"state of effect {e.name}", e.states) for e in model.effects]
        for kind, declared in kinds:
            for one in declared:
                if not isinstance(one, Signal | Effect | Parameter | State):
                    self.refuse(kind, f"a {type(one).__name__}", f"a {kind.split()[0].capitalize()}")
                if not NAME.fullmatch(one.name) or keyword.iskeyword(one.name):
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

    def number(self, field: str, q: Signal | Parameter, what: str, value: float) -> None:
        """A quantity's unit, range and start value."""
        check_unit(self.where, f"{field}, unit", q.unit)
        if q.kind not in (REAL, INTEGER, BOOLEAN):
            self.refuse(f"{field}, kind", repr(q.kind), f"{REAL}, {INTEGER} or {BOOLEAN}")
        if not q.description:
            self.refuse(f"{field}, description", "nothing", "what it is, in words")
        if not (math.isfinite(q.nominal) and q.nominal > 0.0):
            self.refuse(f"{field}, nominal", str(q.nominal), "a number above 0")
        if not q.minimum < q.maximum:
            self.refuse(f"{field}, range", f"{q.minimum} to {q.maximum}", "a minimum below its maximum")
        if q.kind == BOOLEAN and (q.minimum, q.maximum) != (0.0, 1.0):
            self.refuse(f"{field}, range", f"{q.minimum} to {q.maximum}", "0 to 1, since it is a Boolean")
        if not (math.isfinite(value) and q.minimum <= value <= q.maximum):
            self.refuse(f"{field}, {what}", str(value), f"{q.minimum} to {q.maximum}")
        if q.kind != REAL and value != round(value):
            self.refuse(f"{field}, {what}", str(value), "0 or 1" if q.kind == BOOLEAN else "a whole number")

    def effect(self, effect: Effect) -> None:
        for p in effect.parameters:
            self.number(f"parameter {effect.full(p.name)}", p, "default", p.default)
        for x in effect.states:
            check_unit(self.where, f"state {effect.full(x.name)}, unit", x.unit)
            if not callable(x.start):
                self.refuse(f"state {effect.full(x.name)}, start", repr(x.start), "a function of (ops, s, p)")
        known = [p.name for p in effect.parameters]
        for what, names in (("off", effect.off or {}), ("probe", effect.probe), ("delays", effect.delays.values())):
            for name in names:
                if name not in known:
                    self.refuse(f"effect {effect.name}, {what}", f"a parameter {name}", f"one of {', '.join(known) or 'none'}")
        if effect.largest_step is not None and not effect.largest_step > 0.0:
            self.refuse(f"effect {effect.name}, largest_step", str(effect.largest_step), "seconds above 0, or None")

    def schedule(self) -> None:
        model = self.model
        by_name, inputs = {p.name: p for p in model.parameters}, [u.name for u in model.inputs]
        if model.sample_time is not None:
            if model.sample_time not in by_name:
                self.refuse("sample_time", f"a parameter {model.sample_time}", f"one of {', '.join(by_name) or 'none'}")
            if not by_name[model.sample_time].minimum > 0.0:
                self.refuse(f"parameter {model.sample_time}, minimum", "0 or less", "above 0, since it is a period")
        for name, delay in model.delays:
            if name not in inputs:
                self.refuse(f"delay {delay}", f"an input {name}", f"one of {', '.join(inputs) or 'none'}")
            if model.sample_time is not None:
                self.refuse(f"delay {delay}", "a delay in a sampled model", "delays in models without a sample time")
            if by_name[delay].minimum < 0.0:
                self.refuse(f"parameter {delay}, minimum", "below 0", "0 or more, since it is a delay")
        for name in (model.sample_time, *(delay for _, delay in model.delays)):
            if name is not None and by_name[name].tunable:
                self.refuse(f"parameter {name}", "tunable", "fixed: the schedule is made from it once")

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
        dt = ops.node("dt") if graph else TRY_STEP
        for starting in (True, False):
            s, count = _Given("signal", **signals), len(model.inputs)
            for e in model.effects:
                p = _Given("parameter", **{q.name: value(count + k, q.default) for k, q in enumerate(e.parameters)})
                count += len(e.parameters)
                states = {q.name: self.call(f"state {e.full(q.name)}, start", q.start, ops, s, p) for q in e.states}
                if graph and not starting:
                    states = {name: ops.node("v", next(unused)) for name in states}
                x = _Given("state", **states)
                arguments = (ops, s, x, p, INSTANT if starting else dt)
                returned = self.call(f"effect {e.name}, step", e.step, *arguments)
                self.returned(e, returned, s)
                vars(s).update(returned[0])
            self.end(s)

    def call(self, field: str, function: Callable, *arguments):
        """The result of a model's function; an exception becomes a message that names the function."""
        try:
            inspect.signature(function).bind(*arguments)
        except TypeError as error:
            wanted = "(ops, s, p)" if len(arguments) == len("osp") else "(ops, s, x, p, dt)"
            raise BadInput(self.where, field, f"{error}", f"a function of {wanted}") from error
        try:
            return function(*arguments)
        except _Missing as missing:
            raise BadInput(self.where, at_line(field, missing), f"no {missing.args[0]}", missing.args[1]) from missing
        except Unseen as error:
            raise BadInput(
                self.where, at_line(field, error), f"{_spelled(error)}, which can't be traced", error.instead
            ) from error
        except TypeError as error:
            found = f"what can't be traced ({' '.join(str(error).split())[:120]})"
            allowed = "+ - * / < > and ops.where, ops.exp ... instead of if, and, ==, max, math or numpy"
            raise BadInput(self.where, at_line(field, error), found, allowed) from error
        except Exception as error:  # user code may raise any exception
            found = f"{type(error).__name__}: {error}"
            raise BadInput(self.where, at_line(field, error), found, "a function that works on start values") from error

    def returned(self, effect: Effect, returned: object, s: _Given) -> None:
        field = f"effect {effect.name}, step"
        good = isinstance(returned, tuple) and len(returned) == 2 and all(isinstance(part, Mapping) for part in returned)
        if not good:
            self.refuse(field, f"a {type(returned).__name__} returned", "a pair: signals by name, next states by name")
        for name, number in (*returned[0].items(), *returned[1].items()):
            if isinstance(number, _Given):  # an effect may pass its own parameters to later effects
                continue
            if not isinstance(number, float | int) and type(number).__name__ != "Node":
                self.refuse(field, f"{name} is a {type(number).__name__}", "numbers")
        own = [x.name for x in effect.states]
        for name in returned[1]:
            if name not in own:
                self.refuse(field, f"a state {name} returned", f"its declared states: {', '.join(own) or 'none'}")
        for x in effect.states:
            if x.name not in returned[1] and x.closed_by is None:
                self.refuse(f"state {effect.full(x.name)}", "never returned by its step", "a next value, or closed_by a signal")
        if effect.step is no_step and own:
            self.refuse(f"effect {effect.name}", "states without a step", "a step that returns them")

    def end(self, s: _Given) -> None:
        known = list(vars(s))
        for output in self.model.outputs:
            if output.name not in known:
                self.refuse(f"output {output.name}", "set by no effect", f"one of the signals {', '.join(known)}")
        for e in self.model.effects:
            for x in e.states:
                if x.closed_by is not None and x.closed_by not in known:
                    self.refuse(f"state {e.full(x.name)}, closed_by", x.closed_by, f"one of the signals {', '.join(known)}")
