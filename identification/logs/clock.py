"""The time of a log's rows: from any unit or calendar to seconds from 0 that increase, and what had to be mended for that.

A counter that begins anew at a power of two or at midnight is unwound. Time that goes back by less than a row is a logger's two
clocks, or two rows of it in one buffer: the rows keep their order, and the two at odds are put evenly between their neighbours.
Time that goes back further is another log, or none, and refused. Rows at one time are one row told twice, of which the last
stays; unless the stamps are as coarse as several rows, which are then spread evenly from one to the next.
"""

import re
from dataclasses import dataclass, field
from datetime import date

import numpy as np

from identification.logs.sheet import EMPTY, Sheet
from identification.logs.units import QUANTITIES, factor_of
from vpp_fmu.digits import number
from vpp_fmu.files import shown

CALENDAR = "iso"
"""The unit of a time that is a date, a time of day, or both."""

TURNS = {"32-bit us": 2.0**32 * 1e-6, "32-bit ms": 2.0**32 * 1e-3, "16-bit ms": 2.0**16 * 1e-3, "16-bit us": 2.0**16 * 1e-6}
TURNS |= {"midnight": 86400.0, "32-bit ns": 2.0**32 * 1e-9, "24-bit us": 2.0**24 * 1e-6}
"""s after which a counter begins anew."""

COARSE = 0.3
"""Share of rows at the time of the row before from which the stamps are coarse. Doubled rows are few; where stamps are as
coarse as two rows it is a half."""

GAP = 4.0
"""A step of this many usual ones is a gap."""

_CLOCK = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d+))?)?\s*([AaPp][Mm])?\s*(Z|z|UTC|[+-]\d{2}:?\d{2})?"
_STAMP = re.compile(rf"(?:(\d{{1,4}})[-/.](\d{{1,2}})[-/.](\d{{1,4}})(?:[T,]?\s*))?(?:{_CLOCK})?")


@dataclass(frozen=True, eq=False)
class Clock:
    """`rows`: those of the sheet that are kept, in order; `time` (kept,) s from 0. `start`: what the log calls 0, in words.
    `said`: what was mended or left out, each with its number."""

    rows: np.ndarray
    time: np.ndarray
    start: str
    said: tuple[str, ...] = ()
    restarts: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    @property
    def step(self) -> float:
        """s, the median from row to row."""
        return float(np.median(np.diff(self.time)))


def read_clock(sheet: Sheet, name: str, unit: str, runs: bool = False) -> Clock:
    """The clock of a column. `runs`: it may begin anew, and each run of it does (`restarts`, rows of Clock.rows). BadInput."""
    stamps, start = _seconds(sheet, name, unit)
    rows = np.flatnonzero(np.isfinite(stamps))
    if len(rows) < 2:
        raise sheet.wrong(name, 0, f"{len(rows)} rows with a time", "two at least")
    said = [f"time: {len(stamps) - len(rows)} rows without one, left out"] * (len(rows) < len(stamps))
    time, told = _unwound(stamps[rows])
    said += told
    time = time - time[0]
    usual = _usual(time)
    if usual == 0.0:
        raise sheet.wrong(
            name, rows[-1], f"{sheet.columns[name][rows[-1]]}, no later than any row before", "a time that goes on"
        )
    back = np.flatnonzero(np.diff(time) < -usual) + 1
    if len(back) and not runs:
        now, before = (sheet.columns[name][rows[back[0] - k]] for k in (0, 1))
        found = f"{now} after {before}, back by {time[back[0] - 1] - time[back[0]]:.6g} s, {len(back)} such places"
        allowed = "time that doesn't go back by a row or more; a log of several runs goes in with --as steps"
        raise sheet.wrong(name, rows[back[0]], found, allowed)
    parts, kept, restarts = [], [], []
    for first, end in zip([0, *back], [*back, len(time)], strict=True):
        if np.ptp(time[first:end]) == 0.0:
            raise sheet.wrong(name, rows[first], f"a run of {end - first} rows at one time", "runs of which the time goes on")
        own, stay, told = straightened(time[first:end], usual)
        restarts.append(sum(map(len, kept)))
        parts.append(own - own[0])
        kept.append(rows[first:end][stay])
        said += told
    return Clock(np.concatenate(kept), np.concatenate(parts), start, tuple(said), np.array(restarts))


def straightened(time: np.ndarray, usual: float) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(times that increase, the rows that stay, what was done) of a clock (n,) that goes back by no more than `usual` s."""
    said, stay = [], np.arange(len(time))
    same = np.round(np.diff(time), 9) == 0.0
    if same.mean() > COARSE:
        time = _spread(time)
        many = number(1.0 / (1.0 - same.mean()), 3)
        said.append(f"time: stamps stand for {many} rows each, which are spread evenly up to the next")
    elif same.any():
        stay = np.flatnonzero(np.append(~same, True))
        said.append(f"time: {int(same.sum())} rows at the time of the next one, left out")
    time, count, furthest = mended(time[stay])
    if count:
        said.append(
            f"time: goes back in {count} of {len(time)} rows, by {1e3 * furthest:.3g} ms at most, less than a row: mended"
        )
    return time, stay, said


def mended(time: np.ndarray) -> tuple[np.ndarray, int, float]:
    """(times (n,) that increase, how often they did not, by how many s at most).

    Of two rows at odds nobody knows which is wrong: both are put evenly between their neighbours, and more of them if need be.
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
        if doubted[-1]:  # nothing behind it: it goes on at the usual pace
            tail = index > trusted[-1]
            fixed = np.where(tail, time[trusted[-1]] + (index - trusted[-1]) * _usual(time), fixed)
        wrong = np.round(np.diff(fixed), 9) <= 0.0
    return fixed, count, furthest


