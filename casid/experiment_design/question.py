"""The hypotheses, comparisons and targets that an aim stands for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import CasidError, DataError, IdentifiabilityError, ModelError, nearest
from casid.experiment_design.aim import Aim
from casid.experiment_design.base_input import based
from casid.experiment_design.hypotheses import (
    Comparison,
    Hypothesis,
    effect_of,
    name_of,
    nominal_hypothesis,
    with_cause,
)
from casid.experiment_design.information import Target, gradient_of, scores
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.setup import Setup
from casid.experiment_design.stability import require_holdable
from casid.experiment_design.standard_inputs import drawn, shrunk
from casid.experiment_design.thresholds import DESIGN
from casid.identifiability.requirement import require_identifiable
from casid.model.effects.effect import Effect, Sizes
from casid.model.effects.names import law_of
from casid.model.model import Model

MISFIT = Target("misfit", (-1,))

Size = float | Mapping[str, float]
"""Value of a cause's first parameter, or of several by name, in their own units (SI)."""
SizeOf = Mapping[str, Size | Sequence[Size]]
"""Cause -> its size, or several that it may have."""


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """What a design answers.

    Attributes
    ----------
    effects : the causes, in the order of the aim.
    sizes : of each cause, parameter of the effect -> value, SI; the first of several.
    others : of each cause the further sizes that it may have.
    truths : of each comparison of causes, the size of the truth.
    """

    hypotheses: tuple[Hypothesis, ...]
    comparisons: tuple[Comparison, ...]
    targets: tuple[Target, ...]
    effects: tuple[Effect, ...] = ()
    sizes: tuple[Mapping[str, float], ...] = ()
    others: tuple[tuple[Mapping[str, float], ...], ...] = ()
    truths: tuple[Mapping[str, float], ...] = ()

    @property
    def every_size(self) -> tuple[tuple[Mapping[str, float], ...], ...]:
        """All the sizes that each cause may have."""
        return tuple((s, *more) for s, more in zip(self.sizes, self.others, strict=True))

    @property
    def laws(self) -> dict[str, str]:
        """Cause -> what it is called by beside its kind (`law_of`), of those that have it."""
        laws = {name_of(e): law_of(e.kind, e.description) for e in self.effects}
        return {name: law for name, law in laws.items() if law}


def question_of(
    aim: Aim,
    setup: Setup,
    sizes: SizeOf,
    scenarios: Sequence[Mapping[str, float]],
    seed: int,
) -> Question:
    """The question of an aim, for the nominal values and every scenario.

    Parameters
    ----------
    scenarios : parameter -> value, SI, over the nominal ones.

    Raises
    ------
    DataError, ModelError
        For parameters and causes that there are not, sizes that are missing, or a system that no
        planned input keeps where it starts.
    IdentifiabilityError
        If no input answers it.
    """
    base = nominal_hypothesis(setup.nominal, setup.designed, setup.excitation.hold)
    bases = [base, *(base.at(_known(base, s)) for s in scenarios)]
    require_holdable(setup, base, lambda: _usual_motion(setup, base, seed))
    if aim.kind in ("estimate", "identifiable"):
        return _of_parameters(aim, setup, bases)
    usual = _usual_motion(setup, base, seed)
    found = sizes_of(setup, base, usual)
    effects = [effect_of(setup.nominal, c, found) for c in aim.names]
    given = [_sizes_given(setup, c, e, sizes) for c, e in zip(aim.names, effects, strict=True)]
    _require_size(effects, given)
    _require_separable(setup, base, effects)
    full = _as_visible(setup, base, effects, [s[0] if s else None for s in given], usual)
    others = tuple(tuple(s[1:]) for s in given)
    hypotheses: list[Hypothesis] = []
    comparisons: list[Comparison] = []
    truths: list[Mapping[str, float]] = []
    pairs = list(permutations(range(len(effects)), 2)) if len(effects) > 1 else [(0, None)]
    for own, (a, b) in product(bases, pairs):
        rival = own if b is None else with_cause(own, effects[b], full[b])
        for size in (full[a], *others[a]):
            comparisons.append(Comparison(len(hypotheses), len(hypotheses) + 1))
            hypotheses += [with_cause(own, effects[a], size), rival]
            truths.append(size)
    return Question(
        tuple(hypotheses),
        tuple(comparisons),
        (MISFIT,) * len(comparisons),
        tuple(effects),
        tuple(full),
        others,
        tuple(truths),
    )


