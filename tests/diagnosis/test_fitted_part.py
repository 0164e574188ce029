"""What the first part of a record does not determine, and the whole record does, is no refusal."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.errors import IdentifiabilityError


def relief(opens_at: float) -> tuple[casid.Problem, casid.Record]:
    """A vessel with a leak, filled ever faster; a relief valve opens above 1 bar late in it."""
    m = casid.Model("vessel")
    u, x = m.input("inflow", "1", hold="zoh", known=True), m.state("x", "1", initial=0.0)
    a, b = (m.parameter(n, "1/s", start=1.0, lower=0.01, upper=10.0) for n in "ab")
    c = m.parameter("c", "1/s", start=2.0, lower=0.0, upper=50.0)
    m.derivative(x, b * u - a * x - c * (abs(x - 1) + x - 1) / 2)
    m.output("pressure", x, "1")
    rng, N, Ts = np.random.default_rng(5), 300, 0.05
    inflow = np.repeat(rng.uniform(0.0, 0.9, N // 10), 10)
    inflow[int(opens_at * N) :] += 3.0
    level, shown = 0.0, np.empty(N)
    for k in range(N):
        shown[k] = level
        for _ in range(50):
            level += Ts / 50 * (1.1 * inflow[k] - 1.2 * level - 3.0 * max(level - 1.0, 0.0))
    shown += 0.002 * rng.standard_normal(N)
    signals = {"inflow": inflow, "pressure": shown}
    return casid.Problem("vessel", m), casid.Record(signals, dict.fromkeys(signals, "1"), Ts=Ts)


def test_less_is_held_out_where_the_fitted_part_does_not_determine_the_parameters():
    """The valve opens after 75 %: of 30 % held out it is unknown, of 15 % it is not."""
    problem, record = relief(0.75)
    found = casid.diagnose(problem, record, max_causes=1, starts=1, advise=False)
    assert found.settings["held out"] == "the last 15 % of each record"
    assert any("do not determine all parameters" in note for note in found.notes)
    assert found.verdict == "adequate"


def test_what_no_part_of_the_record_determines_is_refused_as_before():
    problem, record = relief(1.0)
    with pytest.raises(IdentifiabilityError, match="c does not move any output"):
        casid.diagnose(problem, record, max_causes=1, starts=1, advise=False)
