"""What is missing in one balance, or in one sensor: over time, and as functions of what is known.

Two estimates of the same force. Over time it is smoothed out of the residual (`smoothed_force`).
As a function, f = sum_j c_j b_j(v) with splines b_j of one variable, or of a variable times
piecewise linear functions of another, it is regressed where the noise is known: in the whitened
residual (`signatures`). Terms are taken in as long as the next is significant for all of them.
What the model's own parameters can absorb is in neither: a force is found up to that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.force_functions import (
    TIME,
    Group,
    Table,
    has_both_signs,
    hats,
    is_slope,
    knots_of,
    slope_of,
    splines,
    units_of,
    variables_of,
)
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.residual.signatures import Regression, Tested, require_place
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import FUNCTIONS, SCORES, TERMS
from casid.diagnosis.unexplained.smoothed_force import SmoothedForce, smoothed_force
from casid.diagnosis.unexplained.variables import variable_words
from casid.estimation.feedback import slope
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.simulation.minimization import Fit
from casid.model.model import Model

SINE = "a sine in time"
"""Name of what repeats at a line of the spectrum."""

GROWTH = {
    0.0: "a sign, whatever the size",
    0.5: "saturating",
    1.0: "in proportion to the size",
    2.0: "growing about as the square",
    3.0: "growing about as the cube",
    4.0: "growing about as the fourth power",
    5.0: "growing steeply, like an end stop",
}
"""What the power of |v| that fits best is called."""


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """One term of the missing force."""

    variables: tuple[str, ...]  # (v,), or (carrier, what its coefficient depends on)
    share: float  # of the misfit, 0..1, in the order in which terms were taken in
    p_value: float  # family-wise
    gain: float  # squares explained, in units of the noise
    parity: str  # "odd", "even", "neither" or "" where the variable has one sign only
    power: float | None  # of |v| that fits best
    size: float  # coefficient of that power's function, at the variable's own scale
    growth: str  # in words
    rivals: tuple[tuple[str, ...], ...]  # other variables that explain nearly as much
    at: Array  # (K,) of the variable (the last of `variables`)
    value: Array  # (K,) force, or coefficient of the carrier
    sd: Array  # (K,)

    @property
    def words(self) -> str:
        """The dependence in plain words."""
        if not self.variables:
            return "a constant"
        shape = ", ".join(
            w for w in (self.parity if self.parity != "neither" else "", self.growth) if w
        )
        label = f" ({shape})" if shape else ""
        first, *others = map(variable_words, self.variables)
        if not others:
            return f"{first}{label}"
        return f"{first}, by a factor that depends on {others[0]}{label}"

    def to_json(self) -> dict[str, Any]:
        """Numbers and words, with the curve."""
        return {
            "variables": list(self.variables),
            "share": self.share,
            "p_value": self.p_value,
            "parity": self.parity,
            "power": self.power,
            "growth": self.growth,
            "words": self.words,
            "rivals": [list(r) for r in self.rivals],
            "curve": {"at": self.at.tolist(), "value": self.value.tolist(), "sd": self.sd.tolist()},
        }


@dataclass(frozen=True, slots=True, eq=False)
class MissingForce:
    """A missing force or sensor error in one place, over time and as functions."""

    place: str
    unit: str
    is_balance: bool
    units: Mapping[str, str]  # of the variables
    misfit: float  # squares left beyond the noise, in units of the noise
    misfit_sd: float  # by chance
    explained: float  # share of the misfit that the terms explain, 0..1
    score: float  # squares explained less what as many functions cost: compares places
    dependences: tuple[Dependence, ...]
    independent_of: tuple[str, ...]  # variables that neither have a term nor rival one
    over_time: SmoothedForce | None

    @property
    def leading(self) -> Dependence | None:
        """The first term."""
        return self.dependences[0] if self.dependences else None


def missing_force(
    at: Weighted,
    experiments: Sequence[Experiment],
    balance: str,
    *,
    recorded: Mapping[str, str] | None = None,
    alpha: float = 0.05,
    with_series: bool = True,
    seed: int = 0,
    linearised: Linearised | None = None,
) -> MissingForce:
    """Estimate what is missing in `balance`, on what it depends and when it acts.

    Parameters
    ----------
    at : a model fitted under its noise.
    balance : a balance of the model, or one of its outputs: then an error of that sensor.
    recorded : channels beside the model's on which it may depend, name -> unit.
    alpha : family-wise rate at which a term is selected by chance.
    with_series : whether to smooth it over time as well.
    linearised : of the fit that is tested, where it is there already.

    Raises
    ------
    ModelError
        If the model has no such balance or output.

    Notes
    -----
    Powers are those of a heuristic list; parity is that of the best of them.
    """
    recorded = dict(recorded or {})
    fit, noise = quiet_fit(at)
    criterion, x = fit.criterion, fit.x
    require_place(criterion, balance)
    linearised = linearised or Linearised(criterion, x)
    joined = joined_table(fit, experiments, recorded, balance)
    over_time = None
    if with_series:
        over_time = smoothed_force(criterion, x, noise, balance, at.input_sd, linearised)
    line = over_time.spectrum.line if over_time is not None else None
    groups, knots = candidate_groups(fit, joined, balance, line)
    regression = Regression(
        fit,
        noise,
        balance,
        groups,
        experiments,
        input_sd=at.input_sd,
        recorded=recorded,
        linearised=linearised,
        seed=seed,
    )
    terms = _select_terms(regression, at.full, alpha=alpha)
    dependences = _describe(regression, terms, joined, knots)
    own = {v for g in groups for v in g.names}
    known, free = units_of(criterion.model, recorded), own - terms.dependent
    return MissingForce(
        place=balance,
        unit=_unit_in(criterion.model, balance),
        is_balance=balance in criterion.model.balances,
        units={v: known.get(v, "") for v in own},
        misfit=regression.misfit,
        misfit_sd=regression.misfit_sd,
        explained=float(min(sum(d.share for d in dependences), 1.0)),
        score=sum(t.gain - terms.charge * t.rank for t in terms.chosen),
        dependences=dependences,
        independent_of=tuple(v for v in joined if v in free and not is_slope(v)),
        over_time=over_time,
    )


def _unit_in(model: Model, place: str) -> str:
    """The unit of a force in a balance, or of an error of an output."""
    return model.balances[place].unit if place in model.balances else model.outputs[place][1]


@dataclass(frozen=True, slots=True)
class _Terms:
    """Terms of the missing force, as selected."""

    charge: float  # squares that one function costs
    chosen: tuple[Tested, ...]
    rivals: tuple[tuple[tuple[str, ...], ...], ...]  # of each, variables that explain as much
    dependent: frozenset[str]  # variables of terms and rivals


def _select_terms(
    regression: Regression,
    full: NoiseModel,
    *,
    alpha: float,
) -> _Terms:
    """Forward selection at level `alpha`; `full` is the noise with what may be a disturbance."""
    groups = regression.groups
    charge = float(np.log(len(regression.e)))
    loud: Regression | None = None
    chosen: list[Tested] = []
    rivals: list[tuple[tuple[str, ...], ...]] = []
    dependent: set[str] = set()
    for _ in range(TERMS.most):
        found = regression.test([t.group for t in chosen], charge=charge)
        if not found:
            break
        # A term that explains little of what is missing is a shape's imperfection, not a cause.
        best = _simplest(found, groups, charge)
        total = max(regression.misfit, chosen[0].gain if chosen else best.gain)
        is_small = bool(chosen) and best.gain - best.chance < TERMS.small * total
        if best.adjusted >= alpha or best.gain <= charge * best.rank or is_small:
            break
        # Under the sensors' noise alone a disturbance is coloured, and a few of its swings decide:
        # a term must be significant where what may be a disturbance counts as noise, too.
        loud = loud or regression.changed(noise=full)
        again = {t.group: t for t in loud.test([t.group for t in chosen])}
        if best.group not in again or again[best.group].adjusted >= alpha:
            break
        chosen.append(best)
        merit = TERMS.near * (best.gain - charge * best.rank)
        near = [
            groups[t.group].names
            for t in sorted(found, key=lambda t: -t.gain)
            if t is not best and t.gain - charge * t.rank > merit
        ]
        rivals.append(tuple(n for n in near if n)[: TERMS.rivals])
        dependent.update(groups[best.group].names, *near)
    return _Terms(charge, tuple(chosen), tuple(rivals), frozenset(dependent))


def _simplest(found: Sequence[Tested], groups: Sequence[Group], charge: float) -> Tested:
    """The term that explains most for its number of functions; of nearly equal ones, the simplest.

    One variable is simpler than a product of two: what an input does to a state, a product of that
    input imitates.
    """

    def merit(t: Tested) -> float:
        return t.gain - charge * t.rank

    best = max(found, key=merit)
    near = [t for t in found if merit(t) > TERMS.near * merit(best)]
    fewest = min((len(groups[t.group].names) for t in near), default=0)
    return max((t for t in near if len(groups[t.group].names) == fewest), key=merit, default=best)


def quiet_fit(at: Weighted) -> tuple[Fit, NoiseModel]:
    """The estimate to test, and the noise of its sensors and measured inputs alone."""
    return at.unbiased or at.fit, at.full.quiet(at.input_sd)


def joined_table(
    fit: Fit, experiments: Sequence[Experiment], recorded: Mapping[str, str], place: str
) -> dict[str, Array]:
    """The variables over all records, end to end; those that never move are left out."""
    criterion = fit.criterion
    tables = []
    for k, d in enumerate(criterion.data):
        sim = criterion.simulated(fit.x, k)
        table = variables_of(criterion, experiments, recorded, k, sim, d)
        if place in criterion.outputs:
            y = sim.y[:, criterion.outputs.index(place)]
            own = slope(y, d.Ts, backward=False, anew=criterion.starts_anew(k))
            table |= {place: y, slope_of(place): own}
        tables.append(table)
    joined = {name: np.concatenate([t[name] for t in tables]) for name in tables[0]}
    return {name: v for name, v in joined.items() if np.ptp(v) > 1e-12 * np.max(np.abs(v))}


def candidate_groups(
    fit: Fit, joined: Table, place: str, line: float | None = None
) -> tuple[list[Group], dict[tuple[str, ...], Array]]:
    """Functions of each variable, and of each state or input times functions of another.

    Of slopes the linear function alone: a late or early channel. With a `line` [Hz] in the
    spectrum, sines there as well, as far apart as the record resolves.
    """
    model = fit.criterion.model
    is_balance = place in model.balances
    groups, knots = [Group((), lambda t: np.ones((len(t[TIME]), 1)))], {}

    def add(names: tuple[str, ...], count: int) -> None:
        """Add the piecewise linear functions of the last name, times the first of two."""
        last = names[-1]
        bends = knots_of(last, joined[last], count)
        if len(bends) < 2:
            return
        knots[names] = bends
        carrier = names[0] if len(names) > 1 else None
        groups.append(Group(names, lambda t: _columns(t, last, bends, carrier)))

    if line is not None:
        apart = TERMS.line_width / float(np.ptp(joined[TIME]))
        found = 2 * np.pi * np.array([line - apart, line, line + apart])
        groups.append(Group((SINE,), lambda t: _sines(t[TIME], found)))
    for name in joined:
        if is_slope(name):
            groups.append(Group((name,), lambda t, name=name: t[name][:, None]))  # type: ignore[misc]
        else:
            add((name,), FUNCTIONS.bends)
    carriers = [*model.states, *model.inputs] if is_balance else [place]
    for carrier in carriers:
        for name in joined:
            if name != carrier and carrier in joined and not is_slope(name):
                add((carrier, name), FUNCTIONS.product_bends)
    return groups, knots


def _sines(t: Array, omega: Array) -> Array:
    phase = np.multiply.outer(t, omega)
    return np.hstack([np.cos(phase), np.sin(phase)])


def _columns(table: Table, last: str, knots: Array, carrier: str | None) -> Array:
    if carrier is not None:
        return hats(table[last], knots) * table[carrier][:, None]
    # Time has jumps; what depends on a state seldom has, but grows.
    return (hats if last == TIME else splines)(table[last], knots)


# -- what a term looks like -----------------------------------------------------------------------


def _describe(
    regression: Regression,
    terms: _Terms,
    joined: Table,
    knots: Mapping[tuple[str, ...], Array],
) -> tuple[Dependence, ...]:
    """The terms in the order in which they were taken in, with their shares of the misfit."""
    chosen = terms.chosen
    if not chosen:
        return ()
    total = max(regression.misfit, sum(t.gain - t.chance for t in chosen), TINY)
    coefficients, covariance = regression.estimate([t.group for t in chosen])
    out, first = [], 0
    for k, t in enumerate(chosen):
        group = regression.groups[t.group]
        width = regression.slices[t.group].stop - regression.slices[t.group].start
        part = slice(first, first + width)
        first += width
        parity, power, size = "", None, 0.0
        names = group.names
        if names and (names[-1] in (TIME, SINE) or is_slope(names[-1])):
            names = ()
        if names:
            others = [regression.groups[o.group] for o in chosen if o is not t]
            parity, power, size = _shape(regression, group, others, joined)
        growth = GROWTH[power] if power is not None else ""
        if group.names and group.names[-1] == TIME:
            growth = _in_time(knots[group.names], coefficients[part])
        out.append(
            Dependence(
                variables=group.names,
                share=float(np.clip((t.gain - t.chance) / total, 0.0, 1.0)),
                p_value=t.adjusted,
                gain=t.gain,
                parity=parity,
                power=power,
                size=size,
                growth=growth,
                rivals=terms.rivals[k],
                at=knots.get(group.names, np.zeros(1)),
                value=coefficients[part],
                sd=np.sqrt(np.maximum(np.diag(covariance)[part], 0.0)),
            )
        )
    return tuple(out)


def _in_time(t: Array, value: Array) -> str:
    """Change of a force or coefficient over the record, in words."""
    steps = np.diff(value)
    travel = float(np.sum(np.abs(steps)))
    if travel <= 0:
        return ""
    j = int(np.argmax(np.abs(steps)))
    if abs(steps[j]) > TERMS.step * travel:
        return f"a step between {t[j]:.3g} and {t[j + 1]:.3g} s"
    if abs(value[-1] - value[0]) > TERMS.trend * travel:
        return "rising over the record" if value[-1] > value[0] else "falling over the record"
    return "coming and going"


def _shape(
    regression: Regression,
    group: Group,
    others: Sequence[Group],
    joined: Table,
) -> tuple[str, float | None, float]:
    """Parity, power and coefficient of the function that fits best, the other terms given.

    Each candidate is fitted alone beside the tangent: a shape is chosen by what it explains.
    """
    last, values = group.names[-1], joined[group.names[-1]]
    carrier = group.names[0] if len(group.names) > 1 else None
    scale = float(np.sqrt(np.mean(values**2)))
    shapes: list[tuple[str, float]] = []
    if has_both_signs(values):
        shapes += [("odd", p) for p in (*TERMS.odd_powers, 1.0)] + [
            ("even", p) for p in TERMS.even_powers
        ]
    else:
        values_mean = float(values.mean())
        shapes += [("", 1.0)]
        if carrier is None and abs(values_mean) > 1e-12 * scale:
            shapes += [("", 2.0)]

    def column(parity: str, power: float) -> Group:
        """The function sign(v) |v|^power, or |v|^power where it is even, times the carrier."""

        def made(t: Table) -> Array:
            v = t[last] / scale
            size = np.abs(v) ** power
            f = np.sign(v) * size if parity == "odd" else size
            return (f if carrier is None else f * t[carrier])[:, None]

        return Group(group.names, made)

    candidates = [column(*s) for s in shapes]
    again = regression.changed(groups=[*candidates, group, *others])
    given = list(range(len(candidates) + 1, len(again.groups)))
    gains = {t.group: t.gain for t in again.test(given, draws=SCORES.few_draws)}
    if not any(i in gains for i in range(len(candidates))):
        return "", None, 0.0
    best = max((i for i in gains if i < len(candidates)), key=lambda i: gains[i])
    whole = max(gains.get(len(candidates), 0.0), gains[best])
    parity, power = shapes[best]
    if gains[best] < TERMS.shape * whole:
        return ("neither" if parity else ""), None, 0.0
    coefficient, _ = again.estimate([best])
    if not parity:
        power = power if carrier is None and power != 1.0 else 1.0
    return parity, power, float(coefficient[0])
