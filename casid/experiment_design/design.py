"""The design of the next experiment: the input under limits that answers a question soonest."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack, cast

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.data.files import plain_fields
from casid.errors import DataError, SolveError, nearest
from casid.experiment_design.aim import Aim
from casid.experiment_design.designed_experiment import (
    DesignedExperiment,
    Learned,
    LimitUse,
    SolverEvidence,
    hypothesis_words,
    time_text,
)
from casid.experiment_design.excitation import Excitation, excitation_of
from casid.experiment_design.hypotheses import name_of
from casid.experiment_design.limits import Limits, Range, limits_of
from casid.experiment_design.options import DesignOptions, filled
from casid.experiment_design.outcome import learned, outcomes, predicted_records, ranked_standards
from casid.experiment_design.question import Question, question_of
from casid.experiment_design.search import Found, Search
from casid.experiment_design.setup import Nominal, Setup, Source, noise_of, nominal_of, start_of
from casid.experiment_design.shortest_record import (
    Duration,
    Tried,
    ends_of,
    required_score,
    shortest,
)
from casid.experiment_design.standard_inputs import kinds_of
from casid.experiment_design.thresholds import DURATION, KEEPING
from casid.experiment_design.verification import (
    Verification,
    contradictions,
    fewest_to_diagnose,
    verified,
)
from casid.model.effects.channels.channel_effects import COURSES
from casid.model.units import from_si
from casid.versions import versions


@names_wrong_types()
def design_experiment(
    source: Source,
    aim: Aim,
    limits: Mapping[str, Range] | None = None,
    duration: Duration = 0.0,
    *,
    progress: Callable[[str], None] | None = None,
    **options: Unpack[DesignOptions],
) -> DesignedExperiment:
    """Design the input of the next experiment under limits on inputs, outputs and states.

    Parameters
    ----------
    source : a problem, designed for at its starts and known values; or an estimate, a diagnosis or
        a fitted model, at its estimates.
    aim : `Aim.estimate("m")`, `Aim.separate("quadratic_damping", "coulomb_friction")`,
        `Aim.detect("coulomb_friction")`, `Aim.identifiable()`.
    limits : input, output or state -> (lower, upper) in its declared unit, or (lower, upper, unit);
        None for an end that is open. Inputs with a limit are designed.
    duration : of the record [s]; or (shortest, longest), between which the shortest is sought that
        names or detects with 95 %, or makes identifiable.
    progress : called with a line of text before what may take seconds.
    options : by name, those of `casid.DesignOptions`: shape of the input, slew rates, energies,
        initial state, noise, sizes of the causes, scenarios, effort.

    Returns
    -------
    DesignedExperiment
        The input, the outputs and the power or standard errors that are predicted of it, and what
        it gains over standard inputs.

    Raises
    ------
    DataError, ModelError, UnitError
        For limits that contradict each other, a start outside them, unknown names, a duration
        shorter than two samples, noise or sizes that are not known.
    IdentifiabilityError
        If no input identifies a parameter or separates two causes; found before the search.
    SolveError
        If no input keeps all limits (which to relax, by how much), or what is wanted is not
        reached within them.

    Source: Goodwin and Payne (1977), ch. 6; Atkinson and Fedorov (1975); Bock and Plitt (1984).
    """
    began = time.process_time()
    o = filled(options)
    nominal = nominal_of(source, with_causes=aim.kind in ("estimate", "identifiable"))
    own = limits_of(
        nominal.acting, limits, slew=o["slew"], max_energy=o["max_energy"], release=o["release"]
    )
    low, high = ends_of(duration)
    score = required_score(aim) if low < high else 0.0
    say = progress or (lambda _: None)
    first = _answer(nominal, own, aim, high, o, say)
    answer, tried = first, cast(tuple[Tried, ...], ())
    if low < high:

        def design(length: float, begin: _Answer | None) -> _Answer:
            return first if begin is None else _again(begin, own, aim, length, o)

        answer, tried = shortest(design, (low, high), score, say)
    best = answer.best
    if aim.kind == "identifiable":
        best = _cheapest(answer.search, aim, best)
    found = _result(aim, replace(answer, best=best), tried, time.process_time() - began)
    return _checked(found, answer.question, best, o, say) if o["verify"] else found


def _checked(
    found: DesignedExperiment,
    question: Question,
    best: Found,
    o: DesignOptions,
    progress: Callable[[str], None],
) -> DesignedExperiment:
    """The design with right answers counted in simulated records."""
    how = Verification(o["verify"], o["verify_by"] == "diagnoses", o["seed"])
    checked = verified(found.aim, question, best, found.outcomes, how, progress)
    notes = [*contradictions(checked), *found.notes]
    return replace(found, outcomes=checked, details={**found.details, "notes": notes})


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """What a design at one duration found."""

    search: Search
    best: Found
    standard: Found

    @property
    def question(self) -> Question:
        return self.search.question


def _answer(
    nominal: Nominal,
    limits: Limits,
    aim: Aim,
    duration: float,
    o: DesignOptions,
    progress: Callable[[str], None],
) -> _Answer:
    """The design at one duration."""
    setup = _setup(nominal, limits, duration, o)
    in_si = [nominal.model.in_si(s) for s in o["scenarios"]]
    question = question_of(aim, setup, o["sizes"], in_si, o["seed"])
    effort = o["candidates"], o["starts"], o["seconds"], o["seed"]
    search = Search(setup, question, *effort, progress, kinds=kinds_of(o["standards"]))
    return _Answer(search, *search.run())


def _again(before: _Answer, limits: Limits, aim: Aim, duration: float, o: DesignOptions) -> _Answer:
    """The design at another duration, started from the one found, with its intervals and causes."""
    old, nominal = before.search.setup, before.search.setup.nominal
    length = old.excitation.per * old.Ts
    options: dict[str, Any] = {**o, "Ts": old.Ts, "interval": min(length, duration)}
    setup = _setup(nominal, limits, duration, cast(DesignOptions, options))
    sizes = dict(zip(aim.names, before.question.every_size, strict=False))
    in_si = [nominal.model.in_si(s) for s in o["scenarios"]]
    question = question_of(aim, setup, sizes, in_si, o["seed"])
    u = before.best.u[: setup.N]
    w = setup.excitation.nearest(u - setup.at_rest)
    begin = setup.at_rest + setup.excitation.samples @ w, before.best.release
    seconds, starts = DURATION.share * o["seconds"], 0 if o["starts"] == 0 else 1
    search = replace(
        before.search,
        setup=setup,
        question=question,
        seconds=seconds,
        starts=starts,
        begin=[begin] if starts else (),
    )
    return _Answer(search, *search.run())


def _setup(nominal: Nominal, limits: Limits, duration: float, o: DesignOptions) -> Setup:
    """The experiment but for the values of the decision variables."""
    model = nominal.acting
    excitation = _excitation(nominal, limits, duration, o)
    designed = tuple(n for n in model.inputs if n in limits.inputs)
    if not designed and not limits.release:
        raise DataError(
            "nothing to choose: give a limit of an input (--limit u=-5:5) or an initial "
            "displacement (--release phi=-0.2:0.2)"
        )
    constants, rest = _held(nominal, limits, designed, o["hold"])
    start = start_of(model, o["x0"], limits)
    noise, length = noise_of(nominal, o["noise"]), excitation.N * excitation.Ts
    return Setup(nominal, excitation, limits, designed, constants, rest, start, noise, length)


def _excitation(nominal: Nominal, limits: Limits, duration: float, o: DesignOptions) -> Excitation:
    """The shape of the input over the record."""
    intervals, interval = o["intervals"], o["interval"]
    if interval is not None:
        if not 0 < interval <= duration:
            raise DataError(
                f"intervals of {interval:g} s in a record of {duration:g} s: give a length "
                "above 0 and up to the duration"
            )
        intervals = max(1, round(duration / interval))
    Ts = o["Ts"] or nominal.Ts or duration / max(intervals, 1) / 4
    Ts = float(f"{Ts:.12g}")  # that of records is a difference of time stamps
    if not 0 < Ts <= duration / 2:
        raise DataError(
            f"a duration of {duration:g} s at a sample time of {Ts:g} s holds less than two "
            "samples; give a longer duration or a shorter sample time (Ts, --sample-time)"
        )
    if duration / Ts > DURATION.samples:
        raise DataError(
            f"a duration of {duration:g} s at a sample time of {Ts:g} s holds {duration / Ts:.3g} "
            f"samples, and a design simulates {DURATION.samples:g} at most; give a shorter "
            "duration or a longer sample time (Ts, --sample-time)"
        )
    unmeasured = [n for n in nominal.unmeasured if n in limits.inputs]
    shape = o["shape"] or ("linear" if limits.slew or unmeasured else "constant")
    if unmeasured and shape == "constant":
        raise DataError(
            f"a piecewise constant {unmeasured[0]} jumps, and so would the channel that stands for "
            "it in the model, which is known at its samples alone; take shape='linear' or "
            "'multisine' (--shape)"
        )
    if o["band"] and shape != "multisine":
        raise DataError(
            f"a band belongs to a multisine, and this input is piecewise {shape}; add "
            "shape='multisine' (--shape multisine), or leave the band out"
        )
    if limits.slew and shape == "constant":
        raise DataError(
            f"a piecewise constant input jumps, and the slew rate of {next(iter(limits.slew))} is "
            "limited; take shape='linear' or 'multisine' (--shape), or leave the slew limit out"
        )
    return excitation_of(shape, round(duration / Ts), Ts, intervals=intervals, band=o["band"])


def _held(
    nominal: Nominal, limits: Limits, designed: Sequence[str], hold: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Values of the inputs that are not designed, and of the designed ones at rest; SI."""
    model = nominal.acting
    for name in hold:
        if name not in model.inputs:
            raise DataError(
                f"hold of {name!r}: {model.name} has no such input{nearest(name, model.inputs)}"
            )
    given = model.in_si(hold)
    constants, rest = {}, {}
    for name, entry in model.inputs.items():
        if name in designed:
            low, high = limits.inputs[name]
            rest[name] = given.get(name, float(np.clip(0.0, low, high)))
            if not low <= rest[name] <= high:
                raise DataError(
                    f"hold of {name}: {hold[name]:g} {model.unit_of(name)} lies outside the limit "
                    "of this input; widen the limit, or hold it inside"
                )
        elif name in nominal.unmeasured:
            constants[name] = given.get(name, 0.0)
        elif entry.kind != "generated":
            if name not in given:
                raise DataError(
                    f"input {name} has neither a limit nor a value: give --limit "
                    f"{name}=LOWER:UPPER to design it, or --hold {name}=VALUE to keep it there"
                )
            constants[name] = given[name]
    return constants, rest


