"""Left inverses of transfer matrices, proper and stable where there is one: Assumption 4.3.

A square matrix has one inverse. A tall one has many: inverses of square selections of its rows are
tried first, the quietest of those that are proper and stable is taken, and where none is, a free
observer gain (`casid.unknown_inputs.indirect.observer_inverse`) finds one if no zero prevents it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

from casid.algebra.roots import Root
from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.quantities import count_text
from casid.unknown_inputs.indirect.approximate_inverse import ApproximateInverse, approximations
from casid.unknown_inputs.indirect.blocks import (
    excess,
    identity,
    is_stable,
    lies_outside,
    noise_gain,
    same,
    unstable_poles,
    zeros,
)
from casid.unknown_inputs.indirect.observer_inverse import observer_inverse


@dataclass(frozen=True, slots=True, eq=False)
class LeftInverse:
    """A left inverse f of G: f G = I.

    Attributes
    ----------
    G : (m, n), from what is sought to what is measured. f : (n, m).
    how : how f was found, in words.
    zeros : transmission zeros of G that no left inverse avoids (None where parameters have no
        value), all of them.
    """

    G: RationalMatrix
    f: RationalMatrix
    how: str
    zeros: tuple[Root, ...] | None

    @property
    def is_proper(self) -> bool:
        """Whether f is causal."""
        return self.f.is_proper

    @property
    def is_stable(self) -> bool:
        """Whether f is stable; a ModelError where parameters have no value."""
        return is_stable(self.f)

    @property
    def is_usable(self) -> bool:
        """Whether f can be run forward in time: proper and stable."""
        return self.is_proper and self.is_stable

    @property
    def excess(self) -> int:
        """How far f is improper: samples it looks ahead, or derivatives that it takes."""
        return excess(self.f)

    @property
    def unstable_zeros(self) -> tuple[Root, ...]:
        """Zeros of G that make f unstable, each with where it is and at what frequency."""
        return tuple(r for r in self.zeros or () if lies_outside(r))

    @property
    def obstacles(self) -> tuple[str, ...]:
        """What keeps f from being run forward in time, in words; none where it can be."""
        reasons = []
        if not self.is_proper:
            is_continuous = self.f.time[0] == "s"
            needs = count_text(self.excess, "derivative" if is_continuous else "sample")
            where = " (a zero at infinity)"
            reasons.append(
                f"f is improper: it needs {needs}{'' if is_continuous else ' ahead'}{where}"
            )
        if not self.f.parameters and not self.is_stable:
            bad = self.unstable_zeros or unstable_poles(self.f)
            reasons.append("f is unstable, from the zero " + "; ".join(str(r) for r in bad))
        return tuple(reasons)

    def approximations(
        self, band: tuple[float, float] | None = None
    ) -> tuple[ApproximateInverse, ...]:
        """Filters to use instead where f is improper or unstable, with their error over a band.

        See `casid.unknown_inputs.indirect.approximate_inverse`.
        """
        return approximations(self.f, self.G, band)

    def require_usable(self) -> LeftInverse:
        """Itself, refused where f cannot be run forward in time.

        Raises
        ------
        ModelError
            With the zero, its frequency, and the approximations with their errors.
        """
        if self.is_usable:
            return self
        offered = "; ".join(str(a) for a in self.approximations())
        raise ModelError(
            f"no left inverse from {', '.join(self.G.outputs)} to {', '.join(self.G.inputs)} is "
            f"proper and stable: {'; '.join(self.obstacles)}. Instead: {offered}"
        )

    def __repr__(self) -> str:
        if self.f.parameters:
            kind = "proper" if self.is_proper else "improper"
        else:
            kind = (
                f"{'proper' if self.is_proper else 'improper'}, "
                f"{'stable' if self.is_stable else 'unstable'}"
            )
        return f"<LeftInverse {self.G.shape[1]} x {self.G.shape[0]}, {kind}: {self.how}>"

    def __str__(self) -> str:
        lines = [repr(self), *str(self.f).split("\n")[1:]]
        return "\n".join(lines + [f"  {o}" for o in self.obstacles])


@names_wrong_types(ModelError)
def left_inverse(
    G: RationalMatrix,
    *,
    given: RationalMatrix | None = None,
    seen_through: RationalMatrix | None = None,
) -> LeftInverse:
    """A left inverse of G, proper and stable where one exists.

    Parameters
    ----------
    G : (m, n), m >= n.
    given : a left inverse (n, m) to be used; it is checked.
    seen_through : matrix L (j, n); what is to be proper and stable is L f, which it may be although
        f is not, where L and G share dynamics (Example 3.11). f itself is preferred if it can be.

    Returns
    -------
    LeftInverse
        Where no choice is proper and stable one that is proper, or the least improper; its
        `obstacles` say why, `approximations` what to do.

    Raises
    ------
    ModelError
        If G lacks full column rank (the inputs that cannot be recovered are named), or `given` is
        not a left inverse (the entry that is wrong is named).
    """
    m, n = G.shape
    if n == 0:
        return LeftInverse(G, zeros((), G.outputs), "nothing to invert", ())
    _require_full_rank(G)
    known = None if G.parameters else G.zeros()
    if given is not None:
        _require_left_inverse(given, G)
        named = RationalMatrix(given.rows, G.inputs, G.outputs)
        return LeftInverse(G, named, "as given", known)
    candidates = list(_row_inverses(G))
    if G.parameters:
        proper = [c for c in candidates if c[0].is_proper]
        f, how = (proper or candidates)[0]
        return LeftInverse(G, f, how, None)
    if m > n and not any(f.is_proper and is_stable(f) for f, _ in candidates):
        free = observer_inverse(G)
        if free is not None:
            candidates.insert(0, (free, "all measurements, with a free gain"))
    if seen_through is None or 0 in seen_through.shape:
        grade = _grade_of(lambda f: f)
    else:
        through = seen_through
        grade = _grade_of(lambda f: through @ f)
    if len(candidates) == 1:
        f, how = candidates[0]
    else:
        own = _grade_of(lambda f: f)
        f, how = min(candidates, key=lambda c: (own(c[0])[0], *grade(c[0])))
    return LeftInverse(G, f, how, known)


def lost_inputs(G: RationalMatrix) -> tuple[str, ...]:
    """Inputs that the outputs do not determine: G without their column has the same rank."""
    full = G.rank()
    rows = range(G.shape[0])
    return tuple(
        name
        for k, name in enumerate(G.inputs)
        if G.shape[1] > 1
        and G.select(rows, [i for i in range(G.shape[1]) if i != k]).rank() == full
        or G.shape[1] == 1
        and full == 0
    )


def _grade_of(
    of: Callable[[RationalMatrix], RationalMatrix],
) -> Callable[[RationalMatrix], tuple[int, int, float]]:
    """Orders candidates: usable, proper, least improper; then the quieter."""

    def grade(f: RationalMatrix) -> tuple[int, int, float]:
        """The worse a left inverse the larger: not causal, unstable, then by its gain of noise."""
        M = of(f)
        ahead, stable = excess(M), is_stable(M)
        kind = 0 if not ahead and stable else 1 if stable or not ahead else 2
        return kind, ahead, noise_gain(M) if kind == 0 else 0.0

    return grade


def _row_inverses(G: RationalMatrix) -> Iterator[tuple[RationalMatrix, str]]:
    """Inverses of all square selections of rows, filled with zeros."""
    m, n = G.shape
    for rows in combinations(range(m), n):
        square = G.select(rows, range(n))
        if m > n and square.rank() < n:
            continue
        inverse = square.inverse()
        blank = zeros(G.inputs, G.outputs).rows
        filled = [list(row) for row in blank]
        for i in range(n):
            for k, r in enumerate(rows):
                filled[i][r] = inverse.rows[i][k]
        how = "the inverse" if m == n else f"from {', '.join(square.outputs)} alone"
        yield RationalMatrix(tuple(tuple(r) for r in filled), G.inputs, G.outputs), how


def _require_full_rank(G: RationalMatrix) -> None:
    m, n = G.shape
    found = G.rank() if m else 0
    if found == n:
        return
    lost = lost_inputs(G) if m else G.inputs
    raise ModelError(
        f"{', '.join(lost)} cannot be recovered from {', '.join(G.outputs) or 'nothing'}: the "
        f"{m} x {n} transfer matrix has rank {found} of {n}. Measure another signal that they act "
        "on, or treat them as disturbances"
    )


def _require_left_inverse(f: RationalMatrix, G: RationalMatrix) -> None:
    if f.shape != G.shape[::-1]:
        raise ModelError(
            f"a left inverse of a {G.shape[0]} x {G.shape[1]} transfer matrix is "
            f"{G.shape[1]} x {G.shape[0]}, not {f.shape[0]} x {f.shape[1]}"
        )
    found = f @ G
    one = identity(G.inputs)
    if same(found, one):
        return
    for i, row in enumerate(found.rows):
        for k, g in enumerate(row):
            if not g.equals(one.rows[i][k]):
                raise ModelError(
                    f"the filter is no left inverse: f G from {G.inputs[k]} to {G.inputs[i]} is "
                    f"{g}, not {int(i == k)}; leave it out for one made of G"
                )
