"""The equations of a model in the order in which a person writes them down.

Every expression of the model is there as it was stated: derivatives, balances with their terms, and
outputs, an eliminated input with the output that it was eliminated with. Parts that several of them
share have names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.model.clock_signals import Always, RampOver, StepAt, TimeSince
from casid.model.declarations import Hold
from casid.model.formula_text import Notation, formula_text, shared_parts
from casid.model.identifiers import identifier
from casid.model.model import Model

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, slots=True, eq=False)
class WrittenBalance:
    """inertia * d(rate)/dt = sum of terms, in the SI `unit`; `shown_unit` is the declared one."""

    name: str
    rate: str
    inertia: Expr
    terms: tuple[Expr, ...]
    unit: str
    shown_unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """An unknown input solved from an output, and what that does between its samples.

    `solution` where a branch was chosen.
    """

    unknown: str
    output: str
    hold: Hold
    solution: Expr | None


@dataclass(frozen=True, slots=True, eq=False)
class WrittenEquations:
    """The equations of `model`, which has its unknown inputs back where that is possible.

    Attributes
    ----------
    parts : shared parts by name, each made of those before it.
    keys : what `formula_text(parts=...)` takes.
    derivatives : state -> right-hand side.
    outputs : output -> expression.
    eliminations : of the model's unknown inputs, in order.
    """

    model: Model
    parts: Mapping[str, Expr]
    keys: Mapping[int, str]
    derivatives: Mapping[str, Expr]
    balances: tuple[WrittenBalance, ...]
    outputs: Mapping[str, Expr]
    eliminations: tuple[Elimination, ...]

    def formula(
        self, expression: Expr, notation: Notation, names: Mapping[str, str], defined: str = ""
    ) -> str:
        """An expression as text, or the definition of the shared part `defined` by the others.

        `names` are those that the symbols of the model have in the text.
        """
        others = {key: part for key, part in self.keys.items() if part != defined}
        return formula_text(expression, notation, names=names, parts=others)


def written_equations(model: Model) -> WrittenEquations:
    """The equations of a model without stages; shared parts are called `common_1` and so on."""
    stated, eliminations = _with_unknown_inputs(model)
    rates, balances = stated._rates, list(stated.balances.values())
    solutions = [e.solution for e in eliminations if e.solution is not None]
    united, found = shared_parts(
        [
            *rates.values(),
            *(e for b in balances for e in (b.inertia, *b.terms)),
            *(e for e, _ in stated.outputs.values()),
            *solutions,
        ]
    )
    rest = iter(united)
    names = [stated.free_name(f"common_{i}") for i in range(1, len(found) + 1)]
    return WrittenEquations(
        model=stated,
        parts={n: p.expression for n, p in zip(names, found, strict=True)},
        keys={p.key: n for n, p in zip(names, found, strict=True)},
        derivatives={s: next(rest) for s in rates},
        balances=tuple(
            WrittenBalance(
                b.name, b.rate, next(rest), tuple(next(rest) for _ in b.terms), b.unit, b.shown_unit
            )
            for b in balances
        ),
        outputs={name: next(rest) for name in stated.outputs},
        eliminations=tuple(_with_solution(eliminations, rest)),
    )


def clock_names(model: Model) -> dict[str, str]:
    """Short names for the inputs that are functions of the clock, whose own say all."""
    short = {StepAt: "step", RampOver: "ramp", TimeSince: "elapsed", Always: "on_this_clock"}
    found: dict[str, str] = {}
    for name, entry in model.inputs.items():
        if entry.kind == "generated":
            base, n = short.get(type(entry.signal), identifier(name)), 2
            text = base
            while text in found.values() or text in model._symbols:
                text, n = f"{base}_{n}", n + 1
            found[name] = text
    return found


def _with_solution(
    eliminations: Sequence[Elimination], rest: Iterator[Expr]
) -> Iterator[Elimination]:
    for e in eliminations:
        yield e if e.solution is None else replace(e, solution=next(rest))


def _with_unknown_inputs(model: Model) -> tuple[Model, list[Elimination]]:
    """The model before its eliminations; where there is no way back, with their solutions in it."""
    if not model._measured:
        return model, []
    try:
        direct = model.direct()
    except ModelError:
        return _substituted(model), []
    branches = {w: r for w, _, r in model._eliminations}
    eliminations = []
    for m in model._measured:
        residual, name = branches[m.unknown.name], m.unknown.name
        is_branch = not ca.is_equal(residual, m.residual, 50)
        solution = model.symbol(name) - residual if is_branch else None
        eliminations.append(Elimination(name, m.output, model.inputs[m.output].hold, solution))
    return direct, eliminations


def _substituted(model: Model) -> Model:
    """The model with the solutions of its eliminated inputs in the place of their symbols."""
    new = model.copy()
    solved = new.explicit().eliminated
    new._eliminations, new._measured = [], []
    for name, expression in solved.items():
        new.substitute_symbol(name, expression)
    new.eliminated_units = {}
    return new
