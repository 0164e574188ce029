"""Which estimators of the indirect model are consistent on its closed loop, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an estimator of the indirect model is consistent on its loop, and why."""

    estimator: str
    is_consistent: bool
    why: str
    by_direct_term: bool = False  # the direct term alone would bias it


def verdicts(
    outputs: Sequence[str],
    inputs: Sequence[str],
    *,
    direct_term: bool,
    input_noise: bool,
    disturbed: bool,
) -> tuple[Verdict, ...]:
    """Consistency of four estimators of G_O from u_I and y_O.

    Source: Linder (2017), section 7.3.2, (7.31)-(7.32): with a direct term the prediction error
    H^-1 (y - G_O u) is white at the true parameters and still correlated with the input's present
    sample, so that its variance is not least there. Forssell and Ljung (1999), Closed-loop
    identification revisited, Automatica 35(7).
    """
    u, y = " and ".join(inputs), " and ".join(outputs)
    noise = f"the noise of {u} is in the regressors and in the error (errors in variables)"
    now = f"the disturbance reaches {u} within the same sample, by the direct term"
    loop = f"the disturbance reaches {u} round the loop"
    coloured = f"the equation error is coloured and reaches the lagged {y}"
    acts = direct_term and disturbed
    least_squares = [now] * acts + [coloured] * disturbed + [noise] * input_noise
    prediction = [now] * acts + [noise] * input_noise
    simulation = [loop] * disturbed + [noise] * input_noise
    clean = "no disturbance and no noise on its inputs"
    safe = (
        f"no direct term: the predictor's {u} is older than the disturbance it leaves"
        if disturbed
        else clean
    )
    return (
        _verdict("least squares (ARX)", least_squares, clean, acts),
        _verdict("prediction error, true noise model", prediction, safe, acts),
        _verdict("simulation error (output error)", simulation, clean, False),
        Verdict(
            "instrumental variables, external instruments",
            True,
            "instruments simulated from an outside reference are independent of disturbance and "
            "noise; a wrong reference filter costs variance alone",
        ),
    )


def _verdict(estimator: str, reasons: list[str], otherwise: str, acts: bool) -> Verdict:
    return Verdict(estimator, not reasons, "; ".join(reasons) or otherwise, acts)
