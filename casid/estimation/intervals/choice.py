"""Which kind of interval each unknown has, by a stated rule.

"auto": normal where the criterion is as good as a parabola (`quadratic_check`), by the profile of
the criterion where it is not. "quick": normal for all, "profile" for all parameters, "bootstrap"
for all unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from casid.arrays import Array
from casid.errors import DataError, nearest
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.intervals.bootstrap import Bootstrapped, bootstrapped
from casid.estimation.intervals.profile import ProfileInterval, profile_interval
from casid.estimation.intervals.quadratic_check import NotQuadratic, why_not_quadratic
from casid.estimation.intervals.scaled_criterion import (
    Minimum,
    ScaledCriterion,
    Tilted,
    tilted,
)
from casid.estimation.intervals.thresholds import BOOTSTRAP_RUNS, PROFILE_SEARCH
from casid.estimation.nlp.solution import Solution
from casid.estimation.simulation.fit import FitSettings
from casid.model.quantities import are, listed
from casid.time_limit import Undone, until, wall_clock

KINDS = ("auto", "quick", "profile", "bootstrap")
"""What may be requested."""

SOURCES = {
    "profile": (
        "J. T. Kent, Biometrika 69 (1982) 19-27: likelihood ratios of a misspecified model",
        "R. E. Chandler, S. Bate, Biometrika 94 (2007) 167-183: their scaling by the sandwich",
        "S. G. Self, K.-Y. Liang, J. Am. Stat. Assoc. 82 (1987) 605-610: at bounds",
    ),
    "bootstrap": ("B. Efron, J. Am. Stat. Assoc. 82 (1987) 171-185: bias-corrected percentiles",),
}
"""Papers behind an interval, by its kind."""

_TESTED = (
    "normal, the estimate +- 1.96 standard errors; tested: the criterion is quadratic that far "
    "from its minimum"
)
_UNTESTED = (
    "normal, the estimate +- 1.96 standard errors; whether the criterion is quadratic that far was "
    "not tested"
)
_PROFILE = (
    "what the criterion cannot reject with the other unknowns refitted, its rise scaled so that it "
    "agrees with the standard error where it is a parabola; noise as the standard errors assume it"
)
_ROOT = "; the bias of the inputs' noise taken from slope and curvature as at the estimate"
_NOT_NORMAL = (
    "{intervals} normal, though {why}: the bias of the inputs' noise is removed at "
    "the estimate alone, and no profile can be taken; simulate (--intervals bootstrap)"
)
_NO_PROFILE = (
    "the interval of {name} is normal, though {why}: the refits of its profile ended short of "
    "their minima; take it as rough"
)
_SIMULATED = (
    "bias-corrected percentiles of {runs} estimates from records simulated with this estimate and "
    "noise like its residual"
)


_REQUESTED = NotQuadratic("it is requested")


@dataclass(frozen=True, slots=True)
class Chosen:
    """Intervals that are not normal, and what each kind assumes.

    Attributes
    ----------
    ends : unknown -> its interval in SI.
    kinds : unknown -> "profile" or "bootstrap"; "quick" for all that are not in it.
    assumes : kind -> what such an interval assumes.
    warnings : unknowns whose normal interval means little and that have no other, and minima that
        are lower than the estimate.
    """

    ends: dict[str, tuple[float, float]] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    assumes: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Estimation:
    """An estimate whose intervals are sought.

    Attributes
    ----------
    fit : the minimum, or the root of equations.
    covariance : of the estimate, for a mask (n,) of the unknowns that are free.
    settings : of the fit.
    noise : channel -> standard deviation of its white noise, where stated.
    undetermined : names of unknowns that have no interval.
    found : what became of noise on the inputs of a fit by simulation; None of another one.
    """

    fit: Minimum
    covariance: Callable[[Array], Array]
    settings: FitSettings
    noise: Mapping[str, float]
    undetermined: Sequence[str] = ()
    found: Corrected | None = None

    @property
    def is_root(self) -> bool:
        """True if the estimate is no minimum, but without the bias of noise on inputs."""
        return self.found is not None and self.found.is_removed

    @property
    def parameters(self) -> list[str]:
        """Parameters whose intervals are sought."""
        c = self.fit.criterion
        return [
            v.name
            for v in c.variables
            if v.source in c.model.parameters
            and v.lower < v.upper
            and v.name not in self.undetermined
        ]


def by_mask(covariance: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """A covariance for a mask (n,) of free unknowns, computed once for each mask."""

    @cache
    def known(free: tuple[bool, ...]) -> Array:
        return covariance(np.array(free))

    return lambda free: known(tuple(free.tolist()))


def undetermined_in(estimate: Estimate, solution: Solution) -> list[str]:
    """Unknowns of an estimate that have no standard error, although no bound holds them."""
    rows = (*estimate.parameters, *estimate.initial_states)
    held = solution.active
    return [p.name for p in rows if p.std_error is None and p.name not in held]


def require_intervals(intervals: str) -> None:
    """Refuse a kind of intervals that there is none of.

    Raises
    ------
    DataError
        With the kinds that there are.
    """
    if intervals not in KINDS:
        raise DataError(
            f"intervals = {intervals!r}{nearest(intervals, KINDS)}: give one of {', '.join(KINDS)}"
        )


def chosen_intervals(
    estimation: Estimation,
    intervals: str,
    undone: Undone,
    progress: Callable[[str], None] = lambda _: None,
    patience: float = math.inf,
) -> Chosen:
    """The intervals of an estimate, of the requested kind; what time does not allow is normal.

    Parameters
    ----------
    patience : seconds that profiles which nobody requested may take.
    """
    chosen = Chosen(assumes={"quick": _UNTESTED})
    if intervals == "bootstrap":
        _bootstrap(estimation, undone, chosen, progress)
    elif intervals == "profile":
        _profiles(estimation, True, undone, chosen, progress)
    elif intervals == "auto":
        with until(wall_clock() + patience):
            _profiles(estimation, False, undone, chosen, progress)
    return chosen


def patience_since(began: float, budget: float | None) -> float:
    """Seconds that profiles which nobody requested may take after an estimate begun at `began`.

    No more than that took, twice over, or some seconds; a budget that is given is theirs to use.
    """
    if budget is not None:
        return math.inf
    return max(PROFILE_SEARCH.seconds, PROFILE_SEARCH.of_estimate * (wall_clock() - began))


def _bootstrap(
    estimation: Estimation, undone: Undone, chosen: Chosen, progress: Callable[[str], None]
) -> None:
    """All unknowns by simulation."""
    found = estimation.found
    assert found is not None

    def simulate() -> Bootstrapped | None:
        return bootstrapped(found, estimation.settings, estimation.noise, progress)

    done = undone.attempt("the bootstrap", simulate)
    if done is None:
        if "the bootstrap" not in undone.not_done:
            chosen.warnings.append(
                f"fewer than {BOOTSTRAP_RUNS.least} of {BOOTSTRAP_RUNS.runs} fits to simulated "
                "records ended: intervals are normal; give the bootstrap more time "
                "(--budget SECONDS), or take the profile (--intervals profile)"
            )
        return
    if done.not_done:
        undone.add(f"{done.not_done} of {BOOTSTRAP_RUNS.runs} simulated records of the bootstrap")
    inner = {v.name for v in found.fit.criterion.variables if v.is_inner}
    for name, value in found.fit.values.items():
        if name not in estimation.undetermined and name not in inner:
            chosen.ends[name] = done.interval(name, value)
            chosen.kinds[name] = "bootstrap"
    chosen.assumes["bootstrap"] = _SIMULATED.format(runs=len(done.values))


def _profiles(
    estimation: Estimation,
    all_of_them: bool,
    undone: Undone,
    chosen: Chosen,
    progress: Callable[[str], None],
) -> None:
    """The parameters by their profiles, all of them or where the quadratic test fails."""
    fit, root = estimation.fit, None
    if estimation.is_root:
        at_root = partial(tilted, fit, estimation.covariance(fit.solution.is_free))
        root = undone.attempt("the test whether intervals are normal", at_root)
        if root is None:
            return
    normal: dict[str, NotQuadratic] = {}
    for name in estimation.parameters:
        if estimation.is_root and name not in _free_names(fit):
            continue  # a root of equations has no size of its own beyond a bound

        def tested(name: str = name) -> tuple[ScaledCriterion, NotQuadratic | None]:
            scaled = _scaled(estimation, name, root)
            return scaled, _REQUESTED if all_of_them else why_not_quadratic(scaled, name)

        known = undone.attempt("the test whether intervals are normal", tested)
        if known is None:
            chosen.warnings.extend(normal_nevertheless(normal))
            return
        scaled, why = known
        if why is None:
            continue
        progress(f"profile of {name}: {why}")

        def profiled(scaled: ScaledCriterion = scaled, name: str = name) -> ProfileInterval:
            return profile_interval(scaled, name)

        interval = undone.attempt(f"the profile of {name}", profiled)
        if interval is None:
            continue
        if not interval.is_found:
            chosen.warnings.append(_NO_PROFILE.format(name=name, why=why))
        elif _is_of_root(scaled, name, interval):
            normal[name] = why
        else:
            _keep(chosen, name, interval, fit)
    chosen.warnings.extend(normal_nevertheless(normal))
    if not all_of_them and not fit.solution.constraint_jacobian.size:
        chosen.assumes["quick"] = _TESTED + (f", but not for {listed([*normal])}" if normal else "")
    if chosen.kinds:
        chosen.assumes["profile"] = _PROFILE + (_ROOT if estimation.is_root else "")


def normal_nevertheless(why: Mapping[str, NotQuadratic]) -> Iterator[str]:
    """A warning for each reason, which names every unknown that is normal in spite of it."""
    for reason in dict.fromkeys(each.reason for each in why.values()):
        names = [name for name, each in why.items() if each.reason == reason]
        of = "" if len(names) == 1 else " for {}"
        details = [why[n].detail + of.format(n) for n in names if why[n].detail]
        s = "" if len(names) == 1 else "s"
        yield _NOT_NORMAL.format(
            intervals=f"the interval{s} of {listed(names)} {are(len(names))}",
            why=NotQuadratic(reason, ", ".join(details)),
        )


def _is_of_root(scaled: ScaledCriterion, name: str, interval: ProfileInterval) -> bool:
    """True for a profile that means nothing, as it ends far from a root of equations."""
    ends = (interval.lower, interval.upper)
    is_far = any(scaled.is_far(end, scaled.names.index(name)) for end in ends)
    return scaled.is_root and (interval.lower_minimum is not None or is_far)


def _keep(chosen: Chosen, name: str, interval: ProfileInterval, fit: Minimum) -> None:
    chosen.ends[name] = _open_where_the_search_ends(name, interval, fit)
    chosen.kinds[name] = "profile"
    if interval.lower_minimum is not None:
        model = fit.criterion.model
        source = fit.criterion.variables[fit.criterion.names.index(name)].source
        there = model.shown(source, interval.lower_minimum)
        chosen.warnings.append(
            f"the criterion is lower than at the estimate where {name} is near {there:.4g}: the "
            "fit is a local minimum; give it more starts (--starts)"
        )


def _open_where_the_search_ends(
    name: str, interval: ProfileInterval, fit: Minimum
) -> tuple[float, float]:
    """The ends of a profile, without those that are where a search ended and not the quantity."""
    v = fit.criterion.variables[fit.criterion.names.index(name)]
    parameters = fit.criterion.model.parameters
    lower, upper = interval.lower, interval.upper
    if v.source in parameters and parameters[v.source].is_searched:
        lower = lower if lower > v.lower else -math.inf
        upper = upper if upper < v.upper else math.inf
    return lower, upper


def _free_names(fit: Minimum) -> list[str]:
    held = fit.solution.active
    return [name for name in fit.criterion.names if name not in held]


def _scaled(estimation: Estimation, name: str, root: Tilted | None) -> ScaledCriterion:
    """The criterion in units of an unknown's own error, which counts as free."""
    fit = estimation.fit
    free = set(_free_names(fit)) | {name}
    mask = np.array([n in free for n in fit.criterion.names])
    return ScaledCriterion(
        fit,
        estimation.covariance(mask),
        root=root,
        solver=estimation.settings.solver,
        constraints=estimation.settings.constraints,
    )


def with_intervals(estimate: Estimate, chosen: Chosen) -> Estimate:
    """The estimate, in SI, with its intervals and what they assume."""

    def row(p: Estimated) -> Estimated:
        if p.name not in chosen.ends:
            return p
        return replace(p, ends=chosen.ends[p.name], interval_kind=chosen.kinds[p.name])

    kinds = dict.fromkeys(chosen.kinds.values())
    papers = [paper for kind in kinds for paper in SOURCES[kind]]
    origin = replace(estimate.origin, sources=(*estimate.sources, *papers))
    return replace(
        estimate,
        parameters=tuple(row(p) for p in estimate.parameters),
        initial_states=tuple(row(p) for p in estimate.initial_states),
        uncertainty=replace(estimate.uncertainty, intervals=dict(chosen.assumes)),
        warnings=(*estimate.warnings, *chosen.warnings),
        origin=origin,
    )
