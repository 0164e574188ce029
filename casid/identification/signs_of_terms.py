"""A term with the wrong sign in an unstable model, found by the simulation with it negated.

A spring or a loss that is written with the wrong sign makes the model of a stable system unstable:
no values of its parameters follow the record, nor does any effect that is added to it. Where the
fit of whole records is poor, every term that depends on a state is negated in turn, and all of a
balance together, and the parameters are estimated anew, as `signs_from_simulation` does with
channels. A term is suspected only if the model then reproduces every output: that of a plant that
is truly unstable, held by a controller, is no better with another sign.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casid.data.experiment import Experiment
from casid.estimation.fit_statistics import nrmse_fit
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.minimization import Fit
from casid.identification.short_windows import tried
from casid.identification.signs_from_simulation import (
    CLEARLY,
    POOR,
    better_by_chance,
    most_excited,
    quick_settings,
    squared_errors,
)
from casid.model.declarations import Balance, Expr
from casid.model.formula_text import shown_text
from casid.model.model import Model
from casid.model.rate_laws import addends, with_balances


@dataclass(frozen=True, slots=True, eq=False)
class WrongTerm:
    """Terms of an equation that probably have the wrong sign.

    Attributes
    ----------
    where : the balance, or the state's derivative.
    terms : as they are written, and with the other sign.
    p_value : that the model fits better by chance with them negated, corrected for the number of
        those that were tried; 0 where the model as it is has no fit.
    fits : output -> fit with them negated, in per cent, the least of any record.
    """

    where: str
    terms: tuple[tuple[str, str], ...]
    p_value: float
    fits: dict[str, float]

    def __str__(self) -> str:
        written = " and ".join(old for old, _ in self.terms)
        right = " and ".join(new for _, new in self.terms)
        shown = " and ".join(f"{name} to {fit:.3g} %" for name, fit in self.fits.items())
        term, has = ("term", "has") if len(self.terms) == 1 else ("terms", "have")
        return (
            f"the {term} {written} in {self.where} probably {has} the wrong sign: as written the "
            f"model is unstable and does not follow the record, and with {right} it reproduces "
            f"{shown}. Write {right} there"
        )


def wrong_term(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    whole: Fit | None,
    *,
    alpha: float = 0.05,
) -> WrongTerm | None:
    """The terms to be suspected, if any, of an unstable model whose fit is poor.

    Parameters
    ----------
    whole : its fit to whole records; None where none was found.
    alpha : of the test, for all terms together.
    """
    short = [most_excited(e, tuple(model.outputs)) for e in experiments]
    quick = quick_settings(settings)
    found: list[tuple[float, _Negated, Fit]] = []
    variants = list(_variants(with_balances(model)))
    for variant in variants:
        fit = tried(variant.model, short, quick)
        if fit is not None and np.isfinite(fit.solution.value):
            found.append((float(squared_errors(fit).sum()), variant, fit))
    if not found:
        return None
    _, best, near = min(found, key=lambda each: each[0])
    fit = tried(best.model, experiments, replace(settings, starts=1), near.values)
    if fit is None or not fit.solution.is_converged:
        return None
    fits = _fits(fit)
    if not all(per_cent >= POOR for per_cent in fits.values()):
        return None
    p = 0.0
    if whole is not None:
        before, after = squared_errors(whole), squared_errors(fit)
        p = min(1.0, len(variants) * better_by_chance(before - after))
        if after.sum() >= CLEARLY * before.sum() or p >= alpha:
            return None
    return WrongTerm(best.where, best.terms, p, fits)


@dataclass(frozen=True, slots=True, eq=False)
class _Negated:
    """A model with terms of one equation negated; attributes as in `WrongTerm`."""

    model: Model
    where: str
    terms: tuple[tuple[str, str], ...]


def _variants(model: Model) -> Iterator[_Negated]:
    """The model with each term that depends on a state negated, and all those of a balance."""
    states = {model.symbol(name).name() for name in model.states}
    for balance in model.balances.values():
        terms = [part for term in balance.terms for part in _parts(ca.SX(term))]
        moving = [i for i, t in enumerate(terms) if states & {s.name() for s in ca.symvar(t)}]
        for chosen in [[i] for i in moving] + ([moving] if len(moving) > 1 else []):
            yield _with_negated(model, balance, terms, chosen)


def _with_negated(
    model: Model, balance: Balance, terms: Sequence[Expr], chosen: Sequence[int]
) -> _Negated:
    new = model.copy()
    turned = tuple(-t if i in chosen else t for i, t in enumerate(terms))
    new.balances[balance.name] = replace(balance, terms=turned)
    texts = tuple((shown_text(terms[i]), shown_text(turned[i])) for i in chosen)
    is_law = balance.name == balance.rate  # as `with_balances` names it
    where = f"the derivative of {balance.rate}" if is_law else f"the {balance.name} balance"
    return _Negated(new.copy(), where, texts)  # whose equations are solved anew


def _parts(term: Expr) -> list[Expr]:
    """The addends of a term, of a quotient or product of a sum as well."""
    parts = addends(term)
    if len(parts) > 1:
        return [part for each in parts for part in _parts(each)]
    (e,) = parts
    if e.n_dep() == 2 and e.op() in (ca.OP_DIV, ca.OP_MUL):
        left, right = _parts(e.dep(0)), e.dep(1)
        if e.op() == ca.OP_DIV:
            return [part / right for part in left] if len(left) > 1 else [e]
        others = _parts(right)
        if len(left) > 1 or len(others) > 1:
            return [a * b for a in left for b in others]
    return [e]


def _fits(fit: Fit) -> dict[str, float]:
    """Output -> its fit in per cent, the least of any record."""
    c = fit.criterion
    rows = []
    for e, d in enumerate(c.data):
        residual = c.simulated(fit.x, e).residual
        rows.append(nrmse_fit(np.where(d.used, d.y, np.nan), np.where(d.used, residual, np.nan)))
    return dict(zip(c.outputs, np.nanmin(rows, axis=0).tolist(), strict=True))
