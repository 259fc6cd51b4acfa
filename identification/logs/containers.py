"""Read a log from Parquet, MAT and HDF5.

A container may hold anything. The log is its largest set of vectors of equal length, named by their paths.
"""

import importlib
import io
import os
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

from identification.logs.raw_table import RawTable
from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_bytes

PARQUET, HDF5, MAT = b"PAR1", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0 MAT-file"

_OTHERS = {
    b"PK\x03\x04": ("a workbook or another ZIP archive", "one table of it saved as CSV"),
    b"\xd0\xcf\x11\xe0": ("a workbook of old Excel", "one table of it saved as CSV"),
    b"ARROW1": ("a Feather file", "the same table as Parquet or CSV"),
    b"TDSm": ("a TDMS file", "the same table as CSV or HDF5"),
    b"MDF ": ("an MDF file", "the same channels as CSV, MAT or HDF5"),
    b"\xa3\x95": ("an ArduPilot log", "its messages of one kind as CSV"),
    b"#ROSBAG": ("a ROS bag", "one topic of it as CSV (rostopic echo -b BAG -p TOPIC)"),
    b"SQLite format 3": ("a ROS 2 bag or another database", "one table of it as CSV"),
    b"\x89MCAP": ("an MCAP recording", "one topic of it as CSV"),
    b"ULog": ("a PX4 log", "one topic of it as CSV (ulog2csv)"),
}
"""First bytes of formats that are not read: (what the file is, what to supply instead)."""

_MOST_COLUMNS = 64
"""A matrix with more columns than this is not a table."""


def read_container(path: str | os.PathLike) -> RawTable | None:
    """The table of a container, whose format its first bytes identify; None for a file that may be text. BadInput."""
    data = read_bytes(path)
    for mark, (found, allowed) in _OTHERS.items():
        if data.startswith(mark):
            raise BadInput(path, "file", found, allowed)
    if data.startswith(PARQUET):
        kind, read = "Parquet", _parquet
    elif HDF5 in (data[:8], data[512:520]):  # a MAT file of 7.3 has 512 bytes of MATLAB's before
        kind, read = "MAT (v7.3)" if data.startswith(b"MATLAB 7.3") else "HDF5", _hdf5
    elif data.startswith(MAT):
        kind, read = "MAT (v5 to v7.2)", _mat
    else:
        return None
    try:
        content, units = read(path, data)
        vectors = dict(_vectors(content))
    except (OSError, RuntimeError, LookupError, TypeError, ValueError, OverflowError, MemoryError, zlib.error) as error:
        name = kind.partition(" ")[0]
        found = f"{name} that its library does not read ({str(error).splitlines()[0][:120]})"
        raise BadInput(path, "file", found, f"a whole {name} file") from error
    lengths = Counter(map(len, vectors.values()))
    rows = max(lengths, key=lambda n: (lengths[n], n), default=0)  # the commonest length; of two such lengths, the longer
    if rows < 2:
        found = f"{kind} without a vector of two values or more"
        raise BadInput(path, "file", found, "vectors of one length, one a channel (of a MATLAB table: writetable, for a CSV)")
    columns = {name: vector for name, vector in vectors.items() if len(vector) == rows}
    dropped = {"vectors of another length": len(vectors) - len(columns)} if len(vectors) > len(columns) else {}
    start = 0
    if len({name.partition(".")[0] for name in columns}) == 1 and all("." in name for name in columns):
        start = len(next(iter(columns)).partition(".")[0]) + 1  # the name of the one struct or group is redundant
    known = {name[start:]: units[name] for name in columns if units.get(name)}
    columns = {name[start:]: vector for name, vector in columns.items()}
    how = f"{kind}, {len(columns)} vectors of {rows}"
    return RawTable(str(path), columns, np.arange(1, rows + 1), known, how, left_out=dropped, rows_are="row")


Content = tuple[dict[str, np.ndarray], dict[str, str]]
"""Arrays and units by name."""


def _parquet(path: str | os.PathLike, data: bytes) -> Content:
    pa, parquet = _library(path, "pyarrow"), _library(path, "pyarrow.parquet")
    try:
        table = parquet.read_table(pa.BufferReader(data)).flatten()
        arrays = {name: table[name].to_numpy() for name in table.column_names}
    except pa.ArrowException as error:
        raise ValueError(str(error)) from error
    told = {field.name: field.metadata or {} for field in table.schema}
    return arrays, {name: _text(about.get(b"units", about.get(b"unit"))) for name, about in told.items()}


def _mat(path: str | os.PathLike, data: bytes) -> Content:
    from scipy.io import loadmat  # noqa: PLC0415 - slow to import, and few logs are MAT files
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    try:
        content = loadmat(io.BytesIO(data), squeeze_me=True)
    except MatReadError as error:
        raise ValueError(str(error)) from error
    return {name: value for name, value in content.items() if not name.startswith("__") and name != "None"}, {}


def _hdf5(path: str | os.PathLike, data: bytes) -> Content:
    h5py = _library(path, "h5py")
    arrays, units = {}, {}

    def visit(name, item):
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        if item.attrs.get("MATLAB_class", b"double") in (b"char", b"cell", b"struct", b"table", b"function_handle"):
            return
        value, own = item[()], name.replace("/", ".")
        names = [*map(_text, np.atleast_1d(item.attrs.get("columns", item.attrs.get("names", []))).tolist())]
        parts = {own: value}
        if len(names) > 1 and np.ndim(value) == 2 and value.shape[1] == len(names):
            parts = {f"{own}.{each}": value[:, k] for k, each in enumerate(names)}
        arrays.update(parts)
        units.update(dict.fromkeys(parts, _text(item.attrs.get("units", item.attrs.get("unit", "")))))

    # HDF5 opens the file itself if it can: it then refuses a broken file, and reading through Python may crash.
    with h5py.File(io.BytesIO(data) if str(path).lower().endswith(".gz") else path, "r") as file:
        file.visititems(visit)
    return arrays, units


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else "" if value is None else str(value)


def _vectors(content: Mapping[str, object]) -> Iterator[tuple[str, np.ndarray]]:
    """(name, vector) of each vector, field of a struct, and column of a matrix."""
    for name, value in content.items():
        flat = np.asarray(value).squeeze()
        if flat.dtype.names:
            yield from _vectors({f"{name}.{own}": flat[own][()] for own in flat.dtype.names})
        elif flat.ndim == 1 and len(flat) > 1 and flat.dtype.kind in "fiubUSOMm":
            yield name, _array(flat)
        elif flat.ndim == 2 and flat.dtype.kind in "fiu" and min(flat.shape) <= _MOST_COLUMNS:
            table = flat if flat.shape[0] > flat.shape[1] else flat.T
            yield from ((f"{name}.{k}", column.astype(float)) for k, column in enumerate(table.T, 1))


def _array(values: np.ndarray) -> np.ndarray:
    """Convert to a type of RawTable: float, datetime64[ns] or text."""
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]")
    if values.dtype.kind == "m":
        return values.astype("timedelta64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind in "USO":
        values = np.array([*map(_text, values.tolist())], dtype=object)
    try:
        return np.where(values == "", "nan", values).astype(float) if values.dtype.kind == "O" else values.astype(float)
    except ValueError:
        return values


def _library(path: str | os.PathLike, name: str):
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        found = f"a file that only {package} reads, which is not installed"
        allowed = "an installed library that reads it"
        raise BadInput(path, "file", found, allowed, "pip install 'vpp-fmu[import]', or the same table as CSV") from error
