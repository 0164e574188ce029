"""Records from files: sources, tables, columns, cells, clocks."""

from casid.reading.columns import ColumnSpec
from casid.reading.record_file import column_names
from casid.reading.sources import parse_window

__all__ = ["ColumnSpec", "column_names", "parse_window"]
