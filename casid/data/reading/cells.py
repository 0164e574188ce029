"""The cells of a table as numbers, and the time stamps as seconds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casid.data.reading.columns import ColumnSpec
from casid.data.reading.faults import Fault, Survey
from casid.data.reading.tables import Table
from casid.data.record import FloatArray
from casid.model.units import to_si

if TYPE_CHECKING:
    import pandas as pd


def numbers_of(
    table: Table,
    frame: pd.DataFrame,
    channel: str,
    spec: ColumnSpec,
    found: Survey,
    *,
    skip_text: bool = False,
) -> FloatArray | None:
    """Return a column as floats; None, with a fault noted, where it holds text."""
    import pandas as pd

    column = frame[spec.column]
    if pd.api.types.is_numeric_dtype(column.dtype):
        return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan))
    if column.dtype.kind in "mM":  # dates are times, not measurements
        column = column.astype(str)
    if table.decimal == ",":
        column = column.where(column.isna(), column.astype(str).str.replace(",", "."))
    numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    text = np.isnan(numbers) & column.notna().to_numpy()
    if skip_text and text.sum() == column.notna().sum():
        return None
    if not text.any():
        return np.asarray(numbers)
    first = int(np.argmax(text))
    found.faults.append(
        Fault(
            "text",
            f"{table.path.name}: column {spec.column!r} (channel {channel}) holds "
            f"{int(text.sum())} values that are no numbers, the first at {table.place(first)}: "
            f"{str(column.iloc[first])!r}.",
            "Correct the cells or leave them empty and read with mark_missing=True; for decimal "
            "commas use semicolons between columns.",
            spec.column,
        )
    )
    return None


def non_finite(
    table: Table,
    channel: str,
    spec: ColumnSpec,
    numbers: FloatArray,
    rows: NDArray[np.intp],
    times: FloatArray | None,
) -> Fault:
    """Samples that are not finite: how many, and where the first is."""
    bad = ~np.isfinite(numbers)
    first, nans = int(np.argmax(bad)), int(np.isnan(numbers).sum())
    at = f", t = {times[first]:g} s" if times is not None else ""
    return Fault(
        "non-finite",
        f"{table.path.name}: column {spec.column!r} (channel {channel}) holds {int(bad.sum())} "
        f"samples that are not finite ({nans} empty or NaN, {int(bad.sum()) - nans} Inf), the "
        f"first at {table.place(int(rows[first]))} (k = {first}{at}).",
        "Leave them out with a window, or mark them missing with mark_missing=True.",
        spec.column,
    )


def times_of(
    table: Table, frame: pd.DataFrame, clock: ColumnSpec, found: Survey
) -> FloatArray | None:
    """Return the time stamps [s]; dates become seconds since the first."""
    import pandas as pd

    column = frame[clock.column]
    if column.dtype.kind == "m" and column.notna().all():
        return np.asarray(column.dt.total_seconds(), dtype=np.float64)
    if not pd.api.types.is_numeric_dtype(column.dtype):
        stamps = pd.to_datetime(column, errors="coerce", format="ISO8601", utc=True)
        if stamps.notna().all():
            table.origin = stamps.iloc[0] if table.origin is None else table.origin
            return np.asarray((stamps - table.origin).dt.total_seconds(), dtype=np.float64)
    numbers = numbers_of(table, frame, "t", clock, found)
    if numbers is None:
        return None
    if not np.isfinite(numbers).all():
        rows = np.arange(numbers.size)
        fault = non_finite(table, "t", clock, numbers, rows, None)
        remedy = "Correct the time stamps, or leave the column out and give Ts."
        found.faults.append(replace(fault, remedy=remedy))
        return None
    return to_si(numbers, clock.unit or "s", "s")
