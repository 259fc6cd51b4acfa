"""How far a model is off by itself, over half a second: steady, and where its thrust moves. For what runs it beside the rig."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
from scipy.signal import lfilter

from identification.assessment.prediction import Prediction
from identification.static.static_map import TERMS, design

BLOCK = 0.5
"""s over which a residual is averaged."""

FADES = 0.5
"""Of a move, what counts as one still in the next block."""

STANDING = 0.25
"""Share of the blocks, those with the least moves, that count as standing."""

PLACE = 0.2
"""Of normalised speed and pitch: commands that lie this far apart find errors of a thrust map that have little to do with each
other. On nine emulated rigs, means over places of 0.33 by 0.25 were 1.2 times as far off as this makes them after short
campaigns, half as far after the paper's."""


@dataclass(frozen=True)
class ModelError:
    """Standard deviation of a block's error: `steady` [N] where the commands stand, and beside it `moving` [1] for each N of a
    move. `freedom`: degrees of freedom that the first is known from."""

    steady: float
    moving: float
    freedom: int

    def summary(self) -> dict:
        """For identification.json."""
        return asdict(self)


def model_error(
    fitted: Iterable[Prediction],
    unseen: Iterable[Prediction],
    values: Mapping[str, float],
    count: int,
    noise: float,
    points: np.ndarray | None = None,
    terms: int = 0,
) -> ModelError | None:
    """Of a model with `count` fitted parameters and these `values`, by its residuals on the records, fitted and not.

    A block's error is the larger of its mean and of the spread about that beyond the reading's `noise` [N]; its move [N] what
    the model's thrust goes through by speed and by pitch, added up, with what fades of the moves before. Records that were
    fitted to show too little error: their squares are scaled as a residual variance is, by n / (n - count), where n counts the
    places of the map that they visit and not the readings, since what is wrong at one place stays wrong there. `points`: the
    residuals [N] of steady points, means, fitted by `terms` coefficients. None where too little was seen for any.
    """
    standing, moving, freedom = [], [], 0
    for predictions, own in ((fitted, count), (unseen, 0)):
        blocks = [_blocks(one, values, noise) for one in predictions]
        if not blocks:
            continue
        squares, moves, places = (np.concatenate(column) for column in zip(*blocks, strict=True))
        still = moves <= np.quantile(moves, STANDING) if len(moves) else np.zeros(0, bool)
        visited = len(np.unique(places[still], axis=0))
        if visited > own:
            scaled = squares * visited / (visited - own)
            standing.append(scaled[still])
            moving.append((scaled[~still], moves[~still]))
            freedom += visited - own
    if points is not None and len(points) > terms:
        standing.append(points**2 * len(points) / (len(points) - terms))
        freedom += len(points) - terms
    if not standing:
        return None
    steady = float(np.concatenate(standing).mean())
    squares, moves = (np.concatenate([*column, []]) for column in zip(*moving, ([], []), strict=True))
    more = float(np.sum(squares - steady) / np.sum(moves**2)) if np.any(moves) else 0.0
    return ModelError(float(np.sqrt(steady)), float(np.sqrt(max(more, 0.0))), freedom)


def _blocks(one: Prediction, values: Mapping[str, float], noise: float):
    """(squared error [N^2], move [N], place (2,)) of each block that has all its readings, (blocks, ...)."""
    record = one.record
    rows = max(1, round(BLOCK / record.period))
    count = (len(record) - 1) // rows

    def cut(column: np.ndarray) -> np.ndarray:
        return column[1 : 1 + count * rows].reshape(count, rows)

    def swing(column: np.ndarray) -> np.ndarray:
        whole = np.column_stack([column[: count * rows : rows], cut(column)])
        return whole.max(axis=1) - whole.min(axis=1)

    residual, thrust = cut(record["thrust"] - one.thrust), cut(one.thrust)
    about = residual.var(axis=1, ddof=1) - noise**2 if rows > 1 else np.zeros(count)
    omega, beta = cut(one.omega).mean(axis=1), cut(one.beta).mean(axis=1)
    by_speed = 2.0 * np.abs(thrust).max(axis=1) / np.maximum(omega, 1e-3 * values["omega_scale"])
    moves = lfilter([1.0], [1.0, -FADES], by_speed * swing(one.omega) + np.abs(_slope(omega, beta, values)) * swing(one.beta))
    speed = cut(record["omega_ref"])[:, -1] / values["omega_scale"]
    pitch = (cut(record["beta_ref"])[:, -1] + values["beta_offset"]) / values["beta_scale"]
    whole = np.isfinite(residual).all(axis=1)
    squares = np.maximum(residual.mean(axis=1) ** 2, about)
    return squares[whole], moves[whole], np.floor(np.column_stack([speed, pitch])[whole] / PLACE + 1e-9)


def _slope(omega: np.ndarray, beta: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
    """N/deg of the thrust map."""
    coefficients = np.array([values[name] for name in TERMS])
    more, less = (design(omega, beta + half, values) @ coefficients for half in (0.5, -0.5))
    return values["thrust_scale"] * (more - less)
