"""Sensor faults of a record: dead, frozen or clipped sensors, spikes, and missing rows.

The reference is the record: the probability that neighbours are equal, and their differences.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from identification.gate.finding import Finding
from identification.gate.response import after_lag
from vpp_fmu.record import Record, digit_of

FEWEST_ROWS = 200
SHORTEST = 2.0
"""Minimum number of rows and seconds of a record to fit: fewer identify no lag of a rig."""

FEWEST_UNSEEN = 20
"""Minimum number of rows of a record that is not fitted: SHORTEST in a log of 10 Hz."""

CHANCE = 1e-6
"""False alarm probability per record of a run of equal readings; a campaign has a hundred records."""

SPIKE = 8.0
"""Robust standard deviations from the median of the neighbours: Gaussian noise exceeds it once in 1e15 rows."""

JUMP = 4.0
"""Minimum ratio of a spike to the 98 % quantile of differences of the running median: a quick move is no spike."""

NEIGHBOURS = 7
"""Readings in the running median: it tracks a move without error and removes spikes of up to three readings."""

LOCAL = 250
"""Readings over which the noise is assumed stationary: a rotor vibrates more at full speed than at rest."""

GAP, SPARSE = 0.25, 10.0
"""A gap is a step longer than this many s, and than this many usual steps: the commands within it are unknown."""

AFTER_GAP = 2.0
"""Seconds after a gap that are excluded: the response to its commands has then decayed."""

STUCK = 20.0
"""Usual times between new values of the speed: a speed constant for longer after a move of its command is stuck. After a
smaller move the limit is the longest run of equal readings at rest by chance; repeated readings at rest make it infinite."""

MULTIPLES = np.log([2.0, 3.0, 4.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0])
"""Logarithms of a speed over the true one, with marks seen twice or missed."""

HALFWAY, NEAR = 0.5 * np.log(2.0), 0.2
"""Logarithm of measured over expected speed above which it is nearer to a multiple; its tolerance at a multiple, and at 1.
Motors hold a command within some per cent."""

EDGE = 4
"""Maximum number of values in which the speed changes to a multiple and back: a smoothing stand makes half of a change each."""

LAGS = (0.0, *np.geomspace(0.5, 200.0, 25))
"""Rows: lags of the speed behind its command that are tried to expect a speed."""

MOVE = 0.05
"""Minimum move of a command, as a share of its range in the record."""


@dataclass(frozen=True)
class Fault:
    """A finding, and the readings that it excludes: `rows` (n,) of a `column`."""

    finding: Finding
    column: str
    rows: np.ndarray


def screen(record: Record, accept: frozenset[str] = frozenset()) -> tuple[Record, tuple[Finding, ...]]:
    """(the record with untrusted readings emptied, the findings). Readings of `accept`ed codes are kept.

    A speed column without any value is removed.
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
        wrong, times = multiples(record)
        if wrong.any():
            yield _multiple(record, wrong, times)
        yield from _speed(record.with_columns(omega=np.where(wrong, np.nan, record["omega"])))
    yield from _gaps(record)


def unusable(record: Record, fewest: int = FEWEST_ROWS) -> Iterator[Finding]:
    """Reasons why a record, which needs at least the `fewest` rows, cannot be fitted."""
    where, seconds, thrust = record.source, float(record.time[-1]), record["thrust"]
    readings = thrust[np.isfinite(thrust)]
    least = fewest // 2
    if len(record) < fewest or seconds < SHORTEST:
        message = f"{len(record)} rows over {seconds:g} s, at least {fewest} over {SHORTEST:g} s are needed"
        yield Finding("too_short", where, "rows", len(record), "1", message, "a part of a record")
    elif len(readings) < least:
        message = f"{len(readings)} readings, at least {least} are needed"
        yield Finding("too_short", where, "thrust", len(readings), "1", message, "empty cells")
    elif np.ptp(readings) == 0.0:
        message = f"{readings[0]:g} N in all rows"
        yield Finding("thrust_dead", where, "thrust", float(readings[0]), "N", message, "no signal reaches the logger")
    if np.ptp(record["omega_ref"]) == 0.0 and np.ptp(record["beta_ref"]) == 0.0:
        cause = "a steady point, or commands that were not logged"
        yield Finding("no_move", where, "omega_ref and beta_ref", 0.0, "1", "constant in all rows", cause)


def runs_of_equals(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first index, length) of each run of equal neighbours."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))
    return first, np.diff(np.append(first, len(values)))


