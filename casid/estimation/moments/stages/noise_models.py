"""Prefilters: ARMA models of each part's equation error, and how far they moved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError, SolveError
from casid.estimation.moments.equations.parts import Part


def noise_models(
    parts: Sequence[Part],
    thetas: Sequence[Array],
    old: Sequence[Any],
    orders: tuple[int, int],
    remarks: list[str],
    j: int,
) -> tuple[list[Any], float]:
    """An ARMA model of the equation error of each part, and the largest change of a coefficient.

    Parameters
    ----------
    old : models of the iteration before, kept where no invertible one is found; None: prefilter 1.
    orders : autoregressive and moving-average.
    remarks : what went otherwise is noted here.
    j : the iteration, from 0.
    """
    from casid.estimation.prediction_error.polynomial.arma import arma

    na, nc = orders
    found: list[Any] = []
    change = 0.0
    for p, theta, before in zip(parts, thetas, old, strict=True):
        e = p.equation
        start = max(c.order for c in (e.left, *e.columns))
        error = e.left.samples(p.signals, start)
        for value, column in zip(theta, e.columns, strict=True):
            error = error - value * column.samples(p.signals, start)
        try:
            model = arma(error - error.mean(), na, nc)
        except (SolveError, IdentifiabilityError) as failure:
            remarks.append(
                f"{p.name}: no ARMA({na}, {nc}) model of the equation error in iteration "
                f"{j + 1} ({failure}); the prefilter "
                f"{'of before is kept' if before is not None else 'stays 1'}"
            )
            found.append(before)
            continue
        if not model.is_invertible:
            remarks.append(
                f"{p.name}: the noise model of iteration {j + 1} is not invertible, so its "
                "inverse is no stable prefilter; the one of before is kept"
            )
            found.append(before)
            continue
        new = np.concatenate([model.ar, model.ma])
        if before is None:
            change = max(change, 1.0)
        else:
            change = max(change, float(np.max(np.abs(new - [*before.ar, *before.ma]))))
        found.append(model)
    return found, change


def eta_distance(new: Any, old: Any) -> float:
    """||eta - last eta|| of two noise models; None is a prefilter 1."""
    if new is None or old is None:
        return 0.0 if new is old else float(np.linalg.norm((new or old).theta))
    return float(np.linalg.norm(new.theta - old.theta))
