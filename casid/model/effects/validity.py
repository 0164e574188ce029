"""Requirements of an effect before it joins a catalogue: a null value, units, a name."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.errors import ModelError, UnitError, nearest
from casid.model.dimensions import check_units
from casid.model.effects.effect import KINDS, Effect
from casid.model.model import Model

NAME = re.compile(r"[a-z][a-z0-9_]*")


def check_effects(model: Model, effects: Sequence[Effect]) -> None:
    """Refuse effects that the search could not judge.

    Raises
    ------
    ModelError
        If a kind is no name, or one of the catalogue's for another thing; a place does not exist;
        an effect has no parameter; the extended model at its null value is not the model, or does
        not depend on the parameter there; units do not agree; two effects share kind and place.
    """
    seen: set[tuple[str, str]] = set()
    for effect in effects:
        _check_name(model, effect)
        if not effect.parameters:
            raise ModelError(
                f"effect {effect.kind} in {effect.where} has no parameter, so nothing sizes it and "
                "no value of it is the model; multiply its term by one, parameter='c', unit=..."
            )
        if effect.key in seen:
            raise ModelError(
                f"effect {effect.kind} in {effect.where} is there twice; give one another kind"
            )
        seen.add(effect.key)
        _check_null(model, effect)


def _check_name(model: Model, effect: Effect) -> None:
    kind, where = effect.kind, effect.where
    if not NAME.fullmatch(kind):
        near = re.sub(r"[^a-z0-9_]+", "_", kind.lower()).strip("_") or "my_effect"
        raise ModelError(
            f"effect {kind!r} in {where}: a kind is a name in lower case; call it {near!r}"
        )
    is_ours = _is_ours(effect)
    if kind in KINDS and not is_ours:
        raise ModelError(
            f"effect {kind!r} in {where}: the catalogue calls something of its own by this name; "
            f"give it another, for example {'my_' + kind!r}"
        )
    places = [*model.balances, *model.parameters, *model.states, *model.inputs, *model.outputs]
    if not is_ours and where not in places:
        raise ModelError(f"effect {kind}: {model.name} has no {where!r}{nearest(where, places)}")


def _check_null(model: Model, effect: Effect) -> None:
    """Compare right-hand sides and outputs with the model's at random points."""
    name = f"effect {effect.kind} in {effect.where}"
    try:
        extended, own = effect.extended(model)
        if not _is_ours(effect):
            _check_units(extended)
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from error
    except UnitError as error:
        raise ModelError(f"{name}: {error}; give its parameters SI units") from error
    e, base = extended.explicit(), model.explicit()
    rows = [e.states.index(s) for s in base.states]  # an effect may bring states of its own
    now, before = ca.vertcat(e.f[rows], e.h), ca.vertcat(base.f, base.h)
    if e.outputs != base.outputs:
        raise ModelError(f"{name} changes which outputs there are; keep them and their order")
    first = extended.symbol(own[0])
    nulls = ca.vertcat(*[extended.symbol(n) for n in own])
    values = [extended.parameters[n].start for n in own]
    slope = ca.substitute(ca.jacobian(now, first), nulls, ca.DM(values))
    at_null = ca.substitute(now, nulls, ca.DM(values))
    symbols = ca.symvar(ca.vertcat(ca.veccat(at_null, slope), before))
    found = [ca.densify(v) for v in (at_null, before, slope)]
    function = ca.Function("n", [ca.vertcat(*symbols)], found)
    rng = np.random.default_rng(11)
    signed = {*model.states, *model.inputs}
    felt = bool(extended.stages != model.stages)
    for _ in range(8):
        point = rng.uniform(0.2, 1.7, len(symbols))
        sign = [rng.choice([-1.0, 1.0]) if s.name() in signed else 1.0 for s in symbols]
        a, b, d = (np.asarray(v, dtype=float).ravel() for v in function(point * np.array(sign)))
        good = np.isfinite(b)
        if not np.all(np.isfinite(a[good])):
            raise ModelError(
                f"{name}: the extended model is not finite at {_values_text(own, values)}, where "
                "it must be the model; round what divides by zero or takes the root of it"
            )
        gap = np.abs(a - b)[good] / (1.0 + np.abs(b[good]))
        if np.max(gap, initial=0.0) > 1e-9:
            raise ModelError(
                f"{name}: at {_values_text(own, values)} the extended model is not the model (its "
                f"equations differ by {np.max(gap):.2g}), so there is no null value to test; "
                f"multiply what is added by {effect.parameters[0].name}, or give null="
            )
        felt = felt or bool(np.any(np.abs(d[np.isfinite(d)]) > 0.0))
    if not felt:
        raise ModelError(
            f"{name}: its first parameter {effect.parameters[0].name} changes nothing to first "
            "order at its null value, so no test can see it; let the term be linear in it there"
        )


def _check_units(extended: Model) -> None:
    try:
        check_units(extended)
    except ModelError as error:
        raise ModelError(
            f"{error}. A number has no unit: give one that has as a shape, "
            "further=[casid.Parameter(name, unit, value=number)]"
        ) from error


def _is_ours(effect: Effect) -> bool:
    """True for what the catalogue's own functions made."""
    maker = effect.apply.__module__ or ""
    return maker.startswith("casid.model.effects.") and maker != "casid.model.effects.user_effects"


def _values_text(names: Sequence[str], values: Sequence[float]) -> str:
    return ", ".join(f"{n} = {v:g}" for n, v in zip(names, values, strict=True))
