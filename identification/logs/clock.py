"""Convert a log's time, in any unit or calendar, to increasing seconds from 0, and report each correction.

A counter that restarts at a power of two or at midnight is unwrapped. Time may decrease by less than a row, from two clocks or
swapped rows: the rows keep their order, and both times are interpolated between their neighbours. A larger decrease is refused.
Of rows at equal time the last is kept. If a stamp covers several rows, they are spread evenly up to the next stamp.
"""

import re
from dataclasses import dataclass, field
from datetime import date

import numpy as np

from identification.logs.raw_table import EMPTY, RawTable
from identification.logs.units import QUANTITIES, factor_of
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import shown

CALENDAR = "iso"
"""Unit of a time that is a date, a time of day, or both."""

TURNS = {"32-bit us": 2.0**32 * 1e-6, "32-bit ms": 2.0**32 * 1e-3, "16-bit ms": 2.0**16 * 1e-3, "16-bit us": 2.0**16 * 1e-6}
TURNS |= {"an hour": 3600.0, "midnight": 86400.0, "32-bit ns": 2.0**32 * 1e-9, "24-bit us": 2.0**24 * 1e-6}
"""s after which a counter restarts."""

_FRACTION = re.compile(r"(?i)(nano|micro|n|u)_?sec(ond)?s?")
"""End of the name of a column that holds the fraction of a stamp's seconds, such as nanosec of ROS and tv_usec of C."""

COARSE = 0.3
"""Share of rows at the time of the row before, above which stamps are coarse. A stamp per two rows gives a half; duplicate rows
are fewer."""

_CLOCK = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d+))?)?\s*([AaPp][Mm])?\s*(Z|z|UTC|[+-]\d{2}:?\d{2})?"
_MINUTES = re.compile(r"(\d{1,2}):(\d{2})[.,](\d+)")
"""Minutes and seconds, as Excel writes times with fractions."""

_STAMP = re.compile(rf"(?:(\d{{1,4}})[-/.](\d{{1,2}})[-/.](\d{{1,4}})(?:[T,]?\s*))?(?:{_CLOCK})?")


@dataclass(frozen=True, eq=False)
class Clock:
    """`rows`: rows of the table that are kept, in order; `time` (kept,) s from 0. `start`: the log's own time at 0, in words.
    `said`: corrections and skipped rows with their numbers. `restarts`: first row of each run, if runs are allowed."""

    rows: np.ndarray
    time: np.ndarray
    start: str
    said: tuple[str, ...] = ()
    restarts: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    @property
    def step(self) -> float:
        """Median step, s."""
        return float(np.median(np.diff(self.time)))


def read_clock(table: RawTable, name: str, unit: str, runs: bool = False, run: int | None = None) -> Clock:
    """The clock of a column. `runs`: time may start again, with each run (`restarts`, indices into Clock.rows). `run`: the
    only one to take, from 1. BadInput."""
    stamps, start = _seconds(table, name, unit)
    rows = np.flatnonzero(np.isfinite(stamps))
    if len(rows) < 2:
        raise table.wrong(name, 0, f"{len(rows)} rows with a time", "two or more")
    notes = [f"time: {len(stamps) - len(rows)} rows without one, left out"] * (len(rows) < len(stamps))
    time, corrections = _unwrapped(stamps[rows])
    notes += corrections
    time = time - time[0]
    usual = _usual_step(time)
    if usual == 0.0:
        raise table.wrong(
            name, rows[-1], f"{table.columns[name][rows[-1]]}, no later than any row before", "a time that increases"
        )
    back = np.flatnonzero(np.diff(time) < -usual) + 1
    if len(back) and not runs and run is None:
        now, before = (table.columns[name][rows[back[0] - k]] for k in (0, 1))
        places = "" if len(back) == 1 else f", {len(back)} such places"
        found = f"{now} after {before}, back by {time[back[0] - 1] - time[back[0]]:.6g} s{places}"
        allowed = "time that doesn't go back by a row or more"
        again = np.all(time[back] <= time[np.append(0, back[:-1])] + usual)
        hint = f"--run 1 for the first of {len(back) + 1} runs, or --as steps where each run is a step"
        hint = hint if again else "sort the rows by their time"
        raise table.wrong(name, rows[back[0]], found, allowed, hint)
    parts, kept, restarts = [], [], []
    spans = list(zip([0, *back], [*back, len(time)], strict=True))
    if run is not None:
        if not 1 <= run <= len(spans):
            number_of = f"1 to {len(spans)}, the runs that {name} has" if len(back) else f"1: {name} never starts again"
            raise BadInput("command line", "--run", str(run), number_of)
        spans = spans[run - 1 : run]
        notes.append(f"time: run {run} of {len(back) + 1} is taken, the others are left out")
        start = f"{table.columns[name][rows[spans[0][0]]]}, where run {run} begins"
    for first, end in spans:
        if np.ptp(time[first:end]) == 0.0:
            raise table.wrong(name, rows[first], f"a run of {end - first} rows at one time", "runs with increasing time")
        increasing, unique, corrections = straightened(time[first:end])
        restarts.append(sum(map(len, kept)))
        parts.append(increasing - increasing[0])
        kept.append(rows[first:end][unique])
        notes += corrections
    return Clock(np.concatenate(kept), np.concatenate(parts), start, tuple(notes), np.array(restarts))


