"""What a log's rows are worth as samples: said when it comes in, each in one line with the number that shows it."""

from pathlib import Path

import numpy as np

from identification.gate.files import FOLLOWS
from identification.gate.finding import Finding
from identification.gate.fitted import FIFTH
from identification.gate.gate import look
from identification.gate.response import Look
from identification.logs.clock import GAP, gaps
from vpp_fmu.campaign import Campaign
from vpp_fmu.digits import number
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig

HELD = 3
"""Rows that a command keeps before and after a move that is judged."""

MOSTLY = 0.7
"""Share of its rows that a command must hold in to be judged: with fewer it moves too often to have a value in between."""

PASSES = 0.3
"""Share of such moves with one value in between from which rows are averages: a command that is sampled goes over at once, and
one that is limited in its slew takes as many rows as the move is long. Of means over a row nearly all have one."""

FEWEST_MOVES = 4
"""Moves from which the share tells."""

ROWS_BACK = 20
"""Rows before whose moves of a command may still move the speed."""

CHANCE = 5.0
"""Standard deviations that noise reaches in one log of three million."""


def said_of_gaps(record: Record) -> list[str]:
    """Rows that are missing."""
    wide = gaps(record.time)
    if not len(wide):
        return []
    longest = wide[np.argmax(record.steps[wide])]
    told = f"{len(wide)} steps of more than {GAP:g} rows of {1e3 * record.period:.3g} ms"
    return [f"gaps: {told}, the longest of {number(record.steps[longest])} s at {record.time[longest]:.2f} s"]


def said_of_rows(record: Record) -> list[str]:
    """Averages passed off as samples, and rows slower than what they sample."""
    lines = []
    through, moves = between(record)
    if moves >= FEWEST_MOVES and through > PASSES * moves:
        told = f"in {through} of {moves} moves between held commands one row lies in between"
        row = f"{1e3 * record.period:.3g} ms"
        lines.append(f"averages: {told}: rows are means over {row} and no samples, and lags come out wrong by as much")
    return lines + _leads(record) + _slow(record)


def between(record: Record) -> tuple[int, int]:
    """(moves of a command with exactly one value in between, moves) between values that are held for HELD rows or more."""
    through = moves = 0
    for name in ("omega_ref", "beta_ref"):
        command = record[name]
        first = np.flatnonzero(np.append(True, command[1:] != command[:-1]))
        length = np.diff(np.append(first, len(command)))
        held = length >= HELD
        if length[held].sum() < MOSTLY * len(command):
            continue  # a ramp, or a measured speed in the command's place
        moves += int(np.sum(held[:-1] & held[1:]))
        single = held[:-2] & (length[1:-1] == 1) & held[2:]
        before, at, after = (command[first[k : len(first) - 2 + k]] for k in range(3))
        inside = single & ((before - at) * (at - after) > 0.0)
        through, moves = through + int(inside.sum()), moves + int(inside.sum())
    return through, moves


def _leads(record: Record) -> list[str]:
    """Whether speed has moved in the row that commands it. A command acts from its row on: then it was sent before.

    Changes of speed from row to row are fitted by those of the command in this row and the ROWS_BACK before it (least squares).
    """
    if "omega" not in record or len(record) < 5 * ROWS_BACK or not np.ptp(record["omega_ref"]):
        return []
    command, speed = np.diff(record["omega_ref"]), np.diff(record["omega"])
    moves = np.lib.stride_tricks.sliding_window_view(command, ROWS_BACK + 1)[:, ::-1]
    seen = np.isfinite(speed[ROWS_BACK:])
    moves, speed = moves[seen], speed[ROWS_BACK:][seen]
    information = moves.T @ moves
    if np.linalg.matrix_rank(information) <= ROWS_BACK:
        return []
    inverse = np.linalg.inv(information)
    share = inverse @ (moves.T @ speed)
    left = speed - moves @ share
    std = np.sqrt(inverse[0, 0] * np.sum(left**2) / (len(left) - len(share)))
    if share[0] < CHANCE * std:
        return []
    told = f"speed has gone {100.0 * share[0]:.2g} ± {100.0 * std:.1g} % of a move in the row that commands it"
    return [f"clock: {told}, and a command acts from its row on: it was sent before; --mend shifts the commands by whole rows"]


def _slow(record: Record) -> list[str]:
    """Whether thrust follows its commands within less rows than show a lag."""
    if np.isfinite(record["thrust"]).sum() < 20 or not (np.ptp(record["omega_ref"]) or np.ptp(record["beta_ref"])):
        return []
    response = Look([record]).response()
    moved = [lag for channel, lag in response.lags.items() if np.ptp(record[f"{channel}_ref"]) > 0.0]
    if response.explained < FOLLOWS or not moved or max(moved) >= FIFTH:
        return []
    row = f"{1e3 * response.row:.3g} ms"
    if max(moved) == 0.0:
        return [
            f"slow sampling: thrust follows its command within a row of {row}, where {FIFTH:g} rows show a lag: log more often"
        ]
    enough = 1e3 * response.row * max(moved) / FIFTH
    told = f"thrust follows its command within {max(moved):.2g} rows of {row}"
    return [f"slow sampling: {told}, where {FIFTH:g} rows show a lag: log every {enough:.2g} ms or more often"]


def findings(record: Record) -> tuple[Finding, ...]:
    """What the quality gate will say of a record: channels that are clipped, frozen, in another unit."""
    campaign = Campaign(Path("."), None, (), record, None, None, rig=infer_rig([record], None, {}))
    return look(campaign).findings
