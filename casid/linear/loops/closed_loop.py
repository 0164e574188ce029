"""The closed-loop view of an indirect model: the feedback in its inputs.

An output y_I that took an unknown input's place is an input of the indirect model, but no
experimenter chose it: it depends on the outputs y_O. Linearised, with p = d/dt,

    y_O = G_O(p) u_I + G_K(p) u_K + H_O(p) tau                                              (1)
    u_I = F_y(p) y_O + external,    external = F_K(p) u_K + F_w(p) w + F_tau(p) tau         (2)

w being the eliminated inputs, u_K the other ones, tau a disturbance in each balance. (1) and (2)
together are the direct model again. Their loop determines which estimators the disturbance biases:
Linder (2017), section 7.3.2, proposition 7.1 (the pendulum: F_y = (z_s p^2 + g)/p, external -a_y).

F_y is as a rule improper, and its bilinear image has poles on the unit circle: it is never
simulated. `ClosedLoopView.discrete` closes the loop in algebra first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from casid.algebra.factoring import factored
from casid.algebra.symbolic import exact
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.linear.laplace import Laplace, solve
from casid.linear.loops.discrete_loop import DiscreteLoop, bilinear
from casid.linear.loops.loop_consistency import Verdict, verdicts
from casid.model.model import Model
from casid.presentation import Presented

Algebra = Any  # a sympy expression or matrix

_WELL_POSED = 1e-6  # smallest leading coefficient of the loop, relative to its terms


@dataclass(frozen=True, eq=False)
class ForwardPath:
    """The indirect model (1): G_O (ny, nI), G_K (ny, nK), H_O (ny, nb)."""

    G_O: Algebra
    G_K: Algebra
    H_O: Algebra


@dataclass(frozen=True, eq=False)
class ReturnPath:
    """(2): F_y (nI, ny), F_K (nI, nK), F_w (nI, nI), F_tau (nI, nb).

    `used` : equations from which it was derived, beside the sensor's own.
    """

    F_y: Algebra
    F_K: Algebra
    F_w: Algebra
    F_tau: Algebra
    used: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ClosedLoopView(Presented):
    """An indirect model as a loop; sympy matrices of rational functions of `p`.

    Attributes
    ----------
    outputs : y_O, the outputs that stay, (ny).
    inputs : u_I, the outputs that became inputs, (nI).
    unknown : w, the inputs that were eliminated, (nI).
    others : u_K, all other inputs, (nK).
    disturbances : balances, each with a disturbance tau in its own unit, (nb).
    forward, back : (1) and (2); their matrices are attributes of the view, too.
    response : [y_O; u_I] from [w; u_K; tau] by the direct model's equations.
    p : sympy symbol of the derivative operator d/dt.
    parameters : names of the model's parameters, symbols of the same names in the matrices.
    values : name -> the model's own value, or start where it is not known.
    """

    name: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    unknown: tuple[str, ...]
    others: tuple[str, ...]
    disturbances: tuple[str, ...]
    forward: ForwardPath
    back: ReturnPath
    response: Algebra
    p: Algebra
    parameters: tuple[str, ...]
    values: Mapping[str, float]

    G_O = property(attrgetter("forward.G_O"))
    G_K = property(attrgetter("forward.G_K"))
    H_O = property(attrgetter("forward.H_O"))
    F_y = property(attrgetter("back.F_y"))
    F_K = property(attrgetter("back.F_K"))
    F_w = property(attrgetter("back.F_w"))
    F_tau = property(attrgetter("back.F_tau"))
    used = property(attrgetter("back.used"))

    def __getstate__(self) -> dict[str, Any]:
        """The fields: what was derived from them is derived anew, compiled functions above all."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    # -- the loop ----------------------------------------------------------------------------

    @property
    def disturbances_as_inputs(self) -> tuple[str, ...]:
        """What the disturbances are called where they drive the loop: ``tau_torque``, ..."""
        return tuple(f"tau_{name}" for name in self.disturbances)

    @cached_property
    def external(self) -> Algebra:
        """What drives the loop from outside, (nI, 1): -a_y for the pendulum."""
        import sympy

        def column(names: tuple[str, ...]) -> Algebra:
            return sympy.Matrix(len(names), 1, [sympy.Symbol(n) for n in names])

        u, w = column(self.others), column(self.unknown)
        tau = column(self.disturbances_as_inputs)
        return (self.F_K * u + self.F_w * w + self.F_tau * tau).applyfunc(sympy.expand)

    @cached_property
    def loop(self) -> Algebra:
        """The loop gain G_O F_y, (ny, ny)."""
        return (self.G_O * self.F_y).applyfunc(self._cancel)

    @cached_property
    def direct_term(self) -> Algebra:
        """lim_{p -> inf} G_O F_y, (ny, ny): what passes round the loop without delay."""
        return self.loop.applyfunc(self._limit)

    @property
    def has_direct_term(self) -> bool:
        """True if the loop's direct term is not identically zero."""
        return any(entry != 0 for entry in self.direct_term)

    @cached_property
    def is_degenerate(self) -> bool:
        """True if 1/(1 - G_O F_y) does not exist: u_I is a function of y_O and nothing else."""
        import sympy

        return bool(self._cancel((sympy.eye(len(self.outputs)) - self.loop).det()) == 0)

    @cached_property
    def closed(self) -> Algebra:
        """[y_O; u_I] from [w; u_K; tau] by closing the loop of (1) and (2), (ny + nI, ..)."""
        import sympy

        self._check_not_degenerate()
        ny = len(self.outputs)
        outside = sympy.Matrix.hstack(self.F_w, self.F_K, self.F_tau)
        nothing = sympy.zeros(ny, len(self.unknown))
        other = sympy.Matrix.hstack(nothing, self.G_K, self.H_O)
        y = solve(sympy.eye(ny) - self.loop, other + self.G_O * outside)
        return y.col_join(self.F_y * y + outside).applyfunc(self._cancel)

    def difference(self) -> Algebra:
        """The residual of (1) and (2) with the direct model's responses put in: zero.

        The proof of proposition 7.1, identically in all parameters. `response` is solved from the
        direct model's equations and do not use the loop; (1) and (2) have one solution unless
        `is_degenerate`.
        """
        import sympy

        ny, nw = len(self.outputs), len(self.unknown)
        y, u = self.response[:ny, :], self.response[ny:, :]
        forward = y - self.G_O * u - sympy.Matrix.hstack(sympy.zeros(ny, nw), self.G_K, self.H_O)
        back = u - self.F_y * y - sympy.Matrix.hstack(self.F_w, self.F_K, self.F_tau)
        return forward.col_join(back).applyfunc(self._cancel)

    def estimators(
        self, *, input_noise: bool = True, disturbed: bool = True
    ) -> tuple[Verdict, ...]:
        """Which estimators are consistent on this loop, and why not.

        Parameters
        ----------
        input_noise : the sensors of u_I have noise (errors in variables).
        disturbed : a disturbance tau acts.
        """
        return verdicts(
            self.outputs,
            self.inputs,
            direct_term=self.has_direct_term,
            input_noise=input_noise,
            disturbed=disturbed,
        )

    # -- numbers -----------------------------------------------------------------------------

    def at(self, matrix: Algebra, values: Mapping[str, float] | None = None) -> Algebra:
        """A matrix of this view with numbers for the parameters: entries functions of p alone."""
        import sympy

        swap = {
            sympy.Symbol(n): sympy.Rational(*exact(v).as_integer_ratio())
            for n, v in self._complete(values).items()
        }
        return matrix.subs(swap).applyfunc(self._cancel)

    def direct_term_at(self, values: Mapping[str, float] | None = None) -> Array:
        """The loop's direct term in numbers, (ny, ny); 1 - it is what the loop divides by."""
        return np.array(self.at(self.direct_term, values).tolist(), dtype=float)

    def poles(self, values: Mapping[str, float] | None = None) -> tuple[Array, Array]:
        """Poles [rad/s] of the indirect model (open loop) and of the direct one (closed loop).

        A stable plant may have an unstable indirect model: I_2 = I_1 - z_s S is small or negative.
        """
        complete = self._complete(values)
        return np.roots(self._open(complete)[1]), np.roots(self._closed(complete)[1])

    def discrete(self, Ts: float, values: Mapping[str, float] | None = None) -> DiscreteLoop:
        """The closed loop by the bilinear transformation, p = (2/Ts) (1 - q^-1)/(1 + q^-1).

        Parameters
        ----------
        Ts : sample time [s].
        values : name -> value, over the model's own.

        Returns
        -------
        DiscreteLoop, from w, u_K and tau to y_O and u_I.

        Raises
        ------
        ModelError
            If the loop is not well posed: det(I - G_O F_y) at p = 2/Ts is near zero, which is the
            leading coefficient 1 - (b0/c)(z_s c^2 + g) of the pendulum; or a name is wrong.

        Notes
        -----
        Bilinear sampling gives every loop with G_O F_y = O(1/p) a direct term of size O(Ts), too.

        Source: Linder (2017), (7.55), with the sign of proposition 7.1.
        """
        self._check_not_degenerate()
        given: Any = Ts
        if isinstance(given, str) or not given > 0:
            raise ModelError(f"{self.name}: sample time {Ts!r} s; give a positive one, a number")
        complete = self._complete(values)
        c = 2.0 / Ts
        columns = [complete[n] for n in self.parameters]
        with np.errstate(all="ignore"):
            loop = np.array(self._loop_function(c, *columns), dtype=float)
        ny = len(self.outputs)
        loop = loop.reshape(ny, ny)
        leading = float(np.linalg.det(np.eye(ny) - loop)) if np.all(np.isfinite(loop)) else np.nan
        if not abs(leading) > _WELL_POSED * (1.0 + float(np.max(np.abs(loop), initial=0.0))):
            raise ModelError(
                f"{self.name}: the loop at Ts = {Ts:g} s is not well posed, its leading "
                f"coefficient det(I - G_O F_y) is {leading:.2g}; check the parameters' values (an "
                "inertia of the direct model near zero), or take another sample time"
            )
        numerators, denominator = self._closed(complete)
        a = bilinear(denominator, Ts)
        rows = (*self.outputs, *self.inputs)
        signals = (*self.unknown, *self.others, *self.disturbances_as_inputs)
        b = {
            (row, signal): bilinear(numerators[i][j], Ts) / a[0]
            for i, row in enumerate(rows)
            for j, signal in enumerate(signals)
        }
        return DiscreteLoop(self.name, rows, signals, Ts, b, a / a[0], leading)

    # -- showing -----------------------------------------------------------------------------

    def __repr__(self) -> str:
        term = "a" if self.has_direct_term else "no"
        return (
            f"<ClosedLoopView {self.name}: {', '.join(self.inputs)} -> {', '.join(self.outputs)}, "
            f"fed back, {term} direct term>"
        )

    # -- inside ------------------------------------------------------------------------------

    def _check_not_degenerate(self) -> None:
        if self.is_degenerate:
            raise ModelError(
                f"{self.name}: {', '.join(self.inputs)} is determined by "
                f"{', '.join(self.outputs)} alone, so the indirect model holds whatever the "
                "parameters are; eliminate the unknown input with another output, one that it "
                "acts on directly"
            )

    def _complete(self, values: Mapping[str, float] | None) -> dict[str, float]:
        given = values or {}
        for name in given:
            if name not in self.parameters:
                raise ModelError(
                    f"{self.name} has no parameter {name!r}{nearest(name, self.parameters)}"
                )
        return {n: float(given.get(n, self.values[n])) for n in self.parameters}

    def _cancel(self, entry: Algebra) -> Algebra:
        import sympy

        return sympy.cancel(entry)

    def _limit(self, entry: Algebra) -> Algebra:
        import sympy

        num, den = (sympy.Poly(e, self.p) for e in sympy.fraction(entry))
        if num.is_zero or num.degree() < den.degree():
            return sympy.Integer(0)
        if num.degree() > den.degree():
            return sympy.oo
        return factored(sympy.cancel(num.LC() / den.LC()))

    @cached_property
    def _loop_function(self) -> Any:
        import sympy

        symbols = [self.p, *map(sympy.Symbol, self.parameters)]
        return sympy.lambdify(symbols, list(self.loop), modules="numpy", cse=True)

    @cached_property
    def _open(self) -> Any:
        return self._common(self.G_O.row_join(self.G_K))

    @cached_property
    def _closed(self) -> Any:
        return self._common(self.response)

    def _common(self, matrix: Algebra) -> Any:
        """Values -> numerators[i][j] and one denominator, descending in p, of equal length."""
        import sympy

        p = self.p
        den = sympy.Integer(1)
        for entry in matrix:
            den = sympy.lcm(den, sympy.fraction(sympy.cancel(entry))[1])
        table = [sympy.Poly(den, p)]
        for entry in matrix:
            table.append(sympy.Poly(sympy.cancel(entry * den), p))
        order = table[0].degree()
        if any(q.degree() > order for q in table[1:]):
            raise ModelError(
                f"{self.name}: a response of the direct model is improper, so it cannot be "
                "simulated; make a state of the signal whose derivative an output measures"
            )
        coefficients = [[q.coeff_monomial(p**k) for k in range(order, -1, -1)] for q in table]
        symbols = list(map(sympy.Symbol, self.parameters))
        function = sympy.lambdify(symbols, coefficients, modules="numpy", cse=True)
        rows, columns = matrix.shape

        def evaluate(values: Mapping[str, float]) -> tuple[Array, Array]:
            flat = np.array(function(*[values[n] for n in self.parameters]), dtype=float)
            return flat[1:].reshape(rows, columns, order + 1), flat[0]

        return evaluate


