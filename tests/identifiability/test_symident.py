"""Ranks and verdicts agree with symident, which finds Lie symmetries over finite fields."""

from __future__ import annotations

import json

import pytest

from casid.identifiability.equations.equation_file import read_equations
from casid.identifiability.rank.observability import observability
from tests.support.shared import shared

symident = pytest.importorskip("symident", reason="symident is not installed; pip install symident")

FILES = (
    *("bilirubin", "cgv1990", "crauste", "crn", "goodwin", "hdnl", "hiv_wodarz", "jakstat"),
    *("kd1999", "leukaemia", "llw", "mapk6", "pharm", "qy", "seaijrc"),
    *("si_issue419", "si_issue503", "siwr1"),
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("akt_fujita", "nfkb_full")),
)


@pytest.mark.parametrize("name", FILES)
def test_symident_finds_the_same_rank_and_the_same_parameters_free(name):
    """A parameter is not identifiable where it stands in the support of a symmetry."""
    path = shared(f"identifiability/{name}.json")
    fields = json.loads(path.read_text())
    (model,) = read_equations(path).systems
    other = symident.detect(
        symident.Model(
            fields["equations"],
            fields["outputs"],
            known_inputs=fields["known_inputs"],
            fixed=fields["known_constants"],
            parameters=fields["params"],
        )
    )
    found = observability(model)
    assert (found.rank, found.unknowns) == (other.rank, other.dim)
    moved = {symbol for symmetry in other.symmetries for symbol in symmetry["support"]}
    assert {p: p not in moved for p in found.parameters} == dict(found.identifiable)
    assert {x: x not in moved for x in model.states} == dict(found.observable[0])
