"""Instruments of a module's regression: lags of signals simulated from the references alone.

The noise-free regressors are the best instruments, (2.48) of Linder (2017). They are approximated
as (2.49)-(2.50) do: output and inputs are simulated from the references, here with an ARX model of
each. A poor model costs variance, not consistency.
"""

from __future__ import annotations

from casid.arrays import Array
from casid.errors import CasidError
from casid.estimation.moments.instruments.instruments import Simulated, from_reference
from casid.estimation.prediction_error.polynomial.estimation import arx
from casid.estimation.prediction_error.polynomial.model import PolynomialModel
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.linear.sampled.lagged_columns import Column
from casid.unknown_inputs.networks.estimation.module_data import ModuleData

ORDERS = 2, 3, 4, 6, 8, 12  # of the ARX models; BIC chooses, so that little noise is fitted
SURPLUS = 2  # lags of each signal beyond those of its regressors: moments that can be tested
OUTPUT = "y"


def reference_instruments(
    data: ModuleData, equation: DifferenceEquation, lags: int | None, few: int
) -> tuple[Simulated, str]:
    """Instruments and what they are, in words.

    Parameters
    ----------
    lags : of the references themselves as instruments; None for simulated signals.
    few : lags of the references to fall back on, where no stable model is found.
    """
    if lags is not None:
        return from_reference(data.references, lags), f"{lags} lags of each reference"
    taken: dict[str, list[int]] = {}
    for column in equation.columns:
        for channel, lag, _ in column.taps:
            taken.setdefault(channel, []).append(lag)
    signals: dict[str, Array] = {}
    columns: list[Column] = []
    orders: list[str] = []
    for channel, used in taken.items():
        measured = data.y if channel == OUTPUT else data.inputs[channel]
        made = f"made[{channel}]"
        if channel in data.references:
            signals[made] = measured
        else:
            simulated = _made_of_references(measured, data)
            if simulated is None:
                description = (
                    f"{few} lags of each reference, as no stable model of {channel} was found"
                )
                return from_reference(data.references, few), description
            signals[made], order = simulated
            orders.append(str(order))
        last = max(used) + SURPLUS
        columns += [Column(f"{made}[t-{m}]", ((made, m, 1.0),)) for m in range(min(used), last + 1)]
    settle = min(data.N // 10, 100)
    description = f"signals that ARX models of orders {', '.join(orders)} make of the references"
    return Simulated(signals, tuple(columns), settle), description


def _made_of_references(measured: Array, data: ModuleData) -> tuple[Array, int] | None:
    """The signal simulated from the references by the ARX model of least BIC, and its order.

    Each half of the record is simulated by the model of the other half (split-sample instruments,
    Angrist & Krueger 1995): what a model has fitted of the noise is not in its own instruments.
    """
    found = []
    for n in ORDERS:
        if n > 2 and data.N < 40 * n * (1 + len(data.references)):
            break
        if (model := _arx(measured, data, slice(None), n)) is not None:
            found.append((model.bic, n))
    half = data.N // 2
    for _, n in sorted(found):
        first, second = (
            _arx(measured, data, part, n) for part in (slice(0, half), slice(half, None))
        )
        if first is not None and second is not None:
            made = second.simulate(dict(data.references))
            made[half:] = first.simulate(dict(data.references))[half:]
            return made, n
    return None


def _arx(measured: Array, data: ModuleData, part: slice, n: int) -> PolynomialModel | None:
    references = {name: x[part] for name, x in data.references.items()}
    try:
        model = arx(measured[part], references, na=n, nb=n + 1, nk=0, discard=max(ORDERS))
    except CasidError:  # the references excite fewer lags
        return None
    return model if model.is_stable else None
