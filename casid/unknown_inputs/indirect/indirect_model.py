"""The indirect model in transfer functions: (4.9)-(4.18) of Linder (2017).

    y_O = Gt_OK u_K + Gt_OI y_I + Gt_OD y_D + Gt_OA u_A + Ht_O tau                          (4.11)

    Gt_OI = G_OI f_II                                                                       (4.14)
    Gt_OK = G_OK - Gt_OI G_IK                                                               (4.15)
    Gt_OD = (G_OD - Gt_OI G_ID) f_DD                                                        (4.16)
    Gt_OA = -Gt_OI G_IA                                                                     (4.17)
    Ht_O  = H_O - Gt_OI H_I - Gt_OD H_D                                                     (4.18)

with left inverses f_II G_II = I and f_DD G_DD = I. It is an identity: exact, whatever they are.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.algebra.roots import Root
from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.unknown_inputs.indirect.blocks import (
    beside,
    difference,
    improper_entries,
    is_stable,
    product,
    unstable_poles,
)
from casid.unknown_inputs.indirect.direct_model import DirectModel
from casid.unknown_inputs.indirect.left_inverse import LeftInverse, left_inverse


@dataclass(frozen=True, slots=True, eq=False)
class IndirectModel:
    """Model (4.11).

    Attributes
    ----------
    direct : the model it was made of.
    f_II, f_DD : the left inverses.
    G_OK, G_OI, G_OD, G_OA, H_O : the blocks Gt_OK .. Ht_O, from u_K, y_I, y_D, u_A and tau.
    """

    direct: DirectModel
    f_II: LeftInverse
    f_DD: LeftInverse
    G_OK: RationalMatrix
    G_OI: RationalMatrix
    G_OD: RationalMatrix
    G_OA: RationalMatrix
    H_O: RationalMatrix

    @property
    def matrix(self) -> RationalMatrix:
        """Gt_O of (4.13), from [u_K; y_I; y_D; u_A] to y_O."""
        return beside(self.G_OK, self.G_OI, self.G_OD, self.G_OA)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of [u_K; y_I; y_D; u_A]."""
        return self.matrix.inputs

    @property
    def is_proper(self) -> bool:
        """Whether every input acts on y_O causally."""
        return self.matrix.is_proper

    @property
    def is_stable(self) -> bool:
        """Whether every input acts on y_O through stable dynamics; needs numbers."""
        return is_stable(self.matrix)

    @property
    def unstable_poles(self) -> tuple[Root, ...]:
        """Poles of (4.11) that are not stable; the direct model's zeros, if it is stable itself."""
        return unstable_poles(self.matrix)

    @property
    def has_direct_term(self) -> bool:
        """Whether a measured input acts on y_O within the sample.

        Its noise is then correlated with the equation error within the sample, and a loop through
        it is algebraic: direct prediction error estimates are biased (section 4.3.1).
        """
        blocks = (self.G_OI, self.G_OD)
        return any(
            g.relative_degree <= 0 for b in blocks for row in b.rows for g in row if not g.is_zero
        )

    @property
    def confounding_noise(self) -> tuple[str, ...]:
        """Noise that acts on the equation error and on a measured input as well."""
        d = self.direct
        found = []
        for k, name in enumerate(d.noise):
            in_error = any(not row[k].is_zero for row in self.H_O.rows)
            in_inputs = any(not row[k].is_zero for H in (d.H_I, d.H_D) for row in H.rows)
            if in_error and in_inputs:
                found.append(name)
        return tuple(found)

    @property
    def obstacles(self) -> tuple[str, ...]:
        """What keeps (4.11) from being simulated forward in time; none where it can be."""
        reasons = [
            f"{output} / {name} is improper (relative degree {g.relative_degree})"
            for output, name, g in improper_entries(self.matrix)
        ]
        if not self.matrix.parameters:
            bad = self.unstable_poles
            if bad:
                reasons.append("unstable at " + "; ".join(str(r) for r in bad))
        return tuple(reasons)

    def require_usable(self) -> IndirectModel:
        """Itself, refused where it cannot be simulated forward in time.

        Raises
        ------
        ModelError
            With the zero, its frequency, and the approximations that there are.
        """
        reasons = self.obstacles
        if not reasons:
            return self
        offers = [
            str(a)
            for inverse in (self.f_II, self.f_DD)
            if not inverse.is_usable
            for a in inverse.approximations()
        ]
        raise ModelError(
            f"the indirect model of {', '.join(self.direct.outputs)}: {'; '.join(reasons)}. "
            "Estimate it from its regression all the same (no stability is needed), choose another "
            "output (casid.unknown_inputs.indirect.output_choice)"
            + (f", or use an approximate inverse: {'; '.join(offers)}" if offers else "")
        )

    def __repr__(self) -> str:
        reasons = "; ".join(self.obstacles) or "proper and stable"
        if self.matrix.parameters and not self.obstacles:
            reasons = "proper"
        return (
            f"<IndirectModel of {', '.join(self.direct.outputs)} from {', '.join(self.inputs)}: "
            f"{reasons}>"
        )

    def __str__(self) -> str:
        lines = [repr(self), *str(self.matrix).split("\n")[1:]]
        for inverse, name in ((self.f_II, "f_II"), (self.f_DD, "f_DD")):
            if inverse.G.shape[1]:
                lines.append(f"  {name}: {inverse.how}")
                lines += [f"    {o}" for o in inverse.obstacles]
                if self.obstacles and not inverse.f.parameters:
                    lines += [f"    instead: {a}" for a in inverse.approximations()]
        if self.has_direct_term:
            lines.append("  a measured input acts within the sample: direct estimates are biased")
        if self.confounding_noise:
            lines.append(f"  in error and inputs both: {', '.join(self.confounding_noise)}")
        return "\n".join(lines)


@names_wrong_types(ModelError)
def indirect_model(
    direct: DirectModel,
    *,
    f_II: RationalMatrix | None = None,
    f_DD: RationalMatrix | None = None,
) -> IndirectModel:
    """Eliminate u_I and u_D, (4.11)-(4.18).

    Parameters
    ----------
    direct : the direct model, from `direct_model`.
    f_II, f_DD : left inverses of G_II and G_DD, if not those that `left_inverse` chooses: proper
        and stable ones where they exist, else such that Gt_OI is, if it can be.

    Raises
    ------
    ModelError
        If G_II or G_DD lacks full column rank (which inputs cannot be recovered), or a filter that
        is given is no left inverse.
    """
    d = direct
    II = left_inverse(d.G_II, given=f_II, seen_through=d.G_OI)
    Gt_OI = product(d.G_OI, II.f)
    rest = difference(d.G_OD, product(Gt_OI, d.G_ID))
    DD = left_inverse(d.G_DD, given=f_DD, seen_through=rest)
    Gt_OD = product(rest, DD.f)
    Gt_OA = product(Gt_OI, d.G_IA)
    return IndirectModel(
        direct=d,
        f_II=II,
        f_DD=DD,
        G_OK=difference(d.G_OK, product(Gt_OI, d.G_IK)),
        G_OI=Gt_OI,
        G_OD=Gt_OD,
        G_OA=-Gt_OA,
        H_O=difference(difference(d.H_O, product(Gt_OI, d.H_I)), product(Gt_OD, d.H_D)),
    )
