"""Every number that decides how noise is treated: on measured inputs, or of missing samples."""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_TEST = "tests/estimation/errors_in_variables/test_input_noise.py"
_VARYING = "tests/estimation/noise/test_varying_likelihood.py"
_STATED = "tests/identification/test_stated_noise.py"
_FAR = "tests/estimation/errors_in_variables/test_total_least_squares.py"


@dataclass(frozen=True, slots=True)
class Removal:
    """When the bias of input noise is removed, and how its root is sought."""

    negligible: float = _is(
        0.1, "standard errors of any unknown, that input noise may move it by at most", _TEST
    )
    adds: float = _is(
        0.1, "share of its variance that input noise may add to any unknown at most", _TEST
    )
    above: float = _is(
        3.0,
        "standard errors that the variance of an input's noise may lie above an estimate of it",
        _TEST,
    )
    agrees: float = _is(
        0.99, "level of the likelihood ratio up to which a residual agrees with a floor", _TEST
    )
    drawn_share: float = _is(
        0.25,
        "of an input's noise, the size of the draw that shows what it gives to a score: of a "
        "function with a kink where an input rests, 1/sqrt(1 + share^2) of it",
        "tests/diagnosis/evidence/test_score_bias.py",
        "Stein, Ann. Statist. 9 (1981) 1135-1151, exact as the share goes to zero; the draw's own "
        "variance grows as its inverse",
    )
    lines: int = _is(
        25,
        "frequencies over which the noise's part in the equations is averaged, if the response "
        "varies: of the scatter of one draw a twenty-fifth is left",
        _FAR,
    )
    steps: int = _is(20, "Gauss-Newton steps towards the root", _TEST)
    longest_step: float = _is(
        25.0, "standard errors of one step: further away nothing is linear", _TEST
    )
    converged: float = _is(0.01, "standard errors: the length of a last step", _TEST)
    least_information: float = _is(
        0.2, "share of the information that noise leaves: with less the root is not sought", _TEST
    )
    absorbs_misfit: float = _is(
        1.1,
        "RMS of the residual over that of sensors and inputs, beyond which it is no noise",
        _TEST,
    )
    absorbs_spreads: float = _is(
        2.0, "standard deviations of that ratio squared by chance, beyond which the same", _TEST
    )
    left_spreads: float = _is(
        4.0,
        "standard deviations of the logarithm of what noise leaves to least squares, by which it "
        "may leave more or less: a root that simulates worse needs noise that is there",
        _TEST,
    )
    left_records: int = _is(20, "records of noise for their mean", _TEST)


@dataclass(frozen=True, slots=True)
class Fillings:
    """How missing samples are drawn from the noise last found."""

    first: int = _is(
        8, "draws of missing samples, after each of which the noise is found anew", _TEST
    )
    again: int = _is(3, "the same, from the noise of the step before", _TEST)


@dataclass(frozen=True, slots=True)
class FarRoot:
    """The search for a root that is far from least squares."""

    nearer: float = _is(
        10.0,
        "units of log-likelihood by which total least squares is better elsewhere, beyond which "
        "the root is sought from there: by chance the root itself lies a few from it",
        _FAR,
    )
    of_noise: float = _is(
        1.3,
        "squares of what total least squares leaves over those that noise of the sizes found would "
        "leave, beyond which its minimum is a false one",
        _FAR,
    )
    searches: int = _is(3, "of its minimum, each from where the one before ended", _FAR)
    of_states: int = _is(2, "steps to the initial states there, which are nearly linear", _FAR)
    evaluations: int = _is(40, "of the equations at most, if steps are shortened", _FAR)
    closely: float = _is(
        2e-4,
        "standard errors: the length of its last step, as least squares may have no minimum",
        _FAR,
    )
    longer: float = _is(1.25, "times the step before, beyond which that one is halved", _FAR)
    least_part: float = _is(0.1, "of a step, below which it is not shortened further", _FAR)


@dataclass(frozen=True, slots=True)
class VarianceSlope:
    """The derivative of the equations by the variance of a noise."""

    difference: float = _is(0.1, "of a variance, by which it is changed for a derivative", _TEST)
    nothing: float = _is(
        1e-6,
        "standard errors of a variance, up to which it is zero: its derivative would be found from "
        "rounding",
        _TEST,
    )


@dataclass(frozen=True, slots=True)
class StatedNoise:
    """When the stated noise of an input is doubted."""

    larger: float = _is(
        1.5,
        "times the stated noise that the floor of its channel is, beyond which a note says so: a "
        "data sheet is no nearer",
        _STATED,
        "engineering judgement",
    )
    floor_errors: float = _is(
        4.0, "standard errors of the floor that it is lower by chance", _STATED
    )


@dataclass(frozen=True, slots=True)
class ChannelFloor:
    """The white noise of a channel by its own spectrum."""

    beyond: float = _is(
        4.0,
        "standard deviations of a difference of white noise, beyond which a step is in it: by "
        "chance one of 16 000 is",
        "tests/estimation/noise/test_noise_floor.py",
        "the normal distribution",
    )


@dataclass(frozen=True, slots=True)
class AverageResponse:
    """Which samples count under noise whose response is that of the record's average."""

    missing: int = _is(
        500,
        "missing samples up to which those of a criterion count, whatever they cost: a system of "
        "as many equations takes a hundredth of a second",
        "tests/diagnosis/search/disturbance/test_sole_disturbance.py",
    )


@dataclass(frozen=True, slots=True)
class VaryingResponse:
    """When noise of inputs whose response varies is taken at every sample, and its variances."""

    noticeable: float = _is(
        0.01, "of the residual's power, from which on a source counts", _VARYING
    )
    likelier: float = _is(
        5.0,
        "units of log-likelihood by which the residual has to be likelier than under an average "
        "response: ends of a record, which the two do not begin alike, and sampled spectra make a "
        "few",
        _VARYING,
    )
    by_chance: float = _is(
        3.0,
        "standard deviations by which the mean square of white noise may differ from one",
        _VARYING,
        "the normal distribution: 1 of 370 by chance",
    )
    corners: int = _is(
        3, "frequencies that the search for the spectrum of a force begins at", _VARYING
    )
    difference: float = _is(
        1e-4,
        "change of the logarithm of a variance over which innovations are differentiated",
        _VARYING,
    )


@dataclass(frozen=True, slots=True)
class Steps:
    """How many steps of Runge and Kutta the noise response of a sample is taken over."""

    resolved: float = _is(
        1e-4,
        "of the states, to which the slopes of a sample are those of the simulation's own steps",
        "tests/estimation/noise/test_noise_response.py",
    )


REMOVAL = Removal()
FILLINGS = Fillings()
FAR_ROOT = FarRoot()
VARIANCE_SLOPE = VarianceSlope()
STATED_NOISE = StatedNoise()
CHANNEL_FLOOR = ChannelFloor()
AVERAGE_RESPONSE = AverageResponse()
VARYING_RESPONSE = VaryingResponse()
STEPS = Steps()
