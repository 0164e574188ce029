"""Numbers that decide something about a fit by simulation error.

Each entry has its value, what it means, where it comes from and the test that pins it.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import entries
from casid.threshold_table import threshold as _is

_AGREEMENT = "tests/estimation/simulation/test_record_agreement.py"


@dataclass(frozen=True, slots=True)
class RecordAgreement:
    """Whether records that share a parameter agree on it."""

    level: float = _is(
        1e-3, "level of the test, over all shared parameters: below it records disagree", _AGREEMENT
    )
    ratio: float = _is(
        4.0,
        "chi^2 over its degrees of freedom, at least: errors twice as large as they are given",
        _AGREEMENT,
    )


RECORD_AGREEMENT = RecordAgreement()

GROUPS = (RECORD_AGREEMENT,)

TABLE = entries(*GROUPS)
"""All of them."""
