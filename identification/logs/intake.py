"""Convert a table and the plan of its columns to the columns of a record, and report each correction."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.gate.files import speed_ratio, speed_unit
from identification.gate.sensors import multiples
from identification.logs.clock import Clock, read_clock
from identification.logs.commands import map_of_signal
from identification.logs.mapping import ROWS, Column, Plan, in_other_unit, moving_angle
from identification.logs.raw_table import RawTable
from identification.logs.sampling import Stalls
from identification.logs.speed_map import RANGES, SignalRange, SpeedMap
from identification.logs.units import QUANTITIES, SIGNALS, factor_of, is_rate, scale_of, signal_unit
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.record import QUANTITIES as RANGE
from vpp_fmu.record import Record

_E_RPM = re.compile(r"(?i)(?<![a-z])e[-_ ]?rpm")

COMMANDS = ("omega_ref", "beta_ref", "signal", "run")

SLOW = 200.0
"""rpm: no electronically commutated motor runs slower throughout a log."""

SAME_SPEED = 0.2
"""Difference of logarithms of the measured and the commanded speed, below which both are the rotor's."""

APART = 0.05
"""Share of a quantity's readings in rows with thrust, below which they are messages of their own."""

SCATTER, EXPLAINED, MOST_MOVES = 0.05, 0.5, 0.1
"""Residual of thrust at fixed pitch as a share of its range, from which a further command is searched; the share of its
variance that such a command explains; the largest share of rows in which a command moves."""

ABSURD = 0.01
"""Share of a measured column's rows beyond its limits, up to which the cells are disturbed ones: a wrong unit spoils most."""

FASTER = 1.0
"""Median step, s, above which rows are steady points and not a record in time."""


@dataclass(frozen=True, eq=False)
class Taken:
    """A log in a record's units: each quantity of the plan (n,), with `time` and `clock` if the log has a time.

    `said`: corrections in words. `speed_map`: source of the speed command, None if the log has the command. `stalls`: of a
    stand's logger.
    """

    columns: Mapping[str, np.ndarray]
    clock: Clock | None
    said: tuple[str, ...]
    source: str
    speed_map: SpeedMap | None = None
    stalls: Stalls | None = None

    @property
    def points(self) -> bool:
        """Whether rows are steady points: no time, or a median step above FASTER."""
        return self.clock is None or self.clock.step > FASTER

    def record(self) -> Record:
        """The columns that a record has."""
        return Record({n: c for n, c in self.columns.items() if n in ("time", *RANGE)}, self.source)


def signal_range(plan: Plan) -> SignalRange | None:
    """Range of the plan's signal, from its unit; None without a signal."""
    return RANGES[SIGNALS[signal_unit(plan.columns["signal"].unit)]] if "signal" in plan.columns else None


def take_in(
    table: RawTable,
    plan: Plan,
    kind: str,
    speed_map: SpeedMap | None = None,
    force: bool = False,
    run: int | None = None,
    stand: bool = False,
) -> Taken:
    """Convert a table for a campaign's file of a `kind`. `speed_map`: from signal to speed; None: fitted to the log.
    `force`: accept a speed that looks electrical; `run`: which, from 1, of a log whose time starts again; `stand`: of a thrust
    stand whose logger stalls. BadInput."""
    _check(table, plan, kind)
    clock, rows, said = None, np.arange(len(table)), []
    if "time" in plan.columns:
        clock = clock_of(table, plan, kind, run)
        rows, said = clock.rows, [f"time 0 is {clock.start} of the log", *clock.said]
    columns = {"time": clock.time} if clock else {}
    for quantity, column in plan.columns.items():
        if quantity != "time":
            factor, offset = scale_of(QUANTITIES[quantity], column.unit)
            columns[quantity] = table.numbers(column.name)[rows] * factor + offset
    if clock and len(clock.restarts) <= 1:
        _check_rows(columns, table.source)
    if not force and (contradiction := electrical(plan.columns, columns)):
        raise BadInput(table.source, f"omega, column {plan.columns['omega'].name}", *contradiction)
    if clock and len(clock.restarts) > 1 and "run" not in columns:
        columns["run"] = np.searchsorted(clock.restarts, np.arange(len(rows)), side="right").astype(float)
        said.append(f"time: begins anew {len(clock.restarts) - 1} times, each a run")
    for name, column in list(columns.items()):
        if not np.isfinite(column).any():
            if name in ("thrust", "omega_ref", "beta_ref", "signal"):
                raise BadInput(
                    table.source, f"{name}, column {plan.columns[name].name}", "empty cells only", QUANTITIES[name].meaning
                )
            del columns[name]
            said.append(f"{name}: no value in any row, left out")
    unknown = clock and not {"beta_ref", "beta"} & {*columns, *plan.fixed} and not _no_angle(table, plan)
    if unknown and (other := _other_command(table, plan, columns, rows)):
        raise BadInput(table.source, "beta_ref", *other)
    words = {name: f"{name}, column {column.name} in {column.unit}" for name, column in plan.columns.items()}
    columns, notes = within_ranges(columns, words, table.source)
    said += notes
    columns, clock, notes = _held(columns, clock)
    said += notes
    stalls = Stalls.of(columns["time"], columns["thrust"]) if stand else None
    if stand and "voltage" in columns:  # an effect's input, without gaps
        columns["voltage"] = _last_value(columns["voltage"], first=True)
    usable = True if stalls is None else ~stalls.stalled
    columns, notes, found = _commanded(table, plan, columns, clock, kind, speed_map, usable)
    columns, _ = within_ranges(columns, words, table.source)
    return Taken(columns, clock, (*said, *notes), table.source, found, stalls)


