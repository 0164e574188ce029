"""Arbitrary unknown inputs eliminated: an equivalent system whose inputs are all known.

Outputs are differentiated along the field until an unknown input appears,

    y_i^(r) = a(x, theta, u, ...) + b(x, theta, u, ...) w_j + ...                              (1)

Then v = y_i^(r) is a known signal, w_j = (v - a - ...) / b is put into all equations, and the
others follow in the same way: the structure algorithm (`structure_algorithm`), and for r = 0 the
indirect model of Linder (2017, ch. 4). Each step maps the trajectories (x, w, y) one to one to
(x, v, y), and v is as arbitrary as w_j was. So the new system determines the same
functions of x(0) and theta, and for known inputs the observability rank has a proved stopping rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from casid.errors import ModelError, nearest
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.structure_algorithm import StructureAlgorithm, written


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """A system without unknown inputs, and how it was derived.

    Attributes
    ----------
    original, system : before, and after. An output that was used undifferentiated has become a
        known input of the same name (unless it is the only output); the derivative of an output has
        become a known input such as ``dy1`` or ``d2y1``; all other outputs are still there.
    used : unknown input -> (output, order): it was eliminated with that derivative of the output.
    solutions : symbol of the unknown input (of its derivative, if it is among `prolonged`) -> what
        it is, in the symbols of `system`.
    prolonged : unknown inputs that enter nonlinearly; they are states now, with unknown initial
        value, and what was eliminated is their derivative.
    unreached : unknown inputs that act on no output once the others are eliminated; they are zero
        in `system`, which changes no output.
    notes : all this in sentences.
    """

    original: System
    system: System
    used: Mapping[str, tuple[str, int]]
    solutions: Mapping[str, Any]
    prolonged: tuple[str, ...] = ()
    unreached: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        how = ", ".join(f"{w} with {written(y, r)}" for w, (y, r) in self.used.items())
        return f"<Elimination {self.original.name}: {how or 'nothing eliminated'}>"

    def __str__(self) -> str:
        return "\n".join([repr(self), *("  " + n for n in self.notes)])


def eliminate_unknown_inputs(
    system: System, *, using: Mapping[str, str] | None = None
) -> Elimination:
    """An equivalent system in which every input is known.

    Parameters
    ----------
    system : each of its unknown inputs is an arbitrary smooth signal.
    using : unknown input -> output it is to be eliminated with; the others are free. The choice
        does not change what is identifiable, only how the equations look.

    Returns
    -------
    Elimination. Which unknown input appears where is decided at random points, exactly for rational
    equations (`casid.algebra.vanishing`).

    Raises
    ------
    IdentifiabilityError
        If an unknown input never acts on its output in `using`; if the elimination divides by
        what is zero at an initial value that was given; or if the derivatives grow beyond
        `structure_algorithm.MAX_NODES`.
    ModelError
        If a name in `using` is not there.

    Example
    -------
    >>> import casadi as ca
    >>> from casid import System
    >>> from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
    >>> x, k, w = (ca.SX.sym(n) for n in ("x", "k", "w"))
    >>> symbols = {"x": x, "k": k, "w": w}
    >>> s = System("tank", ("x",), ("k",), ("level", "flow"), symbols, w - k * x,
    ...            ca.vertcat(x, k * x), unknown_inputs=("w",))
    >>> eliminate_unknown_inputs(s)
    <Elimination tank: w with d level/dt>
    """
    chosen = dict(using or {})
    _check_names(system, chosen)
    if not system.unknown_inputs:
        return Elimination(system, system, {}, {}, notes=("there are no unknown inputs",))
    algorithm = StructureAlgorithm(system, chosen)
    unreached = algorithm.run()
    return Elimination(
        system,
        algorithm.system,
        algorithm.used,
        algorithm.solutions,
        tuple(algorithm.prolonged),
        unreached,
        tuple(algorithm.notes),
    )


def _check_names(system: System, using: Mapping[str, str]) -> None:
    for w, y in using.items():
        for name, known in ((w, system.unknown_inputs), (y, system.outputs)):
            if name not in known:
                raise ModelError(f"{system.name}: using: {name!r} is unknown{nearest(name, known)}")
    twice = [y for y in using.values() if list(using.values()).count(y) > 1]
    if twice:
        raise ModelError(
            f"{system.name}: using: {twice[0]!r} is to eliminate two unknown inputs, but an "
            "output eliminates one; name another output"
        )