@names_wrong_types(ModelError)
def closed_loop_view(
    indirect: Model,
    *,
    equilibrium: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> ClosedLoopView:
    """Write an indirect model as a loop: G_O, F_y and the external signal.

    Parameters
    ----------
    indirect : a model after `eliminate`.
    equilibrium : state or input -> its value where the model is linearised; zero by default.
    values : parameters that are to be numbers; the others stay symbols (a model of many
        parameters and states is quicker with few symbols).

    Returns
    -------
    ClosedLoopView

    Raises
    ------
    ModelError
        If no input was eliminated, the point is no equilibrium, or a name is wrong.

    Notes
    -----
    The sensor's equation gives u_I in terms of the states. These are expressed by y_O through, in
    this order and no more of them than it takes: outputs free of derivatives, d(state)/dt = ...,
    the other outputs, balances without an unknown input, balances with one. Whatever else occurs in
    the equations used goes into the external signal. The view is exact for the linearised model.
    """
    laplace = Laplace(indirect, equilibrium or {}, values or {})
    nI, nK, ny = len(laplace.inputs), len(laplace.others), len(laplace.outputs)
    G = laplace.indirect()
    F, used = laplace.return_path()
    known = indirect.parameters
    start = {n: q.start if q.value is None else q.value for n, q in known.items()}
    return ClosedLoopView(
        name=indirect.name,
        outputs=laplace.outputs,
        inputs=laplace.inputs,
        unknown=laplace.unknown,
        others=laplace.others,
        disturbances=laplace.disturbances,
        forward=ForwardPath(G[:, :nI], G[:, nI : nI + nK], G[:, nI + nK :]),
        back=ReturnPath(
            F_y=F[:, :ny],
            F_w=F[:, ny : ny + nI],
            F_K=F[:, ny + nI : ny + nI + nK],
            F_tau=F[:, ny + nI + nK :],
            used=used,
        ),
        response=laplace.direct(),
        p=laplace.p,
        parameters=laplace.parameters,
        values={n: start[n] for n in laplace.parameters},
    )
