"""A model survives a pickle with every expression, and copies share its symbols."""

from __future__ import annotations

import copy
import pickle

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.serialisation import packed, unpacked
from problems import pendulum, ship_4dof


def values(model: casid.Model, seed: int = 3) -> np.ndarray:
    """Right-hand sides and outputs at a random point."""
    e = model.explicit()
    rng = np.random.default_rng(seed)
    function = ca.Function("f", [e.x, e.u, e.p], [ca.vertcat(e.f, e.h)])
    return np.array(function(*[rng.uniform(0.2, 1.7, part.numel()) for part in (e.x, e.u, e.p)]))


@pytest.mark.parametrize("model", [pendulum.problem.model, ship_4dof.problem.model])
def test_a_pickled_model_computes_the_same_to_the_last_bit(model):
    again = pickle.loads(pickle.dumps(model))
    assert str(again) == str(model)
    assert vars(again).keys() == vars(model).keys()
    assert (again.states, again.inputs, again.parameters) == (
        model.states,
        model.inputs,
        model.parameters,
    )
    assert np.array_equal(values(again), values(model))


def test_the_symbols_of_a_pickled_model_are_those_of_its_expressions():
    """An effect, an elimination undone: both work on what the expressions are made of."""
    again = pickle.loads(pickle.dumps(pendulum.problem.model))
    assert str(again.direct()) == str(pendulum.problem.model.direct())
    assert "a_y" in again.direct().inputs
    again.substitute_symbol("k", 2 * again.symbol("k"))
    assert not np.array_equal(values(again), values(pendulum.problem.model))


def test_copies_are_independent_and_share_the_symbols():
    model = pendulum.problem.model
    for new in (copy.copy(model), copy.deepcopy(model)):
        assert new.symbol("phi") is model.symbol("phi")
        new.parameters["k"] = casid.Parameter("k", "N m/rad", value=1.0)
        assert not model.parameters["k"].is_known


def test_expressions_that_casadi_cannot_read_are_refused():
    state, text = packed({"name": "m", "parts": [ca.SX.sym("x")]})
    with pytest.raises(casid.DataError, match="cannot be read by CasADi"):
        unpacked(state, text[: len(text) // 2])
