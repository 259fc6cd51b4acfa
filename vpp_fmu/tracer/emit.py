"""A traced program as text: Python (for the Python FMU, and where there is no compiler) and C."""

import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from hashlib import sha256
from importlib.resources import files
from math import isinf
from types import MappingProxyType

from vpp_fmu.kernel.ops import WHOLE
from vpp_fmu.tracer.graph import CALLS, COMPARE, EXPONENTIALS, TABLES, Node, needed
from vpp_fmu.tracer.program import Program, Write

ONCE = """#if defined(__clang__)
#define ONCE __attribute__((optnone, noinline))
#elif defined(__GNUC__)
#define ONCE __attribute__((optimize("O0")))
#else
#define ONCE
#endif
#ifdef __GNUC__
#define APART __attribute__((noinline))
#else
#define APART
#endif
#ifndef PREPARED
#define PREPARED
#endif
"""
"""Marks functions that run once per simulation: optimising them takes longer than it saves; parts of a long function; and
prepare(), which is ONCE where prepare_lanes() runs in its place."""


def python_source(program: Program) -> str:
    """Functions `start(v, d)`, `prepare(v, dt, dt_tangent) -> c`, `step(v, c, d)`, `largest_step(v)` and `show(v)`.

    `v` is the list of values by `Layout.index`; `d` the tangents of `Layout.moving`, flat, `len(wrt)` for each value.
    """
    width = len(program.wrt)

    def name(target: tuple) -> str:
        kind, *i = target
        return {"v": "v[{0}]", "c": "c{0}", "d": "d[{0}]", "dt_tangent": "dt_tangent[{0}]", "dt": "dt"}[kind].format(
            i[0] * width + i[1] if kind == "d" else i[0] if i else ""
        )

    def body(writes: tuple[Write, ...]) -> list[str]:
        lines, values = _statements(writes, name, "{0} = {1}")
        if writes and writes[0][0][0] in "vd":
            return [
                *lines,
                *(", ".join(name(t) for t, _ in part) + " = " + ", ".join(values[t] for t, _ in part) for part in [writes]),
            ]
        return [*lines, f"return {', '.join(values[t] for t, _ in writes)}" + ("," if writes[0][0][0] == "c" else "")]

    blocks = (program.start, program.prepare, program.step, program.show)
    tables = [f"{name} = {', '.join(map(repr, parts))}\n" for name, parts in _tables(blocks).items()]
    constants = "".join(f"c{i}, " for i in range(len(program.prepare)))
    functions = (
        ("start(v, d)", body(program.start)),
        ("prepare(v, dt, dt_tangent)", body(program.prepare) if program.prepare else ["return ()"]),
        ("step(v, c, d)", ([f"{constants}= c"] if constants else []) + body(program.step)),
        ("largest_step(v)", body(program.largest_step)),
        ("show(v)", body(program.show)),
    )
    defined = [f"def {head}:\n" + "\n".join("    " + line for line in lines) + "\n" for head, lines in functions]
    of_math = [name for name in CALLS if name not in EXPONENTIALS]
    imports = [f"from math import {', '.join(of_math)}\n", *_modules(blocks).values()]
    return "\n\n".join(["".join([*imports, *tables]), *defined])


