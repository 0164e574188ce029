"""No sentence of a report contradicts another: rules that hold for any diagnosis.

Diagnoses are put together from drawn numbers by the functions that word them (`verdict_sentence`,
`what_remains`, `advice`); the terminal's text and the page's parts are then read as a reader does.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.diagnosis.advice.recommendation import advice
from casid.diagnosis.diagnosis import Alternative, Cause, Diagnosis, Ranked
from casid.diagnosis.facts import Facts
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.cause import Doubts
from casid.diagnosis.verdict.gain import decisive, improves
from casid.diagnosis.verdict.remainder import NoiseFound, what_remains
from casid.diagnosis.verdict.sentences import verdict_sentence
from casid.estimation.estimate import Estimated
from casid.model.effects.effect import KINDS as CATALOGUE
from casid.model.effects.names import _NAMES, ANYWHERE, effect_words
from casid.report.document import Document, plain
from casid.report.html.page import html_page
from casid.report.numbers import p_text
from casid.report.pages.cause_parts import cause_part, ranking_parts
from casid.report.pages.diagnosis_page import decision
from casid.report.pages.limit_parts import pairs_parts
from casid.report.pages.remainder_parts import gain_table, remaining_parts
from tests.support import samples
from tests.support.sample_parts import isolability

MODEL = SimpleNamespace(unit_of=lambda _: "rad/s", shown_size=lambda _, size: size)
PROBLEM = SimpleNamespace(model=MODEL)
KINDS = ("quadratic_damping", "coulomb_friction", "cubic_stiffness", "time_delay", "offset")
LEVEL = 0.05

size = st.floats(1e-4, 1e3)
p_values = st.floats(1e-30, 1.0)


@st.composite
def errors(draw: st.DrawFn) -> dict[str, dict[str, float]]:
    """RMS errors of one or two outputs before and after, and their noise floors."""
    outputs = ("gyro", "accel")[: draw(st.integers(1, 2))]
    floor = {o: draw(size) for o in outputs}
    before = {o: floor[o] * draw(st.floats(0.9, 50.0)) for o in outputs}
    after = {o: floor[o] * draw(st.floats(0.9, 60.0)) for o in outputs}
    return {"baseline_rmse": before, "extended_rmse": after, "noise_floor": floor}


@st.composite
def diagnoses(draw: st.DrawFn) -> Diagnosis:
    """A diagnosis with up to two causes, each with up to two rivals."""
    kinds = draw(st.permutations(KINDS))
    causes = []
    for kind in kinds[: draw(st.integers(0, 2))]:
        rivals = tuple(
            Alternative(k, "torque", draw(p_values), "explains the misfit as well")
            for k in kinds[2 : 2 + draw(st.integers(0, 2))]
        )
        causes.append(
            Cause(
                kind,
                "torque",
                draw(st.floats(1e-30, LEVEL)),
                (Estimated(f"c_{kind}", 0.3, "N m", std_error=0.01),),
                rivals,
                share=draw(st.floats(0.02, 1.0)),
                sentence=f"{kind} acts in the torque balance",
            )
        )
    held = draw(errors())
    if not causes:
        held["extended_rmse"] = {}
    verdict = "deficient" if causes else draw(st.sampled_from(("adequate", "undecided")))
    why = "the record is too short" if verdict == "undecided" else ""
    extended = samples.estimate(extended=True) if causes else None
    outside = draw(st.integers(0, 20))
    last = extended or samples.estimate()
    fit = replace(
        last.fit, whiteness_tests={o: samples.whiteness_of(outside) for o in held["baseline_rmse"]}
    )
    last = replace(last, fit=fit)
    p_value = draw(st.none() | p_values)
    doubts = Doubts(p_value is not None and p_value < LEVEL)
    named = [(c.kind, c.where, c.share / sum(c.share for c in causes)) for c in causes]
    return samples.changed(
        samples.adequate(),
        verdict=verdict,
        sentence=verdict_sentence(verdict, causes, held, why, PROBLEM, doubts=doubts),
        causes=tuple(causes),
        ranking=tuple(
            Ranked(k, "torque", draw(p_values), draw(p_values), 1.0, draw(st.sampled_from(
                ("named", "cannot be rejected", "rejected", "not significant")
            )))
            for k in kinds
        ),
        baseline=samples.estimate() if causes else last,
        extended=last if causes else None,
        held_out=held,
        fitted=held,
        moved=(),
        isolability=draw(st.none() | st.just(isolability())),
        advice=advice(
            verdict, causes, (), why, is_better=improves(decisive(held, held)), doubts=doubts
        ),
        remaining=what_remains(
            named, held, p_value=p_value, test="kind of the residual",
            false_alarm_rate=LEVEL, noise=NoiseFound(last.fit.coloured),
        ),
    )  # fmt: skip


def shown(d: Diagnosis) -> str:
    """What a reader of the page reads, figures apart."""
    parts = [
        *decision(d),
        *(cause_part(i, c, None) for i, c in enumerate(d.causes, 1)),
        gain_table(d),
        *remaining_parts(d),
        *ranking_parts(d),
        *pairs_parts(d),
    ]
    page = html_page(Document(d.problem, parts, kind="Diagnosis"))
    body = page.split("</header>", 1)[1].split("<script", 1)[0]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))


@pytest.mark.slow
@settings(max_examples=500, deadline=None, derandomize=True)
@given(diagnoses())
def test_no_sentence_of_a_diagnosis_contradicts_another(d: Diagnosis) -> None:
    page = shown(d)
    for text in (page, str(d)):
        _verdict_agrees_with_causes(d, text)
        _remainder_agrees_with_its_tests(d, text)
        _gain_agrees_with_advice(d, text, page)
        _what_is_named_alone_is_not_said_to_be_inseparable(d, text)
    _every_effect_has_one_p_value(d)


def _verdict_agrees_with_causes(d: Diagnosis, text: str) -> None:
    assert (d.verdict == "deficient") == bool(d.causes)
    p_value = d.remaining.p_value if d.remaining is not None else None
    is_noise = p_value is None or p_value >= LEVEL
    is_said = "Nothing in this record contradicts the model" in text
    assert is_said == (d.verdict == "adequate" and is_noise)
    assert ("The model may be used" in text) == is_said
    if d.verdict == "adequate":
        assert "Use the extended model" not in text


def _remainder_agrees_with_its_tests(d: Diagnosis, text: str) -> None:
    """Said to be noise: no test rejects it, no error is above the floor, colour is named."""
    r = d.remaining
    assert r is not None
    if "The remainder is consistent with" not in text:
        return
    assert r.p_value is not None
    assert r.p_value >= LEVEL
    assert max(r.over_floor.values()) <= JUDGING.at_floor
    for output, lags in Facts.of(d).coloured.items():
        assert f"{output}: {lags}" in r.sentence
    assert "more than noise" not in text
    assert "An error above the floor remains" not in text


def _gain_agrees_with_advice(d: Diagnosis, text: str, page: str) -> None:
    """What is said to be lowered is lower, and a model that predicts worse is not recommended."""
    changes = {c.output: c for c in Facts.of(d).shown}
    said = re.search(r"Including (?:it|them) (lowers|raises) the RMS error of ([^.]*?) from", text)
    if said is not None:
        assert (changes[said[2]].after < changes[said[2]].before) == (said[1] == "lowers")
    if "Use the extended model" in text:
        assert improves(d.held_out)
        assert not any(c.tied for c in d.causes)
    for c in changes.values():
        if c.after is not None and not math.isclose(c.after, c.before, rel_tol=0.01):
            assert (f"error {'−' if c.after < c.before else '+'}" in page) or len(changes) > 1


def _what_is_named_alone_is_not_said_to_be_inseparable(d: Diagnosis, text: str) -> None:
    """Signatures may be nearly alike all the same: a large misfit separates them."""
    is_open = any(c.alternatives and not c.is_inseparable for c in d.causes)
    assert ("this record does not separate" in text) == is_open
    assert ("To separate" in text) <= is_open


def _every_effect_has_one_p_value(d: Diagnosis) -> None:
    """The table of candidates shows a named cause with the p-value of the cause."""
    facts = Facts.of(d)
    rows = [row for part in ranking_parts(d) for row in _rows(part)]
    assert len(rows) == len(d.ranking)
    for c in d.causes:
        words = effect_words(c.kind, c.where)
        found = {row[1] for row in rows if plain(row[0]).startswith(words)}
        assert found == {p_text(c.p_value)} == {p_text(facts.p_value(*c.key))}


def _rows(part: object) -> list[tuple]:
    if hasattr(part, "parts"):
        return [row for inner in part.parts for row in _rows(inner)]
    return list(getattr(part, "rows", ()))


def test_every_kind_of_the_catalogue_has_a_name_in_words() -> None:
    assert CATALOGUE <= set(_NAMES)
    assert not any("_" in effect_words(kind, "torque") for kind in CATALOGUE)


def test_a_disturbance_that_depends_on_states_is_not_said_to_be_independent_of_them() -> None:
    """The two sentences that once stood beside each other: "no function explains it", p 1e-65."""
    from casid.diagnosis.unexplained.description import disturbance_sentences
    from tests.support.sample_parts import unexplained

    tests = unexplained(samples.view(N=400)).tests
    loose = replace(tests, verdict="a disturbance (random, uncorrelated with inputs and states)")
    assert (
        "no function of states"
        in disturbance_sentences("", replace(loose, p_dependence=0.5), LEVEL)[0]
    )
    text = disturbance_sentences("", replace(loose, p_dependence=1e-65), LEVEL)[0]
    assert "no function of states, inputs or recorded channels explains it" not in text
    assert "p = 1e-65" in text


def test_an_unknown_cause_without_a_place_is_in_the_model():
    assert effect_words("unknown", ANYWHERE) == "unidentified term in the model"
    assert effect_words("unknown", "force: x v") == "unidentified term like x v in force"