def check_stamps(table: RawTable) -> None:
    """BadInput if a column has whole seconds and another their fraction, as sec and nanosec of ROS, tv_sec and tv_usec of C."""
    for name, cells in table.columns.items():
        stem = re.sub(r"(?i)(sec(ond)?s?|s)$", "", name)
        parts = [n for n in table.columns if stem != name and n.startswith(stem) and _FRACTION.fullmatch(n[len(stem) :])]
        if parts and cells.dtype.kind == "f" and np.all(cells % 1.0 == 0.0):
            found, allowed = f"whole seconds in {name}, beside {parts[0]}", "one column with both"
            raise BadInput(table.source, "time", found, allowed, "their sum in the table, and --map time=COLUMN:s")


def straightened(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(increasing times, rows kept, corrections in words) of a clock (n,) that decreases by less than a row."""
    notes, unique = [], np.arange(len(time))
    same = np.round(np.diff(time), 9) == 0.0
    if same.mean() > COARSE:
        time = _spread(time)
        count = number(1.0 / (1.0 - same.mean()), 3)
        notes.append(f"time: one stamp for {count} rows each, which are spread evenly up to the next")
    elif same.any():
        unique = np.flatnonzero(np.append(~same, True))
        notes.append(f"time: {int(same.sum())} rows at the time of the next one, left out")
    time, count, furthest = mended(time[unique])
    if count:
        notes.append(
            f"time: goes back in {count} of {len(time)} rows, by {1e3 * furthest:.3g} ms at most, less than a row: mended"
        )
    return time, unique, notes


def mended(time: np.ndarray) -> tuple[np.ndarray, int, float]:
    """(increasing times (n,), number of steps that did not increase, largest decrease [s]).

    Of two conflicting rows either may be wrong: both are interpolated between their neighbours, and more rows if needed.
    """
    step = np.diff(time)
    wrong = np.round(step, 9) <= 0.0
    count, furthest = int(wrong.sum()), float(-step.min()) if len(step) and wrong.any() else 0.0
    doubted = np.zeros(len(time), bool)
    fixed, index = time, np.arange(len(time))
    while wrong.any():
        doubted[:-1] |= wrong
        doubted[1:] |= wrong
        doubted[0] = False
        trusted = np.flatnonzero(~doubted)
        fixed = np.interp(index, trusted, time[trusted])
        if doubted[-1]:  # no trusted row after it: extrapolate with the usual step
            tail = index > trusted[-1]
            fixed = np.where(tail, time[trusted[-1]] + (index - trusted[-1]) * _usual_step(time), fixed)
        wrong = np.round(np.diff(fixed), 9) <= 0.0
    return fixed, count, furthest


def guessed_unit(values: np.ndarray) -> str | None:
    """Unit of a time without one, from its size: time since 1970, or a logger's usual step; None if ambiguous."""
    seen = values[np.isfinite(values)]
    if len(seen) < 2:
        return None
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 3e8 * scale < seen[0] < 4e9 * scale:  # 1979 to 2096
            return unit
    step, whole = _usual_step(seen), bool(np.all(seen == np.round(seen)))
    if not whole and step < 0.5:
        return "s"
    if whole and step >= 500.0:
        return "us"
    return "ms" if whole and 1.0 < step <= 200.0 else None


def is_calendar(cells: np.ndarray) -> bool:
    """Whether a column holds dates or times of day."""
    if cells.dtype.kind == "M":
        return True
    if cells.dtype.kind == "f":
        return False
    filled = [cell.strip() for cell in cells[:20].tolist() if cell.strip().lower() not in EMPTY]
    return bool(filled) and all(_stamp(cell) is not None for cell in filled)


def _usual_step(time: np.ndarray) -> float:
    """Median of the positive steps; 0 if there are none."""
    step = np.diff(time)
    return float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0


def _seconds(table: RawTable, name: str, unit: str) -> tuple[np.ndarray, str]:
    """(stamps (n,) in s, the first stamp in words)."""
    cells = table.columns[name]
    if cells.dtype.kind == "M":
        stamps = (cells - cells[~np.isnat(cells)][0]).astype("timedelta64[ns]")
        return np.where(np.isnat(cells), np.nan, stamps.astype(np.int64) / 1e9), str(cells[0])
    if unit == CALENDAR:
        return _calendar(table, name)
    values = table.numbers(name)
    seen = values[np.isfinite(values)]
    if not len(seen):
        raise table.wrong(name, 0, "empty cells only", "a time in each row")
    # Subtract the first stamp before the conversion: ns since 1970 exhaust the digits of a float.
    return (values - seen[0]) * factor_of(QUANTITIES["time"], unit), f"{seen[0]:.15g} {unit}"


def _calendar(table: RawTable, name: str) -> tuple[np.ndarray, str]:
    cells = table.columns[name]
    if cells.dtype.kind != "O":
        raise table.wrong(name, 0, f"{cells[0]:.12g}", "a date or a time of day such as 2024-05-01T12:30:00.125")
    found = [None if cell.strip().lower() in EMPTY else _stamp(cell.strip()) or cell for cell in cells.tolist()]
    for row, stamp in enumerate(found):
        if isinstance(stamp, str):
            raise table.wrong(name, row, shown(stamp), "a date or a time of day such as 2024-05-01T12:30:00.125")
    day = _days([stamp[0] for stamp in found if stamp])
    stamps = np.array([np.nan if stamp is None else day(stamp[0]) for stamp in found])
    first = next((k for k, stamp in enumerate(found) if stamp), 0)
    stamps = (stamps - stamps[first]) * 86400.0
    stamps += np.array([np.nan if stamp is None else stamp[1] for stamp in found])
    return stamps - stamps[first], cells[first].strip()


def _stamp(text: str) -> tuple[tuple[int, int, int] | None, float] | None:
    """(three numbers of a date in written order, or None; s of the day, in UTC if the offset is given). None: no stamp."""
    if minutes := _MINUTES.fullmatch(text):
        return None, 60.0 * int(minutes[1]) + int(minutes[2]) + float(f"0.{minutes[3]}")
    days = re.match(r"(\d+) days? ", text)  # a duration, as pandas writes it
    found = _STAMP.fullmatch(text[days.end() :] if days else text)
    if found is None or not text or (found.group(1) is None and found.group(4) is None):
        return None
    a, b, c, hour, minute, second, fraction, half, zone = found.groups()
    hours = int(hour or 0) % 12 + 12 * (half.lower() == "pm") if half else int(hour or 0)
    seconds = 3600.0 * hours + 60.0 * int(minute or 0) + int(second or 0) + (float(f"0.{fraction}") if fraction else 0.0)
    seconds += 86400.0 * int(days[1]) if days else 0.0
    if zone and zone[0] in "+-":
        seconds -= (1.0 if zone[0] == "+" else -1.0) * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:]))
    return (None if a is None else (int(a), int(b), int(c))), seconds