def c_source(program: Program) -> str:
    """The same functions as static C, with the sizes and positions for `schedule.c`."""
    layout, model, width = program.layout, program.model, len(program.wrt)
    at = layout.index

    def name(target: tuple) -> str:
        kind, *i = target
        if kind == "d":
            return f"d[{i[0] * width + i[1]}]"
        return f"{kind}[{i[0]}]" if i else kind

    delayed = [at["input", u] for u, _ in model.delays] or [0]
    delays = [at["parameter", p] for _, p in model.delays] or [0]
    sample_time = at["parameter", model.sample_time] if model.sample_time else 0
    sizes = {
        "N_INPUTS": len(layout.inputs),
        "N_OUTPUTS": len(layout.outputs),
        "N_PARAMETERS": len(layout.parameters),
        "N_STATES": len(layout.states),
        "N_VALUES": len(at),
        "N_CONSTANTS": max(1, len(program.prepare)),
        "N_WRT": width,
        "N_TANGENTS": max(1, width * len(layout.moving)),
        "N_DELAYED": len(model.delays),
        "N_DELAYED_OR_1": len(delayed),
        "N_SAMPLED": len(model.sampled),
        "SAMPLED": int(bool(model.sample_time)),
        "SAMPLE_TIME": sample_time,
    }
    parts = ["#include <math.h>\n", ONCE, *(f"#define {k} {n}\n" for k, n in sizes.items())]
    parts.append(_c_library((program.start, program.prepare, program.step, program.show)))
    parts.append(f"static const int DELAYED_INPUT[] = {{{', '.join(map(str, delayed))}}};\n")
    parts.append(f"static const int DELAY_PARAMETER[] = {{{', '.join(map(str, delays))}}};\n")
    for array, positions in (
        ("SAMPLE_STATE", [at["state", x] for x, _ in model.sampled]),
        ("SAMPLE_PERIOD", [at["parameter", p] for _, p in model.sampled]),
    ):
        parts.append(f"static const int {array}[] = {{{', '.join(map(str, positions or [0]))}}};\n")
    columns = [program.wrt.index(p) if p in program.wrt else -1 for _, p in model.delays] or [-1]
    parts.append(f"static const int DELAY_COLUMN[] = {{{', '.join(map(str, columns))}}};\n")
    plain = tuple((target, value) for target, value in program.step if target[0] != "d")
    for head, writes in (
        ("ONCE void start(double *v, double *d)", program.start),
        ("PREPARED void prepare(const double *v, double dt, const double *dt_tangent, double *c)", program.prepare),
        ("void step(double *v, const double *c, double *d)", program.step),
        *([("void step_values(double *v, const double *c)", plain)] if width else []),
        ("inline double largest_step(const double *v)", program.largest_step),
        ("ONCE void show(double *v)", program.show),
    ):
        parts.append(c_function(head, writes, name))
    return "".join(parts)


LANES = 8
"""Parallel runs in `c_lanes`: one vector of the widest registers of a 64-bit processor, four of the narrowest."""


def c_lanes(program: Program) -> str:
    """`prepare`, and `step` without tangents, as static C on LANES sets of values at once, with the same arithmetic. "" if runs
    may take different steps: for a model that is sampled, has sampled effects, or delays its inputs."""
    if program.model.sample_time or program.model.delays or program.model.sampled:
        return ""
    step = tuple((target, value) for target, value in program.step if target[0] != "d")
    heads = (
        ("prepare_lanes(double (*restrict v)[LANES], const double *restrict dt, double (*restrict c)[LANES])", program.prepare),
        ("step_lanes(double (*restrict v)[LANES], const double (*restrict c)[LANES])", step),
    )
    inlined = "#undef EXP\n#undef EXPM1\n#define EXP exp_inlined\n#define EXPM1 expm1_inlined\n"
    return f"\n#define LANES {LANES}\n{inlined}" + "".join(_c_lanes(head, writes) for head, writes in heads)


def _c_lanes(head: str, writes: tuple[Write, ...]) -> str:
    """Compilers vectorise only loops that call no function, so CALLING operations are in loops of their own."""
    loops, arrays, last = _loops(writes)
    places = {n: f"t{n.number}[k]" for n in arrays}

    def name(target: tuple) -> str:
        return f"{target[0]}[{target[1]}][k]" if target[1:] else f"{target[0]}[k]"

    statements, stores = _c_statements(writes, name, places, CALLING)
    code = [f"__attribute__((always_inline)) static inline void {head} {{\n"]
    code += [f"  double t{number}[LANES];\n" for number in sorted(n.number for n in arrays)]
    for loop in range(last + 1):
        body = [line for n, own in statements if loops[n] == loop for line in own] + stores * (loop == last)
        code += ["  for (int k = 0; k < LANES; k++) {\n", *(f"    {line}\n" for line in body), "  }\n"]
    return "".join([*code, "}\n"])


def c_function(head: str, writes: tuple[Write, ...], name: Callable) -> str:
    """A static C function that does `writes`; `name(target or leaf)` is its C expression."""
    statements, stores = _c_statements(writes, name)
    if len(statements) > LONG and all(kind != "d" for (kind, *_), _ in writes):
        return _c_parts(head, writes, name)
    lines = [line for _, own in statements for line in own] + stores
    return "".join([f"\nstatic {head} {{\n", *(f"  {line}\n" for line in lines), "}\n"])


