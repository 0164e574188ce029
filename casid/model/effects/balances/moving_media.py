"""A medium that moves: a wind, a current. Drag goes with the speed through it, not over ground.

Of drag in proportion to the speed that is a constant force, which is tested as one. Of drag that
grows faster the force of a wind depends on the speed, and no constant imitates it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.names import MEDIUM, WIND
from casid.model.effects.search_ranges import UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.rate_laws import addends
from casid.model.units import same_dimension


def moving_medium(model: Model, balance: str) -> Effect | None:
    """A medium that moves at w along the rate v of a balance: its drag is that of v - w.

    So is the drag in other balances that goes with the size of a speed of which v is a part. None
    where no drag grows faster than v, or v is no speed in m/s.
    """
    b = model.balances[balance]
    own = {name: len(other.terms) for name, other in model.balances.items()}
    is_speed = same_dimension(model.states[b.rate].unit, "m/s")
    if not is_speed or not any(_parts(model, term, b.rate)[0] for term in b.terms):
        return None
    w = Parameter(f"w_{b.rate}", model.states[b.rate].unit, 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        """Move the medium in the terms of the model, not in those that effects have added."""
        known_while_null(new, names)
        v = new.symbol(b.rate)
        for name, count in own.items():
            terms = list(new.balances[name].terms)
            for i, term in enumerate(terms[:count]):
                drag, rest = _parts(new, term, b.rate)
                if drag:
                    moved = ca.substitute(sum(drag), v, v - new.symbol(names[0]))
                    terms[i] = sum(rest, moved)
            new.balances[name] = replace(new.balances[name], terms=tuple(terms))
        new._explicit = None

    return Effect(
        "offset",
        balance,
        (w,),
        apply,
        shape=MEDIUM,
        description=f"{WIND} acts on {b.rate}, whose drag goes with {b.rate} - {w.name}",
    )


def moving_media_of(model: Model) -> Iterator[Effect]:
    """The speeds of media along every rate with drag that grows faster than it."""
    found = (moving_medium(model, balance) for balance in model.balances)
    return (effect for effect in found if effect is not None)


def _parts(model: Model, term: Any, rate: str) -> tuple[list[Any], list[Any]]:
    """The addends of a term that grow faster than a rate, zero where all rests, and the others."""
    v = model.symbol(rate)
    rates = [model.symbol(other.rate) for other in model.balances.values()]
    speeds = [model.symbol(n) for n, p in model.parameters.items() if same_dimension(p.unit, "m/s")]
    drag: list[Any] = []
    rest: list[Any] = []
    for part in addends(ca.SX(term)):
        is_bent = any(ca.which_depends(ca.jacobian(ca.SX(part), v), v))
        is_drag = is_bent and _grows(part, ca.vertcat(*rates, *speeds))
        (drag if is_drag else rest).append(part)
    return drag, rest


def _grows(term: Any, rates: Any) -> bool:
    """True if a term is zero at rest, and of twice the rates far more than twice as large."""
    others = ca.symvar(ca.SX(term))
    scaled = [ca.substitute(term, rates, k * rates) for k in (0.0, 1.0, 2.0)]
    values = ca.Function("f", others, scaled)
    rng = np.random.default_rng(3)
    draws = [values(*rng.uniform(0.2, 1.7, len(others))) for _ in range(3)]
    least = UNNAMED_EFFECTS.faster
    return all(
        abs(float(rest)) <= 1e-12 * abs(float(one)) and abs(float(two)) > least * abs(float(one))
        for rest, one, two in draws
    )
