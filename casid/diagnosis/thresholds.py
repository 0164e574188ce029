"""Every number that decides something in a diagnosis: limits, counts, factors of comparisons.

One frozen group a question; each entry has its value, what it means, where it comes from and the
test or study whose result pins it. Nothing else decides by a bare number. Numbers that keep a
division or a decomposition regular, and conversions of units, stand where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

POWER_STUDY = "analysis.diagnosis_power"
CASES = "analysis.cases"
ADVICE_STUDY = "analysis.diagnosis_advice"
TESTS = "tests/diagnosis"


# -- evidence -------------------------------------------------------------------------------------

_SUFFICIENCY = f"{TESTS}/evidence/records/test_sufficiency.py"


@dataclass(frozen=True, slots=True)
class Sufficiency:
    """When a record holds no answer."""

    per_unknown: int = _is(10, "samples that every unknown must have at least", _SUFFICIENCY)
    held_motion: float = _is(
        3.0, "the held-out part moves so many times as much as the fitted one", _SUFFICIENCY
    )
    misfit: float = _is(
        3.0,
        "times its noise, the error of an output beyond which a cause is sought although no "
        "parameter is determined: the error, not the record, makes the standard errors",
        _SUFFICIENCY,
    )
    clip: float = _is(4.0, "robust standard deviations at which outliers are cut off", _SUFFICIENCY)
    lags_outside: int = _is(
        4,
        "of 20 lags outside their 95 % bounds, beyond which a channel is coloured",
        _SUFFICIENCY,
        "binomial: P(5 or more) = 0.3 %",
    )
    whiteness_lags: int = _is(20, "lags of the autocorrelation of an output", _SUFFICIENCY)
    whiteness_alpha: float = _is(
        0.003,
        "level at which the largest autocorrelation of an output shows that it is coloured, over "
        "all lags",
        _SUFFICIENCY,
        "the level of the count of lags",
    )
    lags: int = _is(400, "lags of the correlation with an input, at most", _SUFFICIENCY)
    lag_share: float = _is(0.25, "of the record, at most", _SUFFICIENCY)
    alpha: float = _is(0.01, "level of that correlation, over all lags and inputs", _SUFFICIENCY)
    clock_gaps: int = _is(3, "rows with a value that show another clock, at least", _SUFFICIENCY)
    clock_share: float = _is(0.95, "of rows that keep that clock", _SUFFICIENCY)
    moved: float = _is(
        0.2,
        "of the simulated motion, the rms that a disturbance adds, beyond which no likelihood "
        "tells laws of that motion apart: their kinks at rest are rounded off as far",
        f"{TESTS}/search/comparison/test_alternatives.py",
    )


_PLATEAUS = f"{TESTS}/evidence/recording_faults/test_plateaus.py"


@dataclass(frozen=True, slots=True)
class Bounds:
    """When a bound holds a parameter by more than chance."""

    beyond: float = _is(
        3.0,
        "standard errors beyond a bound, that an estimate would be without it: from there on the "
        "bound holds it by more than chance",
        f"{TESTS}/evidence/whitening/test_holding_bounds.py",
        "one-sided, 0.13 %: beside a few parameters of which each may be at its bound",
    )
    beside: float = _is(
        0.01,
        "standard errors from a bound, all else fixed, within which a search ended at it",
        f"{TESTS}/evidence/whitening/test_holding_bounds.py",
    )
    rounding: float = _is(
        1e-10,
        "of the curvature of a parameter, left where all others move with it, below which the "
        "records do not determine it",
        f"{TESTS}/evidence/whitening/test_holding_bounds.py",
        "rounding of the Hessian",
    )


@dataclass(frozen=True, slots=True)
class Clipping:
    """When equal samples at the end of a channel's range are a limit."""

    fewest: int = _is(
        4, "equal samples at an end that are a plateau in a channel whose values repeat", _PLATEAUS
    )
    samples_per_plateau: int = _is(10, "samples of the channel for each of these", _PLATEAUS)
    fast: float = _is(
        0.5,
        "of the median step: a step into a plateau that no motion coming to rest takes",
        _PLATEAUS,
    )
    turn: float = _is(
        5.0,
        "steps of a counted channel by which a motion that turns has left its end where it is "
        "twice as far from the middle of it: four of a parabola",
        f"{TESTS}/evidence/recording_faults/test_plateaus.py",
    )
    turn_noise: float = _is(
        3.0,
        "times the noise of a reading, by which the readings beside the end of a motion that turns "
        "lie further from it: two, as the end is the furthest of the readings around it, and one "
        "for those beside",
        f"{TESTS}/evidence/recording_faults/test_plateaus.py",
    )
    apart: float = _is(
        3.0,
        "times the largest step between other samples, beyond which single samples at an end are a "
        "value for a fault: a motion that is cut off comes near the limit",
        _PLATEAUS,
    )
    beside: int = _is(
        20,
        "distinct values next to the end that show how often values repeat in this channel",
        _PLATEAUS,
    )
    repeats: float = _is(0.05, "repetitions a value, added to those counted", _PLATEAUS)
    beyond: float = _is(
        0.5, "of the error elsewhere, by which the simulation lies beyond at least", _PLATEAUS
    )
    motion: float = _is(0.1, "of that mean, by which the simulation moves there", _PLATEAUS)
    far_beyond: float = _is(
        3.0,
        "times the error elsewhere, by which the simulation lies beyond a limit that the noise of "
        "the readings alone shows",
        f"{TESTS}/evidence/recording_faults/test_plateaus.py",
    )
    even: float = _is(
        0.5,
        "of the median noise: the quietest windows have more where the sensor's noise is all that "
        "bends the readings (of white noise 0.8), and less where motion does",
        f"{TESTS}/evidence/recording_faults/test_plateaus.py",
    )
    leap: float = _is(
        3.0,
        "times what 95 % of steps stay below: a step that what sticks by friction does not take, "
        "and a stuck sensor does as it goes on",
        f"{TESTS}/evidence/recording_faults/test_stuck_sensors.py",
    )
    quiet_window: int = _is(
        20,
        "samples of a window that shows the noise of a reading where it hardly moves",
        f"{TESTS}/evidence/recording_faults/test_stuck_sensors.py",
    )
    quiet_share: float = _is(
        0.1,
        "of these windows, the quietest: an encoder is without noise as its motion comes to rest",
        f"{TESTS}/evidence/recording_faults/test_stuck_sensors.py",
    )


_SPIKES = f"{TESTS}/evidence/recording_faults/test_spikes.py"


