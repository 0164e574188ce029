"""Start values that `identify` is given by name."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.errors import ModelError


def cup() -> tuple[casid.Model, casid.Record]:
    """A cooling cup of tea, whose ambience is known."""
    m = casid.Model("cup")
    T, tau = m.state("T", "K", start=40.0), m.parameter("tau", "s", start=100.0, lower=1.0)
    m.derivative(T, -T / tau * m.constant("one", 1.0, "1"))
    m.output("excess", T, "K")
    excess = 50 * np.exp(-5 * np.arange(60) / 400)
    return m, casid.Record({"excess": excess}, {"excess": "K"}, Ts=5, name="tea")


def test_a_start_for_what_is_no_unknown_is_refused_with_the_nearest_name():
    model, record = cup()
    with pytest.raises(ModelError, match=r"'taw', .*there are tau, T\(0\); did you mean 'tau'\?"):
        casid.identify(model, record, start={"taw": 80.0})
    with pytest.raises(ModelError, match=r"'T', .* did you mean 'T\(0\)'\?"):
        casid.identify(model, record, start={"T": 45.0})
    with pytest.raises(ModelError, match="'one', which is known: leave it out"):
        casid.identify(model, record, start={"one": 2.0})


def test_starts_of_parameters_and_initial_states_are_taken_by_record_where_there_are_several():
    model, record = cup()
    found = casid.identify(model, record, start={"tau": 300.0, "T(0)": 45.0})
    assert [found.parameter(n).start for n in ("tau", "T(0)")] == [300.0, 45.0]
    both = [casid.Experiment(record, {}, name) for name in ("p", "q")]
    settings = casid.FitSettings(own=("tau",))
    given = {"tau": 200.0, "tau@q": 300.0, "T(0)@p": 45.0}
    found = casid.identify(model, both, settings=settings, start=given)
    assert [found.parameter(n).start for n in ("tau@p", "tau@q")] == [200.0, 300.0]
    with pytest.raises(ModelError, match=r"'T\(0\)', .* did you mean 'T\(0\)@p'\?"):
        casid.identify(model, both, start={"T(0)": 45.0})
