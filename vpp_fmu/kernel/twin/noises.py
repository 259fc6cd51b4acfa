"""What a model is off, in numbers that every rig shares; and the little linear algebra that a filter needs."""

from collections.abc import Mapping, Sequence
from typing import Any

PLACE = 0.2
"""Of the scales of speed and pitch: so far apart, errors of a thrust map have little to do with each other, as
`identification.assessment.model_error` counts them."""

BLOCK, HALVES = 0.5, 0.5
"""s over which the model's error was measured, and s in which what a move leaves of it halves: likewise."""

ON_THE_WAY, SPEED_ON_THE_WAY = 0.15, 0.06
"""Of a move of thrust and of speed, what a model that is right about its end is off on the way, standard deviation: a motor
that brakes, an actuator at its fastest are far from any lag. The largest of twelve emulated rigs, each identified, under random
steps and under the controller: of thrust 0.05 to 0.15, of speed 0.02 to 0.06. Campaigns alone often show none of it."""

BORNE = 2.5
"""Standard deviations of the model's own error that half of a change which is watched for must exceed: a sum of log-likelihood
ratios falls while what there is stays below half of what it looks for, and one place in 80 is further off."""

OUTLIER = 4.0
"""Standard deviations beyond which a reading pulls no more (Huber): of normal ones, one in 16 000 goes so far."""

WITHIN = 1.96
"""Standard deviations that hold 95 %."""


def nothing(ops: Any, s: Any, p: Any) -> float:
    """The start of a state that knows nothing."""
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
