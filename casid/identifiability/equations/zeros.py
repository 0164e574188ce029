"""Systems in which inputs or parameters are zero, unless their equations divide by them."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.identifiability.equations.formula_scope import is_finite
from casid.identifiability.equations.system import System
from casid.model.formula_text import shown_text
from casid.model.singular_parts import SingularPart, singular_part


def with_zeros(system: System, names: Sequence[str]) -> System:
    """A copy in which these are 0, and no longer declared.

    Raises
    ------
    ModelError
        If the equations then divide by zero, also where a factor of zero stands before the
        quotient: 0 * (q / 0) has no value.
    """
    changed = system.substituted(dict.fromkeys(names, 0.0))
    divided = _vanishing_divisor(system, names)
    if divided is None and is_finite(ca.vertcat(changed.f, changed.h)):
        return changed
    guilty = f" with {', '.join(names)} = 0" if names else ""
    what = f": the equations {divided.verb} {shown_text(divided.part)}" if divided else ""
    raise ModelError(
        f"{system.name}: division by zero at every point{guilty}{what}; correct that value, or "
        "rewrite the equation so that it does not divide by it"
    )


def _vanishing_divisor(system: System, zeros: Sequence[str]) -> SingularPart | None:
    """What has no finite value because these are zero, whatever the others are."""
    if not zeros:
        return None
    symbols = [system.symbols[n] for n in system.declared]
    point = np.array([0.0 if n in zeros else 1 / (2 + i) for i, n in enumerate(system.declared)])
    found = singular_part(ca.vertcat(system.f, system.h), ca.vertcat(*symbols), point)
    if found is None:
        return None
    left = ca.substitute(found.part, ca.vertcat(*[system.symbols[n] for n in zeros]), 0)
    return found if left.is_constant() else None
