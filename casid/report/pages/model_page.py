"""What a notebook shows of models, fitted models, problems and experiments."""

from __future__ import annotations

import math
from dataclasses import replace

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.estimation.fitted.equations import equations_of
from casid.estimation.fitted.fitted_model import FittedModel
from casid.model.model import Model
from casid.report.document import Bullets, Code, Document, Equations, Part, Section, Table
from casid.report.numbers import number_text, value_text
from casid.report.texts.records import record_document


def model_view(model: Model) -> Document:
    """Equations, parameters, states and inputs, in the declared units."""
    return Document(model.name, _model_sections(model), kind="Model")


def _model_sections(model: Model) -> list[Part]:
    return [
        Section("Equations", [Equations(equations_of(model).after)], is_open=True),
        Section("Parameters", [_parameters(model)], is_open=True),
        Section("States and inputs", [_states(model), _inputs(model)]),
    ]


def _parameters(model: Model) -> Table:
    rows = []
    for p in model.parameters.values():
        ends = [model.shown(p.name, x) for x in (p.lower, p.upper)]
        rows.append(
            (
                Code(p.name),
                model.unit_of(p.name),
                value_text(model.shown(p.name, p.nominal)),
                "known" if p.is_known else "start",
                "" if p.is_known else _between(*ends),
            )
        )
    return Table(("parameter", "unit", "value", "", "bounds"), rows, numbers=(2,))


def _between(lower: float, upper: float) -> str:
    if math.isinf(lower) and math.isinf(upper):
        return ""
    if math.isinf(upper):
        return f"at least {number_text(lower)}"
    if math.isinf(lower):
        return f"at most {number_text(upper)}"
    return f"{number_text(lower)} .. {number_text(upper)}"


def _states(model: Model) -> Table:
    rows = [
        (
            Code(x.name),
            model.unit_of(x.name),
            value_text(model.shown(x.name, x.nominal)),
            "start" if x.initial is None else "known",
        )
        for x in model.states.values()
    ]
    return Table(("state", "unit", "initial value", ""), rows, numbers=(2,))


def _inputs(model: Model) -> Table:
    rows = [(Code(u.name), model.unit_of(u.name), u.kind, u.hold) for u in model.inputs.values()]
    return Table(("input", "unit", "kind", "between samples"), rows)


def problem_document(problem: Problem) -> Document:
    """Channels, parameters and load cases, in their units, as a terminal shows them."""
    tables = (_channels(problem), _parameters(problem.model), _load_cases(problem))
    parts: list[Part] = [part for t in tables if t.rows for part in ("", t)]
    return Document(f"{problem.name}: {repr(problem.model)[1:-1]}", parts)


def _load_cases(p: Problem) -> Table:
    rows = [
        (case, Code(name), value_text(value), p.model.unit_of(name))
        for case, values in p.load_cases.items()
        for name, value in values.items()
    ]
    return Table(("load case", "parameter", "value", "unit"), rows, numbers=(2,))


def problem_view(problem: Problem) -> Document:
    """The model, where its signals are found, load cases and references."""
    p, m = problem, problem.model
    return Document(
        p.name,
        [
            p.description,
            *_model_sections(m),
            Section("Channels", [_channels(p)], is_open=True),
            Section("Load cases", [_load_cases(p)]),
            Section("References", [Bullets(p.references)]),
        ],
        kind="Problem",
    )


def _channels(p: Problem) -> Table:
    recorded = [u.name for u in p.model.inputs.values() if u.kind != "generated"]
    kinds = dict.fromkeys(recorded, "input") | dict.fromkeys(p.model.outputs, "output")
    rows = []
    for name, kind in (kinds | dict.fromkeys(p.recorded, "recorded beside")).items():
        unit = p.recorded[name] if name in p.recorded else p.model.unit_of(name)
        source = f"from {', '.join(p.derived[name].sources)}" if name in p.derived else ""
        noise = value_text(p.noise[name]) if name in p.noise else ""
        rows.append((Code(name), kind, unit, source or p.channels.get(name, name), noise))
    return Table(("signal", "kind", "unit", "column", "noise, sd"), rows, numbers=(4,))


def fitted_view(fitted: FittedModel) -> Document:
    """The equations with what was added marked, and the values with their errors."""
    m = fitted.model
    errors = dict(zip(fitted.covariance_names, fitted.covariance.diagonal().tolist(), strict=True))
    rows = []
    for name, value in fitted.values.items():
        variance = errors.get(name)
        error = "" if variance is None else f"{m.shown_size(name, math.sqrt(variance)):.2g}"
        rows.append((Code(name), m.unit_of(name), value_text(value), error))
    added = [c.words for c in fitted.causes]
    changed = equation_changes(fitted)
    return Document(
        fitted.name,
        [
            Section("Added", [Bullets(added), *changed], is_open=True),
            Section("Equations", [Equations(fitted.equations().after)], is_open=not changed),
            Section(
                "Values",
                [Table(("parameter", "unit", "value", "std. error"), rows, numbers=(2, 3))],
                is_open=True,
            ),
            Section("Fitted to", [Bullets([r.name for r in fitted.records])]),
        ],
        kind="Fitted model",
    )


def equation_changes(fitted: FittedModel | None, mark: str = "new") -> list[Part]:
    """The equations that the added causes changed, before and after, with a mark on their terms."""
    if fitted is None or fitted.baseline is None:
        return []
    found = fitted.equations()
    before, after = Equations(found.before), changed_equations(fitted, mark)
    return [Section("Before", [before]), Section("After", [after])]


def changed_equations(fitted: FittedModel, mark: str = "new") -> Equations:
    """The equations that the added causes changed, with a mark on what they added."""
    return Equations([replace(e, mark=mark) for e in fitted.equations().changed])


def experiment_view(experiment: Experiment) -> Document:
    """The record, and what is known for it alone."""
    shown = record_document(experiment.record)
    known = [(name, value_text(value)) for name, value in experiment.known.items()]
    return Document(
        experiment.name or experiment.record.name,
        [*shown.parts, Table(("known for it alone", "value"), known, numbers=(1,))],
        label=shown.label,
        kind="Experiment",
    )
