"""Functions on which what is missing may depend, and their regressions, place by place.

They are the same for every model and whatever its catalogue: powers, signs and products of states
and inputs, channels recorded beside them, each growing in time or other in its second half, and
the slope of the output itself. Which of them is a named effect is not decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.force_functions import TIME, Group, Table, slope_of
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.residual.signatures import Regression
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import RESIDUAL


def regressions(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    places: Collection[str] | None = None,
    seed: int = 0,
) -> Iterator[tuple[str, list[str], Regression]]:
    """Every balance and output with the names of its functions and their regression.

    `places` are those requested; all without.
    """
    fit = at.unbiased or at.fit
    model, outputs = fit.criterion.model, fit.criterion.outputs
    linearised = Linearised(fit.criterion, fit.x)
    inputs = [name for name, u in model.inputs.items() if u.kind != "generated"]
    own = {*model.states, *inputs}
    beside = {name: unit for name, unit in (recorded or {}).items() if name not in own}
    for place in (*model.balances, *outputs):
        if places is not None and place not in places:
            continue
        named = functions_of(
            list(model.states), inputs, list(beside), place if place in outputs else None
        )
        yield (
            place,
            [name for name, _ in named],
            Regression(
                fit,
                at.noise,
                place,
                [group for _, group in named],
                experiments,
                input_sd=at.input_sd,
                recorded=beside,
                linearised=linearised,
                seed=seed,
            ),
        )


def functions_of(
    states: Sequence[str],
    inputs: Sequence[str],
    recorded: Sequence[str] = (),
    output: str | None = None,
) -> list[tuple[str, Group]]:
    """The functions by name; `output` where they are errors of that output.

    Channels that the model does not have enter without products with others: there may be many.
    """
    kinds: list[tuple[str, Callable[[Array], Array]]] = [
        ("{0}", lambda v: v),
        ("{0}^2", lambda v: v**2),
        ("{0} |{0}|", lambda v: v * np.abs(v)),
        ("{0}^3", lambda v: v**3),
        ("sign({0})", _sign),
    ]
    out = []
    own = [*states, *inputs]
    for v in (*own, *recorded):
        for text, function in kinds:
            out.append((text.format(v), _single((v,), function)))
        out.append((f"{v} growing in time", _product((TIME, v), _growing)))
        out.append((f"{v} turned at half time", _product((TIME, v), _late)))
    if output is not None:
        slope = slope_of(output)
        out.append((slope, _single((slope,), lambda f: f)))
        out.append((f"{slope} growing in time", _product((TIME, slope), _growing)))
    for a, b in combinations(own, 2):
        out.append((f"{a} {b}", _product((a, b), lambda f, g: f * g)))
        out.append((f"|{a}| {b}", _product((a, b), lambda f, g: np.abs(f) * g)))
        out.append((f"{a} |{b}|", _product((a, b), lambda f, g: f * np.abs(g))))
    return out


def _sign(of: Array) -> Array:
    """The sign; the one that nearly all samples have, where the other is `RESIDUAL.rare`."""
    sign = np.sign(of)
    most = 1.0 if np.sum(sign) >= 0.0 else -1.0
    return np.where(np.mean(sign != most) < RESIDUAL.rare, most, sign)


def _growing(time: Array, of: Array) -> Array:
    return np.asarray((time - time.mean()) * of)


def _late(time: Array, of: Array) -> Array:
    return np.asarray(np.where(time > time.mean(), 1.0, -1.0) * of)


def _single(names: tuple[str, ...], function: Callable[[Array], Array]) -> Group:
    def columns(table: Table) -> Array:
        return np.asarray(function(table[names[0]]))[:, None]

    return Group(names, columns)


def _product(names: tuple[str, ...], function: Callable[[Array, Array], Array]) -> Group:
    def columns(table: Table) -> Array:
        return np.asarray(function(table[names[0]], table[names[1]]))[:, None]

    return Group(names, columns)