def _days(dates: list):
    """A function from a date's three numbers to its day number. Year first is ISO. Else day and month are ordered so that each
    date is valid and the log is shortest."""

    def by(order):
        def day(parts):
            return 0.0 if parts is None else float(date(*(parts[k] for k in order)).toordinal())

        return day

    ways = []
    for order in ((0, 1, 2), (2, 1, 0), (2, 0, 1)):
        if any(parts is not None and parts[order[0]] < 32 and max(parts) > 31 for parts in dates):
            continue
        try:
            days = [by(order)(parts) for parts in dict.fromkeys(dates)]
        except ValueError:
            continue
        ways.append((max(days) - min(days), len(ways), order))
    return by(min(ways)[2]) if ways else (lambda parts: np.nan)


def _unwrapped(time: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(time without the restarts of its counter, corrections in words)."""
    step, usual, notes = np.diff(time), _usual_step(time), []
    offset = np.zeros(len(time))
    for counter, turn in TURNS.items():
        places = np.flatnonzero((step < -0.5 * turn) & (step + turn > -usual) & (step + turn < 10.0 * usual))
        if len(places) and turn > 20.0 * usual:
            for place in places:
                offset[place + 1 :] += turn
            notes.append(f"time: its counter restarts {len(places)} times, each after {turn:.9g} s ({counter}): unwrapped")
            break
    return time + offset, notes


def _spread(time: np.ndarray) -> np.ndarray:
    """Spread the rows of a stamp evenly up to the next. The first and last may be incomplete: they get the median step."""
    first = np.flatnonzero(np.append(True, np.round(np.diff(time), 9) != 0.0))
    length = np.diff(np.append(first, len(time)))
    within = np.arange(len(time)) - np.repeat(first, length)
    many = float(np.median(length[1:-1])) if len(length) > 2 else float(length.max())
    pace = np.diff(np.append(time[first], np.nan)) / length
    pace[-1] = float(np.median(np.diff(time[first]))) / many if len(first) > 1 else 0.0
    found = time + within * np.repeat(pace, length)
    missing = max(0.0, many - length[0])
    if len(first) > 1 and missing:  # the first stamp is incomplete
        usual = float(np.median(np.diff(time[first]))) / many
        head = slice(0, length[0])
        found[head] = time[first[1]] - usual * (length[0] - within[head])
    return found
