"""The text of a file: unpacked, decoded, and its first and last lines."""

from __future__ import annotations

import gzip
import io
import itertools
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TextIO

from casid.data.reading.file_format import FileFormat
from casid.errors import DataError
from casid.model.quantities import count_text

HEAD = 500
"""Lines from which the layout of a table is read."""

_BLOCK = 1 << 20
_CONTROL = bytes(set(range(32)) - set(b"\t\n\v\f\r\x1a\x1b"))
_LAST_QUOTED = re.compile(r'(?:\A|[;,\t|]) *"[^"]*\Z')
_MOST_PARTS = 6  # lines of one cell in quotes; more of them: a quote that stands alone
_COMMENT = re.compile(rb"(?:^|[\r\n])[ \t]*(?:#(?!N/A|NV|NA\b|VALUE|WERT|DIV|REF)|%|//)")
COMMENT = re.compile(r"[ \t]*(?:#(?!N/A|NV|NA\b|VALUE|WERT|DIV|REF)|%|//)")
"""The beginning of a line of comment; #N/A and its like are cells."""


class TextSource:
    """A text file, plain, in gzip or in a zip archive.

    Attributes
    ----------
    encoding : of what `open` and `handle` read.
    has_comments : whether a line of comment stands anywhere.
    remarks : what was done to read it.
    """

    def __init__(self, path: Path, form: FileFormat) -> None:
        self.path = path
        self.remarks: list[str] = []
        self._content = unpacked(path, form, self.remarks)
        self.encoding, self.has_comments = "utf-8-sig", False
        self._decode(form)

    def _decode(self, form: FileFormat) -> None:
        with self._bytes() as file:
            start = file.read(_BLOCK)
        if not start:
            raise DataError(
                f"{self.path.name}: the file is empty. Export the measurement again, "
                "or give another file."
            )
        wide = form.encoding or _wide(start)
        if wide and wide.lower().replace("_", "-").startswith(("utf-16", "utf-32")):
            self._transcode(wide)
        elif b"\0" in start:
            raise DataError(
                f"{self.path.name}: not a text file (it holds zero bytes). "
                "Give a CSV in UTF-8, or a Parquet file named .parquet."
            )
        elif len(start.translate(None, _CONTROL)) < 0.95 * len(start):
            raise DataError(
                f"{self.path.name}: not a text file (it is full of control characters). "
                "Give a CSV in UTF-8, or a Parquet file named .parquet."
            )
        elif form.encoding is not None:
            self.encoding = form.encoding
        self._scan(chosen=form.encoding is not None)

    def _transcode(self, encoding: str) -> None:
        """Keep the text of an encoding of several bytes a character as UTF-8."""
        with self._bytes() as file:
            content = file.read()
        try:
            self._content = content.decode(encoding).lstrip("\ufeff").encode()
        except UnicodeError as error:
            raise DataError(
                f"{self.path.name}: not text in {encoding} ({error.reason}). "  # type: ignore[attr-defined]
                "Export it again as UTF-8, or name its encoding (--encoding)."
            ) from None
        self.remarks.append(f"text in {encoding}")

    def _scan(self, *, chosen: bool) -> None:
        """Look every byte over once: is it UTF-8, and are there comments?"""
        plain, edge = True, b"\n"
        with self._bytes() as file:
            for block in iter(lambda: file.read(_BLOCK), b""):
                plain = plain and block.isascii()
                self.has_comments = self.has_comments or bool(_COMMENT.search(edge + block))
                edge = block[-80:].rpartition(b"\n")[2] if b"\n" in block[-80:] else b"x"
                edge = b"\n" + edge if edge != b"x" else edge
        if chosen or plain:
            return
        for encoding in ("utf-8-sig", "cp1252", "latin-1"):
            try:
                with io.TextIOWrapper(self._bytes(), encoding=encoding) as text:
                    while text.read(_BLOCK):
                        pass
            except UnicodeDecodeError:
                continue
            self.encoding = encoding
            break
        if self.encoding != "utf-8-sig":
            self.remarks.append(f"not UTF-8: text read as {self.encoding} (--encoding)")

    def _bytes(self) -> IO[bytes]:
        return self.path.open("rb") if self._content is None else io.BytesIO(self._content)

    def open(self) -> TextIO:
        """The decoded text, line ends as `csv` wants them."""
        return io.TextIOWrapper(self._bytes(), encoding=self.encoding, newline="")

    def handle(self) -> Path | IO[bytes]:
        """The path, or the unpacked bytes, for pandas."""
        return self.path if self._content is None else self._bytes()

    def lines(self) -> Iterator[str]:
        """Every line, in order, without its end; line breaks in quotes end none."""
        with io.TextIOWrapper(self._bytes(), encoding=self.encoding, newline=None) as text:
            for line in text:
                yield from _closed(line.rstrip("\n"), text)

    def head(self) -> list[str]:
        """The first lines."""
        return list(itertools.islice(self.lines(), HEAD))

    def tail(self) -> list[str]:
        """The last lines, the first of them perhaps cut."""
        with self._bytes() as file:
            end = file.seek(0, io.SEEK_END)
            file.seek(max(0, end - (1 << 16)))
            content = file.read()
        text = content.decode(self.encoding, errors="replace")
        return text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n")


