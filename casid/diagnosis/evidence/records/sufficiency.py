"""Records that do not determine an answer.

A record that is read without fault and yet is uninformative (no excitation, noise alone, too few
samples) is no error: its verdict is "undecided", with the reason in words.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np
from scipy.signal import correlate
from scipy.stats import norm

from casid.arrays import TINY, Array, robust_sd
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.scores.window_states import states_of_windows
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import SUFFICIENCY
from casid.estimation.covariance import FEWEST_FOR_WHITENESS, autocorrelation, whiteness
from casid.estimation.estimate import Estimate
from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split
from casid.estimation.nlp.solver import Solver
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.records.signals import require_sizes
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


def why_uninformative(model: Model, split: Split) -> str:
    """Why the fitted part is uninformative about the system, or an empty text.

    Checked before the fit, which would be meaningless: every output is constant, or is white noise
    that no input contributes to, measured or known. White and independent of an input, an output
    has correlations with it of variance 1/N at every lag, whatever the input's colour; a system
    that the samples resolve colours what it passes on, and its decay too.
    """
    outputs = _moving(split.fitted, model.outputs)
    inputs = [n for n, u in model.inputs.items() if u.kind in {"measured", "known"}]
    if any(n not in e.record for e in split.fitted for n in (*model.outputs, *inputs)):
        return ""  # refused with its remedy as it is fitted
    for e in split.fitted:
        require_sizes(e.record, [*model.outputs, *inputs])
    if not outputs:
        values = [float(e.record[n][0]) for e in split.fitted for n in model.outputs]
        what = "zero" if not any(values) else "constant"
        verb = "is" if len(model.outputs) == 1 else "are"
        text = f"{' and '.join(model.outputs)} {verb} {what} in every sample that is fitted"
        if _moving([*split.whole, *split.apart], model.outputs):
            return f"{text}, and {_ELSEWHERE}"
        return f"{text}: check the sensor, its cable and the mapping"
    for e in split.fitted:
        for name in model.outputs:
            if not _is_noise(e, name, inputs, len(split.fitted) * len(model.outputs)):
                return ""
    still = [n for n in inputs if not _moving(split.fitted, [n])]
    text = f"{' and '.join(outputs)}, as far as fitted, {'is' if len(outputs) == 1 else 'are'}"
    text += " noise alone: white" + (f", and uncorrelated with {', '.join(inputs)}" * bool(inputs))
    if any(
        np.std(e.record[n][held]) > SUFFICIENCY.held_motion * np.std(e.record[n][~held])
        for e, held in zip(split.whole, split.held, strict=True)
        if held.any()
        for n in outputs
    ):
        return f"{text}; {_ELSEWHERE}"
    return text + _check(still)


_ELSEWHERE = (
    "the motion lies in the held-out part: fit the part that moves (--window, or --hold-out 0)"
)


def _measured(model: Model) -> list[str]:
    return [n for n, u in model.inputs.items() if u.kind == "measured"]


def _moving(experiments: Sequence[Experiment], names: Iterable[str]) -> list[str]:
    """Channels that move in any of the records."""
    return [
        n
        for n in names
        if any(
            values.size > 1 and np.ptp(values) > 0.0
            for e in experiments
            if n in e.record
            for values in (e.record[n][~e.record.is_missing(n)],)
        )
    ]


def _is_noise(e: Experiment, output: str, inputs: Sequence[str], tests: int) -> bool:
    """True if an output is white and uncorrelated with every input, or constant."""
    y = e.record[output]
    y = np.where(e.record.is_missing(output), np.nan, y - np.nanmedian(y))
    # A few outliers must neither make noise of a motion nor a motion of noise.
    spread = robust_sd(y)
    y = np.clip(y, *(SUFFICIENCY.clip * spread * np.array([-1.0, 1.0])))
    y = np.nan_to_num(y - np.nanmean(y))
    read = y[~e.record.is_missing(output)]  # in order: most of an uneven clock's grid is empty
    if read.size < FEWEST_FOR_WHITENESS:
        return False
    if not np.any(y):
        return True
    if _is_coloured(read):
        return False
    lags = min(int(SUFFICIENCY.lag_share * y.size), SUFFICIENCY.lags)
    bound = float(norm.isf(0.5 * SUFFICIENCY.alpha / (lags * max(len(inputs), 1) * tests)))
    for name in inputs:
        u = e.record[name] - e.record[name].mean()
        if not np.any(u):
            continue
        r = correlate(y, u, mode="full", method="fft")[y.size - 1 : y.size - 1 + lags]
        size = math.sqrt(float(y @ y) * float(u @ u) / y.size)
        if float(np.max(np.abs(r))) > bound * size:
            return False
    return True


def _is_coloured(y: Array) -> bool:
    """True if too many autocorrelations of `y` lie outside their bounds, or one far outside.

    A motion that dies away between the samples of a slow or uneven clock colours a lag or two.
    """
    lags = min(SUFFICIENCY.whiteness_lags, y.size - 2)
    bound = float(norm.isf(0.5 * SUFFICIENCY.whiteness_alpha / lags)) / math.sqrt(y.size)
    largest = float(np.max(np.abs(autocorrelation(y, lags))))
    return largest > bound or whiteness(y, lags) > SUFFICIENCY.lags_outside


def still_inputs(c: SimulationError) -> str:
    """Advice on measured inputs that do not move, or an empty text."""
    return _check([n for n in _measured(c.model) if not _moving(c.experiments, [n])])


def _check(still: Sequence[str]) -> str:
    return f"; {' and '.join(still)} never moves: check its cable and mapping" if still else ""


def why_undecided(
    fit: Fit, at: Weighted, std_error: Callable[[str], float], whole: Sequence[Experiment] = ()
) -> str:
    """Why the record cannot support an answer, or an empty text.

    Parameters
    ----------
    fit, at : the model as it is, and under its noise.
    std_error : of a variable by name, robust (`refitting.std_error`).
    whole : the records with what is held out of them.
    """
    c = fit.criterion
    few = why_too_few(c, whole)
    if few:
        return few
    loudest = 0.0
    for e, d in enumerate(c.data):
        y = c.simulated(fit.x, e).y
        for i in range(len(c.outputs)):
            noise = float(at.noise.output_sd[i])
            loudest = max(loudest, float(np.std(y[d.used[:, i], i])) / max(noise, TINY))
    if loudest < 1.0:
        return (
            f"the simulated outputs move by only {loudest:.2g} of the noise: nothing excites the "
            f"system enough to show what the model lacks{still_inputs(c)}"
        )
    if error_over_noise(fit, at.noise) < SUFFICIENCY.misfit and none_is_known(at, std_error):
        return f"no parameter has a standard error below its own size{still_inputs(c)}"
    return ""


def why_doubtful(fit: Fit, at: Weighted, std_error: Callable[[str], float]) -> str:
    """Why the fit of the baseline model is unreliable, or an empty text.

    An added cause may remedy that: an error many times the noise is easily found, and leaves
    no parameter a standard error below its own size before it is. Parameters as in `why_undecided`.
    A fit that ended beside its minimum is no reason where the one under the noise, which begins
    there and which the tests are made at, reached its own.
    """
    if not (fit.solution.is_converged or at.fit.solution.is_converged):
        return (
            f"the model as it is was not fitted to its minimum ({fit.solution.ending}); its errors "
            f"are those where the fit stopped: {fit.solution.remedy}"
        )
    wrong = error_over_noise(fit, at.noise)
    if wrong < SUFFICIENCY.misfit or not none_is_known(at, std_error):
        return ""
    return (
        f"the error of the model is {wrong:.2g} times the noise, and no parameter of it has a "
        f"standard error below its own size{still_inputs(fit.criterion)}"
    )


def none_is_known(at: Weighted, std_error: Callable[[str], float]) -> bool:
    """True if no parameter has a standard error below its own size."""
    relative = _relative_errors(at, std_error)
    return bool(relative) and min(relative.values()) > 1.0


def why_too_few(criterion: SimulationError, whole: Sequence[Experiment] = ()) -> str:
    """Why the samples are too few for the unknowns, or an empty text.

    It names the remedy where the records as a `whole`, with what is held out, have enough. The
    state that each window of an unstable model begins in takes a sample for itself, and no more:
    it is of its window alone.
    """
    unknowns = len(criterion.variables)
    taken = len(states_of_windows(criterion, range(unknowns)))
    n, unknowns = criterion.n_samples - taken, unknowns - taken
    least = fewest_samples(unknowns)
    if n >= least:
        return ""
    left = f", less {taken} for the states that its windows begin in," if taken else ""
    few = (
        f"{n} samples{left} are too few to judge a model with {unknowns} unknowns; {least} are the "
        "least"
    )
    outputs = criterion.outputs
    there = sum(int((~e.record.is_missing(name)).sum()) for e in whole for name in outputs)
    return f"{few}: fit all {there} of them (--hold-out 0)" if there >= least else few


def fewest_samples(unknowns: int) -> int:
    """Samples without which a model with so many unknowns is not judged."""
    return SUFFICIENCY.per_unknown * unknowns


def weak_parameters(
    at: Weighted,
    std_error: Callable[[str], float],
    reported: Estimate,
    *,
    without: Collection[str] = (),
) -> tuple[str, ...]:
    """A note on parameters whose standard errors exceed their own size.

    The model may still be judged: the effect of such a parameter on the outputs is undetectable.
    But so is an effect that acts like it. One whose error is smaller in the estimate that is
    reported, where a parameter at its bound is none, is left out, and so is every one in `without`,
    which is present or absent and not estimated.
    """
    errors = {p.name: (p.std_error, abs(p.value)) for p in reported.parameters}
    clear = {name for name, (error, size) in errors.items() if error is not None and error < size}
    relative = {n: r for n, r in _relative_errors(at, std_error).items() if n not in clear}
    weak = [n for n, r in relative.items() if not r <= 1.0 and n not in without]
    if not weak:
        return ()
    names = " and ".join(weak)
    return (
        f"this record does not determine {names} to within {'its' if len(weak) == 1 else 'their'} "
        "own size: a missing effect that acts in the same way is undetectable in it, too",
    )


def _relative_errors(at: Weighted, std_error: Callable[[str], float]) -> dict[str, float]:
    """Standard error over the larger of estimate and start, of every parameter."""
    c = at.fit.criterion
    out = {}
    for v, value in zip(c.variables, at.fit.x.tolist(), strict=True):
        if v.source in c.model.parameters:
            error = std_error(v.name) / max(abs(value), v.scale)
            out[v.name] = error if math.isfinite(error) else math.inf
    return out


# -- a baseline all the same ----------------------------------------------------------------------


def few_step_fit(model: Model, experiments: Sequence[Experiment]) -> Fit:
    """A baseline for the report where nothing can be estimated: a few steps from the start."""
    criterion = SimulationError(model, experiments)
    return minimize_simulation_error(
        criterion,
        solver=Solver(max_iterations=3),
        check_rank=False,
    )


def weighted_as_white(fit: Fit) -> Weighted:
    """The fit as a `Weighted`, with its residual taken for white noise."""
    c = fit.criterion
    parts = [np.where(d.used, c.simulated(fit.x, e).residual, np.nan) for e, d in enumerate(c.data)]
    sd = np.nan_to_num(rms(np.concatenate(parts)), nan=0.0, posinf=0.0)
    sources = tuple(n for n, u in c.model.inputs.items() if u.kind == "measured")
    flat = Response(np.array([0.0, math.pi]), np.zeros((2, len(sd), len(sources))), sources)
    noise = NoiseModel(
        output_sd=np.maximum(sd, TINY),
        source_sd=dict.fromkeys(sources, 0.0),
        responses=[flat] * len(c.data),
        weights=c.weights,
    )
    return Weighted(c.model, fit, noise, noise, dict.fromkeys(sources, 0.0), False)
