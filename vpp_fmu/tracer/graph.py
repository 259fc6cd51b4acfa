"""Recording arithmetic: the computation of a kernel function on symbols becomes a graph of operations.

Operations that can't be recorded raise Unseen, a TypeError: `if`, `and`, `max`, `math.exp` on a traced value.
"""

from collections.abc import Iterable

from vpp_fmu.kernel.ops import NUMBERS, Ops, Symbolic
from vpp_fmu.kernel.tables import Curve, Surface

CALLS = ("exp", "expm1", "log", "log10", "pow", "sqrt", "sin", "cos", "tanh", "atan2")
"""Functions of one or two numbers; all but EXPONENTIALS are those of C's and Python's maths libraries."""

EXPONENTIALS = ("exp", "expm1")
TABLES = ("look_up", "look_up_2")
COMPARE = ("<", ">", "<=", ">=", "==", "!=", "&", "|")
"""Operations whose result is a condition, which has no derivative."""


class Node(Symbolic):
    """One operation of a graph on `args`: nodes and numbers.

    Leaves have whole numbers for arguments: `v` a value by its position, `d` a tangent, `c` a prepared constant, `dt` the
    step, `dt_tangent` the step's tangent in a delay. Tables have theirs, and the orders of the derivative, in `table`.
    """

    __slots__ = ("args", "graph", "nodes", "number", "op", "table")

    def __init__(self, graph: "Graph", op: str, args: tuple, number: int, table: tuple = ()):
        self.graph, self.op, self.args, self.number, self.table = graph, op, args, number, table
        self.nodes = tuple(a for a in args if isinstance(a, Node))  # none for a leaf

    def __neg__(self):
        return self.graph.node("neg", self)

    __hash__ = object.__hash__


def _recorded(op: str, swapped: bool):
    def method(self, other):
        if isinstance(other, tuple):  # a vector: it has the operation for each of its elements
            return NotImplemented
        return self.graph.node(op, other, self) if swapped else self.graph.node(op, self, other)

    return method


for _name, _op in {"add": "+", "sub": "-", "mul": "*", "truediv": "/", "pow": "pow", "and": "&", "or": "|"}.items():
    setattr(Node, f"__{_name}__", _recorded(_op, False))
    setattr(Node, f"__r{_name}__", _recorded(_op, True))
for _name, _op in {"lt": "<", "gt": ">", "le": "<=", "ge": ">=", "eq": "==", "ne": "!="}.items():
    setattr(Node, f"__{_name}__", _recorded(_op, False))


class Graph(Ops):
    """Records operations, each once."""

    def __init__(self):
        self._known: dict[tuple, Node] = {}
        self.library: set[str] = set()
        """Recorded operations that the languages do not have, or not the same: powers, exponentials and tables."""

    def node(self, op: str, *args, table: tuple = ()) -> Node:
        """The node for `op` on `args`: a new one, or the existing one."""
        key = (op, *(a.number if isinstance(a, Node) else repr(float(a)) for a in args))
        if table:
            key += (id(table[0]), *table[1:])  # a node keeps its table, so no other has this id
        if key not in self._known:
            self._known[key] = Node(self, op, args, len(self._known), table)
            if table or op == "pow" or op in EXPONENTIALS:
                self.library.add(op)
        return self._known[key]

    def rebuilt(self, n: Node, args: Iterable) -> Node:
        """The operation of a node on other arguments."""
        return self.node(n.op, *args, table=n.table)

    def where(self, condition, yes, no):
        return self.node("where", condition, yes, no) if isinstance(condition, Node) else NUMBERS.where(condition, yes, no)

    def look_up(self, x, c: Curve, order=0):
        return self.node("look_up", x, table=(c, order)) if isinstance(x, Node) else NUMBERS.look_up(x, c, order)

    def look_up_2(self, x, y, c: Surface, order_x=0, order_y=0):
        if not isinstance(x, Node) and not isinstance(y, Node):
            return NUMBERS.look_up_2(x, y, c, order_x, order_y)
        return self.node("look_up_2", x, y, table=(c, order_x, order_y))


def _called(name: str):
    def method(self, *x):
        return self.node(name, *x) if any(isinstance(a, Node) for a in x) else getattr(NUMBERS, name)(*x)

    return method


for _name in ("whole", *CALLS):
    setattr(Graph, _name, _called(_name))


def needed(values: Iterable[object]) -> list[Node]:
    """The nodes among the values and all nodes that they need, in the order of recording."""
    stack = [v for v in values if isinstance(v, Node)]
    seen = set(stack)
    while stack:
        below = [a for a in stack.pop().nodes if a not in seen]
        seen.update(below)
        stack += below
    return sorted(seen, key=lambda n: n.number)
