"""An estimate and its images along the family of equivalent parameter values.

Where parameters can move along a curve without a change of any output (`family`), one of them is
given a value by choice. The estimate with any other choice is the image of this one along the
family, and so is its covariance: if theta' = f(theta, c') is the family through theta at c', then
theta_hat' = f(theta_hat, c') and cov theta' = F cov F', F = df/dtheta at c'. No data are needed for
that. The interval of a parameter whatever the choice is the union of its intervals over the choices
that the bounds admit; a parameter that the family does not move has its interval from the data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError
from casid.identifiability.combinations.family import Family, family
from casid.pickling import PickledByFields
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class AlongFamily(Presented, PickledByFields):
    """An estimate and its images along a family.

    Attributes
    ----------
    held : the parameter that was given a value by choice, `at`.
    lower, upper : values of it at which the first parameter leaves its bounds.
    stopped_by : which parameters those are.
    values, std_errors : of the estimate, given that choice.
    slopes : d value / d held at the estimate.
    ranges : (smallest, largest) image of the estimate between lower and upper.
    intervals : union of the intervals of all images; `level` for each of them, so at least that
        for the truth wherever it is on the family.
    """

    held: str
    at: float
    lower: float
    upper: float
    stopped_by: tuple[str, str]
    values: Mapping[str, float]
    std_errors: Mapping[str, float]
    slopes: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]]
    intervals: Mapping[str, tuple[float, float]]
    level: float

    def __post_init__(self) -> None:
        for name in ("values", "std_errors", "slopes", "ranges", "intervals"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def invariant(self) -> tuple[str, ...]:
        """Parameters that the family does not move: identifiable, whatever the choice."""
        return tuple(n for n, (low, high) in self.ranges.items() if low == high)

    def spread(self, name: str) -> float:
        """Width of a parameter's range over its standard error: below 1, the choice hardly matters.

        Infinite for what has no standard error and moves.
        """
        low, high = self.ranges[name]
        if low == high:
            return 0.0
        error = self.std_errors[name]
        return (high - low) / error if error > 0 else float("inf")

    def __repr__(self) -> str:
        return (
            f"<AlongFamily: {self.held} from {self.lower:.4g} to {self.upper:.4g}, "
            f"identifiable: {', '.join(self.invariant) or 'nothing'}>"
        )


def along_family(
    found: Family,
    values: Mapping[str, float],
    names: Sequence[str],
    covariance: Array,
    bounds: Mapping[str, tuple[float, float]],
    *,
    held: str | None = None,
    level: float = 0.95,
    points: int = 400,
) -> AlongFamily:
    """Move an estimate along the family of equivalent parameter values.

    Parameters
    ----------
    found : in closed form, from `casid.assess_identifiability(...).families`.
    values : number of every parameter and constant in its formulas, the estimate's among them.
    names : (n,) parameters that were estimated, the others taken as known.
    covariance : (n, n) of these.
    bounds : parameter -> (smallest, largest) value that is admitted; of the held one at least.
    held : the parameter of the family that was known by choice; default the one not in `names`.
    level : of the intervals, each for its own choice (normal approximation).
    points : on each side of the estimate at which bounds are checked.

    Raises
    ------
    IdentifiabilityError
        If no or more than one parameter of the family was held, there is no closed form along it, a
        value is missing, or the estimate itself lies outside the bounds.

    Notes
    -----
    The ends of the family are where its image of the estimate meets a bound; that the estimate is
    uncertain there as well is not counted.
    """
    held = _held_parameter(found, names, bounds, held)
    curve = found if found.free == held else family(found.direction.following(held))
    if not curve.is_closed or curve.free != held:
        raise IdentifiabilityError(
            f"no closed form of the family along {held}; hold {found.free} in its place"
        )
    image, slope = _compiled(curve, values, names)
    at, shown = float(values[held]), [*names, held]
    ends, stops = _ends(curve, at, image, shown, bounds, points)
    grid = np.unique(np.concatenate([np.linspace(*ends, 2 * points + 1), [at]]))
    images = np.array([image(float(t)) for t in grid])
    fixed = [n not in curve.moved for n in shown]
    images[:, fixed] = image(at)[fixed]
    errors = np.array([_errors(slope(float(t)), covariance) for t in grid])
    from scipy.special import ndtri

    width = float(ndtri(0.5 + level / 2))
    low, high = (images - width * errors).min(axis=0), (images + width * errors).max(axis=0)

    def by_name(column: Array) -> dict[str, float]:
        return dict(zip(shown, column.tolist(), strict=True))

    def pairs(lower: Array, upper: Array) -> dict[str, tuple[float, float]]:
        return {n: (float(a), float(b)) for n, a, b in zip(shown, lower, upper, strict=True)}

    return AlongFamily(
        held=held,
        at=at,
        lower=ends[0],
        upper=ends[1],
        stopped_by=stops,
        values=by_name(image(at)),
        std_errors=by_name(_errors(slope(at), covariance)),
        slopes=by_name(slope(at, speed=True)),
        ranges=pairs(images.min(axis=0), images.max(axis=0)),
        intervals=pairs(low, high),
        level=level,
    )


def _held_parameter(
    found: Family, names: Sequence[str], bounds: Mapping[str, tuple[float, float]], held: str | None
) -> str:
    """The parameter of the family that was given a value by choice.

    Raises
    ------
    IdentifiabilityError
        If there is no such parameter or more than one, or it has no finite bounds.
    """
    chosen = [n for n in found.moved if n not in names]
    if held is None and len(chosen) != 1:
        raise IdentifiabilityError(
            f"the family moves {', '.join(found.moved)}, of which "
            f"{', '.join(chosen) or 'none'} had a value by choice: one has to, no more; fix one "
            "of them and estimate the others, or name it with held="
        )
    held = held or chosen[0]
    if held not in found.moved or held in names:
        raise IdentifiabilityError(
            f"held = {held!r}: name a parameter of the family that was not estimated, one of "
            f"{', '.join(chosen) or 'none'}"
        )
    if held not in bounds or not np.all(np.isfinite(bounds[held])):
        raise IdentifiabilityError(
            f"{held} has no finite bounds, so the family has no end; give them: "
            f"bounds={{{held!r}: (smallest, largest)}}"
        )
    return held


def _ends(
    curve: Family,
    at: float,
    image: Callable[[float], Array],
    shown: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    points: int,
) -> tuple[tuple[float, float], tuple[str, str]]:
    """Values of the held parameter at which the first parameter leaves its bounds, and which."""

    def outside(t: float) -> str | None:
        """The first parameter that lies outside its bounds at t, None where all are inside."""
        moved = dict(zip(shown, image(t), strict=True))
        for n in curve.moved:
            low, high = bounds.get(n, (-np.inf, np.inf))
            room = 1e-9 * max(abs(low) if np.isfinite(low) else 0.0, abs(moved[n]), 1e-12)
            if not low - room <= moved[n] <= high + room:  # a pole is no number, and outside
                return n
        return None

    first = outside(at)
    if first is not None:
        raise IdentifiabilityError(
            f"the estimate has {first} = {dict(zip(shown, image(at), strict=True))[first]:.4g}, "
            f"outside its bounds {bounds[first]}; widen them, or estimate within them"
        )
    (lower, low), (upper, high) = (_end(at, float(b), outside, points) for b in bounds[curve.free])
    return (lower, upper), (low or curve.free, high or curve.free)


def _compiled(
    curve: Family, values: Mapping[str, float], names: Sequence[str]
) -> tuple[Callable[[float], Array], Callable[..., Array]]:
    """c' -> image (n + 1,), the held one last; c' -> df/dtheta (n + 1, n), or df/dc' (n + 1,)."""
    import sympy

    new = sympy.Symbol(curve.free + "'")
    shown = [*names, curve.free]
    formulas = [sympy.sympify(curve.formulas.get(n, sympy.Symbol(n))) for n in shown]
    needed = {s.name for f in formulas for s in f.free_symbols if s != new}
    missing = sorted(needed - set(values))
    if missing:
        raise IdentifiabilityError(
            f"the family along {curve.free} needs a value of {', '.join(missing)}; add it"
        )
    numbers = {sympy.Symbol(n): sympy.Float(float(values[n])) for n in needed}
    theta = [sympy.Symbol(n) for n in names]
    slopes = [[sympy.diff(f, s).xreplace(numbers) for s in theta] for f in formulas]
    speeds = [sympy.diff(f, new).xreplace(numbers) for f in formulas]
    compiled = [
        sympy.lambdify(new, e, "numpy")
        for e in ([f.xreplace(numbers) for f in formulas], slopes, speeds)
    ]

    def image(t: float) -> Array:
        """Values of the parameters shown at t; NaN at a pole."""
        with np.errstate(all="ignore"):
            try:
                return np.array(compiled[0](np.float64(t)), dtype=float)
            except ZeroDivisionError:
                return np.full(len(shown), np.nan)

    def slope(t: float, *, speed: bool = False) -> Array:
        return np.array(compiled[2 if speed else 1](np.float64(t)), dtype=float)

    return image, slope


def _errors(slope: Array, covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, covariance, slope), 0.0)))


def _end(
    at: float, limit: float, outside: Callable[[float], str | None], points: int
) -> tuple[float, str | None]:
    """The last admitted value between `at` and `limit`, and what is outside beyond it."""
    inside = at
    for t in np.linspace(at, limit, points + 1)[1:].tolist():
        stop = outside(t)
        if stop is None:
            inside = t
            continue
        beyond = t
        for _ in range(60):
            middle = (inside + beyond) / 2
            here = outside(middle)
            if here is None:
                inside = middle
            else:
                beyond, stop = middle, here
        return inside, stop
    return inside, None