@dataclass(frozen=True, slots=True)
class Outliers:
    """When isolated samples are spikes."""

    faintest: float = _is(
        2.5, "variance of the spikes over that of the noise, both differenced", _SPIKES
    )
    like_white: float = _is(
        0.1, "how far correlations of the differences may lie from those of white noise", _SPIKES
    )
    large: float = _is(
        5.0,
        "standard deviations beyond which noise hardly masks what a spike leaves beside it",
        _SPIKES,
    )
    left: float = _is(
        0.5,
        "of its height, that the model with all causes leaves of a spike: less was fast misfit",
        _SPIKES,
    )
    farthest: float = _is(12.0, "standard deviations at which the mixture is cut off", _SPIKES)
    shortest: int = _is(20, "samples of a record that can be judged", _SPIKES)
    largest_share: float = _is(0.05, "of samples that are still exceptions", _SPIKES)
    undetected_share: float = _is(
        1.4, "spikes that there may be for each that rises from the noise", _SPIKES
    )
    fitted_share: float = _is(0.2, "of spikes that the mixture may fit at most", _SPIKES)
    body: float = _is(
        0.96, "central share of the differences that their scale is taken of", _SPIKES
    )
    neighbours: tuple[float, float] = _is(
        (0.15, 0.85), "of a large spike, turned round, that its two neighbours show", _SPIKES
    )
    after_steps: int = _is(
        2, "samples after an input's step in which a spike may be a response to it", _SPIKES
    )
    usual_steps: float = _is(
        0.5, "quantile of the inputs' steps beyond which a spike is a response to one", _SPIKES
    )
    in_record: float = _is(
        0.5,
        "of what stands out of the residual: where less of it stands out of the record itself, it "
        "is the simulation that does",
        _SPIKES,
    )
    test_share: float = _is(
        1 / 50,
        "of the false-alarm rate, spent on each test of samples in each channel",
        _SPIKES,
    )


@dataclass(frozen=True, slots=True)
class Steps:
    """When what stands out of a residual is a step of it, and no spike."""

    uneven: float = _is(
        0.25,
        "of a large spike, by which its neighbours may differ: beside a step it is all of it, and "
        "half where a first-order lag goes on from there",
        _SPIKES,
    )
    by_noise: float = _is(
        3.5, "standard deviations of that difference which noise alone may make", _SPIKES
    )


_STEPS_IN_GAPS = f"{TESTS}/evidence/recording_faults/test_steps_in_gaps.py"
_LEVELS_IN_GAPS = f"{TESTS}/evidence/recording_faults/test_levels_in_gaps.py"


@dataclass(frozen=True, slots=True)
class StepsInGaps:
    """Where a held input stepped in a gap of its record."""

    samples: int = _is(
        50,
        "samples behind a gap that are simulated for each place of a step: what it leaves is "
        "largest just behind the gap",
        _STEPS_IN_GAPS,
    )
    lost: float = _is(
        1.5,
        "intervals of an input on an uneven clock that a gap without a lost sample has at most",
        _STEPS_IN_GAPS,
    )
    rounds: int = _is(
        3, "passes over all gaps, as what an earlier one left moves the residual", _STEPS_IN_GAPS
    )
    busy: float = _is(
        0.5,
        "of the samples at which an input changes: beyond, it is controlled, and has a level of "
        "its own in each gap instead of a step",
        _LEVELS_IN_GAPS,
    )
    passes: int = _is(
        2,
        "estimates of the levels in gaps, each followed by a fit: the first begins from "
        "parameters that the wrong levels moved",
        _LEVELS_IN_GAPS,
    )
    memory: float = _is(
        0.999, "of one sample that the next one has, at most: a residual ends", _LEVELS_IN_GAPS
    )
    simulated: int = _is(
        1_000_000,
        "samples behind all gaps together that are simulated for the levels in them: seconds",
        _LEVELS_IN_GAPS,
    )


_STEPS_BETWEEN_ROWS = f"{TESTS}/evidence/recording_faults/test_steps_between_rows.py"


@dataclass(frozen=True, slots=True)
class StepsBetweenRows:
    """When a held input stepped between its rows, at instants that differ from step to step."""

    fewest: int = _is(
        6, "steps, fewer of which show no spread of their instants", _STEPS_BETWEEN_ROWS
    )
    samples: int = _is(
        200, "samples behind a step in which what it does is simulated", _STEPS_BETWEEN_ROWS
    )
    seen: float = _is(
        0.05, "of what the largest step does, that a step has to do at least", _STEPS_BETWEEN_ROWS
    )
    explained: float = _is(
        0.8,
        "of the sum of squares of the residual, at least: an amplitude for each step explains "
        "part of most misfits",
        _STEPS_BETWEEN_ROWS,
    )
    errors: float = _is(
        3.0, "standard errors by which a share may lie outside 0 to 1", _STEPS_BETWEEN_ROWS
    )
    inside: float = _is(
        0.95, "of the steps that lie inside at least, with that room", _STEPS_BETWEEN_ROWS
    )


_DEAD_TIMES = f"{TESTS}/test_dead_time.py"


@dataclass(frozen=True, slots=True)
class DeadTimes:
    """The scan for long dead times, of models that err by `RESTARTS.far`."""

    delays: int = _is(
        40,
        "delays that are tried, evenly from zero to the longest: one each quarter percent of "
        "the window, within which a command that moves at all has hardly changed",
        _DEAD_TIMES,
    )
    part: int = _is(4_000, "samples, all records together, that are simulated for it", _DEAD_TIMES)
    steps: int = _is(2, "Gauss-Newton steps of everything else at each of them", _DEAD_TIMES)
    less: float = _is(
        0.5, "of the sum of squares without a delay, that one must leave at most", _DEAD_TIMES
    )


@dataclass(frozen=True, slots=True)
class Prewhitening:
    """Noise found at a fit."""

    absorbs_misfit: float = _is(
        1.1,
        "residual over the sensors' noise beyond which the noise model absorbs misfit",
        POWER_STUDY,
    )
    absorbs_spreads: float = _is(
        2.0,
        "standard deviations of that ratio by chance, for short records and sharp resonances",
        POWER_STUDY,
    )
    white_share: float = _is(
        0.0005,
        "of the misfit's RMS that counts as white noise where misfit is most of the residual",
        POWER_STUDY,
    )
    rounds: int = _is(2, "noise and fit in turn", POWER_STUDY)
    likelier: float = _is(
        0.5,
        "units of log-likelihood by which a further round under a disturbance has to gain",
        f"{TESTS}/search/noise_assumptions/test_disturbance_rival.py",
    )
    near_bound: float = _is(
        1e-6,
        "of a parameter, or of its scale: so near its bound it is held there",
        f"{TESTS}/evidence/whitening/test_prewhitening.py",
    )
    steps: int = _is(40, "Gauss-Newton steps towards the root without bias", POWER_STUDY)
    patience: int = _is(8, "steps that come no nearer before it is given up", POWER_STUDY)
    nearer: float = _is(0.98, "of the shortest step so far: one that comes nearer", POWER_STUDY)
    converged: float = _is(0.05, "standard errors: the length of a last step", POWER_STUDY)
    longest_step: float = _is(
        25.0, "standard errors of one step: further away nothing is linear", POWER_STUDY
    )
    least_information: float = _is(
        0.2,
        "share of the information that input noise leaves, below which a step is held short",
        POWER_STUDY,
    )
    delay_samples: float = _is(
        15.0, "samples of delay that are sought at most, where the model is faster", POWER_STUDY
    )
    delay_share: float = _is(
        0.1,
        "of the record, beyond which no delay is sought in any case: of one step, recorded until "
        "it has settled, a sensor may be late by a twentieth",
        f"{TESTS}/evidence/records/test_signal_sizes.py",
    )
    trial: float = _is(
        0.01,
        "what the trial of an effect adds to a derivative or an output, over the RMS of that",
        f"{TESTS}/evidence/scores/test_divergence.py",
    )


