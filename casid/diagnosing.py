"""How a design has simulated records diagnosed, to check what it predicts.

As with `casid.presentation`, the one step upward is taken by name when a record is diagnosed: no
module of the packages below may import `casid.diagnosis`.
"""

from __future__ import annotations

import importlib
from typing import Any


def named_causes(problem: Any, record: Any, *, seed: int = 0) -> tuple[str, ...]:
    """What a whole diagnosis of one record names, as `casid.diagnosis.named_causes` has it."""
    module = importlib.import_module("casid.diagnosis.named_causes")
    found: tuple[str, ...] = module.named_causes(problem, record, seed=seed)
    return found