def gaps(time: np.ndarray) -> np.ndarray:
    """(gaps,) rows behind which more than GAP usual steps are missing."""
    step = np.diff(time)
    return np.flatnonzero(step > GAP * np.median(step))


def guessed_unit(values: np.ndarray) -> str | None:
    """The unit of a time that has none, by its size: since 1970, or a step that loggers have; None where two would do."""
    seen = values[np.isfinite(values)]
    if len(seen) < 2:
        return None
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 3e8 * scale < seen[0] < 4e9 * scale:  # 1979 to 2096
            return unit
    step, whole = _usual(seen), bool(np.all(seen == np.round(seen)))
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


def _usual(time: np.ndarray) -> float:
    """The usual step: the median of those that are none at 0."""
    step = np.diff(time)
    return float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0


def _seconds(sheet: Sheet, name: str, unit: str) -> tuple[np.ndarray, str]:
    """(stamps (n,) in s, the first of them in words)."""
    cells = sheet.columns[name]
    if cells.dtype.kind == "M":
        stamps = (cells - cells[~np.isnat(cells)][0]).astype("timedelta64[ns]")
        return np.where(np.isnat(cells), np.nan, stamps.astype(np.int64) / 1e9), str(cells[0])
    if unit == CALENDAR:
        return _calendar(sheet, name)
    values = sheet.numbers(name)
    seen = values[np.isfinite(values)]
    if not len(seen):
        raise sheet.wrong(name, 0, "empty cells only", "a time in each row")
    # The first is taken off before the unit: seconds since 1970 in ns are as long as a float.
    return (values - seen[0]) * factor_of(QUANTITIES["time"], unit), f"{seen[0]:.15g} {unit}"


def _calendar(sheet: Sheet, name: str) -> tuple[np.ndarray, str]:
    cells = sheet.columns[name]
    if cells.dtype.kind != "O":
        raise sheet.wrong(name, 0, f"{cells[0]:.12g}", "a date or a time of day such as 2024-05-01T12:30:00.125")
    found = [None if cell.strip().lower() in EMPTY else _stamp(cell.strip()) or cell for cell in cells.tolist()]
    for row, stamp in enumerate(found):
        if isinstance(stamp, str):
            raise sheet.wrong(name, row, shown(stamp), "a date or a time of day such as 2024-05-01T12:30:00.125")
    day = _days([stamp[0] for stamp in found if stamp])
    stamps = np.array([np.nan if stamp is None else day(stamp[0]) for stamp in found])
    first = next((k for k, stamp in enumerate(found) if stamp), 0)
    stamps = (stamps - stamps[first]) * 86400.0
    stamps += np.array([np.nan if stamp is None else stamp[1] for stamp in found])
    return stamps - stamps[first], cells[first].strip()


def _stamp(text: str) -> tuple[tuple[int, int, int] | None, float] | None:
    """((three numbers of a date as they stand, None without one), s of the day, UTC if an offset is told); None: no stamp."""
    found = _STAMP.fullmatch(text)
    if found is None or not text or (found.group(1) is None and found.group(4) is None):
        return None
    a, b, c, hour, minute, second, fraction, half, zone = found.groups()
    hours = int(hour or 0) % 12 + 12 * (half.lower() == "pm") if half else int(hour or 0)
    seconds = 3600.0 * hours + 60.0 * int(minute or 0) + int(second or 0) + (float(f"0.{fraction}") if fraction else 0.0)
    if zone and zone[0] in "+-":
        seconds -= (1.0 if zone[0] == "+" else -1.0) * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:]))
    return (None if a is None else (int(a), int(b), int(c))), seconds


def _days(dates: list):
    """A function from a date's three numbers to its day. Year first is ISO; else the day is the first of the other two where
    it must be, or where that makes the log the shorter one."""

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


def _unwound(time: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(time that goes on where its counter began anew, what was done)."""
    step, usual, said = np.diff(time), _usual(time), []
    moved = np.zeros(len(time))
    for what, turn in TURNS.items():
        places = np.flatnonzero((step < -0.5 * turn) & (step + turn > -usual) & (step + turn < 10.0 * usual))
        if len(places) and turn > 20.0 * usual:
            for place in places:
                moved[place + 1 :] += turn
            said.append(f"time: begins anew {len(places)} times after {turn:.9g} s ({what}), unwound")
            break
    return time + moved, said


def _spread(time: np.ndarray) -> np.ndarray:
    """Rows of one stamp evenly up to the next stamp; those of the first and last, which may lack rows, at the usual pace."""
    first = np.flatnonzero(np.append(True, np.round(np.diff(time), 9) != 0.0))
    length = np.diff(np.append(first, len(time)))
    within = np.arange(len(time)) - np.repeat(first, length)
    many = float(np.median(length[1:-1])) if len(length) > 2 else float(length.max())
    pace = np.diff(np.append(time[first], np.nan)) / length
    pace[-1] = float(np.median(np.diff(time[first]))) / many if len(first) > 1 else 0.0
    found = time + within * np.repeat(pace, length)
    missing = max(0.0, many - length[0])
    if len(first) > 1 and missing:  # the log began in the midst of a stamp
        usual = float(np.median(np.diff(time[first]))) / many
        head = slice(0, length[0])
        found[head] = time[first[1]] - usual * (length[0] - within[head])
    return found