def _closed(line: str, following: Iterator[str]) -> Iterator[str]:
    """A line with those that follow up to the end of a cell in quotes that it leaves open."""
    parts = [line]
    while _leaves_open("\n".join(parts)) and len(parts) < _MOST_PARTS:
        further = next(following, None)
        if further is None:
            break
        parts.append(further.rstrip("\n"))
    whole = "\n".join(parts)
    yield from parts if _leaves_open(whole) else [whole]


def _leaves_open(text: str) -> bool:
    """Whether the last cell begins with a quote and does not end with one."""
    return text.count('"') % 2 == 1 and _LAST_QUOTED.search(text) is not None


def unpacked(path: Path, form: FileFormat, remarks: list[str]) -> bytes | None:
    """The content of a packed file; None where it is not packed."""
    with path.open("rb") as file:
        magic = file.read(4)
    try:
        if magic[:2] == b"\x1f\x8b":
            remarks.append("unpacked by gzip")
            return gzip.decompress(path.read_bytes())
        if magic != b"PK\x03\x04":
            return None
        with zipfile.ZipFile(path) as archive:
            member = _member(path, archive, form)
            remarks.append(f"unpacked {member} of the archive")
            return archive.read(member)
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as error:
        raise DataError(
            f"{path.name}: the archive cannot be unpacked ({error}). "
            "Pack or send it again, without a password, or give the file inside."
        ) from None


def _member(path: Path, archive: zipfile.ZipFile, form: FileFormat) -> str:
    names = [
        i.filename
        for i in archive.infolist()
        if not i.is_dir() and not i.filename.startswith(("__MACOSX/", "."))
    ]
    if form.table is not None:
        if form.table in names:
            return form.table
        raise DataError(
            f"{path.name}: the archive has no member {form.table!r}. It holds {', '.join(names)}; "
            "name one of them (--table)."
        )
    if len(names) != 1:
        raise DataError(
            f"{path.name}: the archive holds {count_text(len(names), 'file')}"
            f"{': ' if names else ''}{', '.join(names[:8])}. "
            "Choose one with --table NAME (table='NAME'), or unpack it."
        )
    return names[0]


def _wide(start: bytes) -> str | None:
    """UTF-16 or UTF-32, by their marks, or by every other byte being zero."""
    if start.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        return "utf-32"
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    few = start[:2000]
    if len(few) >= 8 and b"\0" in few:
        even, odd = few[::2].count(0) / len(few[::2]), few[1::2].count(0) / len(few[1::2])
        if odd > 0.8 and even < 0.05:
            return "utf-16-le"
        if even > 0.8 and odd < 0.05:
            return "utf-16-be"
    return None
