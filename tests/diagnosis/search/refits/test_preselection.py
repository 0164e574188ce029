"""Candidates compared on the first part of long records: what is left out could not have won."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.refits import preselection
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.search.rounds import Search, shortlist
from casid.diagnosis.thresholds import ROUNDS
from tests.support.hidden_forces import RECORDED, fitted


@pytest.fixture(scope="module")
def found():
    """Refits where damping by drag is hidden, 2000 samples, and its shortlist."""
    at, experiments = fitted("quadratic damping", 3)
    weighing = Weighing(experiments, known_noise={"F": 0.02})
    table = Search(weighing, RECORDED).table(at, [])
    return Refitting(weighing), at, shortlist(at, table)


def test_short_records_are_refitted_as_they_are(found):
    refitting, at, short = found
    kept = preselection.preselected(refitting, at, short)
    assert [start.score for start in kept] == short
    assert all(start.found is None for start in kept)


@pytest.mark.slow
def test_only_hopeless_candidates_are_left_out_of_a_long_record(found, monkeypatch):
    refitting, at, short = found
    every = {s.effect.key: refitting.refit(at, s.effect, s.step, starts=s.starts) for s in short}
    best = max(c.gain for c in every.values() if c is not None)
    monkeypatch.setattr(preselection, "ROUNDS", replace(ROUNDS, long=1000, part=800))
    kept = {s.score.effect.key: s for s in preselection.preselected(refitting, at, short)}
    assert ("quadratic_damping", "force") in kept
    lost = [every[key].gain for key in every if key not in kept]
    assert lost
    assert max(lost) < 0.3 * best  # `Comparison.relative_gain`: none would have been judged further


def test_a_refit_from_the_part_ends_where_any_other_does(found, monkeypatch):
    refitting, at, short = found
    monkeypatch.setattr(preselection, "ROUNDS", replace(ROUNDS, long=1000, part=800))
    near = {s.score.effect.key: s for s in preselection.preselected(refitting, at, short)}
    start = near["quadratic_damping", "force"]
    score = start.score
    again = refitting.again(at, start.found)
    plain = refitting.refit(at, score.effect, score.step, starts=score.starts)
    # Both stop at a scaled gradient of 1e-6: J then is right to about 1e-6 of itself.
    assert again.gain == pytest.approx(plain.gain, rel=1e-4)
    assert again.fit.values[again.names[0]] == pytest.approx(plain.fit.values[plain.names[0]], 1e-3)


def test_a_beginning_that_shows_little_is_not_asked(found, monkeypatch):
    refitting, at, short = found
    monkeypatch.setattr(preselection, "ROUNDS", replace(ROUNDS, long=1000, part=800))
    monkeypatch.setattr(preselection, "_misfit_in_head", lambda at, share: 0.4 * share)
    assert all(s.found is None for s in preselection.preselected(refitting, at, short))


def test_the_first_part_holds_its_share_of_an_even_misfit(found):
    _, at, _ = found
    power = np.sum(at.criterion.columns(at.fit.x, 0)[0] ** 2, axis=1)
    n = round(0.4 * len(power))
    exact = power[:n].sum() / power.sum()
    assert preselection._misfit_in_head(at, 0.4) == pytest.approx(exact, rel=1e-12)