def _cheapest(search: Search, aim: Aim, best: Found) -> Found:
    """The input of least energy that still determines every parameter well enough."""
    floor = required_score(aim)
    if best.least < floor:
        worst = int(np.argmin(best.scores))
        h = best.prediction.hypotheses[0]
        names = list(aim.names or h.free)
        reached = float(np.exp(-0.5 * best.scores[worst]))
        raise SolveError(
            f"{search.setup.nominal.name}: within these limits {names[worst % len(names)]} is "
            f"determined to {100 * reached:.3g} % at best, not to {100 * aim.relative_error:.3g} "
            f"%; record {np.exp(floor - best.least):.3g} times as long, widen the limits, or "
            "allow a larger relative error"
        )
    search.progress("find the cheapest input that is enough")
    cheaper = search.cheapest(best, floor)
    return best if cheaper is None else cheaper


def _result(
    aim: Aim, answer: _Answer, tried: Sequence[Tried], seconds: float
) -> DesignedExperiment:
    search, best, standard = answer.search, answer.best, answer.standard
    setup = search.setup
    model = setup.nominal.acting
    records = predicted_records(setup, best)
    parameters = learned(setup, best, standard)
    initial = dict(zip(model.states, setup.initial(model, best.release).tolist(), strict=True))
    return DesignedExperiment(
        problem=setup.nominal.name,
        aim=aim,
        duration=setup.duration,
        records=records,
        inputs=setup.designed,
        initial=model.in_declared_units(initial),
        noise=dict(zip(setup.nominal.model.outputs, setup.noise.tolist(), strict=True)),
        outcomes=outcomes(aim, search.question, best, standard),
        parameters=parameters,
        standards=ranked_standards(setup, search.judged_standards, best),
        gain=float(np.exp(best.least - standard.least)),
        limits=_used(setup, best.prediction, best.u, best.release),
        solver=SolverEvidence(
            best.what, len(search.standards), best.iterations, search.steps, seconds, search.seed
        ),
        units={n: model.unit_of(n) for n in (*model.states, *model.inputs, *model.outputs)},
        details={
            "notes": [*_notes(search, best, parameters), *_lengths_noted(tried)],
            "sizes": [
                {"cause": name, "values": dict(values)}
                for name, several in zip(aim.names, search.question.every_size, strict=False)
                for values in several
            ],
            "durations": [plain_fields(t) for t in tried],
            "hold": setup.excitation.hold,
            "laws": search.question.laws,
            "versions": dict(versions()),
        },
    )