_BETWEEN = f"{TESTS}/evidence/test_between_samples.py"


@dataclass(frozen=True, slots=True)
class Scores:
    """Score tests of effects and of functions."""

    undetectable: float = _is(
        1e-4,
        "share of a signature, in squares, outside the baseline's tangent space; less is none",
        f"{TESTS}/advice/test_undetectable.py",
    )
    hardly_detectable: float = _is(
        1e-5,
        "the same where the rest of the signature explains `much`: dry friction beside viscous and "
        "quadratic damping in a long decay. Below it a linear signature does not predict a fit",
        POWER_STUDY,
    )
    small_gain: float = _is(
        0.5,
        "gain error up to which another gain of its channel is scored beside it: the simulation "
        "without it may lie far from the record, where nothing is linear",
        f"{TESTS}/search/instants/test_jump_times.py",
    )
    least_reach: float = _is(
        1e-8,
        "squares that initial states of windows leave of a signature, at least: with more growth "
        "over a window than ten thousand, rounding would count",
        f"{TESTS}/evidence/records/test_unstable_records.py",
    )
    much: float = _is(
        100.0,
        "Lagrange multiplier statistic that noise of the size assumed does not reach",
        POWER_STUDY,
        "chi^2(1)",
    )
    between_samples: float = _is(
        0.01,
        "sample times by which a line between samples of a measured input may be late or early: "
        "that of a first-order response with a time constant of eight samples",
        _BETWEEN,
        "Ts^2 / (12 T), Armstrong and Kolesar, Econometrica 86 (2018) 655-683",
    )
    draws: int = _is(4000, "Gaussian draws of the family of effects", POWER_STUDY)
    function_draws: int = _is(2000, "the same of functions", POWER_STUDY)
    few_draws: int = _is(50, "the same where only gains are compared", POWER_STUDY)
    resolved: int = _is(
        20, "draws beyond a p-value that resolve it; below, Bonferroni's bound", POWER_STUDY
    )
    freedom_per_lag: float = _is(
        1.5,
        "degrees of freedom a sample over the lags of the covariance",
        POWER_STUDY,
        "Bartlett window: Andrews, Econometrica 59 (1991) 817-858",
    )
    least_freedom: float = _is(4.0, "degrees of freedom of a score, at least", POWER_STUDY)
    least_function_freedom: float = _is(20.0, "the same of functions", POWER_STUDY)
    relative_rank: float = _is(
        1e-3, "of a group's largest squared singular value, below which it is dropped", POWER_STUDY
    )
    rows: int = _is(1 << 13, "samples projected at once, a bound on memory", POWER_STUDY)


_MISSING = f"{TESTS}/unexplained/test_missing_force.py"


@dataclass(frozen=True, slots=True)
class Functions:
    """Functions of states and inputs on which a missing force may depend."""

    both_signs: float = _is(
        0.2, "of the larger side that the other reaches, where a variable has both signs", _MISSING
    )
    tail: float = _is(0.01, "quantile at which a variable's sides are measured", _MISSING)
    levels: tuple[float, float] = _is(
        (0.25, 0.9), "quantiles of the size between which functions bend", _MISSING
    )
    ends: tuple[float, float] = _is(
        (0.02, 0.98), "the same of a variable of one sign, to the outermost", _MISSING
    )
    fewest_knots: int = _is(4, "knots of a cubic spline", _MISSING)
    bends: int = _is(3, "levels at which a function of one variable bends", _MISSING)
    product_bends: int = _is(2, "the same of a coefficient of another variable", _MISSING)
    few_samples: float = _is(
        10.0,
        "samples that tell of a function, from which on its own errors count more than the "
        "residual's power: a variance of as many squares is known to a factor of two",
        f"{TESTS}/evidence/test_few_samples.py",
    )
    at_limit: float = _is(
        0.999, "of a clipping limit: samples beyond it are clipped", f"{_PLATEAUS}"
    )


_RESIDUAL = f"{TESTS}/evidence/residual/test_residual_tests.py"


@dataclass(frozen=True, slots=True)
class Residual:
    """Kinds of residual."""

    bands: int = _is(12, "bands of the spectrum of every output", _RESIDUAL)
    floor_errors: float = _is(
        2.0,
        "standard errors by which the noise of an input may be larger than the floor of its own "
        "spectrum, before the rest is a disturbance",
        f"{TESTS}/evidence/test_disturbances.py",
    )
    first_band: int = _is(8, "lines of the lowest band", _RESIDUAL)
    blocks: int = _is(20, "stretches in which power is compared over time", _RESIDUAL)
    half_waves: int = _is(
        12,
        "half waves along all records of which the course of a parameter is composed: one that "
        "comes and goes six times is among them",
        f"{TESTS}/evidence/residual/test_constancy.py",
    )
    share_p: float = _is(
        0.05, "p of the dependence up to which its share is computed, whatever the rate", _RESIDUAL
    )
    share: float = _is(
        0.15,
        "of the residual that functions of inputs and states have to explain to be its cause: a "
        "disturbance reaches measured inputs in the loop and correlates a little with everything",
        _RESIDUAL,
    )
    functions: int = _is(3, "functions that this share is taken of, at most", _RESIDUAL)
    beyond_doubt: float = _is(
        1e-8,
        "p of the dependence below which no refit beside a random disturbance makes a residual "
        "random: where one did, it was at least 1e-4 before",
        f"{TESTS}/search/disturbance/test_disturbance_price.py",
    )
    rare: float = _is(
        0.05,
        "of the samples, with the other sign: with fewer the sign counts as constant, as a few "
        "neighbouring samples, which share their noise, show no dependence",
        f"{TESTS}/evidence/residual/test_candidate_functions.py",
    )
    by_chance: float = _is(2.0, "times what chance gives, for each after the first", _RESIDUAL)
    held_out_chance: float = _is(
        1e-3,
        "chance that noise alone makes the held-out error as large: as many verdicts as this are "
        "given up for nothing",
        f"{TESTS}/verdict/test_held_out_noise.py",
    )


_REFERENCES = f"{TESTS}/evidence/records/test_loop_references.py"