def _equal(record: Record) -> Iterator[Fault]:
    """Clipped and frozen thrust: longer runs of equal neighbours than by chance under the surrounding noise.

    A sensor with noise below its last digit, or slower than the rows, has long runs without a fault. Then only a run that
    continues after a move of a command is a fault. Readings at rest are not checked.
    """
    seen = np.flatnonzero(np.isfinite(record["thrust"]) & (record["omega_ref"] > 0.0))
    thrust = record["thrust"][seen]
    if len(thrust) < 2 or np.ptp(thrust) == 0.0:
        return
    first, length = runs_of_equals(thrust)
    usual = length[length <= max(np.quantile(length, 0.99), 1.0)]  # without the longest runs, which may be faults
    common, digit, moved = 1.0 - len(usual) / usual.sum(), digit_of(thrust), _rows_since_move(record)[seen]
    rows = {"clipped": np.zeros(len(record), bool), "frozen": np.zeros(len(record), bool)}
    for k in np.flatnonzero(length > _longest(common, len(thrust))):
        begin, end = first[k], first[k] + length[k]
        equal = max(common, _equal_by_chance(thrust, begin, end, digit))
        continues = _continues_after_move(moved[begin:end], _longest(equal, len(thrust)))
        if length[k] > _longest(equal, len(thrust)) and (equal < 0.5 or continues):
            code = "clipped" if thrust[begin] in (thrust.max(), thrust.min()) else "frozen"
            rows[code][seen[begin:end]] = True
    texts = {
        "clipped": ("at the sensor's limit", "the sensor or its converter ends there"),
        "frozen": ("that are constant", "a reading that was not renewed, or a loose wire"),
    }
    for code, there in rows.items():
        if count := int(there.sum()):
            kind, cause = texts[code]
            begin, values = int(np.argmax(there)), np.unique(record["thrust"][there])
            ends = f"{values[0]:.4g} N" if len(values) == 1 else f"{values[0]:.4g} to {values[-1]:.4g} N"
            message = f"{count} readings {kind} ({ends}) from {record.time[begin]:.2f} s on, excluded"
            yield Fault(Finding(code, record.source, "thrust", count, "1", message, cause), "thrust", there)


def _longest(p: float, readings: int) -> float:
    """Length of a run that occurs by chance once in 1 / CHANCE records, if neighbours are equal with probability `p`."""
    return 3.0 if p <= 0.0 else 1.0 + np.log(CHANCE / readings) / np.log(min(p, 0.999))


def _equal_by_chance(thrust: np.ndarray, begin: int, end: int, digit: float) -> float:
    """Probability of the most frequent value under the noise around a run, 1 / (s sqrt(2 pi)) with its standard deviation of s
    digits; 0 if all readings around have the value of the run."""
    near = np.append(thrust[max(0, begin - LOCAL) : begin], thrust[end : end + LOCAL])
    near = near[near != thrust[begin]]
    if len(near) < NEIGHBOURS:
        return 0.0
    s = 1.4826 * np.median(np.abs(np.diff(near))) / np.sqrt(2.0) / digit
    return min(1.0, 1.0 / (np.sqrt(2.0 * np.pi) * max(s, 1e-3)))


def _rows_since_move(record: Record, least: float | None = None) -> np.ndarray:
    """(n,): rows since the last change of a command by more than `least`; None: by more than MOVE of its range."""
    moves = np.zeros(len(record), bool)
    for name in ("omega_ref", "beta_ref"):
        change = np.abs(np.diff(record[name], prepend=record[name][0]))
        moves |= change > (MOVE * max(np.ptp(record[name]), 1e-12) if least is None else least)
    rows = np.arange(len(record))
    return rows - np.maximum.accumulate(np.where(moves, rows, 0))


def _continues_after_move(since: np.ndarray, rows: float) -> bool:
    """Whether a run includes a move of a command and more than `rows` rows after it. `since`: rows since the last move."""
    inside = np.flatnonzero(np.diff(since) < 0)
    return len(inside) > 0 and float(since[inside[0] + 1 :].max()) > rows


