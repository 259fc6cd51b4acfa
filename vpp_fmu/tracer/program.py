"""A model's own functions, run once on symbols: straight-line blocks with forward tangents.

The operations are those on floats, in the same order: generated Python and C equal the functions to the last bit.
Values that depend only on parameters and the step are computed separately (`prepare`), not at every step.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import or_

from vpp_fmu.kernel.types import Model, largest_step, show, start, step
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
    """A traced model: the writes of `start`, `prepare`, `step`, `largest_step`, and `show`, of the outputs at given states."""

    model: Model
    layout: Layout
    wrt: tuple[str, ...]
    start: tuple[Write, ...]
    prepare: tuple[Write, ...]
    step: tuple[Write, ...]
    largest_step: tuple[Write, ...]
    show: tuple[Write, ...]


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
    settled, ahead = start(model, graph, inputs, parameters), step(model, graph, inputs, states, parameters, dt)
    influenced = _influence([(x, settled[1][n], ahead[1][n]) for n, x in states.items()])
    from_start, from_step = [], []
    for j, name in enumerate(wrt):
        leaves = {parameters[name]: 1.0}
        from_start.append(leaves)
        if name in delay_parameters:  # a delay moves the ends of the schedule's pieces, and so the length of a step
            leaves = leaves | {dt: graph.node("dt_tangent", delay_parameters.index(name))}
        moving = influenced(leaves)
        tangent = {x: graph.node("d", layout.moving.index(at["state", n]), j) for n, x in states.items() if x in moving}
        from_step.append(leaves | tangent)

    begun, moved = _writes(graph, layout, *settled, from_start), _writes(graph, layout, *ahead, from_step)
    zero = {target for target, value in begun if target[0] == "d" and _is_zero(value)}
    moved = tuple((target, value) for target, value in moved if not (target in zero and _is_zero(value)))
    prepared, moved = _set_apart(graph, moved, set(parameters.values()))
    longest = ((("result",), largest_step(model, graph, parameters)),)
    signals = show(model, graph, inputs, states, parameters)
    shown = zip(layout.positions("output"), _values(graph, signals, layout.outputs), strict=True)
    return Program(model, layout, wrt, begun, prepared, moved, longest, tuple((("v", i), value) for i, value in shown))


def _influence(states: Sequence[tuple[Node, object, object]]) -> Callable[[Iterable[Node]], set[Node]]:
    """A function from leaves to the states that have a tangent at any time if the leaves have one.

    `states`: each one's leaf, its value at the start and its value after a step. Most states do not depend on most parameters;
    their tangents are zero, and cost as much as others if they are computed.
    """
    reach: dict[Node, int] = {}  # bits of the leaves on which a value depends; a comparison has no derivative
    for n in needed(value for _, *values in states for value in values):
        below = () if n.op in COMPARE else map(reach.get, n.nodes)
        reach[n] = reduce(or_, below, 0 if n.nodes else 1 << n.number)
    sources = {x: reduce(or_, (reach[v] for v in values if isinstance(v, Node)), 0) for x, *values in states}

    def influenced(leaves: Iterable[Node]) -> set[Node]:
        bits, found, grown = sum(1 << n.number for n in leaves), set(), True
        while grown:
            grown = {x for x, source in sources.items() if x not in found and source & bits}
            found |= grown
            bits |= sum(1 << x.number for x in grown)
        return found

    return influenced


def _is_zero(value: object) -> bool:
    return not isinstance(value, Node) and value == 0.0


def _values(graph: Graph, values: dict, names: Iterable[str]) -> list:
    """Values by their names; of a condition 1 or 0."""
    found = (values[name] for name in names)
    return [graph.where(v, 1.0, 0.0) if isinstance(v, Node) and v.op in COMPARE else v for v in found]


def _writes(graph: Graph, layout: Layout, signals: dict, states: dict, wrt: list[dict[Node, object]]) -> tuple[Write, ...]:
    values = [*_values(graph, signals, layout.outputs), *_values(graph, states, layout.states)]
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
        if n not in moved:  # `n` is fixed: the loop below enters all others in order
            if n in parameters:
                moved[n] = n
            elif n.op in COMPARE:
                moved[n] = constant(graph.where(n, 1.0, 0.0)) > 0.5
            else:
                moved[n] = constant(n)
        return moved[n]

    for n in order:
        if n not in fixed:
            moved[n] = graph.rebuilt(n, map(carried, n.args)) if n.nodes else n
    stepped = tuple((target, carried(value)) for target, value in writes)
    return tuple(prepared), stepped
