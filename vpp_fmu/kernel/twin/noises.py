"""Model errors that are common to all rigs, and the linear algebra of the filter."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import sqrt
from typing import Any

PLACE = 0.2
"""Of the scales of speed and pitch: so far apart, errors of a thrust map have little to do with each other, as
`identification.assessment.model_error` counts them."""

BLOCK, HALVES = 0.5, 0.5
"""Time over which the model's error was measured, and half-life of the error after a move, s: likewise."""

NODES = (1.0 / 3.0, 2.0 / 3.0, 1.0), (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Normalised speeds and pitches of a grid over the map, between which the model's error is interpolated; beyond, it stays."""

AT_NODES = tuple(f"map_error_{i}_{j}" for i, _ in enumerate(NODES[0]) for j, _ in enumerate(NODES[1]))
"""States of the error at the nodes, speed by speed."""

BETWEEN = 0.4
"""Share of the model's error over the map that such an interpolation leaves, standard deviation: the largest of twelve emulated
rigs, each identified, whose error at rest was fitted by it; 0.11 to 0.39."""

NODE = 1.5 * sqrt(1.0 - BETWEEN * BETWEEN)
"""Standard deviation at a node for one over the map: the mean square of a straight line's two weights is 2/3 of 1."""

ON_THE_WAY, SPEED_ON_THE_WAY = 0.08, 0.06
"""Of a move of thrust and of speed, what a model that is right about its end is off on the way, standard deviation: a motor
that brakes, an actuator at its fastest are far from any lag. Of twelve emulated rigs, each identified, under random steps and
under the controller: of thrust 0.03 to 0.15, 0.075 the root of the mean square; of speed 0.02 to 0.06. Campaigns alone often
show none of it."""

TOLERATED = 2.5
"""Standard deviations of the model's error on the way that half of a change which is watched for must exceed to count: a sum of
log-likelihood ratios decreases while the change is below half of the assumed one, and one move in 80 is further off."""

OUTLIER = 4.0
"""Standard deviations beyond which a reading's influence is constant (Huber): one normal reading in 16 000."""

WITHIN = 1.96
"""Standard deviations of a 95 % band."""


def nothing(ops: Any, s: Any, p: Any) -> float:
    """Start value 0 of a state."""
    return 0.0


def pairs(n: int) -> list[tuple[int, int]]:
    """Places in the upper triangle of n x n."""
    return [(i, j) for i in range(n) for j in range(i, n)]


def times(P: Mapping, g: Sequence) -> list:
    """P g of a symmetric matrix by its upper triangle; None in g is 0."""
    return [dot(g, [P[min(i, j), max(i, j)] for j in range(len(g))]) for i in range(len(g))]


def dot(g: Sequence, x: Sequence) -> Any:
    """g x, over what g has; None in g is 0."""
    terms = [b * a for a, b in zip(g, x, strict=False) if a is not None]
    return sum(terms[1:], terms[0]) if terms else 0.0


def weights(ops: Any, w: Any, b: Any) -> list:
    """Of each node of the grid, speed by speed, at a normalised speed and pitch; they add up to 1."""
    by_speed, by_pitch = (_hats(ops, at, nodes) for at, nodes in zip((w, b), NODES, strict=True))
    return [x * y for x in by_speed for y in by_pitch]


def _hats(ops: Any, at: Any, nodes: Sequence[float]) -> list:
    """Weights of linear interpolation between nodes."""
    shares = [
        ops.clip((at - low) * (1.0 / (high - low)), 0.0, 1.0) for low, high in pairwise(nodes)
    ]  # of the way from node to node
    return [before - after for before, after in zip([1.0, *shares], [*shares, 0.0], strict=True)]