def _spikes(record: Record, column: str, unit: str, at: np.ndarray) -> Iterator[Fault]:
    """Single readings far from the running median; `at`: the rows of the readings, neighbours in time."""
    y = record[column][at]
    if len(y) < 4 * NEIGHBOURS:
        return
    course = median_filter(y, NEIGHBOURS, mode="nearest")
    off = y - course
    noise = np.repeat([1.4826 * np.median(np.abs(off[k : k + LOCAL])) for k in range(0, len(y), LOCAL)], LOCAL)[: len(y)]
    limit = np.maximum(SPIKE * np.maximum(noise, digit_of(y)), JUMP * np.quantile(np.abs(np.diff(course)), 0.98))
    far = np.abs(off) > limit
    if column == "omega":  # a lost pulse changes one value; an oscillating rotor has intermediate neighbours
        jump = np.abs(np.diff(y, prepend=y[0], append=y[-1]))
        far &= np.minimum(jump[:-1], jump[1:]) > limit
    far = np.flatnonzero(far)
    if not len(far):
        return
    ends, rows = np.append(at, len(record)), np.zeros(len(record), bool)
    for k in far:  # the column holds a wrong value until the next one
        rows[ends[k] : ends[k + 1]] = True
    worst = far[np.argmax(np.abs(off[far]))]
    message = (
        f"{len(far)} readings far from their neighbours, the farthest by {off[worst]:+.4g} {unit} at "
        f"{record.time[at[worst]]:.2f} s; noise and moves have {limit[worst] / SPIKE:.2g} {unit}, excluded"
    )
    cause = "a disturbed line, or a lost or doubled pulse" if column == "omega" else "a disturbed line, or a knock"
    yield Fault(Finding("spikes", record.source, column, len(far), "1", message, cause), column, rows)


def _speed(record: Record) -> Iterator[Fault]:
    """A speed sensor that is dead, frozen while its command moves, or has spikes."""
    omega, seen = record["omega"], np.flatnonzero(np.isfinite(record["omega"]))
    shown, everywhere = omega[seen], np.ones(len(record), bool)
    if len(shown) == 0 or (np.ptp(shown) == 0.0 and np.ptp(record["omega_ref"]) > 0.0) or float(np.max(shown)) <= 0.0:
        message = f"{shown[0]:g} rpm in all rows, excluded" if len(shown) else "no value, excluded"
        value = float(shown[0]) if len(shown) else 0.0
        finding = Finding("speed_dead", record.source, "omega", value, "rpm", message, "no pulse reaches the logger")
        yield Fault(finding, "omega", everywhere)
        return
    if np.ptp(shown) == 0.0:  # its command is constant, too
        return
    first, length = runs_of_equals(shown)
    alone = record.with_columns(beta_ref=np.zeros(len(record)))
    moved, touched = (_rows_since_move(alone, least)[seen] for least in (None, digit_of(shown)))
    stuck, usual = np.zeros(len(record), bool), float(np.median(length))
    least = usual * _longest(0.0, len(length))
    for begin, many in zip(first, length, strict=True):
        stretch = slice(begin, begin + many)
        if many > least and _continues_after_move(touched[stretch], least):
            turn = max(usual, 60.0 / max(shown[begin], 1e-9) / float(np.median(record.steps)))
            chance = turn * _longest(_equal_at_rest(first, touched, stretch, usual), len(length))
            if _continues_after_move(moved[stretch], STUCK * usual) or _continues_after_move(touched[stretch], chance):
                stuck[seen[stretch]] = True
    if count := int(stuck.sum()):
        begin = record.time[np.argmax(stuck)]
        message = f"{count} readings that are constant from {begin:.2f} s on while the command moves, excluded"
        cause = "lost pulses, or a logger that holds the last value"
        yield Fault(Finding("frozen", record.source, "omega", count, "1", message, cause), "omega", stuck)
    yield from _spikes(record, "omega", "rpm", seen[first])