def _used(setup: Setup, prediction: Any, u: Array, release: Array) -> tuple[LimitUse, ...]:
    """Every limit with what the experiment takes of it, at ten times the sampling rate."""
    limits = setup.limits
    taken: dict[str, tuple[float, ...]] = {
        name: (*limits.inputs[name], float(u[:, k].min()), float(u[:, k].max()))
        for k, name in enumerate(setup.designed)
    }
    reached = prediction.ranges(u, release, finer=KEEPING.finer)
    for (name, ends), found in zip(limits.signals.items(), reached, strict=True):
        taken[name] = (*ends, *(float(v) for v in found))
    out = []
    for name, values in taken.items():
        unit = limits.units.get(name, setup.nominal.acting.unit_of(name))
        shown = [float(v) for v in from_si(values, unit)]
        out.append(LimitUse(name, unit, *shown))
    return tuple(out)


def _too_few(search: Search) -> list[str]:
    """That a diagnosis of the record would refuse it, where it has too few samples."""
    setup = search.setup
    least = fewest_to_diagnose(setup)
    if not search.question.effects or setup.N >= least:
        return []
    return [
        f"A diagnosis judges this model from {least} samples on, and this record has {setup.N}: "
        f"take a sample time of {setup.duration / least:.2g} s or shorter (Ts, --sample-time)."
    ]


