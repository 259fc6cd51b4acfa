"""Recording arithmetic: the computation of a kernel function on symbols becomes a graph of operations.

Operations that can't be recorded raise Unseen, a TypeError: `if`, `and`, `==`, `max`, `**`, `math.exp` on a traced value.
"""

from collections.abc import Iterable

from vpp_fmu.kernel.ops import NUMBERS, Ops, Symbolic

CALLS = ("exp", "expm1", "sqrt", "sin", "cos", "tanh")
COMPARE = ("<", ">")


class Node(Symbolic):
    """One operation of a graph on `args`: nodes and numbers.

    Leaves have whole numbers for arguments: `v` a value by its position, `d` a tangent, `c` a prepared constant, `dt` the
    step, `dt_tangent` the step's tangent in a delay.
    """

    __slots__ = ("args", "graph", "nodes", "number", "op")

    def __init__(self, graph: "Graph", op: str, args: tuple, number: int):
        self.graph, self.op, self.args, self.number = graph, op, args, number
        self.nodes = tuple(a for a in args if isinstance(a, Node))  # none for a leaf

    def __add__(self, other):
        return self.graph.node("+", self, other)

    def __radd__(self, other):
        return self.graph.node("+", other, self)

    def __sub__(self, other):
        return self.graph.node("-", self, other)

    def __rsub__(self, other):
        return self.graph.node("-", other, self)

    def __mul__(self, other):
        return self.graph.node("*", self, other)

    def __rmul__(self, other):
        return self.graph.node("*", other, self)

    def __truediv__(self, other):
        return self.graph.node("/", self, other)

    def __rtruediv__(self, other):
        return self.graph.node("/", other, self)

    def __neg__(self):
        return self.graph.node("neg", self)

    def __lt__(self, other):
        return self.graph.node("<", self, other)

    def __gt__(self, other):
        return self.graph.node(">", self, other)


class Graph(Ops):
    """Records operations, each once."""

    def __init__(self):
        self._known: dict[tuple, Node] = {}

    def node(self, op: str, *args) -> Node:
        """The node for `op` on `args`: a new one, or the existing one."""
        key = (op, *(a.number if isinstance(a, Node) else repr(float(a)) for a in args))
        if key not in self._known:
            self._known[key] = Node(self, op, args, len(self._known))
        return self._known[key]

    def where(self, condition, yes, no):
        return self.node("where", condition, yes, no) if isinstance(condition, Node) else NUMBERS.where(condition, yes, no)

    def whole(self, x):
        return self._call("whole", x)

    def exp(self, x):
        return self._call("exp", x)

    def expm1(self, x):
        return self._call("expm1", x)

    def sqrt(self, x):
        return self._call("sqrt", x)

    def sin(self, x):
        return self._call("sin", x)

    def cos(self, x):
        return self._call("cos", x)

    def tanh(self, x):
        return self._call("tanh", x)

    def _call(self, name, x):
        return self.node(name, x) if isinstance(x, Node) else getattr(NUMBERS, name)(x)


def needed(values: Iterable[object]) -> list[Node]:
    """The nodes among the values and all nodes that they need, in the order of recording."""
    stack = [v for v in values if isinstance(v, Node)]
    seen = set(stack)
    while stack:
        below = [a for a in stack.pop().nodes if a not in seen]
        seen.update(below)
        stack += below
    return sorted(seen, key=lambda n: n.number)