def take_measured(table: RawTable, plan: Plan, kind: str, **options) -> Taken:
    """A log with the measured speed as its command, interpolated over time where the speed is missing, late or a multiple of
    the log's own command. `options`: as of `take_in`."""
    try:
        taken = take_in(table, plan, kind, **options)
        wrong = False if taken.points else multiples(taken.record())[0]
    except BadInput:  # no command to compare with
        columns = {**{q: c for q, c in plan.columns.items() if q != "signal"}, "omega_ref": plan.columns["omega"]}
        taken, wrong = take_in(table, replace(plan, columns=columns), kind, **options), False
    speed, rows = taken.columns["omega"], taken.columns.get("time", np.arange(len(taken.columns["omega"])))
    there = np.isfinite(speed) & ~np.asarray(wrong) & (True if taken.stalls is None else ~taken.stalls.stalled)
    columns = {**taken.columns, "omega_ref": np.interp(rows, rows[there], speed[there])}
    said = (*taken.said, "omega_ref: the measured speed, interpolated where it is missing, late or a multiple")
    return replace(taken, columns=columns, said=said, speed_map=None)


def electrical(plan: Mapping[str, Column], columns: Mapping[str, np.ndarray]) -> tuple[str, str, str] | None:
    """(found, expected, hint) if measured and commanded speed are in different units, or if the measured one's name says
    electrical and there is no command to compare; else None."""
    if "omega" not in columns:
        return None
    column, fastest = plan["omega"], np.nanmax(columns["omega"], initial=0.0)
    hundreds = "100 " if "/100" in column.name else ""
    mapped = f"--map 'omega={column.name}:{hundreds}erpm/7' with the motor's own pole pairs, or --force"
    by_name = "electrical speed, by its name", "the speed of the rotor", mapped
    if _E_RPM.search(column.unit):
        hint = f"--map 'omega={column.name}:100 {column.unit}' if the logger writes hundreds, or --force"
        slow = 0.0 < fastest < SLOW and not column.unit[0].isdigit()
        return (f"at most {fastest:.4g} rpm", f"a motor that reaches {SLOW:g} rpm", hint) if slow else None
    command = np.nan_to_num(columns.get("omega_ref", np.zeros(1)))
    ratio = speed_ratio(columns["omega"], command) if command.any() else None
    if ratio is None or not (other := speed_unit(ratio)):
        matches = ratio is not None and abs(np.log(ratio)) < SAME_SPEED
        return by_name if _E_RPM.search(column.name) and not matches else None
    quantity, unit, cause = other
    column = plan.get(quantity, column)
    if factor_of(QUANTITIES[quantity], column.unit) != 1.0:
        unit = f"{column.unit}/{unit.removeprefix('erpm/')}" if unit.startswith("erpm") else "UNIT"
    hint = f"--map '{quantity}={column.name}:{unit}'{', or in deg/s' * ('deg/s' in cause)}, or --force to take it as it is"
    return f"{ratio:.4g} times the commanded speed ({cause}?)", "the speed of the rotor", hint


