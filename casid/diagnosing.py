"""What a design knows of the diagnosis of its record, and how it has simulated records diagnosed.

As with `casid.presentation`, the one step upward is taken by name when it is needed: no module of
the packages below may import `casid.diagnosis`.
"""

from __future__ import annotations

import importlib
from typing import Any


def fewest_samples(unknowns: int) -> int:
    """Samples without which a diagnosis judges no model with so many unknowns."""
    module = importlib.import_module("casid.diagnosis.evidence.sufficiency")
    found: int = module.fewest_samples(unknowns)
    return found


def named_causes(problem: Any, record: Any, *, seed: int = 0) -> tuple[str, ...]:
    """What a whole diagnosis of one record names, as `casid.diagnosis.named_causes` has it."""
    module = importlib.import_module("casid.diagnosis.named_causes")
    found: tuple[str, ...] = module.named_causes(problem, record, seed=seed)
    return found
