"""Numbers that decide something about a fit by simulation error.

Each entry has its value, what it means, where it comes from and the test that pins it.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_BUDGET = "tests/identification/test_budget.py"
_FIT = "tests/estimation/simulation/test_fit.py"
_AGREEMENT = "tests/estimation/simulation/test_record_agreement.py"
_FILTER = "tests/estimation/prediction_error/test_extended_likelihood.py"
_TANGENTS = "tests/estimation/simulation/test_tangents.py"
_UNSTABLE = "tests/identification/test_unstable.py"
_SINGULAR = "tests/identification/test_singular_plant.py"
_WINDOWS = "tests/diagnosis/evidence/records/test_unstable_records.py"
_LOOP = "tests/estimation/test_feedback.py"
_ROUNDING = "tests/estimation/simulation/test_rounding.py"
_FORESEEN = "tests/estimation/simulation/input_noise/test_foreseen_noise.py"
_GROWING = "tests/estimation/simulation/input_noise/test_growing_noise.py"
_GAPS = "tests/estimation/simulation/test_missing_samples.py"


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
    samples: int = _is(
        5,
        "samples a record has for each of its unknowns, at least: with fewer its residual is too "
        "small to give their errors, which come out below half of what they are",
        _AGREEMENT,
    )


@dataclass(frozen=True, slots=True)
class FitBudget:
    """The time that an estimate may take where none is given; see `budget.py`."""

    seconds: float = _is(
        120.0, "whatever the record: compiling, the check of the rank and the page", _BUDGET
    )
    per_value: float = _is(
        1e-3,
        "seconds more for each sample and unknown: a thousand passes over the record at a "
        "microsecond each, as without a compiler, where an ordinary fit takes fewer than a hundred",
        _BUDGET,
    )
    longest: float = _is(3600.0, "seconds: a fit that takes longer is one to be requested", _BUDGET)


@dataclass(frozen=True, slots=True)
class Steps:
    """How long the steps of the integration may be."""

    at_start: float = _is(
        0.1,
        "of the residual, by which halving the step may move the simulation before a fit: too long "
        "a step makes another model of it, whose optimum may lie far away",
        _FIT,
    )
    at_end: float = _is(0.01, "the same after a fit", _FIT)
    filter_at_start: float = _is(
        0.01,
        "of the number of samples, by which halving the step of a Kalman filter may move the "
        "logarithm of the likelihood before a fit",
        _FILTER,
    )
    filter_at_end: float = _is(
        0.05, "standard errors, by which the same may move the unknowns after a fit", _FILTER
    )
    many: int = _is(
        6, "steps a sample, at least, where two are tried first: they and one cost three", _FIT
    )
    easy: float = _is(
        1e-10,
        "of each state, to which one step of a sample and two of half of it agree where the two "
        "are taken: the two are then exact to a fifteenth of it (Richardson)",
        _FIT,
    )
    most: int = _is(16, "steps a sample, beyond which only what diverges is refined", _FIT)
    last: int = _is(64, "steps a sample, at most", _FIT)


@dataclass(frozen=True, slots=True)
class ErrorWeights:
    """Outputs weighed by the errors that they leave."""

    rounds: int = _is(5, "of weighing and fitting in turn, at most", _FIT)
    settled: float = _is(0.05, "relative change of the weights below which they are kept", _FIT)
    rounding: float = _is(
        1e-6, "of an output's spread: errors below it are those of the simulation", _FIT
    )


@dataclass(frozen=True, slots=True)
class InputGaps:
    """Which gaps of an input are filled as it is held, and which cut a record."""

    longest: int = _is(
        5, "usual intervals of the input that a gap may be long and still be filled", _GAPS
    )
    usual: float = _is(
        0.9,
        "share of the intervals of an input's own clock that are no longer than the usual one: of "
        "an even clock the interval itself, though a few samples be missing",
        _GAPS,
    )
    at_rest: float = _is(
        0.25,
        "of a command's rows at its steps: so many without a step or a sample a file of events has",
        "tests/estimation/simulation/test_files_of_events.py",
    )
    shortest: int = _is(
        50, "samples of a stretch between two long gaps, at least: it has states to start", _GAPS
    )
    error: float = _is(
        1e-3,
        "rms error that filling may leave in an input, over the input's standard deviation, above "
        "which an estimate warns of it: no gain is biased by more, and few are known as exactly",
        _GAPS,
    )


@dataclass(frozen=True, slots=True)
class Instability:
    """When a model is cut into shooting segments without request; see `instability.py`."""

    growth: float = _is(
        7.0,
        "exponent of the growth of an error over the record, at least: a thousandth of the initial "
        "state is then as large as the motion",
        _UNSTABLE,
    )
    per_segment: float = _is(3.0, "the same over a segment: 20 times", _UNSTABLE)
    per_window: float = _is(
        5.0,
        "the same over a window of a diagnosis: a state wrong by a hundredth ends as wrong as the "
        "motion is large; no constraint ties windows, so that shorter ones leave fewer samples "
        "for each of their states",
        _WINDOWS,
    )
    followed: int = _is(
        4,
        "times the window over which a fit follows a record, that windows are long at most: what "
        "is missing has grown by then to what makes longer simulations leave the record",
        _WINDOWS,
    )
    instants: int = _is(
        50, "of a record at which the growth is looked at: as many as windows are usual", _WINDOWS
    )
    departs: float = _is(
        3.0,
        "times the error of the fitted part that a simulation into the held-out part errs, where "
        "the model is unstable: a missing effect alone acts in both parts",
        _WINDOWS,
    )
    samples: int = _is(10, "of a segment, at least", _UNSTABLE)
    most: int = _is(200, "segments a record: each has initial states to estimate", _UNSTABLE)


@dataclass(frozen=True, slots=True)
class MeasuredStates:
    """How outputs are solved for the states that segments begin in; see `measured_states.py`."""

    steps: int = _is(20, "of Gauss-Newton, at most, for outputs that are not linear", _SINGULAR)
    settled: float = _is(
        1e-6, "relative size below which a step is none, and a direction undetermined", _SINGULAR
    )


@dataclass(frozen=True, slots=True)
class Tangents:
    """When the tangent of a simulation is none; see `tangents.py`."""

    ratio: float = _is(
        10.0,
        "times the change of a simulation, by which its tangent may exceed it: a curved "
        "simulation stays far within it over so small a step, a chaotic one is beyond it by many "
        "powers of ten",
        _TANGENTS,
    )


@dataclass(frozen=True, slots=True)
class InputAnswers:
    """When an input is said to follow what disturbs the system; see `input_feedback.py`."""

    level: float = _is(1e-4, "level of the test, over all lags: a warning has to be rare", _LOOP)
    lags: int = _is(20, "samples after which a controller has answered", _LOOP)
    steps: float = _is(
        3.0, "standard deviations that an innovation counts, at most: steps hide answers", _LOOP
    )
    coloured: int = _is(
        6,
        "of 20 autocorrelations of the residual outside the 95 % band, beyond which it is no white "
        "noise: of white noise one in 30 000 has more, and white noise is no bias in a loop",
        _LOOP,
    )


@dataclass(frozen=True, slots=True)
class Readings:
    """When a measured input that repeats its readings is one that is rounded; see `rounding.py`."""

    repeated: float = _is(0.5, "of the samples, above which a channel is no noisy one", _ROUNDING)
    levels: int = _is(10, "different readings, at least: a command has a few levels", _ROUNDING)
    single: float = _is(
        0.25,
        "of its changes that are by a single step which no equal one precedes or follows, at "
        "least: a command that jumps among ten levels at random has a fifth, one that moves there "
        "at a constant rate hardly any",
        _ROUNDING,
    )


@dataclass(frozen=True, slots=True)
class Foreseen:
    """How an input is foretold, to bound its noise."""

    lags: int = _is(
        6,
        "samples back: a controller with a derivative and its filter looks back three",
        _FORESEEN,
    )
    samples: int = _is(
        10, "rows for each coefficient, at least: its error then is a twentieth", _FORESEEN
    )
    rounds: int = _is(10, "fits, each without what lies far off at the one before", _FORESEEN)
    far: float = _is(4.0, "standard deviations: further off are steps of a reference", _FORESEEN)
    rank: float = _is(1e-10, "singular values that count, relative to the largest", _FORESEEN)
    same: float = _is(
        1e-8,
        "of an output's power that its input does not have: less is the same channel",
        _FORESEEN,
    )
    kept: int = _is(100, "bounds that are kept: every model of a record has the same", _FORESEEN)


@dataclass(frozen=True, slots=True)
class GrowingNoise:
    """Noise that grows in proportion to what a sensor reads."""

    alpha: float = _is(
        1e-3,
        "level of the test, of one output: weights that follow noise of one size by chance lose a "
        "little exactness, and no more",
        _GROWING,
    )
    inner: float = _is(
        0.1,
        "the same without the few samples that lie furthest off, as outliers do, and of "
        "differences taken twice, which a smooth misfit does not outlive: both keep most of noise",
        _GROWING,
    )
    few: float = _is(0.05, "share of samples that may be outliers", _GROWING)
    along: float = _is(
        1.94,
        "squared autocorrelations of differences from neighbours of white noise, their sum: 1, "
        "(2/3)^2 and (1/6)^2 on both sides; so many of them count as one",
        _GROWING,
    )
    samples: int = _is(
        8, "differences from neighbours, at least: fewer do not show a size", _GROWING
    )
    ratio: float = _is(
        2.0,
        "size of the noise at large readings (90 % are smaller) over that at small ones (10 %), at "
        "least: of half the samples each, equal weights lose (1 + r^2)^2 / (4 r^2) in variance",
        _GROWING,
    )
    lowest: float = _is(
        1e-3,
        "of the RMS reading, the lowest level below which noise grows no more: a sensor that "
        "resolves less has no such range",
        _GROWING,
    )
    outlier: float = _is(
        4.5,
        "standard deviations from its neighbours at which a sample is none of noise that grows "
        "either: one of 150 000 lies that far off by chance",
        _GROWING,
    )
    most: int = _is(
        4000, "differences that count in a likelihood: more show what is seen already", _GROWING
    )
    as_likely: float = _is(
        0.5, "log-likelihood by which levels are as likely: one standard error", _GROWING
    )
    far: float = _is(
        3.0,
        "times the median of three readings, or its inverse, at most: where the simulation is "
        "further off it errs, and the readings say how large they are",
        _GROWING,
    )


@dataclass(frozen=True, slots=True)
class InitialStates:
    """When the initial state of a record that was not fitted is near enough to its minimum."""

    enough: float = _is(
        1e-7,
        "of its squared error, less than which a step would lower it: what is held out is judged "
        "by a hundredth of that error",
        "tests/estimation/simulation/test_initial_state.py",
    )


RECORD_AGREEMENT = RecordAgreement()
FIT_BUDGET = FitBudget()
STEPS = Steps()
ERROR_WEIGHTS = ErrorWeights()
INPUT_GAPS = InputGaps()
INSTABILITY = Instability()
MEASURED_STATES = MeasuredStates()
TANGENTS = Tangents()
INPUT_ANSWERS = InputAnswers()
READINGS = Readings()
FORESEEN = Foreseen()
GROWING_NOISE = GrowingNoise()
INITIAL_STATES = InitialStates()