@dataclass(frozen=True, slots=True)
class References:
    """When a recorded channel is the reference of a control loop."""

    apart: float = _is(
        0.5, "of the reference's variance by which the output may miss it", _REFERENCES
    )
    left: float = _is(
        0.1,
        "of an input's variance, and of what the output alone leaves of it, that a filter of "
        "reference and output may leave: noise and saturation of the drive",
        _REFERENCES,
    )
    exact: float = _is(
        1e-3, "the same where the output does not follow: no more than rounding", _REFERENCES
    )
    lags: int = _is(4, "samples of memory of that filter, beside an integral", _REFERENCES)


_PEAKS = f"{TESTS}/evidence/residual/test_spectral_peaks.py"


@dataclass(frozen=True, slots=True)
class Peaks:
    """Narrow peaks of a spectrum."""

    guard: int = _is(
        2, "lines beside the one judged that its own leakage reaches: not part of its level", _PEAKS
    )
    finer: int = _is(
        4,
        "points of the searched grid a line: the largest is then missed by 5 % of its power",
        _PEAKS,
    )
    order: int = _is(4, "order of the autoregression that prewhitens the residual", _PEAKS)
    rows: int = _is(1 << 12, "lines whose level is found at once, a bound on memory", _PEAKS)
    shortest: int = _is(64, "samples of a record that is long enough for a level", _PEAKS)
    first: int = _is(3, "lowest line; those below are left to trends", _PEAKS)
    share: float = _is(1 / 8, "of the lines on each side that the level is taken of", _PEAKS)
    neighbours: tuple[int, int] = _is((10, 40), "lines on each side, at least and at most", _PEAKS)
    most: int = _is(3, "peaks of one search", _PEAKS)
    most_forces: int = _is(2, "peaks that are tried as forces", _PEAKS)
    resonance: float = _is(
        0.05,
        "of a resonance's largest squared gain from which a line is at it; the static gain is less "
        "of it: about two half-power bandwidths beside it",
        f"{TESTS}/search/comparison/test_imitations.py",
    )


_COGGING = f"{TESTS}/evidence/residual/test_cogging_periods.py"


@dataclass(frozen=True, slots=True)
class Cogging:
    """The search for a force that is periodic in a position."""

    fewest: float = _is(4.0, "periods in the range of a motion, at least", _COGGING)
    most: float = _is(
        64.0, "periods in the range of a motion, or teeth in a turn, at most", _COGGING
    )
    samples: float = _is(
        6.0, "samples in a period at the rms speed, which a Runge-Kutta step resolves", _COGGING
    )
    start: float = _is(
        0.5, "of the linear estimate, the amplitude that a refit begins at", _COGGING
    )
    at_once: int = _is(8, "periods whose responses are computed at once", _COGGING)
    kept: int = _is(
        30_000_000, "numbers of responses that are kept to be looked at a second time", _COGGING
    )


# -- search ---------------------------------------------------------------------------------------


