"""F_delta estimated from one record, with the parameters of the model given."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casid.data.experiment import Experiment
from casid.errors import DataError, ModelError, SolveError
from casid.estimation.moments.instruments.instruments import Loop, UnstableLoop
from casid.estimation.moments.instruments.reference_filter import SampledFilter
from casid.estimation.prediction_error.polynomial.estimation import oe
from casid.model.model import Model


def estimate_reference_filter(
    model: Model,
    values: Mapping[str, float],
    experiment: Experiment,
    reference: str,
    *,
    channel: str | None = None,
    nb: int = 2,
    nf: int = 1,
    method: str = "bilinear",
) -> SampledFilter:
    """Estimate F_delta(q) from one record, the parameters of the model at `values`.

    The unknown input reaches a measured channel through the direct model G_c, so that
    y_c = F(q) [G_c(q) delta] + noise: an output-error problem in F with a filtered reference.

    Parameters
    ----------
    model : the indirect model, with one unknown input eliminated.
    values : all its parameters, in their units; the record's load case wins.
    channel : measured channel to explain; default the first output of the indirect model.
    nb, nf : coefficients of the numerator (from lag 0) and order of the denominator.

    Raises
    ------
    DataError, ModelError
        If a channel is missing, or the model has several unknown inputs.
    SolveError
        If no stable filter explains the channel, or the model's loop is unstable at `values`.
    """
    record = experiment.record
    loop = Loop(model, record.Ts, method)
    unknown = [n for n, e in loop.direct.inputs.items() if e.kind == "unknown"]
    if len(unknown) != 1:
        raise ModelError(
            f"{loop.direct.name}: {len(unknown)} unknown inputs ({', '.join(unknown)}); F_delta is "
            "estimated for one. Give ReferenceFilter(...) for each"
        )
    chosen = channel or next(c for c in loop.channels if c in model.outputs)
    for name in (reference, chosen):
        if name not in record.names:
            raise DataError(
                f"{experiment.name}: no channel {name!r}; it has {', '.join(record.names)}"
            )
    zero = np.zeros(record.N)
    drives = {n: record[reference] if n == unknown[0] else zero for n in loop.inputs}
    at = model.in_si({**values, **experiment.known})
    try:
        simulated = loop.driven(drives, at)[chosen]
    except UnstableLoop as unstable:
        raise SolveError(
            f"{experiment.name}: the loop is unstable at these values ({unstable}); start from "
            "values at which the system is stable, or give F_delta"
        ) from None
    y = record[chosen] - record[chosen].mean()
    found = oe(y, simulated - simulated.mean(), nb=nb, nf=nf, nk=0, Ts=record.Ts)
    b, a = next(iter(found.B.values())), next(iter(found.F.values()))
    return SampledFilter(np.asarray(b), np.asarray(a), record.Ts, found.fit)