def _known(base: Hypothesis, values: Mapping[str, float]) -> dict[str, float]:
    for name in values:
        if name not in base.values:
            raise ModelError(
                f"a scenario sets {name!r}, which is no parameter{nearest(name, base.values)}"
            )
    return dict(values)


# -- parameters ---------------------------------------------------------------------------------


def _of_parameters(aim: Aim, setup: Setup, bases: Sequence[Hypothesis]) -> Question:
    base, names = bases[0], list(aim.names or bases[0].free)
    for name in names:
        setup.nominal.model.parameter_named(name)
        if name not in base.free:
            raise ModelError(
                f"{name} is known in {setup.nominal.name}; leave its value open "
                "(with_unknown) to design an experiment for it"
            )
    if not base.free:
        raise ModelError(f"{setup.nominal.name} has no unknown parameter to estimate")
    _identifiable(setup, base.model, base.free)
    targets = []
    for h in bases:
        targets.append(_target(aim, h, names))
    return Question(
        tuple(bases),
        tuple(Comparison(None, i) for i in range(len(bases))),
        tuple(targets),
    )


def _target(aim: Aim, h: Hypothesis, names: Sequence[str]) -> Target:
    first = len(h.free_states)
    if aim.function:
        slopes = gradient_of(aim.function, {n: h.values[n] for n in h.free})
        used = [n for n in h.free if slopes[n]]
        return Target(
            "function",
            tuple(first + h.free.index(n) for n in used),
            gradient=tuple(slopes[n] for n in used),
        )
    sizes = tuple(_size(h, n) for n in names)
    kind = "each" if aim.kind == "identifiable" else aim.optimality
    return Target(kind, tuple(first + h.free.index(n) for n in names), sizes)


def _size(h: Hypothesis, name: str) -> float:
    """What a change of a parameter is compared with: its value, or where that is 0 its range."""
    p = h.model.parameters[name]
    if h.values[name]:
        return abs(h.values[name])
    width = p.upper - p.lower
    return float(width) if np.isfinite(width) and width > 0 else 1.0


def _identifiable(setup: Setup, model: Model, free: Sequence[str]) -> None:
    """Refuse parameters that no input identifies."""
    blank = {n: np.zeros(2) for n in (*model.inputs, *model.outputs)}
    units = {n: e.unit for n, e in model.inputs.items()}
    units |= {n: unit for n, (_, unit) in model.outputs.items()}
    record = Record(blank, units, Ts=setup.Ts, name="any record")
    stripped = model.copy()
    for name, entry in model.inputs.items():
        if entry.kind == "generated":
            del blank[name]
    require_identifiable(
        stripped.taking_si(), [Experiment(record, {}, "any record")], free=list(free)
    )


# -- causes -------------------------------------------------------------------------------------


def _usual_motion(setup: Setup, base: Hypothesis, seed: int) -> list[tuple[Array, Array]]:
    """Some of the usual inputs within the limits of the nominal model, or rest."""
    prediction = based(Prediction(setup, [base], []))
    rng = np.random.default_rng((seed, 7))
    found = []
    for _ in range(DESIGN.usual):
        _, _, u, release = drawn(setup, rng)
        allowed = shrunk(prediction, u, release)
        if allowed is not None:
            found.append(allowed)
    return found or [prediction.setup.begun_at]


def sizes_of(setup: Setup, base: Hypothesis, inputs: Sequence[tuple[Array, Array]]) -> Sizes:
    """How large the signals of a hypothesis are under some inputs, for the catalogue of effects."""
    prediction = Prediction(setup, [base], [])
    courses = [prediction.course(0, *each) for each in inputs]
    x = np.concatenate([c.x for c in courses])
    y = np.concatenate([c.y for c in courses])
    states, rms = list(base.model.states), np.sqrt(np.mean(x**2, axis=0))
    low, high = x.min(axis=0).tolist(), x.max(axis=0).tolist()
    return Sizes(
        rates=dict(zip(states, rms.tolist(), strict=True)),
        largest=dict(zip(base.model.outputs, np.max(np.abs(y), axis=0).tolist(), strict=True)),
        window=(0.0, setup.duration),
        longest_delay=setup.Ts,
        Ts=setup.Ts,
        ranges=dict(zip(states, zip(low, high, strict=True), strict=True)),
    )


