"""Numbers that decide something about the design of experiments.

Each entry has its value, what it means, where it comes from and the test that pins it.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_TESTS = "tests/experiment_design"
_LIMITS = f"{_TESTS}/test_limits.py"
_DESIGN = f"{_TESTS}/test_design.py"
_INFORMATION = f"{_TESTS}/test_information.py"
_SHORTEST = f"{_TESTS}/test_shortest_record.py"
_PUBLISHED = f"{_TESTS}/test_published_designs.py"


@dataclass(frozen=True, slots=True)
class Designing:
    """How an input is searched, and what counts as enough."""

    rivals: int = _is(3, "tied causes, the likeliest, that one experiment separates", _SHORTEST)
    intervals: int = _is(100, "intervals of an input where no number is given", _DESIGN)
    candidates: int = _is(60, "standard inputs that are drawn to begin from", _DESIGN)
    usual: int = _is(8, "standard inputs that say how large signals are", _DESIGN)
    starts: int = _is(
        2,
        "of them, the best of different kinds, from which the program is solved, at least",
        _DESIGN,
    )
    seconds: float = _is(45.0, "of the processor, for solving, where no time is given", _DESIGN)
    judged: int = _is(
        6, "standard inputs, the best by linearised rivals, to which rivals are fitted", _DESIGN
    )
    iterations: int = _is(100, "of the solver from one start, at most", _DESIGN)
    accuracy: float = _is(
        0.02, "relative error of the criterion on the grid of the program, at most", _DESIGN
    )
    finest: int = _is(32, "Runge-Kutta steps an interval of the program, at most", _DESIGN)
    refitted: float = _is(
        0.9, "of the energy predicted, below which a rival's fit is the new point", _DESIGN
    )
    power: float = _is(0.95, "probability of the right answer that is enough", _DESIGN)
    relative_error: float = _is(
        0.1,
        "standard error over value, up to which a parameter is identifiable in practice",
        _DESIGN,
    )
    equal: float = _is(
        0.005,
        "of the information, more than a standard input has, that three digits do not show",
        _DESIGN,
    )
    nothing: float = _is(
        1e-9, "of a misfit, that is left where a rival imitates a cause in every input", _DESIGN
    )


@dataclass(frozen=True, slots=True)
class Starting:
    """From how many inputs the program is solved where no number is given."""

    variables: int = _is(
        200,
        "decision variables of all programs together, up to which there are more than the least",
        _PUBLISHED,
    )
    most: int = _is(12, "inputs, at most", _PUBLISHED)


@dataclass(frozen=True, slots=True)
class Keeping:
    """How limits are kept between samples."""

    finer: int = _is(10, "times the sampling rate, at which limits are checked", _LIMITS)
    rounds: int = _is(4, "times that margins are widened, or rivals fitted anew", _LIMITS)
    inset: float = _is(1e-3, "of the width of a limit, kept off it from the beginning", _LIMITS)
    shrunk: float = _is(
        0.97,
        "of an input, to which it may be scaled down to keep the limits between samples",
        _LIMITS,
    )
    wider: float = _is(1.5, "times a violation, by which a margin is widened", _LIMITS)
    between: float = _is(
        0.02,
        "of a limit's width, by which it may be exceeded between steps of the program",
        _LIMITS,
    )
    widest: float = _is(0.4, "of a limit's width, that a margin is at most", _LIMITS)

    halvings: int = _is(8, "of the interval in which the largest amplitude lies", _LIMITS)
    room: float = _is(
        0.25, "of a limit's width, that an input keeps off it at most where rest does not", _LIMITS
    )
    levels: int = _is(
        9, "constant inputs that are tried where rest does not keep the limits", _LIMITS
    )
    touched: float = _is(
        1e-3, "of a limit's width, up to which it counts as touched and not exceeded", _LIMITS
    )
    feasible: int = _is(
        4, "Runge-Kutta steps an interval, where only the limits are in question", _LIMITS
    )


@dataclass(frozen=True, slots=True)
class Numerics:
    """How information is scored."""

    eigenvalue: int = _is(
        8,
        "power of the covariance whose trace stands for its largest eigenvalue",
        _PUBLISHED,
        "Kiefer 1974, phi_p",
    )
    ridge: float = _is(
        1e-12, "of each column's own information, which keeps a factor regular", _INFORMATION
    )
    rounding: float = _is(
        0.01, "of the noise, by which finer integration may still move an output", _DESIGN
    )


@dataclass(frozen=True, slots=True)
class Lengths:
    """How the shortest record is sought."""

    exact: float = _is(0.05, "relative error of the shortest duration", _SHORTEST)
    designs: int = _is(9, "designs of different durations, at most", _SHORTEST)
    inside: float = _is(
        0.15, "of what encloses the duration, kept off both its ends by the next", _SHORTEST
    )
    samples: int = _is(1_000_000, "of a record, at most", _LIMITS)
    share: float = _is(
        0.4, "of the time for one design, for each that begins at another", _SHORTEST
    )


@dataclass(frozen=True, slots=True)
class Checking:
    """How a prediction is compared with simulated records."""

    level: float = _is(
        0.01, "of the binomial test, below which counts contradict the prediction", _DESIGN
    )
    reported: int = _is(25, "diagnoses between two lines of progress", _DESIGN)


@dataclass(frozen=True, slots=True)
class Stability:
    """Which systems an input can be planned for in advance."""

    growth: float = _is(
        1e3,
        "times that a small deviation may grow within the record: one of a thousandth of a limit's "
        "width fills it",
        _LIMITS,
    )
    shown: float = _is(1e6, "times, above which a message names no number but a million", _LIMITS)


DESIGN = Designing()
NUMERICS = Numerics()
STARTING = Starting()
DURATION = Lengths()
KEEPING = Keeping()
STABILITY = Stability()
CHECKING = Checking()
