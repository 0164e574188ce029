"""A candidate whose numbers break down is left out with its reason, and the search goes on."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import nnls

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search import rounds
from casid.model.declarations import Parameter
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Effect
from casid.model.effects.names import effect_words
from problems import roll_decay


@pytest.mark.parametrize(
    "breaks_down",
    [
        pytest.param(lambda: np.linalg.cholesky(-np.eye(2)), id="linear algebra"),
        pytest.param(lambda: nnls(np.eye(3), np.full(3, np.nan)), id="not finite"),
        pytest.param(lambda: 1 / 0, id="arithmetic"),
    ],
)
def test_what_breaks_down_is_left_out_with_its_reason(breaks_down):
    attempts = Attempts()
    assert attempts.attempt("drag", breaks_down) is None
    (note,) = attempts.notes()
    assert note.startswith("drag was left out: its numbers break down (")


def test_a_refusal_of_casid_is_passed_on_in_its_own_words():
    attempts = Attempts()

    def refuse() -> None:
        raise casid.SolveError("the simulation diverges at t = 3 s")

    assert attempts.attempt("drag", refuse) is None
    assert attempts.notes() == ["drag was left out: the simulation diverges at t = 3 s"]
    attempts.succeeded("drag")  # from another start
    assert not attempts.notes()


def test_of_many_reasons_the_first_few_are_listed_each_once():
    attempts = Attempts(failed={f"effect {i}": f"reason {i % 5}" for i in range(100)})
    assert attempts.reasons() == "reason 0; reason 1; reason 2; and 2 more reasons"
    attempts = Attempts(failed={f"effect {i}": f"reason {i % 4}" for i in range(100)})
    assert attempts.reasons() == "reason 0; reason 1; reason 2; and 1 more reason"


@pytest.mark.parametrize("fault", [TypeError, KeyError, KeyboardInterrupt])
def test_faults_and_interrupts_are_not_taken_for_numbers(fault):
    def fail() -> None:
        raise fault

    with pytest.raises(fault):
        Attempts().attempt("drag", fail)


@pytest.mark.slow
def test_candidates_that_break_down_leave_the_one_that_does_not_to_be_named(monkeypatch):
    """All refits but that of the drag fail: it is named, and notes say what failed."""
    record = roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)
    compensated_criterion, broken = Weighing.compensated_criterion, set()

    def breaking(self, at, criterion, x):
        _, _, kind = criterion.model.name.partition(" + ")
        if kind not in ("", "quadratic_damping"):
            broken.add(kind)
            raise np.linalg.LinAlgError("SVD did not converge")
        return compensated_criterion(self, at, criterion, x)

    monkeypatch.setattr(Weighing, "compensated_criterion", breaking)
    found = casid.diagnose(roll_decay.problem, record, advise=False, max_causes=1)
    assert found.causes[0].kind == "quadratic_damping"
    assert broken
    for kind in broken:
        names = {effect_words(r.kind, r.where) for r in found.ranking if r.kind == kind}
        failed = [n for n in found.notes if n.partition(" was left out")[0] in names]
        assert failed
        assert "was left out: its numbers break down (SVD did not converge)" in failed[0]


@pytest.mark.slow
def test_an_effect_that_the_model_has_no_solution_with_leaves_the_others_to_be_tested(monkeypatch):
    record = roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)

    def without_an_inertia(model, names):
        balance = model.balances["torque"]
        model.balances["torque"] = replace(balance, inertia=0 * balance.inertia)

    size = Parameter("s", "1", 0.0)
    unsound = Effect("user", "torque", (size,), without_an_inertia)

    def with_it(*arguments, **options):
        return [*catalogue(*arguments, **options), unsound]

    monkeypatch.setattr(rounds, "catalogue", with_it)
    found = casid.diagnose(roll_decay.problem, record, advise=False, max_causes=1)
    assert found.causes[0].kind == "quadratic_damping"
    (note,) = [n for n in found.notes if "was left out" in n]
    assert "an inertia must not be zero" in note


def without_an_inertia_beside_another(model, names):
    if len({n for n in model.parameters if n.startswith("pair")}) > 1:
        balance = model.balances["torque"]
        model.balances["torque"] = replace(balance, inertia=0 * balance.inertia)


def overflowing(model, names):
    model.add_term("torque", 1e200 * model.symbol(names[0]))


def of_a_logarithm(model, names):
    model.add_term("torque", model.symbol(names[0]) * ca.log(model.symbol("phi") - 10.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "reason"),
    [
        pytest.param([without_an_inertia_beside_another] * 2, "inertia must not be zero", id="two"),
        pytest.param([overflowing], "its sensitivities overflow", id="overflow"),
        pytest.param([of_a_logarithm], "", id="not a number"),
    ],
)
def test_one_effect_that_fails_beside_the_others_is_left_out_alone(effects, reason, monkeypatch):
    """Two effects that break the model together alone, and effects that break its simulation."""
    record = roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)
    own = [
        Effect(f"user {i}", "torque", (Parameter(f"pair{i}", "1", 0.0),), apply)
        for i, apply in enumerate(effects)
    ]

    def with_them(*arguments, **options):
        return [*catalogue(*arguments, **options), *own]

    monkeypatch.setattr(rounds, "catalogue", with_them)
    found = casid.diagnose(roll_decay.problem, record, advise=False, max_causes=1)
    assert found.causes[0].kind == "quadratic_damping"
    (note,) = [n for n in found.notes if "was left out" in n]
    assert note.startswith(f"user {len(own) - 1}")
    assert reason in note
    assert len(note) < 300
