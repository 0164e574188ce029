"""The Python module behind a problem file."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from casid.errors import DataError, ModelError, nearest


def problem_file(path: str | Path) -> Path:
    """The path of a problem file, which is there and is Python.

    Raises
    ------
    DataError
        If the file does not exist or is not Python.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise DataError(
            f"problem file {path} is no file; give a Python file that defines `problem`"
        )
    if not path.is_file():
        folder = path.parent if path.parent.is_dir() else Path()
        there = [p.name for p in folder.glob("*.py")]
        hint = nearest(path.name, there) if there else ""
        raise DataError(f"problem file {path} does not exist{hint}")
    if path.suffix != ".py":
        raise DataError(
            f"{path} is not a problem file: a problem is a Python file that defines `problem`; "
            "give data files after it"
        )
    return path


@contextmanager
def importing(path: Path) -> Iterator[ModuleType]:
    """Run a Python file as a module, and let the caller run what the module defines.

    The file's own folder is on the module path meanwhile.

    Raises
    ------
    ModelError
        If the file, or what the caller runs of it, fails; the message names the line.
    """
    name = f"casid_problem_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    folder_text = str(path.resolve().parent)
    sys.path.insert(0, folder_text)
    try:
        spec.loader.exec_module(module)
        yield module
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # whatever a file raises is the file's
        raise ModelError(
            f"problem file {path} fails to load at {_line(error, path)}: "
            f"{type(error).__name__}: {error}"
        ) from error
    finally:
        sys.path.remove(folder_text)


def _line(error: BaseException, path: Path) -> str:
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"line {error.lineno}"
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).resolve() == path.resolve()
    ]
    return f"line {lines[-1]}" if lines else "an unknown line"
