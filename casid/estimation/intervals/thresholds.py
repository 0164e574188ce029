"""Every number that decides what kind of interval an estimate has, and how it is sought."""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_CHOICE = "tests/estimation/intervals/test_choice.py"
_PROFILE = "tests/estimation/intervals/test_profile.py"
_BOOTSTRAP = "tests/estimation/intervals/test_bootstrap.py"


@dataclass(frozen=True, slots=True)
class QuadraticTest:
    """Whether a criterion is the parabola that a normal interval takes it for."""

    at: float = _is(
        2.0,
        "standard errors to either side at which it is evaluated: a parabola rises by the square",
        _CHOICE,
    )
    half_length: float = _is(
        0.1,
        "share by which the root of the rise may differ from that of a parabola, on either side: "
        "half of a 95 % interval is then wrong by so much, and its tail between 1.4 and 3.9 %",
        _CHOICE,
    )


@dataclass(frozen=True, slots=True)
class ProfileSearch:
    """How the ends of a profile interval are sought."""

    level: float = _is(0.95, "of the intervals of an estimate", _PROFILE, "convention")
    converged: float = _is(
        0.005, "of the root of the rise at an end: so much of the half length", _PROFILE
    )
    refits: int = _is(16, "refits for one end, at most", _PROFILE)
    nearest: float = _is(
        0.05,
        "standard errors from the estimate, within which the criterion does not leap: refits that "
        "do there ended short of their minima",
        _PROFILE,
    )
    leap: float = _is(
        0.5,
        "of the root of the rise at an end: more than that between the last two refits is a leap. "
        "Of an unknown with hardly an upper limit the standard error says nothing of the lower one",
        _PROFILE,
    )
    farthest_of_root: float = _is(
        6.0,
        "standard errors from a root of equations, beyond which the bias of the inputs' noise is "
        "another one than at it: three times the half of a normal interval",
        _CHOICE,
    )
    difference: float = _is(
        0.2,
        "standard errors over which the curvature of a criterion at a root is differentiated: what "
        "the third and fourth derivatives give stays a hundredth of what they give at the ends",
        _PROFILE,
    )
    seconds: float = _is(
        30.0, "that profiles may take which neither a request nor a budget stands behind", _PROFILE
    )
    of_estimate: float = _is(
        2.0, "times as long as the estimate took, where that is more than these seconds", _PROFILE
    )
    growth: float = _is(3.0, "times as far for the next value outside, at most", _PROFILE)


@dataclass(frozen=True, slots=True)
class BootstrapRuns:
    """How many records are simulated."""

    runs: int = _is(
        400,
        "records: the tail of 2.5 % is then known to 0.8 %",
        _BOOTSTRAP,
        "binomial standard error",
    )
    least: int = _is(100, "refits that ended, without which there is no interval", _BOOTSTRAP)


QUADRATIC_TEST = QuadraticTest()
PROFILE_SEARCH = ProfileSearch()
BOOTSTRAP_RUNS = BootstrapRuns()
