"""How a file is written, where the file itself leaves it open."""

from __future__ import annotations

import codecs
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from casid.argument_types import methods_name_wrong_types
from casid.errors import DataError

Dates = Literal["dmy", "mdy", "ymd"]
ORDERS = ("dmy", "mdy", "ymd")


@methods_name_wrong_types()
@dataclass(frozen=True, slots=True)
class FileFormat:
    """How a file is written; what is not given is read from the file, and refused where it is open.

    Attributes
    ----------
    dates : order of day, month and year, "dmy", "mdy" or "ymd".
    time_zone : IANA name of the zone of local time stamps, as "Europe/Berlin"; the jumps of its
        summer time are then taken out.
    decimal : the decimal mark, "." or ","; the other one then separates thousands.
    encoding : of the text, as "cp850".
    table : the sheet, group, variable or member of the archive to read.
    missing : cells, as written, that stand for no value, as ("9999",).
    Ts : sample time [s] of a file without time stamps; its clock starts at 0.

    Raises
    ------
    DataError
        For a value that means nothing.
    """

    dates: Dates | None = None
    time_zone: str | None = None
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    table: str | None = None
    missing: tuple[str, ...] = ()
    Ts: float | None = None

    def updated(self, other: FileFormat | None) -> FileFormat:
        """The format with the fields that `other` sets."""
        return self if other is None else replace(self, **other.given)

    @property
    def given(self) -> dict[str, Any]:
        """The attributes that are given, by name."""
        all_of_them = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in all_of_them.items() if value not in (None, ())}

    @property
    def code(self) -> str:
        """The format as Python code for a problem file."""
        return f"casid.FileFormat({', '.join(f'{n}={v!r}' for n, v in self.given.items())})"

    def __post_init__(self) -> None:
        if self.dates is not None and self.dates not in ORDERS:
            raise DataError(f"dates = {self.dates!r}. Give dmy, mdy or ymd.")
        if self.decimal is not None and self.decimal not in (".", ","):
            raise DataError(f"decimal = {self.decimal!r}. Give a point or a comma.")
        if self.Ts is not None and not (np.isfinite(self.Ts) and self.Ts > 0):
            raise DataError(f"Ts = {self.Ts!r} s. Give a positive number of seconds.")
        if isinstance(self.missing, str):
            object.__setattr__(self, "missing", (self.missing,))
        if self.encoding is not None:
            try:
                codecs.lookup(self.encoding)
            except LookupError:
                raise DataError(
                    f"encoding {self.encoding!r} is unknown. Give for example utf-8, latin-1, "
                    "cp1252, cp850 or utf-16."
                ) from None
        if self.time_zone is not None:
            _require_zone(self.time_zone)


def _require_zone(name: str) -> None:
    import zoneinfo

    try:
        zoneinfo.ZoneInfo(name)
    except (zoneinfo.ZoneInfoNotFoundError, ValueError):
        raise DataError(
            f"time zone {name!r} is unknown. Give its IANA name, for example Europe/Berlin."
        ) from None
