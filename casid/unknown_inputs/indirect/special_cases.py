"""The classical problems that the indirect model contains: section 4.5 of Linder (2017).

Without feedback (u = F_delta delta): all inputs known is open-loop identification, all measured
directly is errors in variables, all measured indirectly is sensor-to-sensor identification (S2SID,
transmissibility). With u_K = F_y y_O + F_r delta the first is identification in closed loop,

    u_K = (I - F_y G_OK)^-1 (F_y H_O tau + F_r delta)                                       (4.57)

and the second errors in variables in closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.quantities import count_text
from casid.unknown_inputs.indirect.blocks import difference, identity, is_stable, product, same
from casid.unknown_inputs.indirect.direct_model import DirectModel


@dataclass(frozen=True, slots=True)
class SpecialCase:
    """What a direct model is called, and what that means for an estimate.

    Attributes
    ----------
    name : as in the literature; "indirect input measurements" where it is none of the special ones.
    means : what makes it so, and what to look out for.
    """

    name: str
    means: str

    def __str__(self) -> str:
        return f"{self.name}: {self.means}"


@names_wrong_types(ModelError)
def special_case(direct: DirectModel, *, feedback: bool = False) -> SpecialCase:
    """The special case of section 4.5 that a direct model is.

    Parameters
    ----------
    feedback : whether u depends on y_O (F_tau is not zero).
    """
    d = direct
    nK, nI, nD = d.G_OK.shape[1], d.G_OI.shape[1], d.G_OD.shape[1]
    outputs = "one output" if d.G_OK.shape[0] == 1 else f"{d.G_OK.shape[0]} outputs"
    if nI == nD == 0:
        inputs = "no input" if nK == 0 else count_text(nK, "known input")
        size = "SISO" if d.G_OK.shape == (1, 1) else "MIMO"
        if feedback:
            return SpecialCase(
                f"closed loop, {size}",
                f"{outputs} and {inputs} that depend on tau by feedback, (4.57): prediction error "
                "with the right noise model, or instruments from delta",
            )
        return SpecialCase(
            f"open loop, {size}",
            f"{outputs}, {inputs} free of noise: every consistent method applies",
        )
    if nK == nI == 0:
        square = d.G_DD.shape[0] == d.G_DD.shape[1]
        is_classical = square and same(d.G_DD, identity(d.G_OD.inputs))
        kind = "classical errors in variables" if is_classical else "errors in variables"
        how = "y_D = u_D + noise" if is_classical else "u_D measured through known dynamics G_DD"
        loop = ", and feedback" if feedback else ""
        return SpecialCase(
            f"{kind}, closed loop" if feedback else kind,
            f"{how}{loop}: the measurement's noise is in the input and in the equation error",
        )
    if nK == nD == 0:
        return SpecialCase(
            "sensor to sensor (S2SID), closed loop" if feedback else "sensor to sensor (S2SID)",
            "every input is had from other sensors: dynamics that they share, and the inputs "
            "themselves, cancel; the remainder is a transmissibility",
        )
    parts = [
        f"{count} {word}"
        for count, word in ((nK, "known"), (nI, "indirectly measured"), (nD, "directly measured"))
        if count
    ]
    return SpecialCase(
        "indirect input measurements, closed loop" if feedback else "indirect input measurements",
        f"inputs of several kinds ({', '.join(parts)}): the general model (4.11)",
    )


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoop:
    """(4.57): the known inputs as functions of noise and reference.

    Attributes
    ----------
    from_noise : (nK, n_tau); from_reference : (nK, n_delta).
    """

    from_noise: RationalMatrix
    from_reference: RationalMatrix

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable from tau and delta."""
        return is_stable(self.from_noise) and is_stable(self.from_reference)


def closed_loop(direct: DirectModel, F_y: RationalMatrix, F_r: RationalMatrix) -> ClosedLoop:
    """(4.57) for u_K = F_y y_O + F_r delta, all inputs known.

    Parameters
    ----------
    F_y : (nK, nO) feedback; F_r : (nK, n_delta) from the reference.

    Raises
    ------
    ModelError
        If there are other inputs than known ones, shapes do not fit, or the loop is ill posed: its
        direct terms make I - F_y G_OK singular at infinity, or everywhere.
    """
    d = direct
    if d.G_OI.shape[1] or d.G_OD.shape[1]:
        raise ModelError(
            "(4.57) is for known inputs alone; close the loop of the indirect model, whose inputs "
            "are all measured"
        )
    nK, nO = d.G_OK.shape[1], d.G_OK.shape[0]
    if F_y.shape != (nK, nO) or F_r.shape[0] != nK:
        raise ModelError(
            f"F_y is {F_y.shape} and F_r {F_r.shape}; give ({nK}, {nO}) and ({nK}, any)"
        )
    known = d.G_OK.inputs
    F_y = RationalMatrix(F_y.rows, known, d.outputs)
    F_r = RationalMatrix(F_r.rows, known, F_r.inputs)
    loop = difference(identity(known), product(F_y, d.G_OK))
    _require_well_posed(loop)
    S = loop.inverse()
    return ClosedLoop(product(S, product(F_y, d.H_O)), product(S, F_r))


def _require_well_posed(loop: RationalMatrix) -> None:
    from casid.algebra.minors import determinant

    value = determinant(loop.rows)
    if value.is_zero or value.is_strictly_proper:
        what = "is zero everywhere" if value.is_zero else "vanishes at infinity"
        raise ModelError(
            f"the loop is ill posed: det(I - F_y G_OK) {what}, its direct terms are an algebraic "
            "loop without a solution; put a delay of one sample into F_y or G_OK"
        )
