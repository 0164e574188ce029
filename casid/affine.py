"""Linear constraints on regression coefficients, found and not typed.

With some physical parameters known, the image of theta = g(theta_p) lies in an affine set

    B theta = b     for every value of the free parameters,                                     (1)

its affine hull. The hull is the same whatever open set the free parameters are drawn from, as g is
analytic: it is found from points spread over orders of magnitude (`affine_hull`), and proved from
the coefficients of polynomials (`symbolic_hull`). Where the hull has more dimensions than the image
itself, equations stay that are not linear: an estimator states them as theta = g(theta_p).

Linder (2017), section 7.3.4 and approach 5.1, has such rows derived by hand: (7.41)-(7.47).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.errors import IdentifiabilityError, ModelError
from casid.expressions import nearest
from casid.symbolic import evaluate_exactly, exact, rational_operations, walk

Array = np.ndarray[Any, Any]
Range = tuple[float, float]

# Rows and columns have entries of size one, so a singular value is a relative size. What lies
# between the two numbers is neither rounding for sure nor something else for sure.
_ROUNDING, _SEEN = 1e-12, 1e-10
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


def affine_hull(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    ranges: Mapping[str, Range] | None = None,
    coefficients: Sequence[str] = (),
    seed: int = 1,
) -> AffineHull:
    """Linear constraints that hold for every value of the free parameters.

    Parameters
    ----------
    g : SX function (np,) -> (n,), coefficients from physical parameters.
    parameters : names of the np parameters, in the order of g's argument.
    values : name -> value of every parameter that is not free; the value of a free one, where
        given, is the centre of its random draws. SI units.
    free : names of the parameters that vary.
    ranges : name -> (low, high) for the draws of a free parameter, either side may be infinite;
        default three orders of magnitude to both sides of its value (or of 1).
    coefficients : names of the n coefficients, for texts.
    seed : of the random draws.

    Returns
    -------
    AffineHull

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
    disagree because g's own constants are rounded, the singular values have the word.
    """
    draw = _Draw(parameters, values, free, ranges or {}, seed)
    n = _outputs(g, parameters)
    names = _coefficient_names(coefficients, n)
    rows = _sample(g, draw, 20 * (n + 1) + 40)
    scale = _column_scale(rows)
    _, singular, right = np.linalg.svd(rows / scale, full_matrices=False)
    singular = singular / singular[0]
    found, clear = _rank(singular)
    exact_rows = _exact_relations(g, draw, n)
    is_exact = exact_rows is not None and (len(exact_rows) == n + 1 - found or not clear)
    if is_exact and exact_rows is not None:
        relations = _largest_one([[float(v) for v in _bounded(row)] for row in exact_rows], n)
    elif not clear:
        raise IdentifiabilityError(
            "the number of linear constraints is unclear, the singular values are "
            f"{', '.join(f'{v:.1e}' for v in singular)}: give wider `ranges` of {', '.join(free)}"
        )
    else:
        relations = _largest_one(_reduced(right[found:], 1e-14 / singular[found - 1]) / scale, n)
    B, b = relations[:, :n], 0.0 - relations[:, n]
    residual = _residual(B, b, _sample(g, draw, 50))
    if residual > _VERIFIED:
        raise IdentifiabilityError(
            f"linear constraints found at some parameters fail at others (by {residual:.1e}): g is "
            "not one analytic function where it was drawn; give `ranges` inside one branch"
        )
    return AffineHull(
        B=B,
        b=b,
        rank=len(B),
        residual=residual,
        image_dimension=image_dimension(g, parameters, values, free, ranges=ranges, seed=seed),
        coefficients=names,
        free=tuple(free),
        known={name: draw.known[name] for name in parameters if name in draw.known},
        is_exact=is_exact,
        gap=float(singular[found - 1] / max(singular[found], 1e-16)) if found <= n else np.inf,
    )


def image_dimension(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    ranges: Mapping[str, Range] | None = None,
    seed: int = 1,
) -> int:
    """Dimension of the image of g: rank of its Jacobian in the free parameters, generically.

    Arguments and errors as `affine_hull`. The rank is the largest over random points, rows and
    columns scaled; for rational g exact arithmetic settles an unclear one.
    """
    draw = _Draw(parameters, values, free, ranges or {}, seed)
    _outputs(g, parameters)
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


@dataclass(frozen=True, slots=True, eq=False)
class SymbolicHull:
    """The affine hull with a proof: B theta = b identically in the free parameters.

    Attributes
    ----------
    B, b : sympy matrices (m, n) and (m, 1), in the known parameters' symbols, row echelon with
        pivots 1. They hold where no denominator of theirs and of g vanishes.
    known : names of the known parameters that stand in them.
    """

    B: Any
    b: Any
    coefficients: tuple[str, ...]
    free: tuple[str, ...]
    known: tuple[str, ...]
    _rows: Callable[..., Any] = field(repr=False)

    @property
    def rank(self) -> int:
        """The number of independent linear constraints."""
        return int(self.B.rows)

    @property
    def dimension(self) -> int:
        """Dimension of the hull: coefficients minus linear constraints."""
        return len(self.coefficients) - self.rank

    def numeric(self, values: Mapping[str, float]) -> tuple[Array, Array]:
        """B (m, n) and b (m,) at the known values, the largest entry of each row 1.

        Raises
        ------
        ModelError
            If a known parameter has no value, or a denominator vanishes at the values.
        """
        lacking = [name for name in self.known if name not in values]
        if lacking:
            raise ModelError(
                f"the constraints need the known value of {', '.join(lacking)}; add it to `values`"
            )
        n = len(self.coefficients)
        with np.errstate(all="ignore"):
            rows = self._rows(*[np.float64(values[name]) for name in self.known])
        full = np.array(rows, dtype=float).reshape(-1, n + 1)
        if not np.all(np.isfinite(full)):
            raise ModelError(
                "a constraint divides by a parameter combination that is zero at the known values; "
                "call affine_hull at these values instead"
            )
        full = _largest_one(full, n)
        return full[:, :n], 0.0 - full[:, n]

    def __str__(self) -> str:
        lines = [
            f"Coefficients {', '.join(self.coefficients)} with {', '.join(self.free) or 'nothing'} "
            f"free: linear constraints {self.rank}, hull of dimension {self.dimension}, proved"
        ]
        for i in range(self.rank):
            terms = [
                name if entry == 1 else f"({entry}) {name}"
                for entry, name in zip(self.B.row(i), self.coefficients, strict=True)
                if entry != 0
            ]
            lines.append(f"  {' + '.join(terms)} = {self.b[i]}")
        return "\n".join(lines)


def symbolic_hull(
    g: ca.Function,
    parameters: Sequence[str],
    values: Mapping[str, float],
    free: Sequence[str],
    *,
    coefficients: Sequence[str] = (),
    limit: int = 5000,
) -> SymbolicHull:
    """Prove the linear constraints: theta_i = num_i / den with polynomials in the free parameters.

    B theta = b for all free parameters is sum_i B_i num_i = b den, coefficient by coefficient: B
    and b are the null space of the matrix of coefficients, over the field of rational functions of
    the known parameters.

    Parameters
    ----------
    g, parameters, free, coefficients : as `affine_hull`.
    values : known parameters that are numbers, as the shortest decimal that gives the float; a
        known parameter without a value stays a symbol: ``{}`` gives the constraints in letters.
    limit : largest number of terms in a numerator or denominator on the way.

    Raises
    ------
    ModelError
        If a name is wrong, g is not rational (an exact hold has exponentials), or the polynomials
        outgrow `limit`; `affine_hull` minds neither.
    """
    import sympy
    from sympy.polys.matrices import DomainMatrix

    _check_names(parameters, values, free)
    n = _outputs(g, parameters)
    names = _coefficient_names(coefficients, n)
    letters = [p for p in parameters if p in free or p not in values]
    if not letters:
        letters = [parameters[0]]  # a field needs a generator
    symbols = {name: sympy.Symbol(name) for name in letters}
    quotients = sympy.QQ.frac_field(*symbols.values())
    inputs = [
        quotients.from_sympy(symbols[p])
        if p in free or p not in values
        else quotients(_rational_of(p, values))
        for p in parameters
    ]
    theta = walk(g, [inputs], _field_operations(limit), lambda v: quotients(_qq(exact(v))))[0]
    ring = quotients.field.ring
    den = ring.one
    for t in theta:
        den = den.lcm(t.denom)
    columns = [t.numer * den.exquo(t.denom) for t in theta] + [den]
    if max(len(c) for c in columns) > limit:
        raise _too_large(limit)
    # Monomials split into their free part, a row of the matrix, and their known part, its entries.
    is_free = [name in free for name in letters]
    known = [symbols[name] for name in letters if name not in free]
    K = sympy.QQ.frac_field(*known) if known else sympy.QQ
    table: dict[tuple[int, ...], list[Any]] = {}
    for j, polynomial in enumerate(columns):
        for powers, value in polynomial.terms():
            row = tuple(e for e, f in zip(powers, is_free, strict=True) if f)
            rest = tuple(e for e, f in zip(powers, is_free, strict=True) if not f)
            entry = K.field.ring({rest: value}) if known else value
            entries = table.setdefault(row, [K.zero] * (n + 1))
            entries[j] = entries[j] + K(entry)
    matrix = DomainMatrix(list(table.values()), (len(table), n + 1), K)
    basis = matrix.nullspace().rref()[0].to_Matrix()
    B = basis[:, :n].applyfunc(sympy.factor)
    b = (-basis[:, n:]).applyfunc(sympy.factor)
    both = B.row_join(-b)
    letters = [s for s in known if s in both.free_symbols]
    return SymbolicHull(
        B=B,
        b=b,
        coefficients=names,
        free=tuple(free),
        known=tuple(str(s) for s in letters),
        _rows=sympy.lambdify(letters, list(both), modules="numpy", cse=True),
    )


def check_consistent(
    B: Array,
    b: Array,
    *,
    labels: Sequence[str] = (),
    coefficients: Sequence[str] = (),
    tolerance: float = 1e-9,
) -> tuple[int, ...]:
    """Refuse linear constraints that no theta satisfies; return which rows are independent.

    Parameters
    ----------
    B : (m, n); b : (m,) constraints B theta = b, rows of any scale.
    labels : what each row is called, such as where it comes from; default "row 1", ...
    coefficients : names of theta's n entries, for texts.
    tolerance : of b, relative to the entries of a row; known values that were estimated before do
        not agree to the last digit.

    Returns
    -------
    Indices of independent rows that say all there is; the others follow from them.

    Raises
    ------
    ModelError
        If rows contradict each other (the fewest that do are named), hold non-finite numbers, or
        the shapes do not fit.

    Notes
    -----
    B theta = b has no solution if and only if some y has y'B = 0 and y'b != 0.
    """
    B, b = np.atleast_2d(np.asarray(B, dtype=float)), np.atleast_1d(np.asarray(b, dtype=float))
    if B.shape[0] != len(b):
        raise ModelError(
            f"linear constraints: B has {B.shape[0]} rows and b {len(b)} entries; give one entry "
            "of b for each row of B"
        )
    m, n = B.shape
    names = tuple(labels) or tuple(f"row {i + 1}" for i in range(m))
    if len(names) != m:
        raise ModelError(f"linear constraints: {len(names)} labels for {m} rows; give {m}")
    letters = _coefficient_names(coefficients, n)
    broken = np.flatnonzero(~np.isfinite(B).all(axis=1) | ~np.isfinite(b)).tolist()
    if broken:
        raise ModelError(
            f"linear constraints: {names[broken[0]]} holds a number that is not finite; look for a "
            "known parameter that is zero or missing and stands in a denominator"
        )
    size = np.maximum(np.max(np.abs(B), axis=1, initial=0.0), 1e-300)
    empty = [i for i in range(m) if not B[i].any()]
    for i in empty:
        if b[i] != 0:
            raise ModelError(
                f"linear constraints: {names[i]} reads 0 = {b[i]:g}, which no theta satisfies; "
                "take it out"
            )
    rows, right = B / size[:, None], b / size
    columns = np.maximum(np.max(np.abs(rows), axis=0, initial=0.0), 1e-300)
    rows = rows / columns
    kept: list[int] = []
    for i in range(m):
        if i in empty:
            continue
        trial = rows[[*kept, i]]
        singular = np.linalg.svd(trial, compute_uv=False)
        if len(trial) <= n and singular[-1] > 1e-10 * singular[0]:
            kept.append(i)
            continue
        # Row i is a combination of kept ones: y'rows[kept] = rows[i]. The same must hold for b.
        y = np.linalg.lstsq(rows[kept].T, rows[i], rcond=None)[0]
        y[np.abs(y) < 1e-9 * max(1.0, float(np.max(np.abs(y))))] = 0.0
        implied = float(y @ right[kept])
        terms = 1.0 + abs(right[i]) + float(np.abs(y) @ np.abs(right[kept]))
        if abs(implied - right[i]) > tolerance * terms:
            guilty = [names[k] for k, weight in zip(kept, y, strict=True) if weight != 0]
            raise ModelError(
                f"linear constraints contradict each other: {' and '.join(guilty)} imply "
                f"{relation(B[i], implied * size[i], letters)}, but {names[i]} has {b[i]:.6g} on "
                f"the right; drop one of {', '.join([*guilty, names[i]])}, or correct the known "
                "values they are made of"
            )
    return tuple(kept)


def relation(row: Array, value: float, coefficients: Sequence[str]) -> str:
    """A linear constraint as text: ``a1 + a2 + 0.02 b0 = -1``."""
    text = ""
    for weight, name in zip(np.asarray(row).tolist(), coefficients, strict=True):
        if weight == 0:
            continue
        size = f"{abs(weight):.6g}"
        factor = "" if size == "1" else f"{size} "
        sign = (" - " if weight < 0 else " + ") if text else ("-" if weight < 0 else "")
        text += f"{sign}{factor}{name}"
    return f"{text or '0'} = {value + 0.0:.6g}"


# -- drawing -------------------------------------------------------------------------------------


class _Draw:
    """Random parameters: the known ones at their values, the free ones over orders of magnitude."""

    def __init__(
        self,
        parameters: Sequence[str],
        values: Mapping[str, float],
        free: Sequence[str],
        ranges: Mapping[str, Range],
        seed: int,
    ) -> None:
        _check_names(parameters, values, free)
        for name in ranges:
            if name not in free:
                raise ModelError(
                    f"a range is given for {name!r}, which is not free{nearest(name, free)}"
                )
            low, high = ranges[name]
            if not low < high:
                raise ModelError(
                    f"range of {name}: ({low:g}, {high:g}) is empty; give (low, high), low < high"
                )
        lacking = [p for p in parameters if p not in free and p not in values]
        if lacking:
            raise ModelError(
                f"no value for the known {', '.join(lacking)}; add it to `values`, or name it "
                "among the free parameters"
            )
        self.parameters = tuple(parameters)
        self.free = tuple(free)
        self.known = {p: float(values[p]) for p in parameters if p not in free}
        bad = [p for p, v in self.known.items() if not np.isfinite(v)]
        if bad:
            raise ModelError(f"the known value of {bad[0]} is {self.known[bad[0]]}; give a number")
        self._centre = {p: float(values.get(p, 1.0)) for p in free}
        self._ranges = ranges
        self._rng = np.random.default_rng(seed)

    def point(self) -> Array:
        """One parameter vector, (np,)."""
        decades = self._rng.uniform(0.3, 3.0)
        drawn = {p: self._one(p, decades) for p in self.free}
        return np.array([self.known[p] if p in self.known else drawn[p] for p in self.parameters])

    def exact_point(self) -> list[Fraction]:
        """One parameter vector of short decimals."""
        return [
            exact(v) if p in self.known else exact(float(f"{v:.3e}"))
            for p, v in zip(self.parameters, self.point().tolist(), strict=True)
        ]

    def _one(self, name: str, decades: float) -> float:
        rng = self._rng
        low, high = self._ranges.get(name, (-np.inf, np.inf))
        if np.isfinite(low) and np.isfinite(high):
            if low * high > 0:
                ends = np.log(np.abs([low, high]))
                return float(np.sign(low) * np.exp(rng.uniform(ends.min(), ends.max())))
            return float(rng.uniform(low, high))
        centre = self._centre[name]
        size = (abs(centre) or 1.0) * 10.0 ** rng.uniform(-decades, decades)
        if np.isfinite(low):
            return float(low + size)
        if np.isfinite(high):
            return float(high - size)
        return float(size * (np.sign(centre) or rng.choice([-1.0, 1.0])))


def _sample(g: ca.Function, draw: _Draw, count: int) -> Array:
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
    return rank, bool(np.all((singular > _SEEN) | (singular < _ROUNDING)))


def _reduced(rows: Array, rounding: float) -> Array:
    """Reduced row echelon form with entries of size one; what is below rounding becomes zero."""
    rows = np.array(rows, dtype=float)
    done = 0
    for j in range(rows.shape[1]):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, j])))
        if abs(rows[pivot, j]) < 100 * rounding:
            rows[done:, j] = 0.0
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, j]
        for i in range(len(rows)):
            if i != done:
                rows[i] -= rows[i, j] * rows[done]
        done += 1
    size = np.max(np.abs(rows), axis=1, keepdims=True)
    rows[np.abs(rows) < rounding * size] = 0.0
    return rows


def _largest_one(rows: Any, n: int) -> Array:
    """Rows divided by their largest coefficient, with its sign; the last column follows."""
    out = np.asarray(rows, dtype=float).reshape(-1, n + 1)
    if not len(out):
        return out
    # The first of equals, so that rounding in the last digit does not choose the sign.
    size = np.abs(out[:, :n])
    first = np.argmax(size > 0.999999 * size.max(axis=1, keepdims=True), axis=1)
    return np.asarray(out / out[np.arange(len(out)), first][:, None] + 0.0)


def _residual(B: Array, b: Array, rows: Array) -> float:
    """Largest mismatch at rows [theta', 1], relative to the sum of the terms' sizes."""
    if not len(B):
        return 0.0
    full = np.hstack([B, -b[:, None]])
    mismatch = np.abs(rows @ full.T)
    terms = np.abs(rows) @ np.abs(full.T)
    return float(np.max(mismatch / np.maximum(terms, 1e-300)))


def _exact_points(f: ca.Function, draw: _Draw) -> Iterator[list[Fraction]]:
    """Values of a rational function at random points; ends at once for other functions."""
    for _ in range(200):
        try:
            yield evaluate_exactly(f, draw.exact_point())[0]
        except ZeroDivisionError:
            continue
        except (ModelError, OverflowError):
            return


def _exact_relations(g: ca.Function, draw: _Draw, n: int) -> list[list[Fraction]] | None:
    """Null space of the rows [theta', 1] in row echelon form, or None where g is not rational."""
    rows: list[list[Fraction]] = []
    for theta in _exact_points(g, draw):
        rows.append([*theta, Fraction(1)])
        if len(rows) == n + 4:
            break
    else:
        return None
    reduced, pivots = _echelon(rows)
    basis = []
    for j in range(n + 1):
        if j in pivots:
            continue
        vector = [Fraction(0)] * (n + 1)
        vector[j] = Fraction(1)
        for i, k in enumerate(pivots):
            vector[k] = -reduced[i][j]
        basis.append(vector)
    return _echelon(basis)[0]


def _exact_rank(J: ca.Function, draw: _Draw, columns: int) -> int | None:
    best = None
    for count, flat in enumerate(_exact_points(J, draw)):
        rows = len(flat) // columns
        matrix = [[flat[i + rows * j] for j in range(columns)] for i in range(rows)]
        best = max(best or 0, len(_echelon(matrix)[1]))
        if count == 2:
            break
    return best


def _echelon(rows: Sequence[Sequence[Fraction]]) -> tuple[list[list[Fraction]], list[int]]:
    """Reduced row echelon form in exact arithmetic, zero rows dropped, and the pivots' columns."""
    work = [list(row) for row in rows]
    pivots: list[int] = []
    for j in range(len(work[0]) if work else 0):
        done = len(pivots)
        pivot = next((i for i in range(done, len(work)) if work[i][j] != 0), None)
        if pivot is None:
            continue
        work[done], work[pivot] = work[pivot], work[done]
        factor = work[done][j]
        work[done] = [v / factor for v in work[done]]
        for i in range(len(work)):
            if i != done and work[i][j] != 0:
                factor = work[i][j]
                work[i] = [a - factor * c for a, c in zip(work[i], work[done], strict=True)]
        pivots.append(j)
    return work[: len(pivots)], pivots


def _bounded(row: Sequence[Fraction]) -> list[Fraction]:
    """A row divided by its largest entry, so that its entries are floats of ordinary size."""
    largest = max(row, key=abs)
    return [v / largest for v in row]


# -- names and kinds of numbers ------------------------------------------------------------------


def _check_names(
    parameters: Sequence[str], values: Mapping[str, float], free: Sequence[str]
) -> None:
    for name in (*free, *values):
        if name not in parameters:
            raise ModelError(
                f"{name!r} is not a parameter of the coefficients{nearest(name, parameters)}"
            )
    for names in (free, parameters):
        twice = [name for name in names if list(names).count(name) > 1]
        if twice:
            raise ModelError(f"parameter {twice[0]!r} is named twice; name it once")


def _outputs(g: ca.Function, parameters: Sequence[str]) -> int:
    if g.n_in() != 1 or g.n_out() != 1 or g.numel_in(0) != len(parameters):
        raise ModelError(
            f"{g.name()} takes {[g.numel_in(i) for i in range(g.n_in())]} entries; it must map one "
            f"vector of the {len(parameters)} parameters {', '.join(parameters)} to one vector"
        )
    return int(g.numel_out(0))


def _coefficient_names(names: Sequence[str], n: int) -> tuple[str, ...]:
    if names and len(names) != n:
        raise ModelError(f"{len(names)} names were given for {n} coefficients; give {n}")
    return tuple(names) or tuple(f"theta{i + 1}" for i in range(n))


def _qq(fraction: Fraction) -> Any:
    from sympy import QQ

    return QQ(fraction.numerator, fraction.denominator)


def _rational_of(name: str, values: Mapping[str, float]) -> Any:
    return _qq(exact(float(values[name])))


def _too_large(limit: int) -> ModelError:
    return ModelError(
        f"the coefficients have numerators of more than {limit} terms, too many to prove the "
        "constraints; give more known parameters as numbers in `values`, raise `limit`, or be "
        "content with affine_hull"
    )


def _field_operations(limit: int) -> dict[int, Callable[..., Any]]:
    """Operations on quotients of polynomials, guarded against their growth."""

    def guarded(operation: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            result = operation(*arguments)
            if len(result.numer) + len(result.denom) > limit:
                raise _too_large(limit)
            return result

        return run

    def power(base: Any, exponent: Any) -> Any:
        if not (exponent.numer.is_ground and exponent.denom.is_ground):
            raise ModelError(
                "a parameter stands in an exponent; such coefficients are not rational"
            )
        number = exponent.numer.LC / exponent.denom.LC if exponent.numer else 0
        if number != int(number):
            raise ModelError(f"a power with the exponent {number} is not rational; use affine_hull")
        return base ** int(number)

    return {code: guarded(op) for code, op in rational_operations(power).items()}