def _as_visible(
    setup: Setup,
    base: Hypothesis,
    effects: Sequence[Effect],
    given: Sequence[Mapping[str, float] | None],
    inputs: Sequence[tuple[Array, Array]],
) -> list[Mapping[str, float]]:
    """The sizes given; the others as visible as the first given one under the usual inputs.

    Visible: the energy of the misfit that neither parameters nor initial state take up.
    """
    known = next(i for i, s in enumerate(given) if s)
    truth = with_cause(base, effects[known], given[known] or {})
    pair = Prediction(setup, [truth, base], [Comparison(0, 1)])
    best, most = inputs[0], -np.inf
    for each in inputs:
        grams = pair.grams(*each)
        value = -np.inf if grams is None else float(scores(grams[0], MISFIT)[0])
        best, most = (each, value) if value > most else (best, most)
    out: list[Mapping[str, float]] = []
    for effect, size in zip(effects, given, strict=True):
        if size is None:
            null = with_cause(base, effect, {})
            grams = Prediction(setup, [null], [Comparison(None, 0)]).grams(*best)
            place = len(null.free_states) + len(base.free)
            per = -np.inf if grams is None else float(scores(grams[0], Target("D", (place,)))[0])
            if not np.isfinite(most - per):
                raise DataError(
                    f"how large {name_of(effect)} may be is not known; give the value of "
                    f"{effect.parameters[0].name} in {effect.parameters[0].unit}, sizes="
                    f"{{{effect.kind!r}: ...}} (--size {effect.kind}=...)"
                )
            size = {effect.parameters[0].name: float(np.exp(0.5 * (most - per)))}
        out.append(size)
    return out


def _sizes_given(setup: Setup, cause: str, effect: Effect, sizes: SizeOf) -> list[dict[str, float]]:
    """Values of a cause's parameters, SI: as given, or as a diagnosis found them; or nothing."""
    for key in (cause, effect.kind, f"{effect.kind}@{effect.key[1]}"):
        if key in sizes:
            value = sizes[key]
            several = value if isinstance(value, Sequence) else (value,)
            if not several:
                raise DataError(f"sizes of {key}: none is given; give a value, or leave it out")
            return [_values(effect, s) for s in several]
    found = setup.nominal.sizes.get((effect.kind, effect.where))
    if found is None:
        return []
    own = [p.name for p in effect.parameters]
    return [dict(zip(own, found.values(), strict=False))]


def _values(effect: Effect, size: Size) -> dict[str, float]:
    if isinstance(size, Mapping):
        return {n: float(v) for n, v in size.items()}
    return {effect.parameters[0].name: float(size)}


def _require_size(effects: Sequence[Effect], given: Sequence[Sequence[Any]]) -> None:
    if any(given):
        return
    e = effects[0]
    p = e.parameters[0]
    raise DataError(
        f"how large {name_of(e)} may be is not known, and with it how soon it shows; give the "
        f"value of {p.name} in {p.unit}, sizes={{{e.kind!r}: ...}} (--size {e.kind}=...), or "
        "design from the result of a diagnosis"
    )


def _require_separable(setup: Setup, base: Hypothesis, effects: Sequence[Effect]) -> None:
    """Refuse causes that no input shows or separates, where the exact rank says so."""
    alone = []
    for e in effects:
        h = with_cause(base, e, {})
        try:
            _identifiable(setup, h.model, h.free)
        except IdentifiabilityError as error:
            raise IdentifiabilityError(
                f"no input shows {name_of(e)} in {setup.nominal.name}: {error}"
            ) from error
        alone.append(h)
    for i, e in enumerate(effects):
        for h, other in zip(alone[:i], effects[:i], strict=True):
            try:
                both = with_cause(h, e, {})
                _identifiable(setup, both.model, both.free)
            except IdentifiabilityError as error:
                raise IdentifiabilityError(
                    f"no input separates {name_of(other)} from {name_of(e)} in "
                    f"{setup.nominal.name}: {error}"
                ) from error
            except CasidError:
                continue  # the two cannot be had together: the simulation decides