def _no_angle(table: RawTable, plan: Plan) -> tuple[str, str, str] | None:
    """(found, expected, hint) if the plan has no pitch, and the log has a moving angle or no angle as pitch; else None."""
    if "beta_ref" in {*plan.columns, *plan.fixed}:
        return None
    if (angle := moving_angle(table, {c.name for c in plan.columns.values()})) is not None:
        name, unit, low, high = angle
        found = f"{name}, an angle that moves from {low:g} to {high:g} {unit}, and no pitch"
        return found, "a command of pitch", f"--map 'beta_ref={name}:{unit}', or --fixed beta_ref=8:deg if the pitch is fixed"
    return _uncalibrated(table, plan, "beta", "pitch")


def _uncalibrated(table: RawTable, plan: Plan, quantity: str, word: str) -> tuple[str, str, str] | None:
    """(found, expected, hint) if an unused column is the quantity by its name, in no unit of it; else None."""
    if (other := in_other_unit(table, quantity, {c.name for c in plan.columns.values()})) is None:
        return None
    name, unit, low, high = other
    found = f"{name}, {word} by its name, from {low:g} to {high:g} {unit}".rstrip()
    if quantity == "thrust":
        hint = f"--map 'thrust={name}:{unit}@A=0,B=10' with the numbers A and B that mean 0 and 10 N"
        return found, "a force", hint
    return found, "a pitch in deg", _calibrated(name, unit, low, high if high > low else low + 1.0)


def _calibrated(name: str, unit: str, low: float, high: float) -> str:
    """How to state the pitch of a column by two points, or a fixed one."""
    points = f"'beta_ref={name}:{unit}@{low:g}=A,{high:g}=B'"
    return f"--map {points}, A and B the pitch there in deg, or --fixed beta_ref=8:deg if the pitch is fixed"


def _other_command(
    table: RawTable, plan: Plan, columns: Mapping[str, np.ndarray], rows: np.ndarray
) -> tuple[str, str, str] | None:
    """(found, expected, hint) if an unused column moves as a command does and explains thrust that speed does not; else None.

    Thrust at fixed pitch is a quadratic in speed. A pitch x adds the terms x, x w^2 and x^2 w^2.
    """
    speed = columns.get("omega", columns.get("omega_ref"))
    seen = np.isfinite(speed) & np.isfinite(columns["thrust"]) if speed is not None else np.zeros(1, bool)
    if seen.sum() < 100:
        return None
    w, thrust = speed[seen] / max(1.0, float(np.abs(speed[seen]).max())), columns["thrust"][seen]

    def residual(*terms):
        a = np.column_stack([np.ones_like(w), w, w**2, *terms])
        return float(np.std(thrust - a @ np.linalg.lstsq(a, thrust, rcond=1e-9)[0]))

    alone = residual()
    if alone < SCATTER * np.ptp(thrust):
        return None
    taken = {part for column in plan.columns.values() for part in table.parts(column.name) if column.name != ROWS}
    free = (n for n, cells in table.columns.items() if n not in taken and cells.dtype.kind == "f")
    for name in (n for n in free if not is_rate(table.unit(n) or "")):
        x = _last_value(table.numbers(name))[rows][seen]
        if not np.isfinite(x).all() or not 3 <= np.sum(np.diff(x) != 0.0) <= MOST_MOVES * len(x):
            continue
        u = (x - x.min()) / np.ptp(x)
        if residual(u, u * w**2, (u * w) ** 2) ** 2 < (1.0 - EXPLAINED) * alone**2:
            found = f"{name}, an unused command from {x.min():g} to {x.max():g} that thrust follows, and no pitch"
            return found, "a command of pitch", _calibrated(name, table.unit(name) or "", x.min(), x.max())
    return None


def _last_value(column: np.ndarray, first: bool = False) -> np.ndarray:
    """The column (n,) with each empty cell filled by the last value before it; before the first NaN, or the `first`."""
    filled = np.isfinite(column)
    last = np.maximum.accumulate(np.where(filled, np.arange(len(column)), np.argmax(filled) if first else 0))
    return column[last]


