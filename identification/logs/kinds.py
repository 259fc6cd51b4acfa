"""Convert a log to a file of a campaign: a record, step responses, or steady points."""

from itertools import pairwise

import numpy as np

from identification.logs.clock import straightened
from identification.logs.intake import Taken
from identification.static.static_map import design
from identification.static.steady import SETTLE, steady_points
from vpp_fmu.campaign import StaticMap, check_repeat
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig

KINDS = ("open_loop", "repeat", "validation", "steps", "static")

BEFORE = 0.2
"""Share of a hold that becomes the initial part of the next step response."""

ROWS = (5, 25)
"""Minimum rows of a step response before and after the step: they determine its two levels."""


def repeat_of(record: Record, open_loop: Record) -> tuple[Record, list[str]]:
    """(the record at the times of the open loop that it repeats, corrections in words). BadInput if commands differ.

    Times of two logs of the same commands differ by the logger's jitter; less than half a row is ignored.
    """
    notes = []
    if len(record) == len(open_loop):
        off = float(np.abs(record.time - open_loop.time).max())
        if 0.0 < off < 0.5 * open_loop.period:
            record = record.with_columns(time=open_loop.time)
            notes.append(f"time: that of open_loop.csv, from which the rows differ by {1e3 * off:.3g} ms at most")
    check_repeat(open_loop, record)
    return record, notes


def runs_of(taken: Taken) -> tuple[list[Record], list[str]]:
    """(step responses, messages): the log's runs if it numbers them, else cut at changes of a command. Rows without thrust are
    left out. BadInput if there is no step."""
    record = taken.record()
    if "run" in taken.columns:
        parts, how = _split(record, taken.columns["run"]), "as the log numbers them"
    else:
        parts, how = _cut(record), "cut where a command changes"
    runs = [_from_zero(p) for p in parts if np.isfinite(p["thrust"]).sum() >= sum(ROWS)]
    if not runs:
        allowed = f"changes of a command with {ROWS[0]} rows before and {ROWS[1]} rows after each"
        raise BadInput(record.source, "steps", "none", allowed)
    short = f"; {len(parts) - len(runs)} too short, left out" if len(runs) < len(parts) else ""
    return runs, [f"steps: {len(runs)} runs, {how}{short}"]


def _split(record: Record, run: np.ndarray) -> list[Record]:
    starts = np.flatnonzero(np.append(True, run[1:] != run[:-1]))
    return [record.part(slice(first, end)) for first, end in zip(starts, [*starts[1:], len(record)], strict=True)]


def _cut(record: Record) -> list[Record]:
    """One step response per change of a command: the last part of the hold before, and the hold after without its last part."""
    moved = (np.diff(record["omega_ref"]) != 0.0) | (np.diff(record["beta_ref"]) != 0.0)
    starts = [0, *(np.flatnonzero(moved) + 1).tolist(), len(record)]
    lead = [max(ROWS[0], round(BEFORE * (end - first))) for first, end in pairwise(starts)]
    parts = []
    for k in range(1, len(starts) - 1):
        last = starts[k + 1] - (lead[k] if k + 2 < len(starts) else 0)
        if starts[k] - starts[k - 1] >= lead[k - 1] and last - starts[k] >= ROWS[1]:
            parts.append(record.part(slice(starts[k] - lead[k - 1], last)))
    return parts


def _from_zero(record: Record) -> Record:
    kept = record.part(np.isfinite(record["thrust"]))
    return kept.with_columns(time=straightened(kept.time - kept.time[0])[0])


def static_of(taken: Taken) -> tuple[StaticMap, list[str]]:
    """(steady points, messages): the log's rows if they are points, else means over holds of both commands."""
    if not taken.points:
        record = taken.record()
        settle = min(SETTLE, 0.5 * typical_hold(record))
        points = steady_points(record, settle=settle)
        return points, [f"static: {len(points.thrust)} steady holds, the first {settle:.2g} s of each left out"]
    columns = taken.columns
    rows = np.isfinite(columns["thrust"])
    own = {n: columns[n][rows] for n in ("omega_ref", "beta_ref", "thrust")}
    omega = columns.get("omega", columns["omega_ref"])[rows]
    own["omega"] = np.where(np.isfinite(omega), omega, own["omega_ref"])
    notes = [f"static: {int(rows.sum())} points, one per row; {int((~rows).sum())} rows without thrust left out"]
    own["samples"] = np.maximum(1.0, np.round(columns["samples"][rows])) if "samples" in columns else np.ones(len(omega))
    if "thrust_std" in columns:
        own["thrust_std"] = np.nan_to_num(np.abs(columns["thrust_std"][rows]))
        return StaticMap(**own, source=taken.source), notes
    spread = _scatter(own)
    notes.append(f"static: the log has no spread; thrust_std is the points' residual about a smooth map, {number(spread)} N")
    return StaticMap(**own, thrust_std=np.full(len(omega), spread), source=taken.source), notes


def typical_hold(record: Record) -> float:
    """Median duration of the holds of both commands, s."""
    moved = (np.diff(record["omega_ref"]) != 0.0) | (np.diff(record["beta_ref"]) != 0.0)
    edges = record.time[[0, *(np.flatnonzero(moved) + 1).tolist(), len(record) - 1]]
    held = np.diff(edges)
    return float(np.median(held[held > 0.0])) if np.any(held > 0.0) else 0.0


def _scatter(points: dict[str, np.ndarray]) -> float:
    """Residual standard deviation of points (n,) about the model's static map, N; for too few points, a hundredth of their
    range."""
    terms = 5
    if len(points["thrust"]) <= terms + 2:
        return 0.01 * float(np.ptp(points["thrust"]))
    scales = vars(infer_rig([], points, {}).scales)
    a = design(points["omega"], points["beta_ref"], scales)
    found, _, rank, _ = np.linalg.lstsq(a, points["thrust"] / scales["thrust_scale"], rcond=1e-9)
    residual = points["thrust"] - scales["thrust_scale"] * (a @ found)
    return float(np.sqrt(np.sum(residual**2) / max(1, len(residual) - rank)))
