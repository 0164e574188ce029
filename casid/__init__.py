"""Constrained grey-box identification with CasADi.

The public names stand in `__init__.pyi`, each with its module, and are loaded at their first use,
so that `import casid` takes no longer than importing a small module.
"""

from typing import Any

import lazy_loader

from casid.errors import nearest

__version__ = "0.1.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    try:
        return _load(name)
    except AttributeError:
        hint = nearest(name, __all__)
        raise AttributeError(f"module 'casid' has no attribute {name!r}{hint}") from None
