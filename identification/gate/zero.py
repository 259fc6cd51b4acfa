"""The load cell's zero: thrust readings at rest, and a zero that drifts or jumps within a record."""

from dataclasses import dataclass

import numpy as np

from identification.gate.response import Look, after_lag
from vpp_fmu.digits import number, signed
from vpp_fmu.record import Record

AT_REST = 0.5
"""s after the rotor's stop from which its readings are at rest."""

FEWEST_AT_REST = 10
"""Minimum readings of a rest."""

WARM_UPS = (3.0, 8.0, 20.0)
"""Durations of a record in time constants of a warm-up that is compared with a jump."""

CORRELATED = 10.0
"""Readings that are taken as one independent reading in a standard error."""

OFFSET = 0.02
"""Minimum offset to report, as a share of the largest thrust; it must also exceed FAR standard deviations."""

FAR = 5.0
"""Minimum standard deviations of a significant offset, also if the scatter is the model error of a map of five terms."""


@dataclass(frozen=True)
class Rest:
    """Thrust at rest from `begin` to `end` [s]: `mean` and standard deviation `spread` [N] of `readings` readings."""

    begin: float
    end: float
    mean: float
    spread: float
    readings: int

    @property
    def error(self) -> float:
        """Standard error of the mean, N."""
        return self.spread / np.sqrt(self.readings / CORRELATED)

    @property
    def text(self) -> str:
        return f"{signed(round(self.mean, 6))} N at {number(0.5 * (self.begin + self.end))} s"


@dataclass(frozen=True)
class Move:
    """A zero that moves from the rest `first` to the rest `last`. `jump`: the first row behind a jump; None: a drift."""

    first: Rest
    last: Rest
    jump: int | None


def resting(record: Record) -> np.ndarray:
    """Mask (n,) of thrust readings at rest: the command is 0, and the measured speed is 0 and has been for AT_REST. Without
    measured speed only the later half of each stop counts."""
    still = record["omega_ref"] == 0.0
    if "omega" in record:
        turning = np.where(record["omega"] > 0.0, record.time, -np.inf)
        still &= (record["omega"] == 0.0) & (record.time - np.maximum.accumulate(turning) > AT_REST)
    else:
        ends = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
        for begin, end in ends.reshape(-1, 2):
            still[begin : begin + (end - begin) // 2] = False
    return still & np.isfinite(record["thrust"])


def rests(record: Record) -> list[Rest]:
    """The rests of a record, between which the rotor turns."""
    still = np.flatnonzero(resting(record))
    turned = np.cumsum(np.nan_to_num(record["omega"]) > 0.0 if "omega" in record else record["omega_ref"] > 0.0)[still]
    stops = (still[turned == k] for k in np.unique(turned))
    return [_rest(record, rows) for rows in stops if len(rows) >= FEWEST_AT_REST]


def tare(record: Record) -> Rest | None:
    """The zero: all readings at rest, or those of the first rest if the zero moves. None without a rest."""
    if move := moved(record):
        return move.first
    still = np.flatnonzero(resting(record))
    return _rest(record, still) if len(still) >= FEWEST_AT_REST else None


def moved(record: Record) -> Move | None:
    """The move of the zero between two rests; None if all rests have one zero.

    It is a jump if a step in time explains more of the residual of a thrust map than a line or an exponential does, and if the
    rests on each side of it have one zero.
    """
    found = sorted(rests(record), key=lambda r: r.mean)
    if len(found) < 2:
        return None
    first, last = sorted((found[0], found[-1]), key=lambda r: r.begin)
    largest = float(np.quantile(np.abs(record["thrust"][np.isfinite(record["thrust"])]), 0.999))
    limit = max(OFFSET * largest, FAR * float(np.hypot(first.error, last.error)))
    if abs(last.mean - first.mean) <= limit:
        return None
    rows, basis, residual = _unexplained(record)
    part = (record.time[rows] - record.time[0]) / record.time[-1]
    drifts = np.column_stack([part, *(1.0 - np.exp(-many * part) for many in WARM_UPS)])
    drifts -= basis @ (basis.T @ drifts)
    drift = float(np.max((residual @ drifts) ** 2 / np.sum(drifts**2, axis=0)))
    after = np.cumsum(residual[::-1])[::-1]  # of a step at each row
    own = np.arange(len(rows), 0, -1) - np.sum(np.cumsum(basis[::-1], axis=0)[::-1] ** 2, axis=1)
    between = (record.time[rows] > first.begin) & (record.time[rows] <= last.end)
    steps = np.where(between & (own > FEWEST_AT_REST), after**2 / np.maximum(own, 1.0), 0.0)
    jump = int(rows[np.argmax(steps)])
    sides = [[r.mean for r in found if (r.end < record.time[jump]) == side] for side in (True, False)]
    one_each = all(max(side, default=0.0) - min(side, default=0.0) <= limit for side in sides)
    return Move(first, last, jump if steps.max() > drift and one_each else None)


def levelled(record: Record) -> tuple[Record, list[str]]:
    """(the record with a jump of its zero taken off, the change in words)."""
    move = moved(record)
    if move is None or move.jump is None:
        return record, []
    still = resting(record)
    after = np.arange(len(record)) >= move.jump
    jump = float(record["thrust"][still & after].mean() - record["thrust"][still & ~after].mean())
    text = f"zero: jumps by {signed(jump)} N at {record.time[move.jump]:.2f} s (at rest {move.first.text}, {move.last.text})"
    return record.with_columns(thrust=record["thrust"] - jump * after), [f"{text}: taken off from there on"]


def _rest(record: Record, rows: np.ndarray) -> Rest:
    thrust = record["thrust"][rows]
    ends = (float(record.time[k]) for k in rows[[0, -1]])
    return Rest(*ends, float(thrust.mean()), float(thrust.std()), len(rows))


def _unexplained(record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows with thrust (m,), orthonormal basis (m, k) of a thrust map, its residual (m,) [N]) at measured speed, else at the
    lagged command."""
    look = Look([record])
    lags = look.response().lags
    omega, beta = (after_lag(record[f"{channel}_ref"], lags[channel]) for channel in ("omega", "beta"))
    seen = np.isfinite(record["thrust"])
    if "omega" in record:
        omega, seen = record["omega"], seen & np.isfinite(record["omega"])
    rows = np.flatnonzero(seen)
    u, size, _ = np.linalg.svd(look.span.columns(omega[rows], beta[rows]), full_matrices=False)
    basis = u[:, size > 1e-9 * size[0]]
    return rows, basis, record["thrust"][rows] - basis @ (basis.T @ record["thrust"][rows])
