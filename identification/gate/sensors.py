"""What of a record's readings can't be trusted: sensors that are dead, stuck, clipped, that spike, and rows that are missing.

All of it is judged against the record itself: how often neighbours are equal by chance, how far neighbours lie apart.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from identification.gate.finding import Finding
from vpp_fmu.record import Record

FEWEST_ROWS = 200
SHORTEST = 2.0
"""A record to fit needs this many rows and seconds: less than that shows no lag of a rig."""

CHANCE = 1e-6
"""How often a record without a fault may show a stretch of equal readings that is taken for one; a campaign has a hundred."""

SPIKE = 8.0
"""Robust standard deviations from the median of the neighbours: Gaussian noise gets there once in 1e15 rows."""

JUMP = 4.0
"""A spike is also this many times as far away as neighbours are in the record's liveliest 2 %: a quick move is none."""

NEIGHBOURS = 7
"""Readings in the running median; it follows a move without error and lets pass spikes of up to three."""

LOCAL = 250
"""Readings over which the noise is taken as even: a rotor shakes more at full speed than at rest."""

GAP, SPARSE = 0.25, 10.0
"""Rows further apart than so many s, and so many times the usual, are a gap: what was commanded meanwhile is not known."""

AFTER_GAP = 2.0
"""Seconds after a gap that are left out: until then what happened in it has died away."""

STUCK = 20.0
"""Usual times between new values of the speed: one that stands still for so many, though its command has moved, is stuck. So
is one that a smaller move finds still longer than chance makes of readings at rest; where these repeat, that is never."""

MOVE = 0.05
"""Share of a command's range in a record that counts as a move."""


@dataclass(frozen=True)
class Fault:
    """A finding, and what it takes from the record: `rows` (n,) of a `column`."""

    finding: Finding
    column: str
    rows: np.ndarray


def screen(record: Record, accept: frozenset[str] = frozenset()) -> tuple[Record, tuple[Finding, ...]]:
    """(the record with empty cells where it can't be trusted, what was found), without the faults of `accept`ed codes.

    A column of speed without any value is dropped.
    """
    found = tuple(faults(record))
    columns = {name: record[name].copy() for name in ("thrust", "omega") if name in record}
    for fault in found:
        if fault.finding.code not in accept:
            columns[fault.column][fault.rows] = np.nan
    kept = record.with_columns(**columns)
    if "omega" in record and not np.isfinite(columns["omega"]).any():
        kept = replace(kept, columns={n: c for n, c in kept.columns.items() if n != "omega"})
    return kept, tuple(f.finding for f in found)


def faults(record: Record) -> Iterator[Fault]:
    """All faults of a record with thrust, one for each code and column."""
    yield from _equal(record)
    yield from _spikes(record, "thrust", "N", np.flatnonzero(np.isfinite(record["thrust"])))
    if "omega" in record:
        yield from _speed(record)
    yield from _gaps(record)


def unusable(record: Record) -> Iterator[Finding]:
    """Why nothing can be fitted to a record."""
    where, seconds, thrust = record.source, float(record.time[-1]), record["thrust"]
    readings = thrust[np.isfinite(thrust)]
    least = FEWEST_ROWS // 2
    if len(record) < FEWEST_ROWS or seconds < SHORTEST:
        told = f"{len(record)} rows over {seconds:g} s, at least {FEWEST_ROWS} over {SHORTEST:g} s are needed"
        yield Finding("too_short", where, "rows", len(record), "1", told, "a part of a record")
    elif len(readings) < least:
        told = f"{len(readings)} readings, at least {least} are needed"
        yield Finding("too_short", where, "thrust", len(readings), "1", told, "empty cells")
    elif np.ptp(readings) == 0.0:
        told = f"{readings[0]:g} N in all rows"
        yield Finding("thrust_dead", where, "thrust", float(readings[0]), "N", told, "no signal reaches the logger")
    if np.ptp(record["omega_ref"]) == 0.0 and np.ptp(record["beta_ref"]) == 0.0:
        cause = "a steady point, or commands that were not logged"
        yield Finding("no_move", where, "omega_ref and beta_ref", 0.0, "1", "constant in all rows", cause)


def runs_of_equals(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first index, length) of each stretch of equal neighbours."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))
    return first, np.diff(np.append(first, len(values)))


