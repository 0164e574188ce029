"""The Python module behind a problem file."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from casid.errors import ModelError


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
