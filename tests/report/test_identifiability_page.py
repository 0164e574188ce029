"""An assessment's page and text: every part there is, offline, and names that stay names."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.model.quantities import percent_text
from casid.report.html.drawing import DRAW
from problems import pendulum, ship
from tests.report.test_pages import Seen, assert_loads_nothing
from tests.support.excited_models import decay
from tests.support.samples import HOSTILE, page_of

WIDTH = 100

MIXING = {
    "states": ["x1", "x2", "x3"],
    "params": ["p1", "p2", "p3", "p4"],
    "known_inputs": ["u"],
    "equations": {
        "x1": "-p1*x1 + p2*u",
        "x2": "-p3*x2 + p4*u",
        "x3": "-(p1 + p3)*x3 + (p4*x1 + p2*x2)*u",
    },
    "outputs": {"y": "x3"},
    "units": {"p1": "1/s"},
}

UNKNOWN_FORCE = {
    "states": ["v"],
    "params": ["m", "d"],
    "unknown_inputs": ["w"],
    "equations": {"v": "(w - d*v)/m"},
    "outputs": {"speed": "v", "acceleration": "(w - d*v)/m"},
}


def two_gains(name: str = "decay", record: str = "run") -> casid.Assessment:
    """p is told, g1 and g2 in their product alone; with the errors to expect of a record."""
    model, clock = decay(T=6.0, gains=2)
    rng = np.random.default_rng(2)
    y = 4 * np.exp(-0.5 * clock.t) + 0.02 * rng.standard_normal(clock.N)
    measured = replace(clock.with_channel("y", y, "m"), name=record)
    problem = casid.Problem(name, model, starts=1)
    return casid.assess_identifiability(problem, [casid.Experiment(measured, {}, record)])


@pytest.fixture(scope="module")
def mixing() -> casid.Assessment:
    sensors = [casid.sensor("first", "x1", 3.0), casid.sensor("second", "x2", 1.0)]
    system = casid.parse_system(MIXING, name="mixing")
    return casid.assess_identifiability(system, candidates=sensors)


@pytest.fixture(scope="module")
def gains() -> casid.Assessment:
    return two_gains()


@pytest.fixture(scope="module")
def swing() -> casid.Assessment:
    profiled = replace(pendulum.problem, starts=1)
    record = pendulum.simulate(duration=8.0)
    return casid.assess_identifiability(profiled, record, profiles=["k"])


@pytest.fixture(scope="module")
def force() -> casid.Assessment:
    return casid.assess_identifiability(casid.parse_system(UNKNOWN_FORCE, name="unknown force"))


@pytest.fixture(scope="module")
def partial() -> casid.Assessment:
    model, records = ship.nine_parameters().model, ship.experiments(duration=1.0)
    return casid.assess_identifiability(model, records, time_limit=1e-9)


ALL = ["mixing", "gains", "swing", "force", "partial"]


@pytest.fixture(params=ALL)
def each(request: pytest.FixtureRequest) -> casid.Assessment:
    return request.getfixturevalue(request.param)


# -- the page --------------------------------------------------------------------------------------


def sections(page: str) -> list[str]:
    return [html.unescape(h) for h in re.findall(r"<h2>(.*?)</h2>", page)]


def test_the_page_loads_nothing_and_runs_no_script_but_those_of_its_figures(each):
    page = page_of(each)
    assert_loads_nothing(page)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert policy.startswith("default-src 'none'")
    assert re.search(r"script-src ([^;]*)", policy)[1].count("'sha256-") == 2
    kinds = [a.get("type", "") for t, a in Seen(page).tags if t == "script"]
    figures = len(each.plot())
    assert page.count('id="library"') == (1 if figures else 0)
    assert kinds == ["application/json"] * figures + ["text/plain"] * bool(figures) + [""]


def test_the_answer_stands_first_in_words(each):
    text = Seen(page_of(each)).text
    word = (
        "partial"
        if each.answer.is_partial
        else "identifiable"
        if each.is_identifiable
        else "not identifiable"
    )
    said = text.index(each.sentence)
    assert word in text[:said]
    assert said < text.index(f"{each.rank} of {each.unknowns}", said)
    assert said < text.index("What the answer rests on", said)


def test_what_the_records_determine_stands_beside_what_could_be_determined(swing):
    """Identifiable in principle, and with which error in these records."""
    text = Seen(page_of(swing)).text
    rows = swing.practical.parameters
    worst = max(rows, key=lambda r: r.relative)
    share = f"{percent_text(100 * worst.relative)} of the value, that of {worst.name}"
    assert all(r.verdict == "well determined" for r in rows)
    assert share in text
    spoilt = replace(worst, relative=0.5, verdict="poorly determined")
    less = replace(swing.practical, rows=tuple(spoilt if r is worst else r for r in rows))
    text = Seen(page_of(replace(swing, records=replace(swing.records, practical=less)))).text
    assert f"These records determine {worst.name} poorly." in text
    assert share not in text


def test_every_part_has_its_section_and_no_section_is_empty(mixing, gains, swing, force):
    always = ["Parameters", "States", "What the answer rests on", "Provenance", "References"]
    expected = {
        "mixing": (mixing, ["Identifiable combinations", "Remedies", "Poorer excitation"]),
        "gains": (gains, ["Identifiable combinations", "What these records give"]),
        "swing": (swing, ["Poorer excitation", "What these records give"]),
        "force": (force, ["Identifiable combinations", "Remedies", "Unknown inputs"]),
    }
    for name, (assessment, own) in expected.items():
        page = page_of(assessment)
        found = sections(page)
        assert set(always + own) <= set(found), name
        assert len(found) == len(set(found)), name
        bodies = re.split(r"<h2>.*?</h2>", page)[1:]
        assert all(Seen(b).text.strip() for b in bodies), name
    assert "Unknown inputs" not in sections(page_of(mixing))
    assert "Remedies" not in sections(page_of(swing))


def test_what_the_assessment_knows_stands_in_the_text(mixing, gains, swing, force):
    def text(assessment: casid.Assessment) -> str:
        return Seen(page_of(assessment)).text

    shown = text(mixing)
    for words in ("structurally unidentifiable", "p2*p4", "1/s", "sensor second", "not observable"):
        assert words in shown
    assert "give any one of p2, p4 a known value" in shown.replace("Give any", "give any")
    shown = text(gains)
    for words in (
        "structurally unidentifiable",
        "g1*g2",
        "Cramer-Rao bound",
        "Expected errors from run",
    ):
        assert words in shown
    shown = text(swing)
    for words in ("a_y zero", "rank", "Profile likelihood", "Excitation orders"):
        assert words in shown
    shown = text(force)
    for words in ("arbitrary", "polynomial_1", "Unknown: w", "w eliminated with"):
        assert words in shown
    for assessment in (mixing, gains, swing, force):
        for words in (assessment.certainty, *assessment.notes, *assessment.sources):
            assert words in text(assessment)


def test_the_table_of_expected_errors_says_what_an_initial_state_is_relative_to(gains):
    said = "elative: the standard error over the value; of an initial state, over the rms"
    for shown in (str(gains), page_of(gains)):
        assert said in " ".join(shown.split())


def test_figures_are_drawn_of_what_records_give_and_of_nothing_else(mixing, gains, swing):
    assert mixing.plot() == {}
    assert set(gains.plot()) >= {"errors"}
    assert set(swing.plot()) == {"errors", "correlations", "profiles"}
    page = page_of(swing)
    plots = [a for _, a in Seen(page).tags if a.get("class") == "plot"]
    assert len(plots) == 3
    assert all(a["aria-label"] for a in plots)
    assert page.count("<figcaption>") == 3
    for script in Seen(page).scripts[:-2]:
        json.loads(script)


def test_the_same_assessment_has_the_same_page(mixing):
    assert page_of(mixing) == page_of(mixing)


def test_both_files_are_written_together(mixing, tmp_path):
    path = mixing.write(tmp_path / "found")
    assert path.name == "report.html"
    assert path.read_text(encoding="utf-8") == page_of(mixing)
    written = json.loads((path.parent / "identifiability.json").read_text())
    assert written == json.loads(json.dumps(mixing.to_json(), allow_nan=False))


# -- names that are attacks ------------------------------------------------------------------------


def hostile() -> casid.Assessment:
    """Every text that a problem, a record or an equation file can bring in is an attack."""
    h = HOSTILE
    a = two_gains(name=h, record=h)
    return replace(
        a,
        units={n: h for n in a.parameters},
        notes=(h, *a.notes),
        inputs=replace(
            a.inputs,
            eliminated=(h,),
            unknown_inputs=(h,),
            by_class={h: a.answer, "none": replace(a.answer, rank=None, unknowns=None, note=h)},
            by_excitation={h: a.answer},
        ),
        provenance=replace(a.provenance, versions={h: h}, sources=(h,)),
    )


def test_hostile_names_stay_text(gains, force):
    harmless, page = page_of(gains), page_of(hostile())
    seen = Seen(page)
    tags = {t for t, _ in (*Seen(harmless).tags, *Seen(page_of(force)).tags)}
    assert {t for t, _ in seen.tags} <= tags
    assert seen.scripts[-2:] == Seen(harmless).scripts[-2:]  # plotly.js and ours, unchanged
    assert len(seen.scripts) == len(Seen(harmless).scripts)
    assert html.unescape(seen.text).count("alert(1)") > 10  # shown, not swallowed
    for data in seen.scripts[:-2]:
        json.loads(data)
        assert not re.search(r"[<>&]", data)
    assert not [a for _, attributes in seen.tags for a in attributes if a.startswith("on")]
    page.encode("utf-8")


def test_hostile_names_in_an_equation_file_stay_text(tmp_path):
    """A file's own name and those of its data sets are free text; states are not."""
    fields = {
        **MIXING,
        "name": HOSTILE,
        "description": HOSTILE,
        "data_sets": [{"name": HOSTILE}, {"name": "plain"}],
    }
    path = tmp_path / "hostile.json"
    path.write_text(json.dumps(fields))
    a = casid.assess_identifiability(path, symbolic=False)
    seen = Seen(page_of(a))
    assert not {"img", "iframe"} & {t for t, _ in seen.tags}
    assert seen.scripts == [DRAW]
    assert "alert(1)" in seen.text
    path.write_text(json.dumps({**MIXING, "states": ["x1", "x2", "<b>"]}))
    with pytest.raises(casid.ModelError, match="is not a name"):
        casid.assess_identifiability(path)


