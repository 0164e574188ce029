"""The stages of an estimation: which records give which parameters, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from casid.estimation.moments.moment_settings import MomentSettings


@dataclass(frozen=True, slots=True)
class StageSpec:
    """One stage: which records, and which parameters they give.

    Attributes
    ----------
    free : parameters estimated here; those of earlier stages are taken from there.
    records : names of experiments; None: all.
    settings : None: those of the whole estimation.
    """

    free: Sequence[str]
    records: Sequence[str] | None = None
    settings: MomentSettings | None = None
