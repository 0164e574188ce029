"""The model: states, inputs, outputs and parameters with units, and balances with names.

A model is written once, as CasADi expressions. It is a set of equations linear in the state
derivatives and in every eliminated input, so one symbolic linear solve gives

    dx/dt = f(x, u, theta),    y = h(x, u, theta)                                           (1)

and eliminating an unknown input is adding one equation (the output that responds to it) and one
unknown: the indirect model of Linder (2017, ch. 4), for gains that may depend on the state.

Numbers are given in the unit beside them and kept in SI; `Model.declared_units` remembers each unit
that was declared and is not SI. Expressions are between SI quantities: an angle declared in deg is
in rad wherever its symbol is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import casadi as ca

from casid.argument_types import methods_name_wrong_types
from casid.errors import ModelError, nearest, require_texts
from casid.model.declarations import (
    SENSED,
    Balance,
    EliminatedWith,
    Expr,
    Hold,
    Input,
    Stage,
    checked_hold,
    expression_of,
    symbol_name,
)
from casid.model.declared_units import (
    common_unit,
    rate_in_own_unit,
    refuse_conversion,
    si_text,
)
from casid.model.explicit_form import Explicit, check_branch, solved_for
from casid.model.formula_text import shown_text
from casid.model.named_quantities import NamedQuantities
from casid.model.quantities import count_text
from casid.model.serialisation import packed, unpacked
from casid.model.units import is_si, same_dimension
from casid.presentation import Viewed


@runtime_checkable
class Extension(Protocol):
    """What a model can be extended with: a `casid.Effect`."""

    def extend(self, model: Model) -> Model:
        """A copy of the model that holds it."""
        ...


@methods_name_wrong_types(ModelError)
class Model(NamedQuantities, Viewed):
    """A physical model under construction.

    Example
    -------
    >>> import casid
    >>> m = casid.Model("mass on a spring")
    >>> x, v = m.state("x", "m"), m.state("v", "m/s")
    >>> F = m.input("F", "N")
    >>> k, d, M = m.parameter("k", "N/m"), m.parameter("d", "N s/m"), m.parameter("M", "kg")
    >>> m.derivative(x, v)
    >>> m.balance(v, "force", inertia=M, terms=[-k * x, -d * v, F])
    >>> _ = m.output("position", x, "m")
    >>> m
    <Model mass on a spring: 2 states, 1 input, 1 output, 3 parameters (3 unknown)>
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.balances: dict[str, Balance] = {}
        self.stages: tuple[Stage, ...] = ()
        self._rates: dict[str, Expr] = {}  # state -> explicit right-hand side
        self._eliminations: list[tuple[str, str, Expr]] = []  # (unknown, equation's name, residual)
        self._measured: list[EliminatedWith] = []  # what each elimination took away, in that order

    # -- declaring ---------------------------------------------------------------------------

    def der(self, state: Any) -> Any:
        """The time derivative of a state, for use in balances and outputs."""
        return self._derivatives[self._state_name(state)]

    def derivative(self, state: Any, expression: Expr) -> None:
        """State that d(state)/dt = expression."""
        name = self._state_name(state)
        self._require_no_equation(name)
        self._rates[name] = expression_of(f"{self.name}: the derivative of {name},", expression)
        self._explicit = None

    def balance(
        self,
        rate: Any,
        name: str,
        *,
        inertia: Expr,
        terms: Sequence[Expr],
        unit: str | None = None,
    ) -> None:
        """State that inertia * d(rate)/dt = sum(terms); missing effects enter such balances.

        Parameters
        ----------
        rate : the state whose derivative the balance determines.
        inertia, terms : expressions in SI.
        unit : in which terms are shown, any of their dimension. Default, the first that applies:
            the unit of a term that is a signal alone; that of an earlier balance of this SI unit;
            for an angle or a share of inertia 1, its own unit over s; the SI unit of most terms.
        """
        state = self._state_name(rate)
        self._require_no_equation(state)
        require_texts(f"{self.name}: balance {name!r}", name=[name])
        if name in self.balances:
            raise ModelError(f"{self.name}: balance {name!r} stated twice; give it another name")
        where = f"{self.name}: balance {name!r}:"
        terms = tuple(expression_of(f"{where} the term", t) for t in terms)
        inertia = expression_of(f"{where} the inertia", inertia)
        si = self._balance_unit(state, inertia, terms) if unit is None else si_text(unit)
        shown = self._unit_of_signal(terms, si) if unit is None else unit
        if unit is None and shown == si:
            shown = rate_in_own_unit(self.unit_of(state), si)
        declared = "" if is_si(shown) else shown
        self.balances[name] = Balance(name, state, inertia, terms, si, declared)
        self._explicit = None

    def output(self, name: str, expression: Expr, unit: str) -> Any:
        """Declare what a sensor measures, shown in `unit`; returns the expression.

        The expression is in SI: `output("angle", phi, "deg")`, without a factor 180/pi.

        Raises
        ------
        ModelError
            If the channel exists already, or the expression converts to `unit` itself.
        """
        require_texts(f"{self.name}: output {name!r}", name=[name])
        if name in self.outputs or name in self.inputs:
            raise ModelError(f"{self.name}: channel {name!r} declared twice; give it another name")
        expression = expression_of(f"{self.name}: output {name!r}:", expression)
        refuse_conversion(self.name, name, expression, unit)
        self.outputs[name] = (expression, self._remember_unit(name, unit))
        self._explicit = None
        return self.outputs[name][0]

    # -- deriving ----------------------------------------------------------------------------

    def eliminate(
        self, unknown: Any, using: str, *, solution: Expr | None = None, hold: Hold = "foh"
    ) -> Model:
        """Solve the output `using` for an unknown input and substitute it (the indirect model).

        The output becomes a measured input, `hold` as of `input`. Where it is not linear in the
        unknown input, `solution` gives the branch, with `eliminated_symbol` for the output.

        Raises
        ------
        ModelError
            If the output does not respond to the input, or the branch is missing or wrong.

        Source: Linder (2017), sections 4.2 and 7.3, (7.24) for the pendulum.
        """
        name = symbol_name(f"{self.name}: unknown input", unknown)
        if name not in self.inputs or self.inputs[name].kind != "unknown":
            raise ModelError(
                f"{self.name}: {name!r} is not an unknown input; declare it with unknown_input"
            )
        if using not in self.outputs:
            raise ModelError(
                f"{self.name}: no output {using!r} to eliminate {name} with"
                f"{nearest(using, self.outputs)}"
            )
        new = self.copy()
        places = list(self.inputs).index(name), list(self.outputs).index(using)
        expression, unit = new.outputs.pop(using)
        measured = self.eliminated_symbol(using)
        residual = expression - measured
        if solution is not None:
            residual = self._symbols[name] - ca.SX(solution)
            check_branch(
                self.name, expression, measured, self._symbols[name], ca.SX(solution), using
            )
        new._symbols[using] = measured
        gone = EliminatedWith(new.inputs.pop(name), using, expression - measured, *places)
        new._measured.append(gone)
        new.eliminated_units[name] = gone.unknown.unit
        new.inputs[using] = Input(using, unit, "measured", checked_hold(using, hold))
        new._eliminations.append((name, using, residual))
        new.explicit()  # refuse here, where the user can correct it
        return new

    def direct(self) -> Model:
        """This model with every elimination undone: unknown inputs and their outputs are back.

        The direct model has as its inputs what acts on the system, unknown inputs among them, and
        as an output each channel that an unknown input was eliminated with. Effects that came
        later stay: a bias of the input `accel` becomes the bias of the output `accel`.

        Raises
        ------
        ModelError
            If an effect made an equation depend nonlinearly on an eliminated channel.

        Source: Linder (2017), (4.1)-(4.4), (7.10) for the pendulum.
        """
        new = self.copy()
        new._eliminations, new._measured, new.eliminated_units = [], [], {}
        kept = list(self._measured)
        while kept:
            gone = kept.pop()
            measured, residual = self._symbols[gone.output], gone.residual
            for stage in new.stages:
                if stage.channel == gone.output and stage.kind in SENSED:
                    # Now the output itself is delayed; the input that carried the tangent goes.
                    residual = ca.substitute(residual, self._symbols[stage.carrier], 0)
                    del new.inputs[stage.carrier]
                    late = replace(stage, kind=SENSED[stage.kind])
                    new.stages = tuple(late if s is stage else s for s in new.stages)
            for blend in new.inputs[gone.output].blends:
                # Between its samples an output has no values that a blend could change.
                p = new.parameters[blend.parameter]
                new.parameters[blend.parameter] = replace(p, value=p.nominal)
            slope_of = ca.jacobian(residual, measured)
            if any(ca.which_depends(slope_of, measured)) or slope_of.nnz() == 0:
                raise ModelError(
                    f"{self.name}: {gone.output} enters its own equation nonlinearly, so it has "
                    "no direct model; call direct() before that effect extends the model"
                )
            expression = -ca.substitute(residual, measured, 0) / slope_of
            if slope_of.is_constant() and float(slope_of) == -1.0:
                expression = ca.substitute(residual, measured, 0)
            unit = new.inputs.pop(gone.output).unit
            new._swap(measured, expression)
            for i, k in enumerate(kept):
                kept[i] = replace(k, residual=ca.substitute(k.residual, measured, expression))
            new.inputs = _inserted(new.inputs, gone.input_place, gone.unknown.name, gone.unknown)
            new.outputs = _inserted(new.outputs, gone.output_place, gone.output, (expression, unit))
        new._explicit = None
        return new

    def eliminated_symbol(self, output: str) -> Any:
        """The symbol that `output` gets when an unknown input is eliminated with it."""
        if output not in self._symbols:
            self._symbols[output] = ca.SX.sym(output)
        return self._symbols[output]

    def extend(self, effect: Extension) -> Model:
        """A copy of this model with `effect` in it; its parameters start at their null values."""
        return effect.extend(self)

    def with_known(self, **values: float) -> Model:
        """A copy in which the named parameters are known, each in the unit it was declared in."""
        return self.with_si_values(self.in_si(values))

    def with_si_values(self, values: Mapping[str, float]) -> Model:
        """A copy in which the named parameters are known; values in SI."""
        new = self.copy()
        for name, value in values.items():
            self.parameter_named(name)
            new.parameters[name] = replace(new.parameters[name], value=float(value))
        return new

    def with_unknown(self, *names: str, **starts: float) -> Model:
        """A copy in which the named parameters are estimated (again), from the given starts.

        Starts are in the units that the parameters were declared in.
        """
        new = self.copy()
        given = self.in_si(starts)
        for name in (*names, *starts):
            old = self.parameter_named(name)
            start = given.get(name, old.value if old.value is not None else old.start)
            new.parameters[name] = replace(old, value=None, start=float(start))
        return new

    def taking_si(self, yes: bool = True) -> Model:
        """A copy whose methods take numbers by name in SI, as the library's own calls do."""
        new = self.copy()
        new.takes_si = yes
        return new

    # -- what effects are made of ------------------------------------------------------------

    def add_term(self, balance: str, term: Expr) -> None:
        """Add a term to a balance (used by effects on their own copy)."""
        old = self.balances[balance]
        self.balances[balance] = replace(old, terms=(*old.terms, ca.SX(term)))
        self._explicit = None

    def add_rate(self, state: str, rate: Expr) -> None:
        """Add to the stated derivative of a state (used by effects on their own copy)."""
        self._rates[state] = self._rates[state] + ca.SX(rate)
        self._explicit = None

    def replace_output(self, name: str, expression: Expr, unit: str) -> None:
        """Give an output another expression (used by effects on their own copy)."""
        self.outputs[name] = (ca.SX(expression), unit)
        self._explicit = None

    def substitute_symbol(self, name: str, expression: Expr) -> None:
        """Replace a parameter or input by an expression wherever it occurs (used by effects)."""
        self._swap(self._symbols[name], expression)

    def take_out_at_zero(self, state: str) -> None:
        """Take out a state that stays at zero (used on an own copy)."""
        self._swap(self._symbols[state], 0)
        del self.states[state], self._symbols[state], self._derivatives[state], self._rates[state]
        self._explicit = None

    def _swap(self, old: Any, expression: Expr) -> None:
        stated = [t for b in self.balances.values() for t in (b.inertia, *b.terms)]
        stated += [*self._rates.values(), *(e for e, _ in self.outputs.values())]
        stated += [r for _, _, r in self._eliminations]
        stated += [m.residual for m in self._measured]
        # All in one call: it costs the same for many expressions as for one.
        stated = [e if isinstance(e, ca.SX) else ca.SX(e) for e in stated]
        new = iter(ca.substitute(stated, [old], [ca.SX(expression)]))
        self.balances = {
            key: replace(b, inertia=next(new), terms=tuple(next(new) for _ in b.terms))
            for key, b in self.balances.items()
        }
        self._rates = {key: next(new) for key in self._rates}
        self.outputs = {key: (next(new), unit) for key, (_, unit) in self.outputs.items()}
        self._eliminations = [(w, y, next(new)) for w, y, _ in self._eliminations]
        self._measured = [replace(m, residual=next(new)) for m in self._measured]
        self._explicit = None

    def position_of(self, rate: str) -> str | None:
        """The state whose derivative is the state `rate`, if there is one."""
        for name, expression in self._rates.items():
            if ca.is_equal(expression, self._symbols[rate], 2):
                return name
        return None

    # -- the equations -----------------------------------------------------------------------

    def equations(self) -> list[tuple[str, Expr, str]]:
        """All equations as (name, residual = 0, unknown it is solved for)."""
        rows: list[tuple[str, Expr, str]] = []
        for name in self.states:
            if name in self._rates:
                rows.append((f"d{name}/dt", self._derivatives[name] - self._rates[name], name))
        for b in self.balances.values():
            total = b.total
            rows.append((b.name, b.inertia * self._derivatives[b.rate] - total, b.rate))
        rows += [(f"{y} = ...", residual, w) for w, y, residual in self._eliminations]
        return rows

    @property
    def eliminations(self) -> dict[str, str]:
        """Eliminated unknown input -> the output that stands for it, an input now."""
        return {unknown: using for unknown, using, _ in self._eliminations}

    def explicit(self) -> Explicit:
        """Solve the equations for the derivatives and the eliminated inputs, once.

        Raises
        ------
        ModelError
            If a state has no equation, the equations are singular, or not linear in an unknown.
        """
        if self._explicit is None:
            self._explicit = self._solve()
        return self._explicit

    def _solve(self) -> Explicit:
        stated = set(self._rates) | {b.rate for b in self.balances.values()}
        lacking = [s for s in self.states if s not in stated]
        if lacking:
            raise ModelError(
                f"{self.name}: state {lacking[0]} has no equation; state one with "
                f"derivative({lacking[0]}, ...) or balance({lacking[0]}, ...)"
            )
        # Eliminated inputs come first, each solved from its own output: no needless divisors.
        eliminated = [w for w, _, _ in self._eliminations]
        if not self.states and not eliminated:
            raise ModelError(
                f"{self.name} has no state, so there is nothing to simulate; fit a static relation "
                "with casid.regress, or declare a state"
            )
        rows = self.equations()
        rows = rows[len(rows) - len(eliminated) :] + rows[: len(rows) - len(eliminated)]
        z = ca.vertcat(
            *[self._symbols[w] for w in eliminated], *[self._derivatives[s] for s in self.states]
        )
        values = solved_for(z, [r for _, r, _ in rows], self.name, len(eliminated))
        nw = len(eliminated)
        h = ca.vertcat(*[e for e, _ in self.outputs.values()]) if self.outputs else ca.SX(0, 1)
        # der() and eliminated inputs stand in the outputs: put their solutions there.
        h = ca.substitute(h, z, values)
        return Explicit(
            x=ca.vertcat(*[self._symbols[s] for s in self.states]),
            u=ca.vertcat(*[self._symbols[u] for u in self.inputs]),
            p=ca.vertcat(*[self._symbols[p] for p in self.parameters]),
            f=values[nw:],
            h=h,
            states=tuple(self.states),
            inputs=tuple(self.inputs),
            parameters=tuple(self.parameters),
            outputs=tuple(self.outputs),
            eliminated={w: values[i] for i, w in enumerate(eliminated)},
        )

    # -- showing -----------------------------------------------------------------------------

    def __repr__(self) -> str:
        unknown = sum(not p.is_known for p in self.parameters.values())
        return (
            f"<Model {self.name}: {count_text(len(self.states), 'state')}, "
            f"{count_text(len(self.inputs), 'input')}, {count_text(len(self.outputs), 'output')}, "
            f"{count_text(len(self.parameters), 'parameter')} ({unknown} unknown)>"
        )

    def __str__(self) -> str:
        lines = [repr(self)]
        for b in self.balances.values():
            terms = " + ".join(f"({shown_text(t)})" for t in b.terms)
            lines.append(f"  {b.name}: ({shown_text(b.inertia)}) d{b.rate}/dt = {terms} [{b.unit}]")
        lines += [f"  d{s}/dt = {shown_text(e)}" for s, e in self._rates.items()]
        lines += [f"  {n} = {shown_text(e)}   [{unit}]" for n, (e, unit) in self.outputs.items()]
        lines += [f"  {w} eliminated using {y}" for w, y, _ in self._eliminations]
        return "\n".join(lines)

    # -- inside ------------------------------------------------------------------------------

    def _balance_unit(self, rate: str, inertia: Expr, terms: Sequence[Expr]) -> str:
        """The unit that most of the terms and the inertia times d(rate)/dt have."""
        own = self.states[rate].unit
        sides = [] if inertia.is_constant() else [inertia * self._derivatives[rate]]
        is_rotation = same_dimension(own, "rad/s")
        return common_unit([*sides, *terms], self.symbol_units, is_rotation=is_rotation)

    @property
    def shown_units(self) -> dict[str, str]:
        """`declared_units`, with those of balances whose name no other quantity has."""
        taken = {*self.symbol_units, *self.outputs}
        named = {b.name: b.declared for b in self.balances.values() if b.declared}
        return {n: u for n, u in named.items() if n not in taken} | self.declared_units

    def _unit_of_signal(self, terms: Sequence[Expr], si: str) -> str:
        """The unit of the first term that is a signal alone; else of another balance; else `si`."""
        for term in terms:
            bare = term.dep(0) if term.is_op(ca.OP_NEG) else term
            name = bare.name() if bare.is_symbolic() else ""
            if name in self._symbols and same_dimension(self.unit_of(name), si):
                return self.unit_of(name)
        return next((b.declared for b in self.balances.values() if b.declared and b.unit == si), si)

    def _require_no_equation(self, name: str) -> None:
        if name in self._rates or any(b.rate == name for b in self.balances.values()):
            raise ModelError(f"{self.name}: state {name} has two equations; drop one")

    def copy(self, name: str | None = None) -> Model:
        """An independent copy that shares the symbols."""
        new = Model.__new__(Model)
        new.__dict__.update(self.__dict__)
        new.name = name or self.name
        for key in ("states", "inputs", "parameters", "balances", "outputs"):
            setattr(new, key, dict(getattr(self, key)))
        new._symbols = dict(self._symbols)
        new._derivatives = dict(self._derivatives)
        new._rates = dict(self._rates)
        new._eliminations = list(self._eliminations)
        new._measured = list(self._measured)
        new.eliminated_units = dict(self.eliminated_units)
        new.declared_units = dict(self.declared_units)
        new._explicit = None
        return new

    def __copy__(self) -> Model:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Model:
        return self.copy()  # symbols and expressions never change

    def __reduce__(self) -> tuple[Any, ...]:  # an SX expression cannot be pickled by itself
        return _rebuilt, packed({**self.__dict__, "_explicit": None})


def _rebuilt(state: Mapping[str, Any], text: str) -> Model:
    """The model that was packed, with symbols of its own."""
    new = Model.__new__(Model)
    new.__dict__.update(unpacked(state, text))
    return new


def _inserted(entries: Mapping[str, Any], place: int, name: str, entry: Any) -> dict[str, Any]:
    """A dict with one more entry, at `place` in its order."""
    items = [(k, v) for k, v in entries.items() if k != name]
    return dict([*items[:place], (name, entry), *items[place:]])
