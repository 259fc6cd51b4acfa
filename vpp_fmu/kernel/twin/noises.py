"""Model errors that are common to all rigs, and the linear algebra of the filter."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import sqrt
from typing import Any

PLACE = 0.2
"""Correlation length of the errors of a thrust map, as a share of the scales of speed and pitch, as in
`identification.assessment.model_error`."""

BLOCK, HALVES = 0.5, 0.5
"""Time over which residuals are averaged, s, and share of a move that counts in the next such block: as there."""

SLOW_TIME = 0.15
"""Usual correlation time of the slow noise, s. Repeated runs of four rigs have 0.12 to 0.17 s."""

NODES = (1.0 / 3.0, 2.0 / 3.0, 1.0), (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Normalised speeds and pitches of a grid over the map, between which the model's error is interpolated; constant beyond."""

AT_NODES = tuple(f"map_error_{i}_{j}" for i, _ in enumerate(NODES[0]) for j, _ in enumerate(NODES[1]))
"""States of the error at the nodes, speed by speed."""

BETWEEN = 0.4
"""Standard deviation of the interpolation's error, as a share of the model's error over the map: the largest of twelve
emulated, identified rigs, whose error at rest was interpolated; 0.11 to 0.39."""

NODE = 1.5 * sqrt(1.0 - BETWEEN * BETWEEN)
"""Standard deviation at a node, if it is 1 over the map: the mean sum of squares of two linear weights is 2/3."""

ON_THE_WAY, SPEED_ON_THE_WAY = 0.08, 0.06
"""Standard deviation of the model's error during a move, as a share of the move of thrust and of speed, if its end is predicted
correctly: a braking motor or an actuator at its rate limit is far from any lag. On twelve emulated, identified rigs under
random steps and under the controller: of thrust 0.03 to 0.15, root mean square 0.075; of speed 0.02 to 0.06. Campaigns alone
often do not show it."""

TOLERATED = 2.5
"""Half of a monitored change counts if it exceeds this many standard deviations of the model's error during a move. A sum of
log-likelihood ratios decreases while the change is below half of the assumed one; one move in 80 has a larger error."""

OUTLIER = 4.0
"""Standard deviations beyond which a reading's influence is constant (Huber): one normal reading in 16 000."""

WITHIN = 1.96
"""Standard deviations of a 95 % band."""


def pairs(n: int) -> list[tuple[int, int]]:
    """Places in the upper triangle of n x n."""
    return [(i, j) for i in range(n) for j in range(i, n)]


def times(P: Mapping, g: Sequence) -> list:
    """P g of a symmetric matrix by its upper triangle; None in g is 0."""
    return [dot(g, [P[min(i, j), max(i, j)] for j in range(len(g))]) for i in range(len(g))]


def dot(g: Sequence, x: Sequence) -> Any:
    """Scalar product g x, over the length of g; None in g is 0."""
    terms = [b * a for a, b in zip(g, x, strict=False) if a is not None]
    return sum(terms[1:], terms[0]) if terms else 0.0


def weights(ops: Any, w: Any, b: Any) -> list:
    """Weight of each node of the grid, speed by speed, at a normalised speed and pitch; their sum is 1."""
    by_speed, by_pitch = (_hats(ops, at, nodes) for at, nodes in zip((w, b), NODES, strict=True))
    return [x * y for x in by_speed for y in by_pitch]


def _hats(ops: Any, at: Any, nodes: Sequence[float]) -> list:
    """Weights of linear interpolation between nodes."""
    # Shares of the way from node to node.
    shares = [ops.clip((at - low) * (1.0 / (high - low)), 0.0, 1.0) for low, high in pairwise(nodes)]
    return [before - after for before, after in zip([1.0, *shares], [*shares, 0.0], strict=True)]