def _tables(blocks: Iterable[tuple[Write, ...]]) -> dict[str, tuple]:
    """The tables that these blocks read, by name."""
    if not _library(blocks) & set(TABLES):
        return {}
    return {_table_name(n): tuple(n.table[0]) for n in needed(v for writes in blocks for _, v in writes) if n.op in TABLES}


def _library(blocks: Iterable[tuple[Write, ...]]) -> set[str]:
    """The operations of the blocks' graph that need the library."""
    return next((value.graph.library for writes in blocks for _, value in writes if isinstance(value, Node)), set())


def _table_name(n: Node) -> str:
    return f"TABLE_{sha256(repr(n.table[0]).encode()).hexdigest()[:12]}"


MODULES = {"exponential": EXPONENTIALS, "tables": TABLES}
"""Modules of the kernel whose functions generated code calls; each has the same in C beside it."""


def _modules(blocks: Iterable[tuple[Write, ...]]) -> dict[str, str]:
    """The modules that these blocks call, with the statements that import them."""
    used = _library(blocks)
    statements = {name: f"from vpp_fmu.kernel.{name} import {', '.join(functions)}\n" for name, functions in MODULES.items()}
    return {name: statement for name, statement in statements.items() if used & set(MODULES[name])}


def _c_library(blocks: Sequence[tuple[Write, ...]]) -> str:
    """What these blocks call beside C's library: modules, tables, and a power that no compiler replaces."""
    parts = []
    if "pow" in _library(blocks):  # compilers replace pow(x, 2.0) by x * x, which Python does not
        parts.append("static double (*const volatile power)(double, double) = pow;\n")
    parts += [(files("vpp_fmu.kernel") / f"{name}.c").read_text(encoding="utf-8") for name in _modules(blocks)]
    for name, arrays in _tables(blocks).items():
        for k, numbers in enumerate(arrays):
            if numbers:
                parts.append(f"static const double {name}_{k}[] = {{{', '.join(map(repr, numbers))}}};\n")
    return "".join(parts)


LONG, PART = 3000, 100
"""Statements from which on a function is cut into parts, and those of a part: the time to compile a function without branches
grows faster than its length."""