# -- the text --------------------------------------------------------------------------------------


def test_lines_of_the_text_fit_a_terminal(each):
    lines = str(each).splitlines()
    assert lines[0] == f"Identifiability of {each.name}: rank {each.rank} of {each.unknowns}"
    assert max(map(len, lines)) <= WIDTH
    assert all(line == line.rstrip() for line in lines)


def test_the_text_says_what_the_json_says(each):
    text = " ".join(str(each).split())
    assert " ".join(each.sentence.split()) in text
    for note in each.notes:
        assert " ".join(note.split()) in text
    for family in each.families:
        if len(family.moved) > 1:
            for invariant in family.invariants:
                assert str(invariant) in text
    if not each.answer.is_partial:
        content = each.to_json()
        lost = [p for p, v in content["parameters"].items() if v == "not_identifiable"]
        if lost:
            assert f"structurally unidentifiable: {', '.join(lost)}" in text
        assert repr(each) == (
            f"<Assessment of {content['problem']}: rank {content['rank']} of {content['unknowns']}>"
        )


def test_the_json_holds_plain_values_alone(each):
    content = each.to_json()
    assert json.loads(json.dumps(content, allow_nan=False)) == content


def test_expected_errors_are_shown_in_the_units_that_were_declared():
    """A spring of 400 kN/m and its deflection in mm; plain values stay in SI units."""
    m = casid.Model("spring")
    x, F = m.state("x", "mm", start=2.0), m.input("F", "N", known=True)
    k = m.parameter("k", "kN/m", start=400.0)
    c = m.constant("c", 4e5, "N s/m")
    m.balance(x, "force", inertia=c, terms=[F, -k * x])
    m.output("x", x, "mm")
    force = np.where(np.arange(200) % 40 < 20, 500.0, -500.0)
    record = casid.Record({"F": force}, {"F": "N"}, Ts=0.1)
    found = casid.practical_identifiability(m, record, noise={"x": 1e-5})
    shown = {r[0]: r[1:4] for r in (row.split() for row in str(found).splitlines()) if len(r) > 4}
    assert shown["k"][:2] == ["kN/m", "400"]
    assert shown["x(0)"][:2] == ["mm", "2"]
    assert float(shown["k"][2]) == pytest.approx(found["k"].std_error / 1e3, rel=1e-3)
    assert found["k"].to_json()["unit"] == "N/m"
