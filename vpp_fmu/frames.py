"""Frames of other libraries as tables. These libraries are optional: the extra `frames` installs them."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from vpp_fmu.errors import BadInput, ExtraMissing
from vpp_fmu.table import Table

EXTRA = "frames"


class Frame(Table):
    """A table that was not read from a file: its messages name cells by row, from 0."""

    def wrong(self, name: str, row: int, found: object, allowed: str, hint: str = "") -> BadInput:
        return BadInput(self.source, f"{name}, row {row}", found, allowed, hint)


def library(name: str) -> Any:
    """pandas, polars or xarray. ExtraMissing names the command that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ExtraMissing(f"{name}: found no library, expected one. Try: pip install {name}, or 'vpp-fmu[{EXTRA}]'") from error


def frame_table(frame: Any, source: str) -> Frame:
    """A frame's columns as a table, to be checked like that of a file. None and NaN become empty cells.

    A pandas frame may have `time` as its index. BadInput: no frame, or no rows.
    """
    columns = {str(name): np.asarray(column) for name, column in _columns(frame, source).items()}
    if not columns or not len(next(iter(columns.values()))):
        raise BadInput(source, "frame", "no rows", "a column `time` and at least one row")
    count = len(next(iter(columns.values())))
    for name, column in columns.items():
        if column.shape != (count,):
            raise BadInput(source, name, f"an array of shape {column.shape}", f"({count},), one value a row")
    return Frame(source, {name: _cells(column) for name, column in columns.items()}, np.arange(count))


def _columns(frame: Any, source: str) -> dict[Any, Any]:
    if hasattr(frame, "data_vars"):  # xarray
        return {name: frame[name].values for name in (*frame.coords, *frame.data_vars)}
    if hasattr(frame, "get_columns"):  # polars
        return {column.name: column.to_numpy() for column in frame.get_columns()}
    if hasattr(frame, "iloc"):  # pandas
        frame = frame.reset_index() if frame.index.name is not None else frame
        return {name: frame[name].to_numpy() for name in frame.columns}
    if isinstance(frame, Mapping):
        return dict(frame)
    raise BadInput(
        source, "frame", f"a {type(frame).__name__}", "a frame of pandas or polars, an xarray.Dataset, or arrays by name"
    )


def _cells(column: np.ndarray) -> np.ndarray:
    """float if all are finite numbers, else text as in a file."""
    if column.dtype.kind in "fiub":
        values = column.astype(float)
        if np.isfinite(values).all():
            return values
    return np.array(["" if str(cell) in ("None", "nan", "<NA>") else str(cell) for cell in column.tolist()], dtype=object)
