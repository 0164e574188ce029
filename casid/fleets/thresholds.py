"""Numbers that decide something about a fleet.

Each entry has its value, what it means, where it comes from and the test that pins it.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_SCREENING = "tests/fleets/test_screening.py"
_FINDINGS = "tests/fleets/test_findings.py"
_RECORDS = "tests/fleets/test_supervision.py"
_EFFECTS = "tests/fleets/test_random_effects.py"
_STUDY = "analysis.fleet"


@dataclass(frozen=True, slots=True)
class Screening:
    """Which records get the full search."""

    share: float = _is(
        0.5,
        "of the level: family-wise p of a record's scores from which it is not searched; "
        "Benjamini-Hochberg rejects such a record only where more than this share of all records "
        "is rejected",
        _STUDY,
    )
    tests: int = _is(
        3,
        "tests of a record, whose smallest p counts times as many: its scores, what effects gain, "
        "and lines",
        _SCREENING,
    )
    references: int = _is(
        5, "first records of an asset whose median fit is its reference", _SCREENING
    )
    steps: int = _is(
        6, "Gauss-Newton steps from an asset's reference before a solver is tried", _SCREENING
    )
    taken_out: int = _is(
        4, "effects that are taken out of a residual that disturbances might explain", _STUDY
    )
    alike: float = _is(
        0.9999,
        "cosine of two signatures from which what one explains stands for what the other does: "
        "gains differ by the square of their sine, 2e-4 of them",
        _SCREENING,
    )
    beside: int = _is(
        6,
        "lines on either side of one in a sea, of which its level is taken: a sea's spectrum may "
        "be as narrow, and fewer make the test's tail heavier",
        _STUDY,
    )
    settled: float = _is(
        0.3,
        "standard errors that the last of them may be long; a record that is further away is "
        "searched",
        _SCREENING,
    )


@dataclass(frozen=True, slots=True)
class Grouping:
    """When a cause in several records of an asset is one finding."""

    shown: float = _is(0.9, "probability that a record shows a cause that is there", _FINDINGS)
    by_chance: float = _is(
        0.01, "probability that a record shows a cause that is not there", _FINDINGS
    )
    drop: float = _is(
        1.92,
        "units of log-likelihood within which an onset or end is not excluded",
        _FINDINGS,
        "chi^2(1) / 2 at 95 %",
    )
    common: float = _is(
        0.5, "share of the assets that have a cause at one time, from which it is common", _FINDINGS
    )
    fewest: int = _is(3, "assets that have a cause in common, at least", _FINDINGS)


@dataclass(frozen=True, slots=True)
class Effects:
    """Parameters over assets and records."""

    fewest: int = _is(3, "estimates, at least", _EFFECTS)
    none: float = _is(
        1e-6, "of the squared spread of the values: a variance that is called zero", _EFFECTS
    )


@dataclass(frozen=True, slots=True)
class RecordBudget:
    """What one record may use."""

    seconds: float = _is(300.0, "where none is given", _RECORDS)
    memory: float = _is(2000.0, "megabytes beside what the libraries take", _RECORDS)
    loading: float = _is(
        120.0, "seconds in which its process has to load the libraries: of no record", _RECORDS
    )
    look: float = _is(
        1.0, "seconds between two looks of a process at whether the one above it is there", _RECORDS
    )
    grace: float = _is(
        1.2,
        "times the seconds after which its process is stopped: a search that looks at the clock "
        "has ended by itself until then",
        _RECORDS,
    )


SCREENING = Screening()
GROUPING = Grouping()
EFFECTS = Effects()
RECORD_BUDGET = RecordBudget()