def _lengths_noted(tried: Sequence[Tried]) -> list[str]:
    """What records of other durations give, where the shortest was sought."""
    if not tried:
        return []
    words = [f"{time_text(t.duration)} {'enough' if t.share >= 1 else 'not enough'}" for t in tried]
    if tried[-1].share < 1:
        return [f"No record of up to {time_text(tried[-1].duration)} is long enough."]
    return [f"Designs for other durations: {', '.join(words)}."]


def _other_courses(setup: Setup) -> list[str]:
    """Inputs that the problem declares otherwise between samples than they are designed."""
    hold, inputs = setup.excitation.hold, setup.nominal.model.inputs
    return [
        f"{name} is {COURSES[hold]} in this design, and {COURSES[inputs[name].hold]} in the "
        f'problem: declare hold="{hold}" for it before its record is diagnosed.'
        for name in setup.designed
        if name in inputs and inputs[name].hold != hold
    ]


def _notes(search: Search, best: Found, parameters: Sequence[Learned]) -> list[str]:
    notes = [search.setup.nominal.note] if search.setup.nominal.note else []
    lost = [
        p.name
        for p in parameters
        if p.std_error is None or (p.value and p.std_error > abs(p.value))
    ]
    if lost:
        notes.append(
            f"This record does not determine {', '.join(lost)}: the standard error is larger than "
            "the value. Check the duration, the limits and their units."
        )
    for name in search.setup.nominal.unmeasured:
        if name not in search.setup.designed:
            held = search.setup.nominal.acting.shown(name, search.setup.constants[name])
            unit = search.setup.nominal.acting.unit_of(name)
            notes.append(
                f"{name}, which is not measured, is assumed to be {held:.4g} {unit} throughout the "
                "record. The sensor that it was eliminated with shows what it does."
            )
    notes += [*_other_courses(search.setup), *_too_few(search)]
    for effect, several in zip(search.question.effects, search.question.every_size, strict=True):
        values = " and with ".join(
            ", ".join(f"{n} = {v:.4g}" for n, v in size.items()) for size in several
        )
        cause = hypothesis_words(name_of(effect), search.question.laws)
        notes.append(f"{cause} is taken with {values} (SI).")
    if not best.iterations and search.starts != 0:
        notes.append(
            "The optimisation found no better input than the best standard input, which is the "
            "result."
        )
    notes.append(
        "The noise of the outputs is taken as white and independent; noise of measured inputs and "
        "disturbances are not in the prediction."
    )
    return notes
