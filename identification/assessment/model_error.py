"""Standard deviation of a model's error over half a second, steady and in transients, for a model that runs beside the rig."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from identification.assessment.prediction import Prediction
from identification.static.static_map import TERMS, design

BLOCK = 0.5
"""s: residuals are averaged over it."""

FADES = 0.5
"""Share of a move that counts in the next block."""

STANDING = 0.25
"""Share of the blocks, those with the smallest moves, that count as steady."""

PLACE = 0.2
"""Of normalised speed and pitch: correlation length of the errors of a thrust map. On nine emulated rigs, means over places of
0.33 by 0.25 had 1.2 times this error after short campaigns, and half of it after the paper's."""


@dataclass(frozen=True)
class ModelError:
    """Standard deviation of a block's error: `steady` [N] at constant commands, plus `moving` [1] times the move [N].
    `freedom`: degrees of freedom of `steady`."""

    steady: float
    moving: float
    freedom: int


def model_error(
    fitted: Iterable[Prediction],
    unseen: Iterable[Prediction],
    values: Mapping[str, float],
    count: int,
    noise: float,
    points: np.ndarray | None = None,
    terms: int = 0,
) -> ModelError | None:
    """Error of a model with `count` fitted parameters and these `values`, from its residuals on fitted and unseen records.

    A block's error is the larger of its mean and its standard deviation beyond the `noise` [N] of a reading. Its move [N] is
    the sum of the ranges of the predicted thrust due to speed and to pitch, plus FADES of the move before. Residuals of fitted
    records are too small: their squares are scaled by n / (n - count), as a residual variance. Here n counts the places of the
    map that they visit, because errors at one place are the same. `points`: residuals [N] of steady points, fitted by `terms`
    coefficients. None if the data are too few.
    """
    steady_squares, moving, freedom = [], [], 0
    for predictions, own in ((fitted, count), (unseen, 0)):
        blocks = [_blocks(one, values, noise) for one in predictions]
        if not blocks:
            continue
        squares, moves, places = (np.concatenate(column) for column in zip(*blocks, strict=True))
        at_rest = moves <= np.quantile(moves, STANDING) if len(moves) else np.zeros(0, bool)
        visited = len(np.unique(places[at_rest], axis=0))
        if visited > own:
            scaled = squares * visited / (visited - own)
            steady_squares.append(scaled[at_rest])
            moving.append((scaled[~at_rest], moves[~at_rest]))
            freedom += visited - own
    if points is not None and len(points) > terms:
        steady_squares.append(points**2 * len(points) / (len(points) - terms))
        freedom += len(points) - terms
    if not steady_squares:
        return None
    steady = float(np.concatenate(steady_squares).mean())
    squares, moves = (np.concatenate([*column, []]) for column in zip(*moving, ([], []), strict=True))
    more = float(np.sum(squares - steady) / np.sum(moves**2)) if np.any(moves) else 0.0
    return ModelError(float(np.sqrt(steady)), float(np.sqrt(max(more, 0.0))), freedom)


def _blocks(one: Prediction, values: Mapping[str, float], noise: float):
    """(squared error [N^2], move [N], place (2,)) of each complete block, (blocks, ...)."""
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
    """N/deg: slope of the thrust map with pitch."""
    coefficients = np.array([values[name] for name in TERMS])
    more, less = (design(omega, beta + half, values) @ coefficients for half in (0.5, -0.5))
    return values["thrust_scale"] * (more - less)
