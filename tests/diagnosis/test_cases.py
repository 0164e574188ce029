"""Synthetic pendulum records whose hidden effect is listed beside them: is it the one named?

All of them are in the study `analysis.cases`, here the kind that other tests of a pendulum do not
hide in a record; `test_diagnose` has the others, and records without an effect.
"""

from __future__ import annotations

import json

import pytest

import casid
from analysis.cases.study import KINDS as STUDIED
from casid.model.effects.effect import KINDS
from problems import pendulum
from tests.support.shared import shared

NAMED = [("case_012", "scheduled_parameter")]


def diagnosed(case: str) -> tuple[dict, casid.Diagnosis]:
    folder = shared("cases/pendulum")
    truths = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    listed = {t["case"]: t for t in truths}[case]
    record = pendulum.problem.read(folder / f"{case}.csv")
    return listed, casid.diagnose(pendulum.problem, record, advise=False)


def test_every_kind_named_here_is_in_the_study():
    assert {kind for _, kind in NAMED} <= STUDIED <= KINDS


@pytest.mark.slow
@pytest.mark.parametrize(("case", "kind"), NAMED)
def test_the_listed_effect_is_the_first_cause_with_at_most_one_further(case, kind):
    listed, d = diagnosed(case)
    assert listed["kind"] == kind
    assert d.verdict == "deficient"
    assert d.causes[0].kind == kind
    assert len(d.causes) <= 2
    first = d.causes[0]
    places = {first.where} | {a.where for a in first.alternatives if a.kind == kind}
    assert listed["where"] in places