def _equal(record: Record) -> Iterator[Fault]:
    """Clipped and frozen thrust: more equal neighbours than chance makes of the noise around them.

    A sensor that is quieter than its last digit, or slower than the rows, stands still by itself: then only a stretch that
    outlasts a command's move is a fault. At rest nothing moves a reading, and none is judged.
    """
    seen = np.flatnonzero(np.isfinite(record["thrust"]) & (record["omega_ref"] > 0.0))
    thrust = record["thrust"][seen]
    if len(thrust) < 2 or np.ptp(thrust) == 0.0:
        return
    first, length = runs_of_equals(thrust)
    usual = length[length <= max(np.quantile(length, 0.99), 1.0)]  # a fault must not say itself how common it is
    common, digit, moved = 1.0 - len(usual) / usual.sum(), np.min(np.diff(np.unique(thrust))), _rows_since_move(record)[seen]
    rows = {"clipped": np.zeros(len(record), bool), "frozen": np.zeros(len(record), bool)}
    for k in np.flatnonzero(length > _longest(common, len(thrust))):
        begin, end = first[k], first[k] + length[k]
        equal = max(common, _equal_by_chance(thrust, begin, end, digit))
        outlasts = _outlasts(moved[begin:end], _longest(equal, len(thrust)))
        if length[k] > _longest(equal, len(thrust)) and (equal < 0.5 or outlasts):
            code = "clipped" if thrust[begin] in (thrust.max(), thrust.min()) else "frozen"
            rows[code][seen[begin:end]] = True
    said = {
        "clipped": ("at the sensor's limit", "the sensor or its converter ends there"),
        "frozen": ("that stand still", "a reading that was not renewed, or a loose wire"),
    }
    for code, there in rows.items():
        if count := int(there.sum()):
            kind, cause = said[code]
            begin, values = int(np.argmax(there)), np.unique(record["thrust"][there])
            ends = f"{values[0]:.4g} N" if len(values) == 1 else f"{values[0]:.4g} to {values[-1]:.4g} N"
            told = f"{count} readings {kind} ({ends}) from {record.time[begin]:.2f} s on, left out"
            yield Fault(Finding(code, record.source, "thrust", count, "1", told, cause), "thrust", there)


def _longest(p: float, readings: int) -> float:
    """Equal readings in a row that chance makes once in 1 / CHANCE records, neighbours being equal with probability `p`."""
    return 3.0 if p <= 0.0 else 1.0 + np.log(CHANCE / readings) / np.log(min(p, 0.999))


def _equal_by_chance(thrust: np.ndarray, begin: int, end: int, digit: float) -> float:
    """Probability of the commonest value under the noise of the readings around a stretch, of standard deviation s digits:
    1 / (s sqrt(2 pi)); 0 where all around are of the stretch's own value."""
    near = np.append(thrust[max(0, begin - LOCAL) : begin], thrust[end : end + LOCAL])
    near = near[near != thrust[begin]]
    if len(near) < NEIGHBOURS:
        return 0.0
    s = 1.4826 * np.median(np.abs(np.diff(near))) / np.sqrt(2.0) / digit
    return min(1.0, 1.0 / (np.sqrt(2.0 * np.pi) * max(s, 1e-3)))


def _rows_since_move(record: Record, least: float | None = None) -> np.ndarray:
    """(n,) rows since a command last moved by more than `least`; None: than MOVE of its range."""
    moves = np.zeros(len(record), bool)
    for name in ("omega_ref", "beta_ref"):
        change = np.abs(np.diff(record[name], prepend=record[name][0]))
        moves |= change > (MOVE * max(np.ptp(record[name]), 1e-12) if least is None else least)
    rows = np.arange(len(record))
    return rows - np.maximum.accumulate(np.where(moves, rows, 0))


def _outlasts(since: np.ndarray, rows: float) -> bool:
    """Whether a stretch, by its rows since the last move of a command, holds one and so many rows after it."""
    inside = np.flatnonzero(np.diff(since) < 0)
    return len(inside) > 0 and float(since[inside[0] + 1 :].max()) > rows


def _spikes(record: Record, column: str, unit: str, at: np.ndarray) -> Iterator[Fault]:
    """Single readings far from the running median; `at`: the rows of the readings, neighbours in time."""
    y = record[column][at]
    if len(y) < 4 * NEIGHBOURS:
        return
    off = y - median_filter(y, NEIGHBOURS, mode="nearest")
    noise = np.repeat([1.4826 * np.median(np.abs(off[k : k + LOCAL])) for k in range(0, len(y), LOCAL)], LOCAL)[: len(y)]
    values = np.unique(y)
    digit = float(np.min(np.diff(values))) if len(values) > 1 else 0.0
    limit = np.maximum(SPIKE * np.maximum(noise, digit), JUMP * np.quantile(np.abs(np.diff(y)), 0.98))
    far = np.abs(off) > limit
    if column == "omega":  # a lost pulse spoils one value; a rotor that hunts has neighbours on its way
        jump = np.abs(np.diff(y, prepend=y[0], append=y[-1]))
        far &= np.minimum(jump[:-1], jump[1:]) > limit
    far = np.flatnonzero(far)
    if not len(far):
        return
    ends, rows = np.append(at, len(record)), np.zeros(len(record), bool)
    for k in far:  # a value that the column holds until its next one is wrong for as long
        rows[ends[k] : ends[k + 1]] = True
    worst = far[np.argmax(np.abs(off[far]))]
    told = (
        f"{len(far)} readings far from their neighbours, the farthest by {off[worst]:+.4g} {unit} at "
        f"{record.time[at[worst]]:.2f} s where noise and moves make {limit[worst] / SPIKE:.2g} {unit}, left out"
    )
    cause = "a disturbed line, or a lost or doubled pulse" if column == "omega" else "a disturbed line, or a knock"
    yield Fault(Finding("spikes", record.source, column, len(far), "1", told, cause), column, rows)


