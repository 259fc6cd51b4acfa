"""Logs of an RCbenchmark (Tyto Robotics) stand with fixed pitch: tables whose header is known and whose logger stalls.

Properties of the logger, from two logs of 80 to 120 rows a second (notes/identification.md):

- A third of the filled thrust cells repeat the last value to the last digit; other neighbours differ by 900 steps of the
  converter. Such a cell is one conversion read twice: it is emptied, so that it counts once.
- The logger stalls: most steps up have a gap of 80 to 97 ms. The row after a gap was measured before it (its current is still
  the motor's inrush). Its readings are emptied, except the voltage.
- Rows further apart than SAMPLED are averages by its program: steady points, not samples.
- Speed and thrust are smoothed over rows: after a gap half of the remaining step is made per row, whatever the time between
  rows. They are emptied until less than 1 % of the step remains, for REMEMBERED rows.

Nothing is resampled: rows keep their uneven times.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from identification.gate.zero import tare
from identification.logs.intake import Taken
from identification.logs.raw_table import RawTable, split_unit
from identification.logs.sampling import REMEMBERED
from vpp_fmu.digits import number, signed
from vpp_fmu.errors import BadInput

NEEDED = {"time": "Time", "signal": "ESC signal", "thrust": "Thrust", "voltage": "Voltage"}
"""Names in the header of each log, by quantity."""

PWM_FROM = 900.0
"""Smallest signal of a log without its unit, from which it is PWM in us and not DShot."""


def preset(table: RawTable, words: Iterable[str], backwards: bool, saved: Collection[str] = ()) -> list[str]:
    """The columns that each log has, as further words of --map beside a user's and those `saved` in an import.toml.

    The kind of a signal without a unit is that of its values; `backwards`: thrust has the opposite sign. BadInput for another
    header than that of the stand's program.
    """
    header = {split_unit(name)[0].lower(): name for name in table.columns}
    if missing := [name for name in NEEDED.values() if name.lower() not in header]:
        found = f"only {', '.join(table.columns)}"[:200]
        raise BadInput(table.source, f"column {missing[0]}", found, "a log of RCbenchmark with its own header")
    columns = {quantity: header[name.lower()] for quantity, name in NEEDED.items()}
    signal, thrust = columns["signal"], columns["thrust"]
    if not table.unit(signal) and np.nanmin(table.numbers(signal), initial=np.inf) >= PWM_FROM:
        columns["signal"] = f"{signal}:us"
    if backwards and (unit := table.unit(thrust)):
        columns["thrust"] = f"{thrust}:-1 {unit}"
    own = {*saved, *(word.partition("=")[0] for word in words)}
    return [*words, *(f"{quantity}={column}" for quantity, column in columns.items() if quantity not in own)]


def cleaned(taken: Taken, keep_stalls: bool) -> tuple[Taken, list[str]]:
    """(the log without cells that are no measurements, its thrust less the mean at rest; both in words). `keep_stalls`: only
    repeats are emptied."""
    stalls, columns = taken.stalls, taken.stalls.emptied(taken.columns, keep_stalls)
    said, gaps = list(stalls.said), 1e3 * np.diff(columns["time"])[stalls.late[1:]]
    if len(gaps):
        said.append(
            f"stalls: {len(gaps)} gaps of {gaps.min():.0f} to {gaps.max():.0f} ms in rows of {1e3 * taken.clock.step:.1f} ms; "
            f"speed and thrust of {stalls.stalled.sum()} rows ({REMEMBERED} behind each) "
            f"{'kept as logged' if keep_stalls else 'left empty'}"
        )
    taken = replace(taken, columns=columns)
    if (zero := tare(taken.record())) is None:
        return taken, [*said, "tare: none, the log has no rest; thrust is as logged"]
    how = f"the mean of {zero.readings} readings at rest (spread {number(zero.spread)} N)"
    columns = {**columns, "thrust": columns["thrust"] - zero.mean}
    return replace(taken, columns=columns), [*said, f"tare: {signed(zero.mean)} N taken off, {how}"]