def _c_parts(head: str, writes: tuple[Write, ...], name: Callable) -> str:
    """The same in functions of PART statements, which leave in an array `m` what later ones need."""
    order = needed(value for _, value in writes)
    homes, outer = _homes(order, writes, HEAVY), {}
    for n in order:
        outer[n] = _outermost(n, homes[n])
    alone = [n for n in order if not homes[n].depth]
    part = {n.number: k // PART for k, n in enumerate(alone)}
    later = {value for _, value in writes if isinstance(value, Node)}  # the last function stores them
    reads: dict[Node, set[Node]] = {}
    for n in order:  # a comparison is computed where it is used
        reads[n] = set().union(*(reads[a] if a.op in COMPARE else {a} for a in n.nodes))
        later |= {a for a in reads[n] if part[outer[a]] != part[outer[n]]}
    later |= set().union(*(reads[value] for value in later if value.op in COMPARE))
    places = {n: f"m[{k}]" for k, n in enumerate(n for n in alone if n in later and n.op not in COMPARE)}
    statements, stores = _c_statements(writes, name, places)
    once, kind, function, arguments = re.fullmatch(r"(ONCE |PREPARED |)(\w+) (\w+)\((.*)\)", head).groups()
    passed = ", ".join(re.split(r"\W+", argument)[-1] for argument in arguments.split(", "))
    text, calls = [], []
    for k in range(0, len(statements), PART):
        lines = [line for _, own in statements[k : k + PART] for line in own]
        text += [
            f"\nAPART {once}static void {function}_{k}({arguments}, double *m) {{\n",
            *(f"  {line}\n" for line in lines),
            "}\n",
        ]
        calls.append(f"{function}_{k}({passed}, m);")
    lines = [f"double m[{max(1, len(places))}];", *calls, *stores]
    return "".join([*text, f"\nstatic {kind} {function}({arguments}) {{\n", *(f"  {line}\n" for line in lines), "}\n"])


def _outermost(n: Node, place: "Place") -> int:
    """The number of the node at the outermost place within whose statement a node at this place is."""
    while place.depth > 1:
        place = place.outer
    return place.choice if place.depth else n.number


HEAVY = frozenset((*CALLS, *TABLES)) - {"sqrt"}
"""Operations that cost as much as some twenty others: if only one side of a choice needs them, they are computed there."""

CALLING = HEAVY - {*EXPONENTIALS}
"""Those of them that call a function: exponentials are arithmetic."""

DEEPEST = 32
"""Most choices within each other: compilers and Python's parser limit the depth of brackets."""


class Place:
    """Place of a statement: side 1 or 2 of the choice number `choice`, within another place; the outermost has no `outer`."""

    __slots__ = ("choice", "depth", "known", "outer", "side")

    def __init__(self, outer: "Place | None" = None, choice: int = -1, side: int = 0):
        self.outer, self.choice, self.side, self.known = outer, choice, side, {}
        self.depth: int = outer.depth + 1 if outer else 0

    def within(self, choice: int, side: int) -> "Place":
        """The place of one side of a choice that is here; each exists once."""
        key = (choice, side)
        if key not in self.known:
            self.known[key] = Place(self, choice, side)
        return self.known[key]


def _loops(writes: tuple[Write, ...]) -> tuple[dict[Node, int], set[Node], int]:
    """(number of the loop of each statement at the outermost place, statements whose values later loops use, the last loop).

    Even loops have no CALLING operations; an odd one has those that need only the loops before it. The last is even; it stores.
    """
    order = needed(value for _, value in writes)
    homes, outer = _homes(order, writes, CALLING), {}
    for n in order:
        outer[n] = _outermost(n, homes[n])
    heavy = {outer[n] for n in order if n.op in CALLING}
    ready: dict[Node, int] = {}  # the even loop from which a value can be used
    loops: dict[Node, int] = {}
    for n in order:
        ready[n] = max((ready[a] for a in n.nodes), default=0)
        if not homes[n].depth and n.number in heavy:
            loops[n], ready[n] = ready[n] + 1, ready[n] + 2
        elif not homes[n].depth:
            loops[n] = ready[n]
    last = max(loops.values(), default=0)
    last += last % 2
    used: dict[Node, set[int]] = {value: {last} for _, value in writes if isinstance(value, Node)}
    at = {n.number: loop for n, loop in loops.items()}
    for n in reversed(order):
        for a in n.nodes:  # a comparison is computed where it is used
            used.setdefault(a, set()).update(used[n] if n.op in COMPARE else {at[outer[n]]})
    return loops, {n for n in loops if n.op not in COMPARE and used[n] - {loops[n]}}, last


def _c_statements(
    writes: tuple[Write, ...], name: Callable, places: Mapping[Node, str] = MappingProxyType({}), heavy: Container[str] = HEAVY
) -> tuple[list[tuple[Node, list[str]]], list[str]]:
    """(for each node at the outermost place the lines that compute it, lines that store or return the values). `places`:
    elements of arrays that hold the values of nodes."""
    order, form = needed(value for _, value in writes), "const double {0} = {1};"
    outermost = Place()
    homes, text = _homes(order, writes, heavy, outermost), {}
    inside: dict[Place, list[Node]] = {}
    for n in order:
        inside.setdefault(homes[n], []).append(n)

    def said(value: object) -> str:
        return text[value] if isinstance(value, Node) else _number(value, form)

    def statement(n: Node) -> list[str]:
        if n.op in COMPARE:
            text[n] = f"({_operation(n, [said(a) for a in n.args], True)})"
            return []
        text[n] = places.get(n, f"t{n.number}")
        sides = [homes[n].within(n.number, side) for side in (1, 2)] if n.op == "where" else []
        if any(side in inside for side in sides):
            lines = [f"double {text[n]};"] * (n not in places)
            for head, side, value in zip((f"if ({said(n.args[0])}) {{", "} else {"), sides, n.args[1:], strict=True):
                lines += [head, *(f"  {line}" for line in block(side)), f"  {text[n]} = {said(value)};"]
            return [*lines, "}"]
        code = _operation(n, [said(a) for a in n.args], True) if n.nodes else name((n.op, *n.args))
        return [f"{text[n]} = {code};" if n in places else form.format(text[n], code)]

    def block(path: Place) -> list[str]:
        return [line for n in inside.get(path, ()) for line in statement(n)]

    statements = [(n, statement(n)) for n in inside.get(outermost, ())]
    return statements, [f"{name(t)} = {said(v)};" if t != ("result",) else f"return {said(v)};" for t, v in writes]


def _homes(
    order: Sequence[Node], writes: tuple[Write, ...], heavy: Container[str], outermost: Place | None = None
) -> dict[Node, Place]:
    """For each node the innermost place that is visible to all its users; choices without `heavy` operations have no place."""
    outermost = outermost or Place()
    homes: dict[Node, Place] = {value: outermost for _, value in writes if isinstance(value, Node)}
    for n in reversed(order):  # all users of a node come later
        for k, a in enumerate(n.args):
            if isinstance(a, Node):
                there = homes[n].within(n.number, k) if n.op == "where" and k and homes[n].depth < DEEPEST else homes[n]
                homes[a] = _shared(homes[a], there) if a in homes else there
    opened = {outermost}
    for n in order:
        place = homes[n]
        while n.op in heavy and place not in opened:
            opened.add(place)
            place = place.outer
    return {n: _innermost(place, opened) for n, place in homes.items()}


def _innermost(place: Place, opened: Container[Place]) -> Place:
    while place not in opened:
        place = place.outer
    return place


def _shared(one: Place, other: Place) -> Place:
    """The innermost place that contains both."""
    while one is not other:
        if one.depth >= other.depth:
            one = one.outer
        else:
            other = other.outer
    return one


def _statements(writes, name: Callable, form: str):
    """Python code for `writes`: (statements in order, expression of each target's value)."""
    order = needed(value for _, value in writes)
    uses = Counter(value for _, value in writes if isinstance(value, Node))
    uses.update(a for n in order for a in n.nodes)
    lines, text, depth = [], {}, {}
    for n in order:
        args = [text[a] if isinstance(a, Node) else _number(a, form) for a in n.args] if n.nodes else None
        code = _operation(n, args, False) if args else name((n.op, *n.args))
        depth[n] = 1 + max((depth[a] for a in n.nodes), default=0)
        if n.op in COMPARE or n.op in ("c", "dt") or (uses[n] == 1 and depth[n] < DEEPEST):
            text[n] = f"({code})" if args and n.op not in (*CALLS, *TABLES) else code
        else:
            text[n], depth[n] = f"t{len(lines)}", 0
            lines.append(form.format(text[n], code))
    return lines, {t: text[v] if isinstance(v, Node) else _number(v, form) for t, v in writes}


def _number(x: float, form: str) -> str:
    if isinf(x):
        return ("-" if x < 0 else "") + ("INFINITY" if form.endswith(";") else 'float("inf")')
    return f"({float(x)!r})" if x < 0 else repr(float(x))


INFIX = frozenset(("+", "-", "*", "/", *COMPARE)) - {"&", "|"}


def _operation(n: Node, x: list[str], in_c: bool) -> str:
    """The operation of a node on its arguments `x`, in C or in Python."""
    if n.op in INFIX:
        return f"{x[0]} {n.op} {x[1]}"
    match n.op:
        case "where":
            return f"{x[0]} ? {x[1]} : {x[2]}" if in_c else f"{x[1]} if {x[0]} else {x[2]}"
        case "neg":
            return f"-{x[0]}"
        case "whole":
            return f"{x[0]} + {WHOLE!r} - {WHOLE!r}"
        case "&" | "|" if in_c:
            return f"{x[0]} {n.op * 2} {x[1]}"
        case "&" | "|":
            return f"{x[0]} {'and' if n.op == '&' else 'or'} {x[1]}"
        case "pow" if in_c:
            return f"power({x[0]}, {x[1]})"
        case "exp" | "expm1" if in_c:
            return f"{n.op.upper()}({x[0]})"
        case "look_up" | "look_up_2":
            return f"{n.op}({', '.join([*x, *_table_arguments(n, in_c), *map(str, n.table[1:])])})"
    return f"{n.op}({', '.join(x)})"


def _table_arguments(n: Node, in_c: bool) -> list[str]:
    """Sizes and arrays of a node's table."""
    name, parts = _table_name(n), n.table[0]
    arrays = [(f"{name}_{k}" if in_c else f"{name}[{k}]") if part else "0" if in_c else "None" for k, part in enumerate(parts)]
    if n.op == "look_up":
        return [str(len(parts.xs)), *arrays]
    sized = [str(len(parts.xs)), arrays[0], str(len(parts.ys)), arrays[1], arrays[2]]
    return [*sized, str(int(len(parts.grid) > len(parts.xs) * len(parts.ys)))] if in_c else sized