def _speed(record: Record) -> Iterator[Fault]:
    """A speed sensor that is dead, or stands still for a while though its command has moved, or spikes."""
    omega, seen = record["omega"], np.flatnonzero(np.isfinite(record["omega"]))
    shown, everywhere = omega[seen], np.ones(len(record), bool)
    if len(shown) == 0 or (np.ptp(shown) == 0.0 and np.ptp(record["omega_ref"]) > 0.0) or float(np.max(shown)) <= 0.0:
        told = f"{shown[0]:g} rpm in all rows, left out" if len(shown) else "no value, left out"
        value = float(shown[0]) if len(shown) else 0.0
        finding = Finding("speed_dead", record.source, "omega", value, "rpm", told, "no pulse reaches the logger")
        yield Fault(finding, "omega", everywhere)
        return
    if np.ptp(shown) == 0.0:  # as its command does
        return
    first, length = runs_of_equals(shown)
    alone = record.with_columns(beta_ref=np.zeros(len(record)))
    moved, touched = (_rows_since_move(alone, least)[seen] for least in (None, float(np.min(np.diff(np.unique(shown))))))
    stuck, usual = np.zeros(len(record), bool), float(np.median(length))
    least = usual * _longest(0.0, len(length))
    for begin, many in zip(first, length, strict=True):
        stretch = slice(begin, begin + many)
        if many > least and _outlasts(touched[stretch], least):
            turn = max(usual, 60.0 / max(shown[begin], 1e-9) / float(np.median(record.steps)))
            chance = turn * _longest(_equal_at_rest(first, touched, stretch, usual), len(length))
            if _outlasts(moved[stretch], STUCK * usual) or _outlasts(touched[stretch], chance):
                stuck[seen[stretch]] = True
    if count := int(stuck.sum()):
        begin = record.time[np.argmax(stuck)]
        told = f"{count} readings that stand still from {begin:.2f} s on while the command moves, left out"
        cause = "lost pulses, or a logger that holds the last value"
        yield Fault(Finding("frozen", record.source, "omega", count, "1", told, cause), "omega", stuck)
    yield from _spikes(record, "omega", "rpm", seen[first])


def _equal_at_rest(first: np.ndarray, since: np.ndarray, stretch: slice, usual: float) -> float:
    """Probability that a speed is renewed with the same value where its command has stood for half of the time that it will.

    `first`: where values are new, `since` (n,): rows since the last move, `usual`: rows between renewals. What a `stretch`
    itself shows does not count: 1 where the command stands nowhere else.
    """
    ends = np.flatnonzero(np.append(np.diff(since) <= 0, True))
    hold = np.repeat(since[ends], np.diff(ends, prepend=-1))  # rows that each row's command stands in all
    rests = since > 0.5 * hold
    rests[stretch] = False
    renewals = rests.sum() / usual
    return float(np.clip((renewals - rests[first].sum() + 1.0) / (renewals + 1.0), 0.0, 1.0))


def _gaps(record: Record) -> Iterator[Fault]:
    """Missing rows, and what can't be predicted for a while behind them."""
    steps = record.steps
    wide = np.flatnonzero(steps > max(GAP, SPARSE * float(np.median(steps))))
    if not len(wide):
        return
    blind = np.zeros(len(record), bool)
    for row in wide:
        blind |= (record.time > record.time[row]) & (record.time < record.time[row + 1] + AFTER_GAP)
    longest = wide[np.argmax(steps[wide])]
    told = f"a gap of {steps[longest]:.2f} s after {record.time[longest]:.2f} s"
    told += f", and {len(wide) - 1} shorter" if len(wide) > 1 else ""
    told += f": the {AFTER_GAP:g} s behind are left out"
    finding = Finding("gap", record.source, "time", float(steps[longest]), "s", told, "a logger that stalled")
    for column in ("thrust", "omega") if "omega" in record else ("thrust",):
        yield Fault(finding, column, blind)
