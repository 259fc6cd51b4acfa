"""Forward derivatives of a recorded graph, themselves recorded."""

from collections.abc import Mapping

from vpp_fmu.tracer.graph import COMPARE, Graph, Node, needed_by


class Tangents:
    """Derivatives of nodes in one parameter, from those of the leaves; leaves not named do not depend on it.

    A derivative that is zero stays the number 0.0, so what doesn't depend on the parameter costs nothing.
    """

    def __init__(self, graph: Graph, leaves: Mapping[Node, object]):
        self._graph, self._known = graph, dict(leaves)

    def of(self, value):
        """The derivative of a node or number: a node or a number."""
        if not isinstance(value, Node):
            return 0.0
        for n in needed_by(value, self._known):
            self._known[n] = self._rule(n)
        return self._known[value]

    def _rule(self, n: Node):
        d = [self._known[a] if isinstance(a, Node) else 0.0 for a in n.args]
        if n.op in COMPARE or all(_is(x, 0.0) for x in d):
            return 0.0
        x = n.args
        match n.op:
            case "+":
                return _sum(d[0], d[1])
            case "-":
                return _difference(d[0], d[1])
            case "neg":
                return -d[0]
            case "*":
                return _sum(_product(d[0], x[1]), _product(x[0], d[1]))
            case "/":
                return _difference(d[0], _product(n, d[1])) / x[1]
            case "exp":
                return _product(n, d[0])
            case "expm1":
                return _product(n + 1.0, d[0])
            case "sqrt":
                return d[0] / (2.0 * n)
            case "sin":
                return _product(self._graph.cos(x[0]), d[0])
            case "cos":
                return -_product(self._graph.sin(x[0]), d[0])
            case "tanh":
                return _product(1.0 - n * n, d[0])
            case "where":
                return self._graph.where(x[0], d[1], d[2])
        raise TypeError(f"no derivative is known for {n.op}")


def _is(x, number: float) -> bool:
    return not isinstance(x, Node) and x == number


def _sum(x, y):
    return y if _is(x, 0.0) else x if _is(y, 0.0) else x + y


def _difference(x, y):
    return x if _is(y, 0.0) else -y if _is(x, 0.0) else x - y


def _product(x, y):
    if _is(x, 0.0) or _is(y, 0.0):
        return 0.0
    return y if _is(x, 1.0) else x if _is(y, 1.0) else x * y
