"""Records written to CSV and Parquet files, with their units, so that they read back the same."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from casid.arrays import FloatArray
from casid.data.files import refuse_existing
from casid.data.reading.columns import ColumnSpec
from casid.data.record import Record
from casid.errors import DataError
from casid.model.units import parse_unit
from casid.whole_files import write_bytes

SUFFIXES = (".csv", ".parquet")


def write_record(
    record: Record,
    path: str | Path,
    columns: Mapping[str, ColumnSpec] | None = None,
    *,
    time: str = "t",
    force: bool = False,
) -> Path:
    """Write a record as CSV, with a row of units below the names, or as Parquet with unit fields.

    Parameters
    ----------
    path : ends with .csv or .parquet.
    columns : channel -> column and its unit; every channel under its own name, in SI units, where
        not given.
    time : column of the time stamps [s].
    force : write over a file that exists.

    Returns
    -------
    Path
        Of the file. Samples that are missing are empty cells.

    Raises
    ------
    DataError
        For another ending, a file that exists, or a channel that the record lacks.
    """
    path = Path(path)
    require_new(path, force=force)
    chosen = {n: ColumnSpec(n, record.units[n]) for n in record} if columns is None else columns
    values, units = {time: record.t}, {time: "s"}
    for channel, spec in chosen.items():
        unit = spec.unit or record.units[channel]
        samples = np.where(record.is_missing(channel), np.nan, _in_unit(record[channel], unit))
        if spec.column in values:
            raise DataError(
                f"{path.name}: two channels would be written to column {spec.column!r}; give each "
                "a column of its own"
            )
        values[spec.column], units[spec.column] = samples, unit
    text = _parquet(values, units) if path.suffix.lower() == ".parquet" else _csv(values, units)
    return write_bytes(path, text)


def require_new(path: Path, *, force: bool = False) -> None:
    """Refuse a file that no record can be written to.

    Raises
    ------
    DataError
        For another ending than .csv and .parquet, or a file that exists.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise DataError(f"{path}: write records as .csv or .parquet; give the file such an ending")
    refuse_existing(path, force=force)


def _in_unit(values: FloatArray, unit: str) -> FloatArray:
    """SI values in `unit`, the nearest that reading converts back to the same number if there is.

    Reading computes `value * factor + offset`, and a quotient is off by a rounding now and then.
    """
    parsed = parse_unit(unit)
    if parsed.is_si:
        return values
    found = (values - parsed.offset) / parsed.factor
    for toward in (np.inf, -np.inf):
        other = np.nextafter(found, toward)
        better = np.abs(other * parsed.factor + parsed.offset - values) < np.abs(
            found * parsed.factor + parsed.offset - values
        )
        found = np.where(better, other, found)
    return np.asarray(found)


def _csv(values: Mapping[str, FloatArray], units: Mapping[str, str]) -> bytes:
    import csv
    import io

    import pandas as pd

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(values)
    writer.writerow(units.values())
    pd.DataFrame(dict(values)).to_csv(text, index=False, header=False, lineterminator="\n")
    return text.getvalue().encode()


def _parquet(values: Mapping[str, FloatArray], units: Mapping[str, str]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema(
        [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in units.items()]
    )
    table = pa.table({n: pa.array(v, from_pandas=True) for n, v in values.items()}, schema=schema)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return bytes(sink.getvalue())
