"""Estimates from sums alone: records larger than memory, or kept on other machines.

Cross moments (`moments`) are sums over samples. They are made where the data lie, chunk by
chunk, added, and what arrives here is a small matrix for each load case: enough for least squares
and for instrumental variables with any instruments that are lags of recorded channels. Simulated
instruments are lags too, once their signal has been streamed along as a channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from casid.data.problem import Problem
from casid.errors import DataError, ModelError
from casid.estimation.cross_moments.moments import Moments
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.stage import Stage
from casid.estimation.moments.stages.stage_estimate import moment_estimate
from casid.estimation.moments.stages.staged_estimation import with_prior
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.lagged_columns import Column
from casid.model.model import Model


def estimate_from_moments(
    problem: Problem | Model,
    sums: Mapping[str, Moments],
    *,
    Ts: float | Mapping[str, float],
    known: Mapping[str, Mapping[str, float]] | None = None,
    instruments: Sequence[Column] | None = None,
    free: Sequence[str] | None = None,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """Estimate jointly from the sums of each load case.

    Parameters
    ----------
    problem : whose model has no unknown inputs left (`Model.eliminate`).
    sums : name of a load case -> its moments; records of one load case are added beforehand. The
        channels are those of the model and of the instruments, in SI units, with lags at least up
        to the order of the difference equation and of the instruments.
    Ts : sample time [s], or one for each load case.
    known : load case -> values known for it, in the parameters' units.
    instruments : columns on channels of the sums; None: least squares.
    free, prior, settings : as `estimators.instrumental_variables`; noise models and
        refinement need samples and are not available here.

    Returns
    -------
    MomentEstimate
        Its error bars assume white equation errors: the sums hold no more. Sensor noise makes the
        error coloured, A(q) e; the spread over the sums of several stretches then says more.

    Raises
    ------
    DataError
        If the sums lack a channel, or their lags are too few.
    """
    settings = settings or MomentSettings()
    if settings.noise_model is not None or settings.alpha is not None:
        raise ModelError(
            "noise models and robust estimates look at samples, sums have none left; drop "
            "noise_model= and alpha=, or estimate from records"
        )
    cases = dict(known or {})
    _refuse_cases(sums, cases)
    model = with_prior(problem, prior)
    names = tuple(free or (p.name for p in model.parameters.values() if not p.is_known))
    pairs = [
        pair
        for case, total in sums.items()
        for pair in _equations(
            model,
            (case, total, float(Ts[case]) if isinstance(Ts, Mapping) else float(Ts)),
            cases.get(case, {}),
            instruments,
            settings,
        )
    ]
    parts = [part for part, _ in pairs]
    stage = Stage(model, parts, names, settings, name="from sums")
    fit = stage.fit_equations([e for _, e in pairs], parts, [p.values for p in parts])
    provenance = [f"{case}: sums of {total.N} samples" for case, total in sums.items()]
    return moment_estimate(
        model, [fit], settings, prior, how="white", origin=(problem.name, provenance)
    )


def _refuse_cases(sums: Mapping[str, Moments], known: Mapping[str, Mapping[str, float]]) -> None:
    """Refuse no load case, and known values of one that has no sums."""
    foreign = [name for name in known if name not in sums]
    if foreign:
        raise DataError(
            f"known values for {foreign[0]!r}, which has no sums; there are {', '.join(sums)}"
        )
    if not sums:
        raise DataError("no sums given; name at least one load case")


def _equations(
    model: Model,
    sums: tuple[str, Moments, float],
    known: Mapping[str, float],
    instruments: Sequence[Column] | None,
    settings: MomentSettings,
) -> Iterator[tuple[Part, MomentEquations]]:
    """The equations of each output from the sums of a load case: its name, moments and Ts [s]."""
    case, total, Ts = sums
    values = model.nominal_values
    for name in known:
        model.parameter_named(name)
    values |= model.in_si(known)
    for output in settings.outputs or tuple(model.outputs):
        equation = difference_equation(model, output, Ts, method=settings.method)
        _require(case, total, (equation.left, *equation.columns, *(instruments or ())))
        part = Part(case, equation, values, frozenset(known), {}, {}, Ts)
        name = f"{case}/{output}"
        yield part, MomentEquations.from_moments(equation, total, instruments, name=name)


def _require(case: str, total: Moments, columns: Sequence[Column]) -> None:
    used = dict.fromkeys(c for column in columns for c, _, _ in column.taps)
    lacking = [c for c in used if c not in total.channels]
    if lacking:
        raise DataError(
            f"{case}: the sums lack channel {lacking[0]!r}, they hold {', '.join(total.channels)}; "
            "name it when they are made"
        )
    order = int(np.max([c.order for c in columns]))
    if order > total.lags:
        raise DataError(
            f"{case}: the sums reach {total.lags} lags, the equation and its instruments need "
            f"{order}; make them again with lags={order}"
        )