def multiples(record: Record) -> tuple[np.ndarray, list[float]]:
    """(mask (n,) of rows whose measured speed is a multiple or a fraction of the true one, the factor of each such stretch).

    Expected is the command after one lag, times the record's own gain. In a stretch the measured speed is a multiple of it, and
    it changes by that factor within EDGE values at both ends. `_spikes` treats stretches of up to half of NEIGHBOURS.
    """
    wrong, found = np.zeros(len(record), bool), []
    seen = np.flatnonzero(np.isfinite(record["omega"]))
    at = seen[runs_of_equals(record["omega"][seen])[0]] if len(seen) else seen
    size = np.log(np.maximum(record["omega"][at], 1e-9))
    if len(at) < 4 * NEIGHBOURS or np.abs(size[EDGE:] - size[:-EDGE]).max() < HALFWAY:
        return wrong, found
    ratio = _log_ratio(record, at, size)
    off, right = np.abs(ratio) > HALFWAY, np.flatnonzero(np.abs(ratio) < NEAR)
    first, length = runs_of_equals(off)
    for begin, end in zip(first[1:-1], (first + length)[1:-1], strict=True):
        off[begin:end] |= end - begin <= EDGE  # a move of the command within a stretch
    first, length = runs_of_equals(off)
    for begin, end in zip(first, first + length, strict=True):
        factor = MULTIPLES[np.argmin(np.abs(MULTIPLES - np.median(ratio[begin:end])))]
        if end - begin <= NEIGHBOURS // 2 or abs(np.median(ratio[begin:end]) - factor) > NEAR:
            continue
        inside = begin + np.flatnonzero(np.abs(ratio[begin:end] - factor) < NEAR)
        before, after = right[right < begin][-1:], right[right >= end][:1]
        ends = [(before, inside[0]), (after, inside[-1])]
        if begin > 0 and end < len(at) and not (len(before) and len(after)):
            continue
        sharp = (abs(b - k) <= EDGE and (size[k] - size[b]) * np.sign(factor) > HALFWAY for side, k in ends for b in side)
        if all(sharp) and (len(before) or len(after)):
            wrong[at[before[0] + 1] if len(before) else 0 : at[after[0]] if len(after) else len(record)] = True
            found.append(float(np.exp(factor)))
    return wrong, found


def _log_ratio(record: Record, at: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(len(at),) logarithm of measured over expected speed at the rows `at`; 0 near rest, and everywhere in another unit."""
    best, ratio = np.inf, np.zeros(len(at))
    for lag in LAGS:
        expected = after_lag(record["omega_ref"], lag)[at]
        turning = (expected > MOVE * record["omega_ref"].max()) & (record["omega"][at] > 0.0)
        if not turning.any():
            continue
        tried = size - np.log(np.maximum(expected, 1e-9))
        gain = float(np.median(tried[turning]))
        tried = np.where(turning, tried - gain, 0.0)
        error = float(np.mean(np.minimum(np.abs(tried), NEAR)))
        if abs(gain) < HALFWAY and error < best:
            best, ratio = error, tried
    return ratio


def _multiple(record: Record, wrong: np.ndarray, times: list[float]) -> Fault:
    """The fault of a speed that is a multiple for a while."""
    factors = ", ".join(f"{f:.3g}" for f in sorted({*times}))
    begin, many = record.time[np.argmax(wrong)], int(wrong.sum())
    places = f" in {len(times)} places" if len(times) > 1 else ""
    message = f"{many} readings are {factors} times what the command and their neighbours say, from {begin:.2f} s on{places}"
    cause = "a second mark that is seen" if max(times) > 1.0 else "missed marks"
    finding = Finding("speed_multiple", record.source, "omega", many, "1", f"{message}, excluded", cause)
    return Fault(finding, "omega", wrong)


def _equal_at_rest(first: np.ndarray, since: np.ndarray, stretch: slice, usual: float) -> float:
    """Probability that a speed is renewed with the same value in the second half of a hold of its command.

    `first`: rows of new values, `since` (n,): rows since the last move, `usual`: rows between renewals. The `stretch` is
    excluded: 1 if there is no other hold.
    """
    ends = np.flatnonzero(np.append(np.diff(since) <= 0, True))
    hold = np.repeat(since[ends], np.diff(ends, prepend=-1))  # length of the hold that includes each row
    settled = since > 0.5 * hold
    settled[stretch] = False
    renewals = settled.sum() / usual
    return float(np.clip((renewals - settled[first].sum() + 1.0) / (renewals + 1.0), 0.0, 1.0))


def _gaps(record: Record) -> Iterator[Fault]:
    """Missing rows, and the readings after them that cannot be predicted."""
    steps = record.steps
    wide = np.flatnonzero(steps > max(GAP, SPARSE * float(np.median(steps))))
    if not len(wide):
        return
    blind = np.zeros(len(record), bool)
    for row in wide:
        blind |= (record.time > record.time[row]) & (record.time < record.time[row + 1] + AFTER_GAP)
    longest = wide[np.argmax(steps[wide])]
    message = f"a gap of {steps[longest]:.2f} s after {record.time[longest]:.2f} s"
    message += f", and {len(wide) - 1} shorter" if len(wide) > 1 else ""
    message += f": the {AFTER_GAP:g} s after are excluded"
    finding = Finding("gap", record.source, "time", float(steps[longest]), "s", message, "a logger that stalled")
    for column in ("thrust", "omega") if "omega" in record else ("thrust",):
        yield Fault(finding, column, blind)
