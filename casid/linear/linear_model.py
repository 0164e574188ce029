"""Linear models and their transfer functions, as expressions of the physical parameters.

A model is linearised about an equilibrium that holds for every parameter value,

    dx/dt = A(p) x + B(p) u,    y = C(p) x + D(p) u,                                        (1)

and its transfer functions C (sI - A)^-1 B + D follow from the Faddeev-LeVerrier recursion, which
divides by integers alone: polynomials in the entries of A, B, C, D, so that they can be
differentiated in p. What vanishes for all parameter values is found in exact rational arithmetic
and removed: states that are not controllable or not observable, coefficients, common factors s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.leverrier import faddeev_leverrier
from casid.algebra.vanishing import float_points, remove_zeros
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.linear.common_denominator import (
    CommonDenominator,
    packed,
    parameter_vector,
    unpacked,
)
from casid.model.declarations import Parameter
from casid.model.explicit_form import Explicit
from casid.model.model import Model
from casid.presentation import Presented

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, eq=False)
class LinearModel:
    """The model (1): deviations from an equilibrium that holds for all parameter values.

    Attributes
    ----------
    A (nx, nx), B (nx, nu), C (ny, nx), D (ny, nu) : SX, functions of `p`.
    p : (np,) SX, all parameters of the model in its order, named in `parameters`.
    known : the values of the parameters that are known.
    equilibrium : value (SX) of every state, input and output there; 0 unless stated otherwise.
    is_nonlinear : whether the model is, which this then holds for small deviations of alone.
    lost : parameters of the model that the linearisation does not depend on.
    """

    name: str
    A: Expr
    B: Expr
    C: Expr
    D: Expr
    p: Expr
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    description: tuple[Parameter, ...]
    equilibrium: Mapping[str, Expr]
    is_nonlinear: bool = False
    lost: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know: that the model is nonlinear, and what it has lost."""
        near = f"{self.name} is nonlinear: valid for small deviations from the equilibrium"
        lost = f"the linear model does not depend on {', '.join(self.lost)}"
        return (*([near] if self.is_nonlinear else []), *([lost] if self.lost else []))

    @property
    def known(self) -> dict[str, float]:
        """The known parameters' values."""
        return {q.name: q.value for q in self.description if q.value is not None}

    @cached_property
    def function(self) -> ca.Function:
        """p (np,) -> A, B, C, D."""
        matrices = [ca.densify(m) for m in (self.A, self.B, self.C, self.D)]
        return ca.Function("linear", [self.p], matrices, ["p"], ["A", "B", "C", "D"])

    def vector(self, values: Mapping[str, float] | None = None) -> Array:
        """The parameters (np,) in order; known ones have their value unless given here.

        Raises
        ------
        ModelError
            If an unknown parameter has no value, or a name is not a parameter.
        """
        return parameter_vector(self.name, self.description, values or {})

    def matrices(
        self, values: Mapping[str, float] | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D as numbers."""
        A, B, C, D = (np.array(m) for m in self.function(self.vector(values)))
        return A, B, C, D

    def to_control(self, values: Mapping[str, float] | None = None) -> Any:
        """A ``control.StateSpace`` with these parameter values."""
        import control

        return control.StateSpace(
            *self.matrices(values),
            states=list(self.states),
            inputs=list(self.inputs),
            outputs=list(self.outputs),
            name=self.name,
        )

    def subsystem(self, outputs: Sequence[str] | str | None = None) -> LinearModel:
        """The part between the inputs and these outputs (all by default): other states dropped.

        A state stays if, by the sparsity of A, B and C, an input reaches it and it an output.
        Where no input reaches a state that reaches an output, those states stay: a free decay.
        """
        if isinstance(outputs, str):
            outputs = (outputs,)
        outputs = self.outputs if outputs is None else tuple(outputs)
        rows = [self._output(o) for o in outputs]
        into = _pattern(self.A)
        C = self.C[rows, :]
        observed = _closure(into.T, np.any(_pattern(C), axis=0))
        reached = _closure(into, np.any(_pattern(self.B), axis=1))
        is_driven = (observed & reached).any() or _pattern(self.D[rows, :]).any()
        keep = observed & reached if is_driven else observed
        index = [int(i) for i in np.flatnonzero(keep)]
        return replace(
            self,
            A=self.A[index, index],
            B=self.B[index, :],
            C=C[:, index],
            D=self.D[rows, :],
            states=tuple(self.states[i] for i in index),
            outputs=outputs,
        )

    def transfer(self, outputs: Sequence[str] | str | None = None) -> TransferMatrix:
        """Transfer functions with one common denominator, of these outputs (all by default)."""
        part = self.subsystem(outputs)
        denominator, adjugate = adjugate_polynomials(part.A)
        n, nu, ny = len(part.states), len(self.inputs), len(part.outputs)
        flat = [denominator[k] for k in range(n + 1)]
        products = [ca.SX(ny, nu), *(part.C @ M @ part.B for M in adjugate)]
        for i in range(ny):
            for j in range(nu):
                flat += [products[k][i, j] + part.D[i, j] * denominator[k] for k in range(n + 1)]
        flat = remove_zeros(flat, self.p)
        rows = [flat[k * (n + 1) : (k + 1) * (n + 1)] for k in range(1 + ny * nu)]
        while n > 0 and all(row[n].nnz() == 0 for row in rows):  # a factor s common to all
            rows, n = [row[:n] for row in rows], n - 1
        columns = [_column(row) for row in rows]
        return TransferMatrix(
            name=self.name,
            denominator=columns[0],
            numerators=tuple(tuple(columns[1 + i * nu + j] for j in range(nu)) for i in range(ny)),
            p=self.p,
            inputs=self.inputs,
            outputs=part.outputs,
            parameters=self.parameters,
            description=self.description,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        expressions = [self.A, self.B, self.C, self.D, *self.equilibrium.values()]
        kept = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in "ABCDp"}
        kept["equilibrium"] = tuple(self.equilibrium)
        return _linear_from, (packed(self.p, expressions), kept)

    def _output(self, name: str) -> int:
        if name not in self.outputs:
            raise ModelError(f"{self.name} has no output {name!r}{nearest(name, self.outputs)}")
        return self.outputs.index(name)

    def __repr__(self) -> str:
        return (
            f"<LinearModel {self.name}: states {', '.join(self.states) or 'none'}; "
            f"inputs {', '.join(self.inputs) or 'none'}; outputs {', '.join(self.outputs)}>"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class TransferMatrix(CommonDenominator, Presented):
    """Rational transfer functions with a common denominator, as expressions of the parameters.

    Attributes
    ----------
    denominator : (n+1,) SX, descending powers of s, monic.
    numerators : [output][input] -> (n+1,) SX, descending powers of s; longer than the denominator
        where a transfer function is improper. Coefficients that vanish are structural zeros.
    """

    @property
    def is_proper(self) -> bool:
        """True if no numerator has a higher degree than the denominator."""
        return all(
            int(b[: b.numel() - 1 - self.order].nnz()) == 0
            for row in self.numerators
            for b in row
            if b.numel() > self.order + 1
        )

    def __repr__(self) -> str:
        return (
            f"<TransferMatrix {self.name}: {', '.join(self.outputs)} from "
            f"{', '.join(self.inputs) or 'nothing'}, order {self.order}>"
        )


@names_wrong_types()
def linearise(
    model: Model,
    *,
    x: Mapping[str, float | Expr] | None = None,
    u: Mapping[str, float | Expr] | None = None,
) -> LinearModel:
    """Linearise a model about an equilibrium.

    Parameters
    ----------
    x, u : state or input -> its value at the equilibrium [its unit], a number or an SX expression
        of the model's parameters; 0 for what is not given. Unknown inputs are inputs as others.

    Raises
    ------
    ModelError
        If a name is unknown, this is not an equilibrium for all parameter values, a derivative is
        not finite there, or the model has a delay, a clipping or a generated input.

    Example
    -------
    >>> import casid
    >>> import casadi as ca
    >>> m = casid.Model("pendulum")
    >>> phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    >>> w2 = m.parameter("w2", "1/s^2", start=9.0)
    >>> m.derivative(phi, p)
    >>> m.derivative(p, -w2 * ca.sin(phi))
    >>> _ = m.output("angle", phi, "rad")
    >>> casid.linearise(m)
    <LinearModel pendulum: states phi, p; inputs none; outputs angle>
    >>> casid.linearise(m).A[1, 0]
    SX((-w2))
    """
    _require_finite_order(model)
    e = model.explicit()
    point_x = _point(model.name, "state", e.states, x or {})
    point_u = _point(model.name, "input", e.inputs, u or {})
    symbols: Expr = ca.vertcat(e.x, e.u)
    point: Expr = ca.vertcat(point_x, point_u)

    def there(expression: Expr) -> Expr:
        return ca.substitute(ca.SX(expression), symbols, point)

    _require_equilibrium(model, e.states, there(e.f), e.p, point)
    nx = len(e.states)
    slopes = ca.jacobian(ca.vertcat(e.f, e.h), symbols)
    at = there(slopes)
    flat = remove_zeros([at[i, j] for j in range(at.size2()) for i in range(at.size1())], e.p)
    rows = at.size1()
    matrix = ca.SX(rows, at.size2())
    for k, entry in enumerate(flat):
        if entry.nnz():
            matrix[k % rows, k // rows] = entry
    _require_finite(model, matrix, e.p)
    values = {name: point[i] for i, name in enumerate((*e.states, *e.inputs))}
    h = there(e.h)
    return LinearModel(
        name=model.name,
        A=matrix[:nx, :nx],
        B=matrix[:nx, nx:],
        C=matrix[nx:, :nx],
        D=matrix[nx:, nx:],
        p=e.p,
        states=e.states,
        inputs=e.inputs,
        outputs=e.outputs,
        parameters=e.parameters,
        description=tuple(model.parameters[n] for n in e.parameters),
        equilibrium=values | {name: h[i] for i, name in enumerate(e.outputs)},
        is_nonlinear=bool(slopes.nnz() and any(ca.which_depends(ca.vec(slopes), symbols))),
        lost=_lost(model, e, matrix),
    )


def _require_finite_order(model: Model) -> None:
    for stage in model.stages:
        what = "clips" if stage.kind == "clip" else "delays"
        raise ModelError(
            f"{model.name}: the effect on {stage.channel} {what} it, which no linear model of "
            f"finite order does; linearise the model without that effect, or fit it by simulation"
        )
    for entry in model.inputs.values():
        if entry.kind == "generated":
            raise ModelError(
                f"{model.name}: {entry.name!r} changes the model with time; linearise the model "
                "without that effect, or fit it by simulation"
            )


def _lost(model: Model, e: Explicit, matrix: Expr) -> tuple[str, ...]:
    """Parameters that the equations of a model depend on, and its linearisation does not."""
    equations = ca.vertcat(e.f, e.h)
    used = [n for i, n in enumerate(e.parameters) if ca.depends_on(equations, e.p[i])]
    return tuple(n for n in used if not ca.depends_on(matrix, model.symbol(n)))


def notes_about_rest(linear: LinearModel) -> tuple[str, ...]:
    """The notes where the rest counts as well: a parameter that it depends on is not lost."""
    rest = ca.vertcat(*(ca.SX(value) for value in linear.equilibrium.values()))
    kept = [n for i, n in enumerate(linear.parameters) if ca.depends_on(rest, linear.p[i])]
    return replace(linear, lost=tuple(n for n in linear.lost if n not in kept)).notes


def adjugate_polynomials(A: Expr) -> tuple[Expr, list[Expr]]:
    """`faddeev_leverrier` of a square SX matrix: (n+1,) SX, and n matrices (n, n)."""
    coefficients, adjugate = faddeev_leverrier(A, ca.SX.eye(A.size1()), ca.SX(1), ca.trace)
    return ca.vertcat(*coefficients), adjugate


def _linear_from(function: ca.Function, fields: dict[str, Any]) -> LinearModel:
    p, (A, B, C, D, *values) = unpacked(function, fields["parameters"])
    fields["equilibrium"] = dict(zip(fields["equilibrium"], values, strict=True))
    return LinearModel(A=A, B=B, C=C, D=D, p=p, **fields)


# -- inside ------------------------------------------------------------------------------------


def _column(entries: Sequence[Expr]) -> Expr:
    """Scalars stacked, structural zeros kept."""
    column = ca.SX(len(entries), 1)
    for k, entry in enumerate(entries):
        if entry.nnz():
            column[k] = entry
    return column


def _pattern(matrix: Expr) -> Array:
    """True where an SX matrix has a structural nonzero."""
    return np.array(ca.DM(matrix.sparsity(), 1.0).full() != 0.0).reshape(matrix.shape)


def _closure(into: Array, start: Array) -> Array:
    """All nodes that can be reached from `start`; into[i, j]: an edge from j to i."""
    reached = np.asarray(start, dtype=bool).copy()
    for _ in range(len(reached)):
        more = reached | (into[:, reached].any(axis=1) if reached.any() else False)
        if (more == reached).all():
            break
        reached = more
    return reached


def _point(
    model: str, kind: str, names: tuple[str, ...], given: Mapping[str, float | Expr]
) -> Expr:
    for name in given:
        if name not in names:
            raise ModelError(
                f"{model} has no {kind} {name!r} to linearise about{nearest(name, names)}"
            )
    return ca.vertcat(*[ca.SX(given.get(name, 0.0)) for name in names])


def _require_equilibrium(
    model: Model, states: tuple[str, ...], f: Expr, p: Expr, point: Expr
) -> None:
    foreign = [s.name() for s in ca.symvar(point) if not ca.depends_on(p, s)]
    if foreign:
        raise ModelError(
            f"{model.name}: the equilibrium is given in terms of {', '.join(foreign)}; use numbers "
            "or the model's own parameters, model.symbol('...')"
        )
    moving = remove_zeros([f[i] for i in range(f.numel())], p)
    for name, rate in zip(states, moving, strict=True):
        if rate.nnz() and not rate.is_zero():
            raise ModelError(
                f"{model.name}: the point to linearise about is no equilibrium for all parameters, "
                f"d{name}/dt = {rate} there; give the values at rest, linearise(model, x=..., "
                "u=...), as numbers or expressions of the parameters, or drop the constant term"
            )


def _require_finite(model: Model, matrix: Expr, p: Expr) -> None:
    if matrix.nnz() == 0:
        return
    if not float_points(matrix.nz[:].elements(), p, 1):
        raise ModelError(
            f"{model.name}: a derivative is not finite at the point to linearise about (a root or "
            "a division by zero there); choose another equilibrium, linearise(model, x=..., u=...)"
        )
