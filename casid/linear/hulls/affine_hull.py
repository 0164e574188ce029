"""Linear constraints on regression coefficients, found and not typed.

With some physical parameters known, the image of theta = g(theta_p) lies in an affine set

    B theta = b     for every value of the free parameters,                                     (1)

its affine hull. The hull is the same whatever open set the free parameters are drawn from, as g is
analytic: it is found from points spread over orders of magnitude (`affine_hull`), and proved from
the coefficients of polynomials (`symbolic_hull`). Where the hull has more dimensions than the image
itself, equations stay that are not linear: an estimator states them as theta = g(theta_p).

Linder (2017), section 7.3.4 and approach 5.1, derives such rows on paper: (7.41)-(7.47).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca
import numpy as np

from casid.algebra.elimination import null_space, row_echelon
from casid.algebra.symbolic import evaluate_exactly
from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError, ModelError
from casid.linear.hulls.linear_constraints import coefficient_names, largest_one, relation
from casid.linear.hulls.parameter_draws import ParameterDraw, Range, count_of_coefficients
from casid.linear.hulls.symbolic_hull import SymbolicHull as SymbolicHull
from casid.linear.hulls.symbolic_hull import symbolic_hull as symbolic_hull

# Rows and columns have entries of size one, so a singular value is a relative size. What lies
# between the two numbers is neither rounding for sure nor something else for sure.
_ROUNDING, _NONZERO = 1e-12, 1e-10
_VERIFIED = 1e-8  # largest residual at fresh points, relative to the terms of the row


@dataclass(frozen=True, slots=True, eq=False)
class AffineHull:
    """All theta with B theta = b: the smallest affine set that holds g(theta_p).

    Attributes
    ----------
    B : (m, n), rows reduced (row echelon), the largest entry of each row 1.
    b : (m,)
    rank : m, the number of independent linear constraints.
    residual : largest abs(B theta - b) at fresh random parameters, relative to the row's terms.
    image_dimension : dimension of the image of g, at most that of the hull.
    is_exact : True if B and b were computed in rational arithmetic and rounded once.
    gap : ratio of the singular values on the two sides of the rank decision, infinite where no
        constraint was found.
    """

    B: Array
    b: Array
    rank: int
    residual: float
    image_dimension: int
    coefficients: tuple[str, ...]
    free: tuple[str, ...]
    known: Mapping[str, float]
    is_exact: bool
    gap: float

    @property
    def dimension(self) -> int:
        """Dimension of the hull: coefficients minus linear constraints."""
        return len(self.coefficients) - self.rank

    @property
    def nonlinear(self) -> int:
        """Number of equality constraints that no linear one can state."""
        return self.dimension - self.image_dimension

    def relations(self) -> tuple[str, ...]:
        """The constraints as text, one each row."""
        return tuple(
            relation(row, value, self.coefficients)
            for row, value in zip(self.B, self.b, strict=True)
        )

    def __repr__(self) -> str:
        return (
            f"<AffineHull of {len(self.coefficients)} coefficients: {self.rank} linear and "
            f"{self.nonlinear} nonlinear constraints; {', '.join(self.free) or 'nothing'} free>"
        )

    def __str__(self) -> str:
        lines = [
            f"Coefficients {', '.join(self.coefficients)} with {', '.join(self.free) or 'nothing'}"
            " free"
        ]
        lines += [f"  {line}" for line in self.relations()]
        rest = f"{self.nonlinear} nonlinear remain, theta = g(theta_p)" if self.nonlinear else ""
        lines.append(
            f"  linear constraints: {self.rank}, hull of dimension {self.dimension}, image of "
            f"dimension {self.image_dimension}: {rest or 'nothing else remains'}"
        )
        how = "rational arithmetic" if self.is_exact else "singular values"
        lines.append(
            f"  by {how} (gap {self.gap:.0e}), checked at fresh parameters to {self.residual:.0e}"
        )
        return "\n".join(lines)


@names_wrong_types(ModelError)
def affine_hull(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str] | str,
    *,
    ranges: Mapping[str, Range] | None = None,
    coefficients: Sequence[str] = (),
    seed: int = 1,
) -> AffineHull:
    """Linear constraints that hold for every value of the free parameters.

    ``equation.constraints(free, values)`` is the same for a `DifferenceEquation`, whose names and
    known values it fills in.

    Parameters
    ----------
    g : SX function (np,) -> (n,), coefficients from physical parameters.
    parameters : names of the np parameters, in the order of g's argument.
    values : name -> value of every parameter that is not free; the value of a free one, where
        given, is the centre of its random draws. SI units.
    free : names of the parameters that vary, or the name of one.
    ranges : name -> (low, high) for the draws of a free parameter, either side may be infinite;
        default three orders of magnitude to both sides of its value (or of 1).
    coefficients : names of the n coefficients, for texts.
    seed : of the random draws.

    Raises
    ------
    ModelError
        If a name is wrong, a known parameter has no value, or g is not finite where it is drawn.
    IdentifiabilityError
        If the rank cannot be decided, or the constraints fail at fresh parameters.

    Notes
    -----
    Rows [theta', 1] at random parameters, scaled to entries of size one; the null space gives (1).
    Where g is rational the same is done in exact arithmetic (rank right with probability one). That
    settles what the singular values leave open, and gives B without loss of digits; where the two
    disagree because g's own constants are rounded, the singular values decide.
    """
    free = (free,) if isinstance(free, str) else tuple(free)
    draw = ParameterDraw(parameters, values, free, ranges or {}, seed)
    n = count_of_coefficients(g, parameters)
    names = coefficient_names(coefficients, n)
    relations, is_exact, gap = _relations(g, draw, n)
    B, b = relations[:, :n], 0.0 - relations[:, n]
    residual = _verified_residual(B, b, _sample(g, draw, 50))
    return AffineHull(
        B=B,
        b=b,
        rank=len(B),
        residual=residual,
        image_dimension=image_dimension(g, parameters, values, free, ranges=ranges, seed=seed),
        coefficients=names,
        free=free,
        known={name: draw.known[name] for name in parameters if name in draw.known},
        is_exact=is_exact,
        gap=gap,
    )


def _relations(g: ca.Function, draw: ParameterDraw, n: int) -> tuple[Array, bool, float]:
    """Rows [B, -b], whether they are exact, and the gap of the rank decision."""
    rows = _sample(g, draw, 20 * (n + 1) + 40)
    scale = _column_scale(rows)
    _, singular, right = np.linalg.svd(rows / scale, full_matrices=False)
    singular = singular / singular[0]
    found, clear = _rank(singular)
    exact_rows = _exact_relations(g, draw, n)
    is_exact = exact_rows is not None and (len(exact_rows) == n + 1 - found or not clear)
    if is_exact and exact_rows is not None:
        relations = largest_one([[float(v) for v in _bounded(row)] for row in exact_rows], n)
    elif not clear:
        values = ", ".join(f"{v:.1e}" for v in singular)
        raise IdentifiabilityError(
            f"the number of linear constraints is unclear, the singular values are {values}: give "
            f"wider `ranges` of {', '.join(draw.free)}"
        )
    else:
        relations = largest_one(_reduced(right[found:], 1e-14 / singular[found - 1]) / scale, n)
    gap = float(singular[found - 1] / max(singular[found], 1e-16)) if found <= n else np.inf
    return relations, is_exact, gap


def image_dimension(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str] | str,
    *,
    ranges: Mapping[str, Range] | None = None,
    seed: int = 1,
) -> int:
    """Dimension of the image of g: rank of its Jacobian in the free parameters, generically.

    Arguments and errors as `affine_hull`. The rank is the largest over random points, rows and
    columns scaled; for rational g exact arithmetic settles an unclear one.
    """
    free = (free,) if isinstance(free, str) else tuple(free)
    draw = ParameterDraw(parameters, values, free, ranges or {}, seed)
    count_of_coefficients(g, parameters)
    if not free:
        return 0
    p = ca.SX.sym("p", len(parameters))
    columns = [draw.parameters.index(name) for name in free]
    J = ca.Function("J", [p], [ca.densify(ca.jacobian(g(p), p)[:, columns])])
    best, clear = 0, True
    for _ in range(12):
        point = draw.point()
        values_here = np.array(J(point)) * point[columns]
        if not np.all(np.isfinite(values_here)):
            continue
        for axis in (1, 0, 1, 0):  # rows and columns of size one
            size = np.max(np.abs(values_here), axis=axis, keepdims=True)
            values_here = values_here / np.where(size > 0, size, 1.0)
        singular = np.linalg.svd(values_here, compute_uv=False)
        if singular[0] == 0:
            continue
        singular = singular / singular[0]
        rank, is_clear = _rank(singular)
        if rank > best:
            best, clear = rank, is_clear
    if not clear:
        rank_there = _exact_rank(J, draw, len(columns))
        if rank_there is None:
            raise IdentifiabilityError(
                "the rank of the coefficients' Jacobian is unclear; give wider `ranges` of "
                f"{', '.join(free)}"
            )
        best = rank_there
    return best


def _sample(g: ca.Function, draw: ParameterDraw, count: int) -> Array:
    """Rows [theta', 1] at random parameters, each divided by its largest entry: (count, n + 1)."""
    rows = []
    for _ in range(10 * count):
        theta = np.array(g(draw.point())).ravel()
        if np.all(np.isfinite(theta)):
            row = np.append(theta, 1.0)
            rows.append(row / np.max(np.abs(row)))
            if len(rows) == count:
                return np.array(rows)
    raise ModelError(
        "the coefficients are not finite at most random parameters; give `ranges` of "
        f"{', '.join(draw.free)} in which the model makes sense"
    )


# -- ranks ---------------------------------------------------------------------------------------


def _column_scale(rows: Array) -> Array:
    size = np.sqrt(np.mean(rows**2, axis=0))
    return np.asarray(np.where(size > 1e-14 * size.max(), size, 1.0))


def _rank(singular: Array) -> tuple[int, bool]:
    """Number of singular values above rounding, and whether none lies in between."""
    rank = int(np.sum(singular > 1e-11))
    return rank, bool(np.all((singular > _NONZERO) | (singular < _ROUNDING)))


def _reduced(rows: Array, rounding: float) -> Array:
    """Reduced row echelon form with entries of size one; what is below rounding becomes zero."""
    found = row_echelon(rows.tolist(), is_zero=lambda v: abs(v) < 100 * rounding, size=abs)
    rows = np.array(found.rows).reshape(rows.shape)
    size = np.max(np.abs(rows), axis=1, keepdims=True)
    rows[np.abs(rows) < rounding * size] = 0.0
    return rows


def _verified_residual(B: Array, b: Array, rows: Array) -> float:
    """`_residual` at fresh points; refuses constraints that fail there."""
    residual = _residual(B, b, rows)
    if residual > _VERIFIED:
        raise IdentifiabilityError(
            f"linear constraints found at some parameters fail at others (by {residual:.1e}): g is "
            "not one analytic function where it was drawn; give `ranges` inside one branch"
        )
    return residual


def _residual(B: Array, b: Array, rows: Array) -> float:
    """Largest mismatch at rows [theta', 1], relative to the sum of the terms' sizes."""
    if not len(B):
        return 0.0
    full = np.hstack([B, -b[:, None]])
    mismatch = np.abs(rows @ full.T)
    terms = np.abs(rows) @ np.abs(full.T)
    return float(np.max(mismatch / np.maximum(terms, TINY)))


def _exact_points(f: ca.Function, draw: ParameterDraw) -> Iterator[list[Fraction]]:
    """Values of a rational function at random points; ends at once for other functions."""
    for _ in range(200):
        try:
            yield evaluate_exactly(f, draw.exact_point())[0]
        except ZeroDivisionError:
            continue
        except (ModelError, OverflowError):
            return


def _exact_relations(g: ca.Function, draw: ParameterDraw, n: int) -> list[list[Fraction]] | None:
    """Null space of the rows [theta', 1] in row echelon form, or None where g is not rational."""
    rows: list[list[Fraction]] = []
    for theta in _exact_points(g, draw):
        rows.append([*theta, Fraction(1)])
        if len(rows) == n + 4:
            break
    else:
        return None
    found = row_echelon(null_space(rows, Fraction(1)))
    return found.rows[: found.rank]


def _exact_rank(J: ca.Function, draw: ParameterDraw, columns: int) -> int | None:
    best = None
    for count, flat in enumerate(_exact_points(J, draw)):
        rows = len(flat) // columns
        matrix = [[flat[i + rows * j] for j in range(columns)] for i in range(rows)]
        best = max(best or 0, row_echelon(matrix, reduced=False).rank)
        if count == 2:
            break
    return best


def _bounded(row: Sequence[Fraction]) -> list[Fraction]:
    """A row divided by its largest entry, so that its entries are floats of ordinary size."""
    largest = max(row, key=abs)
    return [v / largest for v in row]
