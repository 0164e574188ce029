"""Least squares and instrumental variables for A y = sum B_i u_i, with generated instruments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from casid.errors import IdentifiabilityError
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import Regression, Term
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.two_stage_limit import PredictedInputs


def polynomial_regressors(
    layout: Layout, output: str, sources: Mapping[str, str]
) -> dict[str, Term]:
    """Coefficient -> signal of A y = sum B_i u_i, (2.21), in the order of the layout."""
    made: dict[str, Term] = {f"a{k}": (f"-{output}", k) for k in range(1, layout.na + 1)}
    for name, nb, nk in zip(layout.inputs, layout.nb, layout.nk, strict=True):
        made |= {f"b{k}[{name}]": (sources[name], k) for k in range(nk, nk + nb)}
    return made


def instrumental_limit(
    system: LinearSignals,
    output: str,
    sources: Mapping[str, str],
    references: Sequence[str],
    orders: Orders,
    *,
    lags: int | None = None,
    method: str | None = None,
) -> Asymptotics:
    """IV whose instruments are the regressors as the references make them, free of all else.

    Parameters
    ----------
    sources : name that coefficients carry -> signal.
    references : externals that are known.
    orders : na, nb, nk; nothing else.
    lags : of the responses to the references, as in `two_stage_limit`. Where the estimate is
        consistent, estimating these responses adds nothing to its variance.

    Raises
    ------
    IdentifiabilityError
        If no reference reaches a regressor, or they do not move the regressors apart.
    """
    layout = Layout.of(orders, list(sources))
    every = {"": output, **sources} if layout.na else dict(sources)
    stage = PredictedInputs(system, every, references, None, lags)
    regressors = polynomial_regressors(layout, output, sources)
    made = polynomial_regressors(layout, stage.sources.get("", output), stage.sources)
    try:
        return regression_limit(
            stage.system,
            Regression(output, regressors, list(made.values())),
            method=method,
        )
    except IdentifiabilityError as why:
        if len(regressors) <= 6:
            raise
        raise IdentifiabilityError(
            f"{', '.join(references)} cannot move the {len(regressors)} regressors of the full "
            "relation apart. Excite further nodes, or give a model of lower order"
        ) from why
