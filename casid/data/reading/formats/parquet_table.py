"""Tables in Parquet files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from casid.data.reading.file_format import FileFormat
from casid.data.reading.tables import Table
from casid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd


class ParquetTable(Table):
    """A Parquet file; the `unit` or `units` in a field's metadata is its unit."""

    def __init__(self, path: Path, form: FileFormat) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        super().__init__(path, form)
        try:
            file = pq.ParquetFile(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise DataError(
                f"{path.name}: not a readable Parquet file ({str(error).splitlines()[0]}). "
                "Write it again, or give the measurement as CSV."
            ) from None
        if file.metadata.num_rows == 0:
            raise DataError(
                f"{path.name}: the file holds no rows. Export the measurement again, "
                "or give another file."
            )
        schema = file.schema_arrow
        units = [dict(field.metadata or {}) for field in schema]
        self.name_columns(
            [str(name) for name in schema.names],
            [(u.get(b"unit") or u.get(b"units") or b"").decode() for u in units],
        )

    def read(self, columns: list[str]) -> pd.DataFrame:
        """Read the named columns whole."""
        import pyarrow.parquet as pq

        frame: pd.DataFrame
        frame = pq.read_table(self.path, columns=columns).to_pandas(ignore_metadata=True)
        return frame

    def chunks(self, columns: list[str], size: int) -> Iterator[pd.DataFrame]:
        """Read the named columns `size` rows at a time."""
        import pyarrow.parquet as pq

        # Without these pyarrow reads ahead, all of the file; a row group may be all of it too.
        file = pq.ParquetFile(self.path, pre_buffer=False, buffer_size=1 << 20)
        for batch in file.iter_batches(batch_size=size, columns=columns):
            yield batch.to_pandas(ignore_metadata=True)
