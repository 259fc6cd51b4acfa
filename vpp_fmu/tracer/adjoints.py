"""Reverse derivatives of a traced program: vector-Jacobian products of `step`, `prepare` and `start`.

For y = f(x) and cotangents b_y (the derivatives of some number in y), b_x = (df/dx)^T b_y. One sweep from y back to x gives
all of b_x for a few times the work of f, however many x there are (Griewank and Walther, Evaluating Derivatives, ch. 3);
tangents cost the work of f once for each x.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from vpp_fmu.tracer.emit import c_function
from vpp_fmu.tracer.graph import Graph, Node, needed
from vpp_fmu.tracer.program import Program, Write
from vpp_fmu.tracer.tangents import tangents


@dataclass(frozen=True)
class Adjoints:
    """The reverse sweep through each block of a program. It changes cotangents in place: all are read before any is written.

    `b` holds cotangents of values by position, `g` those of prepared constants. `step` replaces the cotangents of the states
    after the step by those before it, and sets those of the outputs to 0, because the step overwrites the outputs. It adds to
    those of parameters and constants. `prepare` adds the contribution of the constants to the parameters; its result is the
    cotangent of dt. `start` adds to the parameters.
    """

    step: tuple[Write, ...]
    prepare: tuple[Write, ...]
    start: tuple[Write, ...]


def adjoints(program: Program) -> Adjoints:
    """The adjoints of a program's blocks in all that they read except inputs; for a program traced without tangents."""
    graph, layout = _graph(program), program.layout
    parameters, states = layout.positions("parameter"), layout.positions("state")
    constants = range(len(program.prepare))

    def added(total: dict, kind: str, leaf: str, positions: Iterable[int]) -> list[Write]:
        leaves = ((i, graph.node(leaf, i)) for i in positions)
        return [((kind, i), graph.node(kind, i) + total[x]) for i, x in leaves if x in total]

    total = pulled_back(graph, _seeds(graph, program.step))
    moved = [(("b", i), total.get(graph.node("v", i), 0.0)) for i in states]
    moved += [(("b", i), 0.0) for i in layout.positions("output")]
    moved += added(total, "b", "v", parameters) + added(total, "g", "c", constants)
    total = pulled_back(graph, _seeds(graph, program.prepare))
    prepared = added(total, "b", "v", parameters)
    prepared.append((("result",), total.get(graph.node("dt"), 0.0)))
    begun = added(pulled_back(graph, _seeds(graph, program.start)), "b", "v", parameters)
    return Adjoints(tuple(moved), tuple(prepared), tuple(begun))


def pulled_back(graph: Graph, seeds: Iterable[tuple[object, Node]]) -> dict[Node, object]:
    """The cotangent (node or number) of every node that the seeds depend on; seeds are (node or number, its cotangent).

    Each operation's partial derivatives are its forward rule on one-hot tangents: both modes use one table of rules.
    """
    total: dict[Node, object] = {}
    seeds = list(seeds)

    def add(n: Node, w: object) -> None:
        total[n] = total[n] + w if n in total else w

    for value, w in seeds:
        if isinstance(value, Node):
            add(value, w)
    for n in reversed(needed(value for value, _ in seeds)):  # all nodes that use n come later, so its cotangent is complete
        for a in dict.fromkeys(n.nodes):
            (partial,) = tangents(graph, {a: 1.0}, [n], [n])
            if n in total and not _is(partial, 0.0):
                add(a, total[n] if _is(partial, 1.0) else -total[n] if _is(partial, -1.0) else total[n] * partial)
    return total


def c_adjoints(program: Program) -> str:
    """The adjoints of a program as static C functions, for `adjoint.c`; comes after the program's own text."""
    back = adjoints(program)

    def name(target: tuple) -> str:
        kind, *i = target
        return f"{kind}[{i[0]}]" if i else kind

    return "".join(
        (
            c_function("void step_back(const double *v, const double *c, double *b, double *g)", back.step, name),
            c_function("double prepare_back(const double *v, double dt, const double *g, double *b)", back.prepare, name),
            c_function("void start_back(const double *v, double *b)", back.start, name),
        )
    )


def _seeds(graph: Graph, writes: tuple[Write, ...]) -> list[tuple[object, Node]]:
    kinds = {"v": "b", "c": "g"}
    return [(value, graph.node(kinds[t[0]], *t[1:])) for t, value in writes if t[0] in kinds]


def _graph(program: Program) -> Graph:
    return next(value.graph for _, value in (*program.step, *program.start) if isinstance(value, Node))


def _is(x: object, number: float) -> bool:
    return not isinstance(x, Node) and x == number
