"""What the design of experiments calls of `casid.diagnosis`, which it may not import.

Like `casid.presentation`, an upward call: the module is imported by name when it is needed.
"""

from __future__ import annotations

import importlib
from typing import Any


def fewest_samples(unknowns: int) -> int:
    """The fewest samples from which a diagnosis judges a model with so many unknowns."""
    module = importlib.import_module("casid.diagnosis.evidence.records.sufficiency")
    found: int = module.fewest_samples(unknowns)
    return found


def named_causes(problem: Any, record: Any, *, seed: int = 0) -> tuple[str, ...]:
    """Causes that a diagnosis of one record names; see `casid.diagnosis.named_causes`."""
    module = importlib.import_module("casid.diagnosis.named_causes")
    found: tuple[str, ...] = module.named_causes(problem, record, seed=seed)
    return found
