"""Forward derivatives of a recorded graph, themselves recorded."""

from collections.abc import Iterable, Mapping, Sequence

from vpp_fmu.kernel.ops import LN_10
from vpp_fmu.tracer.graph import COMPARE, Graph, Node


def tangents(graph: Graph, leaves: Mapping[Node, object], values: Sequence[object], order: Iterable[Node]) -> list[object]:
    """The derivatives of values in one parameter, from those of the leaves; unnamed leaves do not depend on it.

    Values and derivatives are nodes or numbers; `order`: all nodes that the values need, in order. A derivative that is zero
    stays the number 0.0, so values that do not depend on the parameter cost nothing.
    """
    known = {n: d for n, d in leaves.items() if not _is(d, 0.0)}  # missing ones are 0
    for n in order:
        if n not in known and n.op not in COMPARE and not known.keys().isdisjoint(n.nodes):
            derivative = _rule(graph, n, [known.get(a, 0.0) if isinstance(a, Node) else 0.0 for a in n.args])
            if not _is(derivative, 0.0):
                known[n] = derivative
    return [known.get(v, 0.0) if isinstance(v, Node) else 0.0 for v in values]


def _rule(graph: Graph, n: Node, d: Sequence[object]):
    """The derivative of one operation from its arguments' derivatives `d`."""
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
        case "log":
            return d[0] / x[0]
        case "log10":
            return d[0] / (LN_10 * x[0])
        case "pow":
            return _sum(
                0.0 if _is(d[0], 0.0) else _product(x[1] * graph.pow(x[0], x[1] - 1.0), d[0]),
                0.0 if _is(d[1], 0.0) else _product(n * graph.log(x[0]), d[1]),
            )
        case "atan2":
            return _difference(_product(x[1], d[0]), _product(x[0], d[1])) / (x[0] * x[0] + x[1] * x[1])
        case "look_up":
            return _product(graph.look_up(x[0], n.table[0], n.table[1] + 1), d[0])
        case "look_up_2":
            c, i, j = n.table
            along_x = 0.0 if _is(d[0], 0.0) else _product(graph.look_up_2(*x, c, i + 1, j), d[0])
            return _sum(along_x, 0.0 if _is(d[1], 0.0) else _product(graph.look_up_2(*x, c, i, j + 1), d[1]))
        case "sqrt":
            return d[0] / (2.0 * n)
        case "sin":
            return _product(graph.cos(x[0]), d[0])
        case "cos":
            return -_product(graph.sin(x[0]), d[0])
        case "tanh":
            return _product(1.0 - n * n, d[0])
        case "whole":
            return 0.0
        case "where":
            return graph.where(x[0], d[1], d[2])
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
