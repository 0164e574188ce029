"""Feedforward from what was measured of unknown inputs: (6.22)-(6.24) of Linder (2017).

    u_K = u* + Gt_KI y_I + Gt_KD y_D + Gt_KA u_A,   Gt_KX = -Gt_OK^-1 Gt_OX,  X = I, D, A   (6.22)

makes y_O = Gt_OK u* + Ht_O tau (6.23): the unknown inputs are gone. The same filters with
Gt_KO = Gt_OK^-1 are the inverse model (6.24), u_K from y_O and the measurements. They can be
realisable although Gt_OK^-1 is not, where the delay or the zero is in Gt_OX too. Where they are
not, B Gt_KX with a scalar filter B leaves (1 - B) of the effect of the measurements.

u_K acts on y_I as well, and y_I on u_K: that loop is no part of (6.23), but it has to be stable. As
I - Gt_KI G_IK = Gt_OK^-1 G_OK, its poles are the zeros of y_O / u_K in the direct model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.algebra.realisation import matrices
from casid.algebra.roots import Root
from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError
from casid.model.quantities import count_text
from casid.unknown_inputs.indirect.approximate_inverse import ApproximateInverse
from casid.unknown_inputs.indirect.blocks import beside, improper_entries, product, unstable_poles
from casid.unknown_inputs.indirect.indirect_model import IndirectModel
from casid.unknown_inputs.indirect.left_inverse import LeftInverse, left_inverse


@dataclass(frozen=True, slots=True, eq=False)
class Feedforward:
    """The filters of (6.22) and (6.24), and whether they can be run.

    Attributes
    ----------
    model : the indirect model that they invert.
    inverse : of the transposed Gt_OK, whose transpose is Gt_OK^-1.
    G_KO : from y_O to u_K, Gt_OK^-1; for the inverse model alone.
    G_KI, G_KD, G_KA : from y_I, y_D and u_A to u_K.
    """

    model: IndirectModel
    inverse: LeftInverse
    G_KO: RationalMatrix
    G_KI: RationalMatrix
    G_KD: RationalMatrix
    G_KA: RationalMatrix

    @property
    def matrix(self) -> RationalMatrix:
        """From [y_I; y_D; u_A] to u_K."""
        return beside(self.G_KI, self.G_KD, self.G_KA)

    @property
    def is_realisable(self) -> bool:
        """Whether every filter of (6.22) is proper and stable, and the loop through y_I too."""
        return not self.obstacles

    @property
    def obstacles(self) -> tuple[str, ...]:
        """What keeps (6.22) from being run, with the zero and its frequency; none if it can."""
        reasons = [
            f"{to} / {name} looks {_steps(-g.relative_degree, g.variable)} ahead"
            for to, name, g in improper_entries(self.matrix)
        ]
        bad = unstable_poles(self.matrix)
        if bad:
            reasons.append(
                "unstable, from the zero " + "; ".join(str(r) for r in bad) + " of y_O / u_K"
            )
        if reasons:
            return tuple(reasons)
        loop = self.unstable_loop
        if loop:
            reasons.append(
                "the loop from u_K to y_I and back is unstable at "
                + "; ".join(str(r) for r in loop)
            )
        return tuple(reasons)

    @property
    def unstable_loop(self) -> tuple[Root, ...]:
        """Poles outside the stable region of (I - Gt_KI G_IK)^-1, the loop that (6.22) closes.

        Raises
        ------
        ModelError
            If the loop is algebraic and has no solution.
        """
        G_IK = self.model.direct.G_IK
        if 0 in G_IK.shape:
            return ()
        loop = product(self.G_KI, G_IK)
        if all(g.is_zero for row in loop.rows for g in row):
            return ()
        A, B, C, D = matrices(loop)
        one = np.eye(len(D))
        if abs(np.linalg.det(one - D)) < 1e-12:
            raise ModelError(
                "the loop from u_K to y_I and back is algebraic with gain one, so (6.22) has no "
                "solution; delay the measurement by a sample, or use another one"
            )
        closed = A + B @ np.linalg.solve(one - D, C)
        variable, Ts = loop.time
        roots = [Root(complex(v), variable or "q", Ts) for v in np.linalg.eigvals(closed)]
        return tuple(r for r in roots if not r.is_stable)

    def require_realisable(self) -> Feedforward:
        """Itself; a ModelError with zeros and approximations where (6.22) cannot be run."""
        if self.is_realisable:
            return self
        offers = "; ".join(str(a) for a in self.approximations())
        raise ModelError(
            f"feedforward to {', '.join(self.G_KO.outputs)}: {'; '.join(self.obstacles)}. Choose "
            "another actuator or measurement, or estimate a realisable inverse model directly, "
            "(6.24)" + (f"; or use an approximate inverse: {offers}" if offers else "")
        )

    def approximations(
        self, band: tuple[float, float] | None = None
    ) -> tuple[ApproximateInverse, ...]:
        """Filters B Gt_OK^-1 to use instead, each with the residual over a band [rad/s].

        The part |1 - B| of the effect of the measured signals stays in y_O.
        """
        return self.inverse.approximations(band)

    def approximated(self, by: ApproximateInverse) -> Feedforward:
        """The filters with B in them, one of `approximations` that runs forward in time.

        Raises
        ------
        ModelError
            If it does not: the noncausal one, which needs the whole record.
        """
        if by.kind == "noncausal":
            raise ModelError(
                "the noncausal inverse needs the future; feedforward cannot use it. Choose "
                "another of approximations()"
            )
        return _with_inverse(self.model, self.inverse, _transposed(by.f))

    def left_over(self, omega: Array) -> Array:
        """(F, n_O, n) response from [y_I; y_D; u_A] to y_O that feedforward leaves; 0 where exact.

        `omega` [rad/s]; [rad/sample] where Ts is not known.
        """
        m = self.model
        rest = beside(m.G_OI, m.G_OD, m.G_OA)
        K = m.G_OK.frequency_response(omega)
        return np.asarray(
            rest.frequency_response(omega) + K @ self.matrix.frequency_response(omega)
        )

    def __repr__(self) -> str:
        reasons = "; ".join(self.obstacles) or "realisable"
        return f"<Feedforward to {', '.join(self.G_KO.outputs)}: {reasons}>"

    def __str__(self) -> str:
        lines = [repr(self)]
        for to, row in zip(self.matrix.outputs, self.matrix.rows, strict=True):
            parts = [
                f"({g}) {name}"
                for name, g in zip(self.matrix.inputs, row, strict=True)
                if not g.is_zero
            ]
            lines.append(f"  {to} = " + " + ".join([f"{to}*", *parts]))
        if not self.is_realisable:
            lines += [f"  instead: {a}" for a in self.approximations()]
        return "\n".join(lines)


@names_wrong_types(ModelError)
def feedforward(model: IndirectModel) -> Feedforward:
    """The filters (6.22) and (6.24) of an indirect model.

    With more inputs u_K than outputs the inverse is the one `left_inverse` chooses of the
    transposed matrix, proper and stable where there is one.

    Raises
    ------
    ModelError
        If u_K does not reach every output independently (which one it does not), or parameters
        have no value.
    """
    if model.matrix.parameters:
        raise ModelError(
            f"feedforward needs numbers: no value is given for {', '.join(model.matrix.parameters)}"
            "; give them with values="
        )
    n_O, n_K = model.G_OK.shape
    if not n_K:
        raise ModelError(
            f"the model of {', '.join(model.direct.outputs)} has no known input u_K, so there is "
            "nothing to feed forward with; give G_OK"
        )
    if n_K < n_O or model.G_OK.rank() < n_O:
        raise ModelError(
            f"{n_K} inputs {', '.join(model.G_OK.inputs)} cannot move the {n_O} outputs "
            f"{', '.join(model.G_OK.outputs)} independently (rank {model.G_OK.rank()}); use as "
            "many actuators as outputs, or control fewer outputs"
        )
    across = left_inverse(_transposed(model.G_OK))
    return _with_inverse(model, across, _transposed(across.f))


def _with_inverse(model: IndirectModel, inverse: LeftInverse, f: RationalMatrix) -> Feedforward:
    return Feedforward(
        model=model,
        inverse=inverse,
        G_KO=f,
        G_KI=-product(f, model.G_OI),
        G_KD=-product(f, model.G_OD),
        G_KA=-product(f, model.G_OA),
    )


def _steps(n: int, variable: str) -> str:
    return count_text(n, "derivative" if variable == "s" else "sample")


def _transposed(G: RationalMatrix) -> RationalMatrix:
    return RationalMatrix(tuple(zip(*G.rows, strict=True)), G.inputs, G.outputs)
