"""Results that can be saved."""

from __future__ import annotations

from pathlib import Path


class Saved:
    """A result with a method `save`; `casid.load` reads what it writes."""

    __slots__ = ()

    def save(self, path: str | Path) -> Path:
        """Write this result to a file, or to a folder where `path` has no ending; the path.

        JSON, Parquet for long arrays, CasADi's own serialisation for the equations, and a version;
        `casid.load(path)` reads it again. ``run.casid`` makes one zip file.

        Raises
        ------
        DataError
            If the result holds a function of the user's own, or the path cannot be written.
        """
        from casid.saving.archive import save

        return save(self, path)
