"""A record as Parquet: the same columns, exact to the bit, with the unit of each as metadata of its field.

`vpp import csv` reads it again, units and all; so do pandas, polars, DuckDB and MATLAB.
"""

import io

from vpp_fmu.errors import BadInput
from vpp_fmu.record import QUANTITIES, Record

UNITS = {"time": "s", "omega_wanted": "rpm", "beta_wanted": "deg", "thrust_std": "N"} | {
    n: s.unit for n, s in QUANTITIES.items()
}
"""Unit of a column by its name; others are counts, in the unit 1."""


def check_parquet() -> None:
    """BadInput if the library that writes Parquet is missing; call it before a measurement."""
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415  (an extra)
    except ImportError as error:
        found = "parquet, which only pyarrow writes, and it is not installed"
        raise BadInput(
            "command line", "--records", found, "an installed library that writes Parquet", "pip install 'vpp-fmu[import]'"
        ) from error


def as_parquet(record: Record) -> bytes:
    """The content of a Parquet file. BadInput if pyarrow is missing."""
    check_parquet()
    import pyarrow as pa  # noqa: PLC0415
    from pyarrow import parquet  # noqa: PLC0415

    kinds = {name: pa.array(column).type for name, column in record.columns.items()}
    fields = [pa.field(name, kind, metadata={"unit": UNITS.get(name, "1")}) for name, kind in kinds.items()]
    packed = io.BytesIO()
    parquet.write_table(pa.table(dict(record.columns), schema=pa.schema(fields)), packed)
    return packed.getvalue()