def _check_rows(columns: Mapping[str, np.ndarray], source: str) -> None:
    """BadInput if other quantities are messages in rows of their own."""
    thrust = np.isfinite(columns["thrust"])
    others = {n: np.isfinite(c) for n, c in columns.items() if n not in ("time", "thrust") and np.isfinite(c).sum() > 1}
    if apart := [n for n, seen in others.items() if thrust.sum() > 1 and np.mean(thrust[seen]) < APART]:
        found, allowed = f"{', '.join(apart)} in other rows than thrust", "one row for all quantities of an instant"
        without = "" if {*apart} & {*COMMANDS} else f", or --map {' '.join(f'{name}=-' for name in apart)}"
        raise BadInput(source, "rows", found, allowed, f"a table joined at the rows of thrust{without}")


def _check(table: RawTable, plan: Plan, kind: str) -> None:
    if "thrust" not in plan.columns:
        if other := _uncalibrated(table, plan, "thrust", "thrust"):
            raise BadInput(table.source, "thrust", *other)
        found = f"no column of it among {_names(table)}"
        raise BadInput(table.source, "thrust", found, "a column of thrust", "--map thrust=COLUMN:UNIT")
    if "time" not in plan.columns and kind != "static":
        hint = "--map time=COLUMN:UNIT, or time=row:4ms for rows that are 4 ms apart"
        raise BadInput(table.source, "time", f"no column of it among {_names(table)}", "a column of time", hint)
    known = {"omega_ref", "signal"} & {*plan.columns, *plan.fixed} or (kind == "static" and "omega" in plan.columns)
    if not known:
        hint = (
            "--map omega_ref=COLUMN:rpm, with the measured speed if there is no other, or signal=COLUMN:us and omega=COLUMN:rpm"
        )
        raise BadInput(table.source, "omega_ref", f"no column of it among {_names(table)}", "a command of speed", hint)


def _names(table: RawTable) -> str:
    text = ", ".join(table.columns)
    return text if len(text) < 200 else f"{text[:197]}..."


def clock_of(table: RawTable, plan: Plan, kind: str, run: int | None) -> Clock:
    """The clock of a plan's time, for a campaign's file of a `kind`; `run`: which, from 1, if time starts again. BadInput."""
    column = plan.columns["time"]
    if column.name == ROWS and ROWS not in table.columns:
        step = factor_of(QUANTITIES["time"], column.unit)
        return Clock(np.arange(len(table)), step * np.arange(len(table)), f"row 1, rows are {column.unit} apart", ())
    clocks = (n for n in table.columns if re.fullmatch(rf"{re.escape(column.name)}\.\d+", n))  # X_Value.3: of one channel
    if other := next((n for n in clocks if not np.array_equal(table.columns[n], table.columns[column.name])), None):
        found = f"several, of which {other} differs from {column.name}"
        raise BadInput(table.source, "time", found, "one time for all columns", "an export with one time, or one rate")
    return read_clock(table, column.name, column.unit, kind == "steps", run)


def _held(columns: dict[str, np.ndarray], clock: Clock | None) -> tuple[dict[str, np.ndarray], Clock | None, list[str]]:
    """Fill empty cells of commands with the last value; rows before the first command are left out."""
    there = [name for name in COMMANDS if name in columns]
    said, begun = [], np.ones(len(next(iter(columns.values()))), bool)
    for name in there:
        begun &= np.maximum.accumulate(np.isfinite(columns[name]))
    if not begun.all():
        said.append(f"{int((~begun).sum())} rows before the first command, left out")
        columns = {name: column[begun] for name, column in columns.items()}
        clock = clock and replace(clock, rows=clock.rows[begun], time=clock.time[begun])
    if "time" in columns:
        columns["time"] = columns["time"] - columns["time"][0]
    for name in there:
        empty = ~np.isfinite(columns[name])
        if empty.any():
            columns[name] = _last_value(columns[name])
            said.append(f"{name}: {int(empty.sum())} empty cells hold the value before")
    return columns, clock, said


