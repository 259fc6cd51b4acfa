"""A model's own functions, run once on symbols: straight-line blocks with forward tangents.

The same operations in the same order as on floats, so that generated Python and C equal the functions to the last bit.
Values that depend only on parameters and the step are computed separately (`prepare`), not at every step.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from vpp_fmu.kernel.types import Model, largest_step, start, step
from vpp_fmu.tracer.graph import COMPARE, Graph, Node, needed
from vpp_fmu.tracer.tangents import tangents


@dataclass(frozen=True)
class Layout:
    """Index of each value in the list of all values; it is the FMU's value reference."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    states: tuple[str, ...]

    @classmethod
    def of(cls, model: Model) -> "Layout":
        """The layout of a model's declared quantities, in their order."""
        groups = model.inputs, model.outputs, model.parameters, model.states
        return cls(*(tuple(quantity.name for quantity in group) for group in groups))

    @cached_property
    def index(self) -> dict[tuple[str, str], int]:
        """(kind, name) -> position; kinds are `input`, `output`, `parameter`, `state`."""
        groups = {"input": self.inputs, "output": self.outputs, "parameter": self.parameters, "state": self.states}
        return {key: i for i, key in enumerate((kind, name) for kind, names in groups.items() for name in names)}

    def positions(self, kind: str) -> list[int]:
        """Positions of all values of one kind, in their order."""
        return [i for (k, _), i in self.index.items() if k == kind]

    @cached_property
    def moving(self) -> list[int]:
        """Positions of the values that a step changes, outputs then states; these have tangents, in this order."""
        return self.positions("output") + self.positions("state")


Write = tuple[tuple, object]
"""(target, node or number): ("v", i) a value, ("d", k, j) the tangent of `moving[k]` in `wrt[j]`, ("c", i) a prepared
constant, ("result",) a scalar that is returned."""


@dataclass(frozen=True)
class Program:
    """A traced model: the writes of `start`, `prepare`, `step` and `largest_step`."""

    model: Model
    layout: Layout
    wrt: tuple[str, ...]
    start: tuple[Write, ...]
    prepare: tuple[Write, ...]
    step: tuple[Write, ...]
    largest_step: tuple[Write, ...]


def trace(model: Model, wrt: Iterable[str] = ()) -> Program:
    """Trace `model`, with forward sensitivities of states and outputs in the parameters named in `wrt`."""
    wrt, layout, graph = tuple(wrt), Layout.of(model), Graph()
    at = layout.index
    inputs, parameters, states = (
        {name: graph.node("v", at[kind, name]) for name in names}
        for kind, names in (("input", layout.inputs), ("parameter", layout.parameters), ("state", layout.states))
    )
    dt = graph.node("dt")
    delay_parameters = [p for _, p in model.delays]
    from_start, from_step = [], []
    for j, name in enumerate(wrt):
        leaves = {parameters[name]: 1.0}
        from_start.append(leaves)
        leaves = leaves | {x: graph.node("d", layout.moving.index(at["state", n]), j) for n, x in states.items()}
        if name in delay_parameters:  # a delay moves the ends of the schedule's pieces, and so the length of a step
            leaves[dt] = graph.node("dt_tangent", delay_parameters.index(name))
        from_step.append(leaves)

    begun = _writes(graph, layout, *start(model, graph, inputs, parameters), from_start)
    moved = _writes(graph, layout, *step(model, graph, inputs, states, parameters, dt), from_step)
    prepared, moved = _set_apart(graph, moved, set(parameters.values()))
    longest = ((("result",), largest_step(model, graph, parameters)),)
    return Program(model, layout, wrt, begun, prepared, moved, longest)


def _writes(graph: Graph, layout: Layout, signals: dict, states: dict, wrt: list[dict[Node, object]]) -> tuple[Write, ...]:
    values = [signals[n] for n in layout.outputs] + [states[n] for n in layout.states]
    writes = [(("v", i), value) for i, value in zip(layout.moving, values, strict=True)]
    order = needed(values)
    for j, leaves in enumerate(wrt):
        writes += [(("d", k, j), derivative) for k, derivative in enumerate(tangents(graph, leaves, values, order))]
    return tuple(writes)


def _set_apart(graph: Graph, writes: tuple[Write, ...], parameters: set[Node]) -> tuple[tuple[Write, ...], tuple[Write, ...]]:
    """Split off values that need only parameters and dt: (writes of `prepare`, writes of `step`)."""
    order = needed(value for _, value in writes)
    fixed = set()
    for n in order:
        leaf = n in parameters or n.op in ("dt", "dt_tangent")
        made = bool(n.nodes) and all(a in fixed for a in n.nodes)
        if leaf or made:
            fixed.add(n)

    prepared: list[Write] = []
    moved: dict[Node, Node] = {}

    def constant(n: Node) -> Node:
        prepared.append((("c", len(prepared)), n))
        return graph.node("c", len(prepared) - 1)

    def carried(n: object) -> object:
        """The expression for `n` in `step`."""
        if not isinstance(n, Node):
            return n
        if n not in moved:  # then it is fixed: all others are entered in order, below
            if n in parameters:
                moved[n] = n
            elif n.op in COMPARE:
                moved[n] = constant(graph.where(n, 1.0, 0.0)) > 0.5
            else:
                moved[n] = constant(n)
        return moved[n]

    for n in order:
        if n not in fixed:
            moved[n] = graph.node(n.op, *(carried(a) for a in n.args)) if n.nodes else n
    stepped = tuple((target, carried(value)) for target, value in writes)
    return tuple(prepared), stepped