_JOINT_REFIT = f"{TESTS}/search/refits/test_joint_refit.py"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Candidates compared."""

    strong: float = _is(
        6.0,
        "units of BIC that reject a rival",
        POWER_STUDY,
        'Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795: "strong"',
    )
    relative_gain: float = _is(
        0.3, "share of the best gain below which a candidate cannot win", POWER_STUDY
    )
    by_chance: float = _is(
        10.0,
        "how far a gain predicted, or found on a part, may be off",
        POWER_STUDY,
        "chi^2(1): P = 0.2 %",
    )
    least_left: float = _is(
        1e-9,
        "of the misfit that a candidate leaves beyond what noise of the inputs gives, at least: "
        "less is a difference of two larger numbers",
        f"{TESTS}/search/noise_assumptions/test_disturbance_rival.py",
    )
    least_samples: float = _is(8.0, "independent samples of a residual, at least", POWER_STUDY)
    imitator: float = _is(
        0.5,
        "of the best lasting cause's gain that one on the clock must gain beside",
        POWER_STUDY,
    )
    leaders: int = _is(6, "candidates compared again under the noise of the best", POWER_STUDY)
    rounds: int = _is(2, "such comparisons, where another comes first", POWER_STUDY)
    vuong_p: float = _is(
        0.05,
        "p above which a rival is open where the noise model absorbs misfit",
        POWER_STUDY,
        "Vuong, Econometrica 57 (1989) 307-333, (5.6)",
    )
    vuong_share: float = _is(0.5, "of the best merit that such a rival has at least", POWER_STUDY)
    same: float = _is(
        1e-6, "of the best merit within which two are equal, as far as fits go", _JOINT_REFIT
    )
    near_share: float = _is(
        0.8,
        "of the best merit that a candidate has at least to be compared again under the noise that "
        "the best one leaves, where misfit passed for noise before",
        f"{TESTS}/search/comparison/test_alternatives.py",
    )
    likely: float = _is(
        4.0,
        "units of BIC by which a kind with lower prior plausibility must be better than another",
        POWER_STUDY,
    )
    memory: float = _is(
        0.5,
        "of the merit of hysteresis, above which a law without memory goes first: beside the "
        "mixture of damping laws of a hull it has 0.7 of it, beside true hysteresis 0.1",
        f"{TESTS}/search/comparison/test_alternatives.py",
    )
    likely_share: float = _is(
        0.015,
        "the same as a share of the better one's merit, where the noise model absorbs misfit: "
        "gains count misfit of another kind as well there",
        POWER_STUDY,
    )


@dataclass(frozen=True, slots=True)
class Refits:
    """Where refits of an effect start, and how far its parameter may go."""

    enough: float = _is(
        1e-5,
        "of the criterion of a candidate, less than which a step would lower it: the refit ends "
        "there. At 20 000 samples of noise alone a tenth of a unit of the log-likelihood",
        f"{TESTS}/search/refits/test_joint_refit.py",
    )
    factors: tuple[float, ...] = _is(
        (0.5, 1.0, 2.0, 4.0), "times the linearised delay or lag to start from", POWER_STUDY
    )
    stiffer: tuple[float, ...] = _is(
        (1.0, 10.0),
        "times its linearised stiffness that a stop is started with: the motion that it is "
        "linearised at goes far beyond a stiff one",
        _JOINT_REFIT,
    )
    least_delay: float = _is(0.2, "sample times to start from, at least", POWER_STUDY)
    room: float = _is(2.0, "times its start that a delay may reach", POWER_STUDY)
    room_samples: float = _is(4.0, "sample times beyond that", POWER_STUDY)
    unknown_size: float = _is(
        4.0, "steps that a parameter of unknown value is taken to have", POWER_STUDY
    )
    step_share: float = _is(0.4, "of a parameter's value that a first change takes", POWER_STUDY)
    loss: float = _is(0.95, "of its value that a parameter may lose", POWER_STUDY)
    growth: float = _is(3.0, "times its value that a parameter may gain", POWER_STUDY)
    growth_for_a_while: float = _is(
        30.0,
        "times its value that it may gain for a while: by an open door a room loses many times "
        "what its walls do",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    slope_room: float = _is(2.0, "times the slope to zero that a change may have", POWER_STUDY)
    inside: float = _is(0.9, "of these bounds between which a fit starts", POWER_STUDY)


@dataclass(frozen=True, slots=True)
class Restarts:
    """When a refit is begun again elsewhere."""

    lost: float = _is(
        0.1,
        "of its declared start, below which a parameter says little of how far it may change",
        f"{TESTS}/search/test_lost_parameters.py",
    )
    far: float = _is(
        10.0,
        "times its noise, the error of an output beyond which parameters of the model may be so "
        "far away that refits start from the declared values, too",
        _JOINT_REFIT,
    )
    explained: float = _is(
        3.0, "times its noise, the error that needs no other start", _JOINT_REFIT
    )
    promising: float = _is(
        0.3,
        "of the gain of the best, at least, of a candidate that is refitted from where that led",
        f"{TESTS}/search/refits/test_where_the_best_led.py",
    )
    shorter: tuple[float, ...] = _is(
        (0.1, 0.01),
        "of the linearised size of an effect, to start from where the whole of it led farther from "
        "the records than the model without it",
        _JOINT_REFIT,
    )


@dataclass(frozen=True, slots=True)
class Jumps:
    """Instants of a parameter's jump."""

    promising: float = _is(0.6, "of the best gain beyond which a jump is placed", POWER_STUDY)
    reach: float = _is(1.5, "steps of the first grid on both sides", POWER_STUDY)
    scans: int = _is(3, "scans, each finer", POWER_STUDY)
    instants: int = _is(101, "instants of a scan", POWER_STUDY)
    worth: float = _is(
        0.5,
        "of chi^2, what another instant explains more, at least, where it is worth a refit: a "
        "third of a standard error of the instant is nothing to the choice of a cause",
        f"{TESTS}/search/instants/test_jump_times.py",
    )
    zoom: float = _is(12.0, "by which the next scan is finer", POWER_STUDY)
    fine: float = _is(
        5.0,
        "samples of reach at which the scans end: a tenth of one between two instants",
        f"{TESTS}/search/instants/test_jump_times.py",
    )
    knock: float = _is(
        10.0,
        "samples that a force lasts whose impulse a knock is first tried with",
        f"{TESTS}/verdict/test_unknown_cause.py",
    )
    same_event: float = _is(
        1.2, "steps of the first grid within which it is one event", POWER_STUDY
    )
    seen: float = _is(
        1e-6,
        "of the power of two steps, what their difference has at least: less is rounding",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    moves: int = _is(
        3,
        "Gauss-Newton steps of all instants at once, in the whole records beside all causes",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    still: float = _is(
        0.1,
        "standard errors of an instant, by which no step is worth a fit",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    z: float = _is(
        1.96,
        "standard errors within which an instant is followed: 95 % of a normal one",
        f"{TESTS}/search/instants/test_instant_errors.py",
    )
    distances: int = _is(
        9,
        "distances on each side at which an instant is followed, and again between two of them",
        f"{TESTS}/search/instants/test_instant_errors.py",
    )
    ends: int = _is(
        41,
        "instants of a scan at either end of what is over again: all pairs of them are compared",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )


@dataclass(frozen=True, slots=True)
class Scans:
    """How near each other the instants of a scan are, where a jump rings."""

    alike: float = _is(
        0.7,
        "cosine of what sets in at two neighbours, at least: one between them then has a cosine of "
        "nine tenths with one of them",
        f"{TESTS}/search/instants/test_ringing_jumps.py",
    )
    finest: float = _is(
        2.0, "samples between two of them", f"{TESTS}/search/instants/test_ringing_jumps.py"
    )
    most: int = _is(801, "of them: eight scans", f"{TESTS}/search/instants/test_ringing_jumps.py")


_FRICTION = f"{TESTS}/search/refits/test_friction_speeds.py"


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry friction: the speed below which it is smoothed, and whether a model has any."""

    promising: float = _is(
        0.9, "of the best gain beyond which other smoothing speeds are tried", _FRICTION
    )
    narrower: float = _is(1 / 3, "times the last speed tried", _FRICTION)
    steps: int = _is(3, "speeds tried, at most: down to 1/27 of the first", _FRICTION)
    finer: int = _is(4, "times finer steps that a sharper reversal may take", _FRICTION)
    samples: int = _is(20_000, "steps of a simulation up to which they are taken", _FRICTION)
    refits: int = _is(8, "refits between the neighbours of the best one", _FRICTION)
    exact: float = _is(0.05, "of the speed at which they end", _FRICTION)
    stable: float = _is(
        1.0,
        "steps over the friction's time constant at rest, at most: a sharper one costs many more",
        _FRICTION,
        "Runge-Kutta of order four is stable to 2.78 on the real axis",
    )
    resolved: float = _is(
        2.0,
        "times as many steps as are stable, where likelihoods are compared: fewer err by as much",
        _FRICTION,
    )
    in_the_end: int = _is(
        400_000, "steps of a simulation up to which the reversal is resolved in the end", _FRICTION
    )
    doublings: int = _is(
        8, "times that the speed is halved or doubled beside all causes, at most", _FRICTION
    )
    clearly: float = _is(
        0.5,
        "rise of the logarithm of the likelihood that is worth it: less moves no parameter by more "
        "than its standard error",
        _FRICTION,
    )
    speeds: tuple[float, float] = _is(
        (0.3, 0.6),
        "of the rms speed, at which the model's resistance tells dry friction from the rest: the "
        "second twice the first, both well above `Smoothing.speed`",
        f"{TESTS}/search/comparison/test_imitations.py",
    )
    share: float = _is(
        0.1,
        "of the resistance at the first that must remain towards rest, for friction to be dry",
        f"{TESTS}/search/comparison/test_imitations.py",
    )


@dataclass(frozen=True, slots=True)
class Stops:
    """Which stops are springs that harden."""

    soft: float = _is(
        0.1,
        "of the stiffness beside it, below which a stop has to show its corner: one of a thirtieth "
        "is mostly a spring that hardens, as the righting arm of a ship does",
        f"{TESTS}/search/refits/test_soft_stops.py",
    )
    rounded: float = _is(
        0.1,
        "of where it begins, over which a corner is rounded that is none: of a stop with a corner "
        "that is tens of units of log-likelihood, of a spring that hardens a gain",
        f"{TESTS}/search/refits/test_soft_stops.py",
    )


_PRESELECTION = f"{TESTS}/search/refits/test_preselection.py"


@dataclass(frozen=True, slots=True)
class Bursts:
    """The stretch of a record in which most of its misfit lies, at whose start jumps are tried."""

    over_mean: float = _is(
        3.0,
        "times the mean square of the whitened residual that a burst exceeds",
        f"{TESTS}/evidence/residual/test_bursts.py",
    )
    share: float = _is(
        0.1,
        "of the sum of squares that it has beyond that, at least",
        f"{TESTS}/evidence/residual/test_bursts.py",
        "a residual of noise has less than 0.02 in 300 samples",
    )
    start: float = _is(
        0.02,
        "of a record, within whose first part a burst is one of the initial state",
        f"{TESTS}/evidence/residual/test_bursts.py",
    )
    spikes: int = _is(
        3,
        "spikes, at most, at which jumps are tried too: a sensor that errs now and then has more",
        f"{TESTS}/search/instants/test_spikes_of_jumps.py",
    )


@dataclass(frozen=True, slots=True)
class Shortlist:
    """Which effects are refitted, of all that were tested."""

    kinds: int = _is(6, "kinds refitted, by robust p and by plain score each", POWER_STUDY)
    unnamed: int = _is(4, "neighbours without a name beside them, of each order", POWER_STUDY)
    timed: int = _is(
        4,
        "effects at an instant beside them, of each order: a jump of one parameter is nearly one "
        "of any other",
        f"{TESTS}/search/test_shortlist.py",
    )
    gains: int = _is(
        2,
        "gains of channels that change, beside jumps and changes that are over again: a push of an "
        "input for an instant is a gain of it as well, and crowds out no force",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    passing: int = _is(
        4,
        "changes that are over again beside them, as many as of jumps: a sensor's bias for a while "
        "looks like a force for a while and like two parameters",
        f"{TESTS}/search/instants/test_temporary_changes.py",
    )
    lags: int = _is(
        4,
        "lags of further channels, at most, where misfit passes for noise: another lag, or a "
        "parameter at its bound, hides what they gain",
        f"{TESTS}/search/refits/test_lags_of_channels.py",
    )
    few: int = _is(
        6,
        "effects that are seen beside a disturbance, at most, where the first cause is sought "
        "among them: many look alike there as well",
        f"{TESTS}/search/noise_assumptions/test_first_cause.py",
    )
    alike: float = _is(
        0.99,
        "|cosine| from which an effect is refitted beside the best of those: it explains 98 %",
        f"{TESTS}/search/noise_assumptions/test_first_cause.py",
    )
    switch: int = _is(
        3,
        "levels of a switch, at most: held by its nature, nothing in it is sought to be smooth",
        f"{TESTS}/search/test_switches.py",
    )


@dataclass(frozen=True, slots=True)
class Rounds:
    """How much is searched, and what is adopted."""

    rivals: int = _is(4, "rivals of one cause that are refitted in the end", POWER_STUDY)
    pairs: int = _is(
        2,
        "candidates beside which a second is sought where none alone lowers the held-out error",
        f"{TESTS}/search/adoption/test_refinement.py",
    )
    very_strong: float = _is(
        10.0,
        "units of BIC that reject an effect with a name against a function without one, which one "
        "record in twenty prefers by chance",
        "tests/diagnosis/search/comparison/test_alternatives.py",
        'Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795: "very strong"',
    )
    lean: float = _is(
        0.1,
        "of what all causes explain, at most, that a model without the superfluous ones may lose: "
        "where it loses more, its fit went astray",
        f"{TESTS}/search/adoption/test_refinement.py",
    )
    beside: int = _is(
        2,
        "causes sought beside a random disturbance before any is sought without one: misfit that "
        "more of them explain is none",
        f"{TESTS}/test_cases.py",
    )
    frictions: int = _is(
        2,
        "laws of friction or damping adopted in one place: a third repairs their shape",
        f"{TESTS}/search/comparison/test_imitations.py",
    )
    backward_wald: float = _is(
        2.0,
        "standard errors below which a cause is eliminated again, or more where it was chosen "
        "among many",
        POWER_STUDY,
    )
    overfit: float = _is(
        0.1,
        "of the squared error that a cause removes a fitted sample, by which that of a held-out "
        "one may rise: a cause fitted to noise loses all of it there",
        f"{TESTS}/search/comparison/test_simulation_errors.py",
    )
    record_alpha: float = _is(
        0.01,
        "level below which sizes are called different between records",
        f"{TESTS}/test_sizes_by_record.py",
    )
    residual_share: float = _is(
        0.2,
        "of the false-alarm rate, for the test of the residual where nothing was named: it comes "
        "on top of the search's. Where something was, the rate is twice as large",
        POWER_STUDY,
    )
    long: int = _is(
        30_000, "samples beyond which candidates are compared on a part first", _PRESELECTION
    )
    part: int = _is(20_000, "samples of that part, all records together", _PRESELECTION)
    kept: float = _is(
        0.2,
        "of the best gain on the part below which a candidate is left out; less than "
        "`Comparison.relative_gain`, as on the whole the shares are not quite the same",
        _PRESELECTION,
    )
    fewest_compared: int = _is(3, "fewest candidates that are compared on a part", _PRESELECTION)
    head_misfit: float = _is(
        0.5, "of its share of samples that a part must have of the misfit", _PRESELECTION
    )


# -- what is unexplained --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms of a missing force."""

    most: int = _is(3, "terms of one place, at most", _MISSING)
    small: float = _is(
        0.03, "of the misfit: a smaller term is a shape's imperfection, not a cause", _MISSING
    )
    near: float = _is(0.9, "of the best term's merit that a rival or simpler term has", _MISSING)
    rivals: int = _is(4, "rivals of a term that are listed", _MISSING)
    line_width: float = _is(0.5, "lines of the spectrum beside one, for sines", _MISSING)
    step: float = _is(0.6, "of the travel in one interval: a step", _MISSING)
    trend: float = _is(0.7, "of the travel from first to last: rising or falling", _MISSING)
    shape: float = _is(0.6, "of the gain that a power must explain to be called so", _MISSING)
    odd_powers: tuple[float, ...] = _is(
        (0.0, 0.5, 2.0, 3.0, 5.0), "powers of |v| with the sign of v, beside v itself", _MISSING
    )
    even_powers: tuple[float, ...] = _is((1.0, 2.0, 4.0), "powers of |v|", _MISSING)


_DESCRIPTION = f"{TESTS}/unexplained/test_description.py"


@dataclass(frozen=True, slots=True)
class Description:
    """The description of what was found, and of a misfit outside the catalogue."""

    noiseless: float = _is(
        1e-3,
        "of the rms error that noise leaves, the white noise of an output below which none was "
        "found: its estimate ended next to zero",
        f"{TESTS}/verdict/test_sentences.py",
    )
    no_noise: float = _is(
        1e-6,
        "of the scatter of an input, its white noise below which none was found: no logger has 20 "
        "bits of it, and the estimate ended next to zero",
        f"{TESTS}/verdict/test_sentences.py",
    )
    as_well: float = _is(
        2.0,
        "of BIC, up to which an alternative is said to explain the misfit as well",
        f"{TESTS}/verdict/test_sentences.py",
        'Kass and Raftery (1995): "not worth more than a bare mention"',
    )
    slow: float = _is(
        0.01,
        "frequency [Hz] of a disturbance below which its period is said as well",
        f"{TESTS}/evidence/test_disturbances.py",
        "a period of minutes or more is easier to recognise than its frequency",
    )
    apart: float = _is(
        12.0,
        "squares by which a place must explain more than another to be named alone: six units of "
        "BIC, doubled, as the places' terms were chosen too",
        _DESCRIPTION,
        "Kass and Raftery (1995), doubled",
    )
    dynamic: float = _is(
        3.0, "log-likelihood by which a force is better than an error of a sensor", _DESCRIPTION
    )
    loud: float = _is(2.0, "times the median power: a stretch in which much remains", _DESCRIPTION)
    rare: float = _is(0.4, "of the record beyond which such stretches are not named", _DESCRIPTION)
    stretches: int = _is(4, "stretches that are listed", _DESCRIPTION)
    band_p: float = _is(0.01, "p below which the loudest band is named", _DESCRIPTION)
    reported: float = _is(
        100.0,
        "times the noise floor: a limit of the held-out error from which its number is left out",
        f"{TESTS}/verdict/test_remainder.py",
    )
    names: int = _is(
        5,
        "names of what may be one cause, in the verdict; all of them stand with the cause",
        f"{TESTS}/verdict/test_sentences.py",
    )
    unit: float = _is(
        0.02,
        "of the ratio of two units, within which a sensor's gain is called that of a wrong unit: "
        "what a sound sensor errs by",
        f"{TESTS}/verdict/test_wrong_units.py",
    )
    gain: float = _is(
        2.0,
        "factor beyond which a sensor's gain is no error of its calibration",
        f"{TESTS}/verdict/test_wrong_units.py",
        "an amplifier with half or twice its gain is broken, or another one",
    )


@dataclass(frozen=True, slots=True)
class Smoothing:
    """A missing force over time."""

    bands: int = _is(60, "bands of its spectrum", _MISSING)
    likelihood_bands: int = _is(200, "bands in which the likelihood is computed", _MISSING)
    memories: int = _is(14, "correlation times tried", _MISSING)
    longest_memory: float = _is(0.25, "of the longest period that the record holds", _MISSING)
    evidence: float = _is(
        8.0,
        "units of log-likelihood that two parameters gain by chance in 1 of 1000",
        _MISSING,
        "chi^2(2) / 2",
    )
    share: float = _is(0.3, "of the variance that the smoother finds, to be shown", _MISSING)
    line_p: float = _is(1e-4, "p below which a line of the spectrum is named", _MISSING)
    line_window: int = _is(25, "lines on each side that a line's level is the median of", _MISSING)


# -- verdict --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Foresight:
    """When what causes foresee of held-out data refutes a random disturbance in their place."""

    left: float = _is(
        0.25,
        "of the squares of each held-out error that causes may leave for a random disturbance to "
        "be no explanation of what they explain: it is another one in what was held out",
        f"{TESTS}/search/comparison/test_simulation_errors.py",
    )
    p: float = _is(
        1e-3,
        "chance that they fall so far, at most: several candidates had to lower them",
        f"{TESTS}/search/comparison/test_simulation_errors.py",
        "Blackman and Tukey, The Measurement of Power Spectra, Dover 1958, section 23",
    )
    all_but: float = _is(
        0.01,
        "of the squares of each held-out error, which causes leave at most where no second search "
        "beside a disturbance is worth its time: one that moves the system leaves more",
        f"{TESTS}/search/test_causes_that_predict.py",
    )


@dataclass(frozen=True, slots=True)
class Disturbed:
    """When a random disturbance is all that a model leaves."""

    looked_at: int = _is(
        6,
        "effects that score best, beside a disturbance and under the sensors' noise, whose gain "
        "beside a disturbance is computed",
        f"{TESTS}/search/disturbance/test_sole_disturbance.py",
    )
    followed: float = _is(
        0.5,
        "of the gain in log-likelihood that decides: an effect that gains less in a first step, of "
        "two, is not followed up",
        "analysis.fleet",
    )
    explains: float = _is(
        0.5,
        "of the excess misfit: an effect that explains more by its score is refitted beside a "
        "disturbance, however little its tangent gains there",
        f"{TESTS}/search/disturbance/test_sole_disturbance.py",
    )


@dataclass(frozen=True, slots=True)
class Growth:
    """By how much more a model may err that is fitted beside a disturbance than one that is not."""

    by_chance: float = _is(
        0.1,
        "by which the held-out error may grow where a disturbance is most of it, with or without "
        "the cause",
        f"{TESTS}/search/noise_assumptions/test_disturbance_rival.py",
    )
    by_least_squares: float = _is(
        0.5,
        "of the fitted error, by which it may grow at most where least squares fits of a "
        "disturbance what is no part of the model",
        f"{TESTS}/search/comparison/test_simulation_errors.py",
    )


@dataclass(frozen=True, slots=True)
class Judging:
    """What decides the verdict and its sentences."""

    doubtful: float = _is(
        0.15,
        "share of the excess misfit left, above which the one cause named is not the cause",
        f"{TESTS}/verdict/test_unknown_cause.py",
    )
    practical: float = _is(
        0.02,
        "share of the excess misfit below which a significant effect is a small remainder, no "
        "cause, and a disturbance is not reported: without it the RMS error falls by less than a "
        "seventh of what it could",
        f"{TESTS}/evidence/test_disturbances.py",
        "a tenth of the square root; engineering judgement",
    )
    visible: float = _is(
        1e-4,
        "share of the misfit below which a significant effect is not listed as a remainder, unless "
        "the extended model has it: in no figure would anybody see it",
        f"{TESTS}/search/adoption/test_refinement.py",
        "a hundredth of the square root, in units of the error; engineering judgement",
    )
    carried: float = _is(
        0.5,
        "of its value, by which a parameter of the model moves without a cause that is one "
        "although it explains little",
        f"{TESTS}/search/adoption/test_refinement.py",
    )
    clearly: float = _is(
        5.0,
        "standard errors, by which it moves at least: well beyond what chance and misfit give",
        f"{TESTS}/search/adoption/test_refinement.py",
    )
    expressed: float = _is(
        0.03,
        "share of a signature, in squares, left beside the causes below which they express it: "
        "1 - cos^2; linear signatures of one thing at two sizes of it differ by as much",
        f"{TESTS}/verdict/test_unnamed_alternatives.py",
    )
    alias: float = _is(0.99, "|cosine| of two effects that are the same in this model", POWER_STUDY)
    aliases: int = _is(3, "of them that are listed", POWER_STUDY)
    exchanges: float = _is(
        0.7,
        "|correlation| of two estimates that make up for each other: half of the variance of one "
        "goes with the other",
        f"{TESTS}/verdict/test_unknown_sizes.py",
    )
    small_outliers: float = _is(
        0.01,
        "of the criterion, and of the white noise of the sensor: outliers that carry less are not "
        "reported",
        _SPIKES,
    )
    unlike: float = _is(
        1.5,
        "times the fitted error or floor: a held-out error that forbids a verdict; times its RMS "
        "error with an effect, that of an output without it, which makes the effect a cause",
        CASES,
    )
    at_floor: float = _is(
        1.1,
        "times the noise floor: a floor estimated from the same record is no better known; an "
        "error of what was held out may be larger by chance (`chance_over_floor`)",
        f"{TESTS}/verdict/test_remainder.py",
    )
    moved: float = _is(
        2.0,
        "standard errors, the larger of both fits', by which a parameter moved",
        f"{TESTS}/verdict/test_remainder.py",
        "Hausman, Econometrica 46 (1978) 1251-1271, section 2: by chance in less than 1 of 20",
    )
    nearly_all: float = _is(
        0.005, "share left below which 100 % is not printed", f"{TESTS}/verdict/test_remainder.py"
    )
    more_noise: float = _is(
        1.5, "times a channel's own noise beyond which a disturbance is named", CASES
    )


# -- advice and calibration -----------------------------------------------------------------------

_ISOLABILITY = f"{TESTS}/advice/test_isolability.py"
_NEXT = f"{TESTS}/advice/test_next_experiment.py"


@dataclass(frozen=True, slots=True)
class Planning:
    """What separates tied causes, and which experiments are proposed."""

    margin: float = _is(
        6.0, "units of BIC within which causes count as tied", _ISOLABILITY, "Comparison.strong"
    )
    power: float = _is(0.95, "probability with which the right cause is to win", _ISOLABILITY)
    same: float = _is(
        0.995, "|cosine| from which two effects are indistinguishable in a record", _ISOLABILITY
    )
    alike: float = _is(
        0.5,
        "|cosine| from which a pair stands in `diagnosis.json` with its energy: below it a rival "
        "adds less than a third to the energy, and a wide model has ten thousand such pairs",
        _ISOLABILITY,
    )
    suspects: int = _is(3, "rivals that experiments are planned to separate", ADVICE_STUDY)
    shortest: float = _is(
        0.05, "of the predicted record below which its length is not extrapolated", _NEXT
    )
    clearer: float = _is(2.0, "times less energy needed: an experiment preferred for that", _NEXT)
    shorter: float = _is(
        2 / 3,
        "of the same record again: a shorter one. A gain of less than a third is none, since "
        "predicted lengths err by as much",
        _NEXT,
    )
    longest: float = _is(
        10.0,
        "times the present records, and an hour at least (`easily`), up to which an experiment is "
        "advised: nobody makes much longer ones, and the differences that would show in them alone "
        "are smaller than what the model gets wrong besides",
        _NEXT,
    )
    easily: float = _is(
        3600.0, "seconds that a record may last whatever the present one does", _NEXT
    )
    realistic: float = _is(
        10.0,
        "times the longest that is advised (`longest`, `easily`), up to which a length is stated: "
        "a longer one is extrapolated a hundredfold from a linear prediction, and is no length",
        _NEXT,
    )
    lasting: float = _is(
        31557600.0,
        "seconds, a year, beyond which no length is stated that is not advised: systems change, "
        "and so do the people who record them",
        _NEXT,
    )
    notable: float = _is(1.5, "times less energy needed: it is mentioned", _NEXT)
    rank_limit: float = _is(
        0.3, "seconds for the rank of one extended model", f"{TESTS}/advice/test_undetectable.py"
    )
    formula_limit: float = _is(
        0.6,
        "seconds for all closed forms of identifiable combinations",
        f"{TESTS}/advice/test_undetectable.py",
    )


@dataclass(frozen=True, slots=True)
class Experiments:
    """Which experiments are predicted."""

    larger: float = _is(2.0, "times the amplitude", _NEXT)
    longer: int = _is(4, "times the record's length", _NEXT)
    wider: float = _is(3.0, "times the band of excitation and motion", _NEXT)
    slower: float = _is(1 / 3, "of the frequency at which the system moves most", _NEXT)
    aside: float = _is(
        1.6, "ratio by which an excitation beside the resonance keeps away from it", _NEXT
    )
    load: float = _is(1.5, "times a known value that may be changed", _NEXT)
    band_power: float = _is(0.95, "of the power of an input that its band holds", _NEXT)
    highest: float = _is(0.4, "of the sampling rate, the highest frequency excited", _NEXT)
    settling: float = _is(0.5, "of the record's length that one free decay may take", _NEXT)
    shortest_decay: int = _is(40, "samples of a free decay, at least", _NEXT)


_CALIBRATION = f"{TESTS}/calibration/test_false_alarm_rate.py"


@dataclass(frozen=True, slots=True)
class Calibrating:
    """Null records."""

    runs: int = _is(
        200,
        "null records where no number is given: a rate of 5 % is then known to 1.5 %",
        _CALIBRATION,
        "binomial standard error",
    )
    alarm: float = _is(
        0.999, "of the level: an alarm whatever p-value its causes have", _CALIBRATION
    )


_BUDGET = f"{TESTS}/test_budget.py"


@dataclass(frozen=True, slots=True)
class Budget:
    """The time that a diagnosis may take."""

    seconds: float = _is(600.0, "where none is given; a calibration comes on top", _BUDGET)
    calibration: float = _is(0.5, "of one that is given, when the calibration ends", _BUDGET)
    search: float = _is(0.7, "of it, when the search ends: the verdict needs the rest", _BUDGET)
    refits: float = _is(
        0.6,
        "of the time that is left, when the refits of a round end: the best of them needs the rest "
        "to be tested and adopted",
        _BUDGET,
    )
    rounds: float = _is(
        0.85,
        "of the time that is left, when no further cause is sought: whether those found need each "
        "other is tested in the rest",
        _BUDGET,
    )
    adoption: float = _is(
        0.7,
        "of the time of the search, when no further cause is sought: a disturbance in their place "
        "is compared in the rest",
        _BUDGET,
    )


SUFFICIENCY = Sufficiency()
BOUNDS = Bounds()
CLIPPING = Clipping()
OUTLIERS = Outliers()
STEPS = Steps()
STEPS_IN_GAPS = StepsInGaps()
STEPS_BETWEEN_ROWS = StepsBetweenRows()
DEAD_TIMES = DeadTimes()
PREWHITENING = Prewhitening()
SCORES = Scores()
FUNCTIONS = Functions()
RESIDUAL = Residual()
REFERENCES = References()
PEAKS = Peaks()
COGGING = Cogging()
COMPARISON = Comparison()
REFITS = Refits()
RESTARTS = Restarts()
JUMPS = Jumps()
SCANS = Scans()
FRICTION = Friction()
STOPS = Stops()
BURSTS = Bursts()
SHORTLIST = Shortlist()
ROUNDS = Rounds()
TERMS = Terms()
DESCRIPTION = Description()
SMOOTHING = Smoothing()
FORESIGHT = Foresight()
DISTURBED = Disturbed()
GROWTH = Growth()
JUDGING = Judging()
PLANNING = Planning()
EXPERIMENTS = Experiments()
CALIBRATING = Calibrating()
BUDGET = Budget()