def _commanded(table: RawTable, plan: Plan, columns: dict, clock: Clock | None, kind: str, speed_map: SpeedMap | None, usable):
    """(columns with both commands, messages, the speed map of a signal). `usable` (n,): rows whose speed belongs to their
    signal."""
    rows, said, found = len(columns["thrust"]), [], None
    if "signal" in columns and "omega_ref" not in columns:
        span = signal_range(plan)
        signal = columns.pop("signal")
        _check_signal(table, plan, signal, span)
        volts = _filled(columns["voltage"]) if "voltage" in columns else None
        time = None if clock is None or clock.step > FASTER else columns["time"]
        found, origin = map_of_signal(table.source, speed_map, span, time, signal, columns.get("omega"), volts, usable)
        said.append(f"speed map: {origin}")
        columns["omega_ref"] = found.omega_ref(signal)
    elif "signal" in columns:
        del columns["signal"]
    for name, value in plan.fixed.items():
        columns[name] = np.full(rows, value)
    if "omega_ref" not in columns:
        columns["omega_ref"] = columns["omega"]
        said.append("omega_ref: the measured speed, as the log has no command")
    pitch = columns.get("beta")
    if "beta_ref" not in columns and pitch is not None and kind == "static" and (clock is None or clock.step > FASTER):
        columns["beta_ref"] = pitch
        said.append("beta_ref: the measured pitch, as the points have no command")
    if "beta_ref" not in columns:
        if pitch is not None and np.nanmax(pitch) - np.nanmin(pitch) > 1.0:
            found = f"a measured pitch from {np.nanmin(pitch):.4g} to {np.nanmax(pitch):.4g} deg and no command of it"
            hint = f"--map 'beta_ref={plan.columns['beta']}' beta=- if its command was not logged"
            raise BadInput(table.source, "beta_ref", found, "a command of pitch", hint)
        if no_angle := _no_angle(table, plan):
            raise BadInput(table.source, "beta_ref", *no_angle)
        value = 0.0 if pitch is None else float(np.nanmean(pitch))
        columns["beta_ref"] = np.full(rows, value)
        said.append(
            f"beta_ref: not in the log, taken as a fixed pitch of {number(value)} deg (another: --fixed beta_ref=8:deg)"
        )
    first = [name for name in ("time", "run", "omega_ref", "beta_ref", "omega") if name in columns]
    return {name: columns[name] for name in (*first, *(n for n in columns if n not in first))}, said, found


def _filled(column: np.ndarray) -> np.ndarray:
    """The column (n,) with empty cells interpolated."""
    rows, there = np.arange(len(column)), np.isfinite(column)
    return np.interp(rows, rows[there], column[there])


def _check_signal(table: RawTable, plan: Plan, signal: np.ndarray, span: SignalRange) -> None:
    low, high = (600.0, 2400.0) if span.kind == "PWM" else (span.low, span.high)
    if signal.min() < low or signal.max() > high:
        found = f"{signal.min():.6g} to {signal.max():.6g}"
        allowed, hint = f"{low:g} to {high:g} of {span.kind}", "another unit of the signal: us, % or 1, or none for DShot"
        raise BadInput(table.source, f"signal, column {plan.columns['signal'].name}", found, allowed, hint)


def within_ranges(
    columns: Mapping[str, np.ndarray], fields: Mapping[str, str], source: str
) -> tuple[dict[str, np.ndarray], list[str]]:
    """(columns (n,) without measured cells beyond a record's limits, messages). BadInput for a command beyond them, or for more
    cells than a share ABSURD, usually because of a wrong unit. `fields`: by name, the column in words."""
    kept, said = dict(columns), []
    for name, values in sorted(columns.items(), key=lambda item: item[0] in COMMANDS):  # a map makes a command of a speed
        if (quantity := RANGE.get(name)) is None:
            continue
        outside = (values < quantity.minimum) | (values > quantity.maximum)
        if not (count := int(outside.sum())):
            continue
        worst = values[outside][np.argmax(np.abs(values[outside]))]
        allowed = f"{quantity.minimum:g} to {quantity.maximum:g} {quantity.unit}"
        if name in COMMANDS or count > ABSURD * len(values):
            found = f"{worst:.6g} {quantity.unit}, {count} of {len(values)} rows beyond the range"
            raise BadInput(source, fields.get(name, name), found, allowed, f"another unit with --map {name}=COLUMN:UNIT")
        kept[name] = np.where(outside, np.nan, values)
        said.append(f"{name}: {count} cells beyond {allowed}, up to {worst:.4g}, are emptied")
    return kept, said
