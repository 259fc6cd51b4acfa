"""Place of an imported log in a campaign's folder: one file per kind, which never replaces another log's silently."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from identification.gate.zero import levelled
from identification.logger_fit import mended
from identification.logs.intake import Taken
from identification.logs.kinds import KINDS, repeat_of, runs_of, static_of
from identification.logs.sampling import read_once, screened
from vpp_fmu.app.report.sentences import size
from vpp_fmu.campaign import write_static, write_steps
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.outputs import OutputSet
from vpp_fmu.record import Record, read_record, write_record


def add_kind(parser, default: str | None, text: str) -> None:
    """The options --as, --replace and --mend."""
    parser.add_argument("--as", dest="kind", choices=KINDS, default=default, help=text)
    parser.add_argument("--replace", action="store_true", help="replace a file of another log")
    text = "shift the commands by whole rows to where the response says that they acted; nothing is changed without this"
    parser.add_argument("--mend", action="store_true", help=text)


def add_speed_from(parser) -> None:
    text = "take omega_ref from the command or signal, or from the measured speed, where the motor does not hold its command"
    parser.add_argument("--speed-from", choices=("command", "measured"), default="command", help=text)


def placed(place: Path, kind: str, taken: Taken, replace: bool, mend: bool = False) -> tuple[OutputSet, Taken, list[str]]:
    """(the output folder with the file KIND.csv, not yet in its place; the log with the corrections of a record; remarks).
    BadInput."""
    if kind == "static":
        static, said = static_of(taken)
    elif kind == "steps":
        runs, said = runs_of(taken)
    else:
        record, said = _record(place, kind, taken, mend)
        taken = dataclasses.replace(taken, columns=record.columns)
    if (other := there(place, kind)) and other.suffix == ".gz":
        raise BadInput(
            other, "file", f"{kind}.csv.gz already in the folder", f"either it or {kind}.csv", "delete it, or another folder"
        )
    folder = OutputSet(place, "import")
    if kind == "static":
        write_static(folder, static)
    elif kind == "steps":
        write_steps(folder, runs)
    else:
        write_record(folder, f"{kind}.csv", record)
    if kind in KINDS and f"{kind}.csv" in folder.replaced and not replace:
        raise BadInput(
            place / f"{kind}.csv", "file", "the file of another log", "a new file", "another folder, another --as, or --replace"
        )
    return folder, taken, said


def headline(folder: OutputSet, kind: str, columns: Mapping[str, np.ndarray] | Record, log: str) -> str:
    """The imported file in a sentence; `columns`: by name, NaN where a cell is empty."""
    rows, text = len(columns["omega_ref"]) if "omega_ref" in columns else len(columns["thrust"]), ""
    if "time" in columns:
        text = f" over {size(float(columns['time'][-1] - columns['time'][0]), 's')}"
    if "thrust" in columns and np.isfinite(columns["thrust"]).any():
        low, high = (float(extreme(columns["thrust"])) for extreme in (np.nanmin, np.nanmax))
        text += f", thrust {size(low)} to {size(high, 'N')}"
    return f"{Path(log).name} became {folder.path / kind}.csv: {rows} rows{text}."


def _record(place: Path, kind: str, taken: Taken, mend: bool) -> tuple[Record, list[str]]:
    record = taken.record()
    if taken.points:
        allowed = "rows close enough to show how the thrust moves"
        raise BadInput(record.source, "time", f"rows {number(record.period)} s apart", allowed, "--as static for steady points")
    record, said = read_once(record)
    record, remarks = levelled(record)
    said += remarks
    if mend:
        record, remarks = mended(record)
        said += remarks
    if kind == "repeat" and (first := there(place, "open_loop")):
        record, remarks = repeat_of(record, read_record(first, holes=("thrust",)))
        said += remarks
    return record, [*said, *screened(record)]


def there(folder: Path, kind: str) -> Path | None:
    """The file of a kind in a folder, packed or not; None without one."""
    return next((path for suffix in ("csv", "csv.gz") if (path := folder / f"{kind}.{suffix}").exists()), None)
