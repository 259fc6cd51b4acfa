"""Read a log from Parquet, MAT and HDF5.

A container may hold anything. The log is its largest set of vectors of equal length, named by their paths.
"""

import importlib
import io
import os
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

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
        vectors, units = read(path, data)
    except (OSError, RuntimeError, LookupError, TypeError, ValueError, OverflowError, MemoryError, zlib.error) as error:
        allowed = f"a whole {(name := kind.partition(' ')[0])} file"
        found = f"{name} that its library does not read ({str(error).splitlines()[0][:120]})"
        raise BadInput(path, "file", found, allowed) from error
    return _raw_table(path, vectors, units, kind)


Vectors = tuple[dict[str, np.ndarray], dict[str, str]]
"""Vectors and units by name."""


def _parquet(path: str | os.PathLike, data: bytes) -> Vectors:
    pa, parquet = _library(path, "pyarrow"), _library(path, "pyarrow.parquet")
    try:
        table = parquet.read_table(pa.BufferReader(data)).flatten()
        vectors = {name: _array(table[name].to_numpy()) for name in table.column_names}
    except pa.ArrowException as error:
        raise ValueError(str(error)) from error
    told = {field.name: field.metadata or {} for field in table.schema}
    return vectors, {n: unit.decode("utf-8", "replace") for n, m in told.items() if (unit := m.get(b"units", m.get(b"unit")))}


def _mat(path: str | os.PathLike, data: bytes) -> Vectors:
    from scipy.io import loadmat  # noqa: PLC0415 - slow to import, and few logs are MAT files
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    try:
        content = loadmat(io.BytesIO(data), squeeze_me=True, struct_as_record=True, chars_as_strings=True)
    except MatReadError as error:
        raise ValueError(str(error)) from error
    vectors = dict(_vectors({name: value for name, value in content.items() if not name.startswith("__")}))
    if not vectors and any(type(value).__name__ == "MatlabOpaque" or name == "None" for name, value in content.items()):
        found, allowed = "a table or timetable, which only MATLAB reads", "vectors, or a struct of them"
        raise BadInput(path, "file", found, allowed, "writetable in MATLAB, for a CSV")
    return vectors, {}


def _hdf5(path: str | os.PathLike, data: bytes) -> Vectors:
    h5py = _library(path, "h5py")
    matlab = data.startswith(b"MATLAB 7.3")
    found, units = {}, {}

    def visit(name, item):
        if not isinstance(item, h5py.Dataset) or name.startswith(("#refs#", "#subsystem#")):
            return
        if item.attrs.get("MATLAB_class", b"") in (b"char", b"cell", b"struct", b"table", b"function_handle"):
            return
        value = item[()]
        value = value.T if matlab and isinstance(value, np.ndarray) else value  # MATLAB's columns are HDF5's rows
        names = np.atleast_1d(item.attrs.get("columns", item.attrs.get("names", []))).tolist()
        unit = _text(item.attrs.get("units", item.attrs.get("unit", "")))
        for own, vector in _vectors({name.replace("/", "."): value}, [*map(_text, names)]):
            found[own] = vector
            if unit:
                units[own] = unit

    # HDF5 opens the file itself if it can: it then refuses a broken file, and reading through Python may crash.
    with h5py.File(io.BytesIO(data) if str(path).lower().endswith(".gz") else path, "r") as file:
        file.visititems(visit)
    return found, units


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else "" if value is None else str(value)


def _vectors(content: Mapping[str, object], names: Sequence[str] = ()) -> Iterator[tuple[str, np.ndarray]]:
    """(name, vector) of each vector, field of a struct, and column of a matrix; `names`: of the columns, if known."""
    for name, value in content.items():
        array = np.asarray(value)
        if array.dtype.names and array.ndim < 2:
            yield from ((f"{name}.{own}", v) for own, v in _vectors({f: array[f][()] for f in array.dtype.names}))
        elif array.dtype.kind not in "fiubUSOM":
            continue
        elif (flat := array.squeeze()).ndim == 1 and len(flat) > 1:
            yield name, _array(flat)
        elif flat.ndim == 2 and flat.dtype.kind in "fiu":
            table = flat if flat.shape[0] > flat.shape[1] else flat.T
            if table.shape[1] <= _MOST_COLUMNS:
                own = names if len(names) == table.shape[1] else [str(k) for k in range(1, table.shape[1] + 1)]
                yield from ((f"{name}.{column}", _array(table[:, k])) for k, column in enumerate(own))


def _array(values: np.ndarray) -> np.ndarray:
    """Convert to a type of RawTable: float, datetime64[ns] or text."""
    if values.dtype.kind in "fiub":
        return values.astype(float)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]")
    texts = [*map(_text, values.tolist())]
    try:
        return np.array([float(text) if text else np.nan for text in texts])
    except ValueError:
        return np.array(texts, dtype=object)


def _raw_table(path: str | os.PathLike, vectors: Mapping[str, np.ndarray], units: Mapping[str, str], kind: str) -> RawTable:
    """The vectors of the commonest length; of two such lengths, the longer."""
    lengths = Counter(len(vector) for vector in vectors.values())
    rows = max(lengths, key=lambda n: (lengths[n], n), default=0)
    if rows < 2:
        found = f"{kind} without a vector of two values or more"
        raise BadInput(path, "file", found, "vectors of one length, one a channel")
    columns = {name: vector for name, vector in vectors.items() if len(vector) == rows}
    dropped = {"vectors of another length": len(vectors) - len(columns)} if len(vectors) > len(columns) else {}
    if len({name.split(".")[0] for name in columns}) == 1 and all("." in name for name in columns):
        # one struct or group: its name is redundant
        columns, units = ({name.partition(".")[2]: x for name, x in of.items()} for of in (columns, units))
    known = {n: u for n, u in units.items() if n in columns}
    text = f"{kind}, {len(columns)} vectors of {rows}"
    return RawTable(str(path), columns, np.arange(1, rows + 1), known, text, {}, dropped, rows_are="row")


def _library(path: str | os.PathLike, name: str):
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.split(".", maxsplit=1)[0]
        found = f"a file that only {package} reads, which is not installed"
        raise BadInput(
            path, "file", found, "an installed library that reads it", "pip install 'vpp-fmu[import]', or the same table as CSV"
        ) from error
