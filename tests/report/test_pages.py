"""The report is one page that opens offline, says all there is, and lets no text become code."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

import casid
from casid.diagnosis.advice.next_experiment import Proposal
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.verdict.cause import Alternative, Cause, Ranked
from casid.estimation.estimate import Estimated
from casid.model.quantities import unit_text
from casid.report.document import Table
from casid.report.figures.diagnosis import diagnosis_figures
from casid.report.numbers import estimated_texts
from casid.report.pages.cause_parts import ranking_parts
from casid.report.pages.limit_parts import inseparable, proposals_table
from tests.support import sample_parts, samples
from tests.support.fitted_models import extended_pendulum, pendulum_alone
from tests.support.samples import page_of

FIGURES = {"page": 7, "rich": 15, "hostile": 15}
SECTIONS = (
    "What remains",
    "What is unknown",
    "Parameters that moved",
    "What cannot be distinguished",
    "Next experiment",
    "Undetectable in this set-up",
    "Calibration",
)


def test_an_unknown_alternative_is_listed_once():
    """With its function described, and not again by the name that the search has for it."""
    d = samples.deficient()
    first = d.causes[0]
    rival = Alternative("unknown", "torque", 0.4, "explains it as well", "a power of the angle")
    tied = Ranked("unknown", "torque: phi^5", 1e-9, 1e-8, 40.0, "cannot be rejected")
    d = replace(d, causes=(replace(first, alternatives=(rival,)),), ranking=(tied,))
    table = inseparable(d)
    assert isinstance(table, Table)
    assert len(table.rows) == 1


def test_a_length_that_nobody_would_record_is_a_bound_and_no_number_of_years():
    """Thirteen years would be extrapolated a hundredfold from a record of an hour."""
    proposal = Proposal(
        name="larger",
        description="twice the amplitude",
        pair=(("offset", "heat"), ("sensor_bias", "T")),
        cosine=0.99,
        energy_needed=1e3,
        record_length=13 * 31557600.0,
        gain_factor=1.0,
        seconds=3600.0,
        limit=36000.0,
    )
    d = replace(samples.deficient(), proposals=(proposal,))
    assert proposals_table(d).rows[0][4] == "more than 4.2 days (too long)"
    d = replace(d, proposals=(replace(proposal, record_length=72000.0),))
    assert str(proposals_table(d).rows[0][4]).endswith("(too long)")
    assert "more than" not in str(proposals_table(d).rows[0][4])


def test_terms_of_an_effect_that_is_not_the_cause_are_marked_as_the_nearest():
    """Where the cause has no name the extended model is a comparison, and no correction."""
    d = samples.deficient()
    assert d.extended is not None
    model = replace(extended_pendulum(), baseline=pendulum_alone())
    d = samples.changed(d, extended=replace(d.extended, model=model))
    named = page_of(d)
    assert "<mtext>new</mtext>" in named
    assert "no correction of the model" not in named
    near = Alternative("quadratic_damping", "torque", 1e-39, "the nearest effect")
    unknown = Cause("unknown", "torque", 1e-39, (), (near,))
    page = page_of(replace(d, causes=(unknown,)))
    assert "<mtext>new</mtext>" not in page
    assert "<mtext>nearest</mtext>" in page
    near_words = "quadratic damping in the torque balance"
    assert f"marked as nearest are no correction of the model: they are {near_words}" in page


def test_candidates_stand_by_what_became_of_them_then_by_p_and_gain():
    """Of many the p is below what a number holds; what they gain tells them apart."""
    fates = {"a": ("rejected", 0.0, 5.0), "b": ("rejected", 0.0, 50.0), "c": ("named", 1e-9, 9.0)}
    fates |= {"d": ("cannot be rejected", 1e-8, 8.0), "e": ("rejected", 1e-3, 90.0)}
    rows = tuple(Ranked(k, "torque", p, p, gain, how) for k, (how, p, gain) in fates.items())
    table = ranking_parts(replace(samples.deficient(), ranking=rows))[0]
    assert isinstance(table, Table)
    assert [row[2] for row in table.rows] == ["9", "8", "50", "5", "90"]


def test_no_number_is_less_than_nothing_when_it_is_rounded():
    """-3e-7 to the second digit of an error of 1.2e-4 is zero, and so is the upper end."""
    p = Estimated("x", -3e-7, "m", std_error=1.2e-4, ends=(-2e-4, -1e-9), interval_kind="profile")
    value, _, between = estimated_texts(p)
    assert value == "0.00000"
    assert between == "-0.00020 .. 0.00000 (profile)"


class Seen(HTMLParser):
    """Tags, attributes, scripts and text of a page, as a parser that is not a browser sees them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data):
        if self.cdata_elem == "script":
            self.scripts[-1] += data
        elif self.cdata_elem is None:
            self.text += data


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(samples.deficient())


def test_the_verdict_stands_first_in_words(page):
    d = samples.deficient(N=100)
    text = Seen(page).text
    assert text.index("deficient") < text.index(d.sentence) < text.index(d.causes[0].sentence)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (samples.adequate, ("adequate", "None. No effect of the catalogue")),
        (samples.undecided, ("undecided", "the record cannot support an answer")),
    ],
)
def test_a_diagnosis_without_a_cause_says_why(make, words):
    text = Seen(page_of(make())).text
    for word in words:
        assert word in text


@pytest.mark.slow
def test_a_model_beside_a_large_disturbance_is_not_said_to_explain_the_record():
    explains = "The model explains this record"
    assert explains in Seen(page_of(samples.adequate())).text
    for share, is_said in ((0.3, True), (0.9, False)):
        beside = samples.changed(
            samples.adequate(), disturbances=(Disturbance("torque", 0.1, "N m", share),)
        )
        text = Seen(page_of(beside)).text
        assert (explains in text) is is_said
        assert ("A disturbance that nobody recorded" in text) is not is_said


def test_everything_the_diagnosis_knows_stands_in_the_text(page):
    d = samples.deficient(N=100)
    text = Seen(page).text
    for expected in (
        "34 \u2192 10.4",  # key numbers, mrad/s
        "\u221269 %",
        "0.349",
        "0.327 .. 0.371",
        "Could also be:",
        d.causes[0].alternatives[0].why,
        "absorbed by s and I",  # invisible candidate
        "refit gains too little",
        d.advice,
        *d.notes,
        *map(unit_text, d.noise.values()),
        *d.provenance,
        *d.settings.values(),
        *d.versions.values(),
        *d.sources,
        d.baseline.assumes,
        d.baseline.whiteness["gyro"],
        "rank 3 of 3",
        "at lower bound",
    ):
        assert expected in text, expected


def test_warnings_of_the_extended_model_are_printed_beside_the_key_numbers():
    """A bound of the model without the causes is the error that they make."""
    d = samples.deficient(N=100)
    before = replace(d.baseline, warnings=("k is at its upper bound",))
    after = replace(d.extended, warnings=("only 1 of 4 starts agrees",))
    text = Seen(page_of(samples.changed(d, baseline=before, extended=after))).text
    assert text.index("Warning: only 1 of 4 starts agrees") < text.index(d.causes[0].sentence)
    assert "Warning: k is at its upper bound" not in text


def assert_loads_nothing(page):
    for tag, attributes in Seen(page).tags:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base"), tag
        for name in ("src", "href", "action", "srcset", "data"):
            value = attributes.get(name)
            assert value is None or value.startswith("#"), (tag, name, value)
        assert not [a for a in attributes if a.startswith("on")], (tag, attributes)
    assert "@import" not in page


def test_the_page_loads_nothing_and_carries_plotly_once(page):
    assert_loads_nothing(page)
    assert page.count('id="library"') == 1
    kinds = [a.get("type", "") for t, a in Seen(page).tags if t == "script"]
    assert kinds == ["application/json"] * FIGURES["page"] + ["text/plain", ""]


def test_a_page_weighs_less_than_a_megabyte(rich):
    """Two records of 6000 samples, 15 figures, and plotly.js."""
    assert 650_000 < len(rich.encode("utf-8")) < 1_000_000


def test_what_decides_is_open_and_details_unfold(page):
    """Verdict, gain, what to change and what to do next come before anything that unfolds."""
    first, _, folded = page.partition("<details")
    text = Seen(first).text
    for word in ("deficient", "What to change in the model", "What to do next"):
        assert word in text
    assert "All candidates" in folded
    assert "Provenance" in folded


def test_the_page_has_language_title_viewport_and_a_name_for_every_figure(page):
    seen = Seen(page)
    assert ("html", {"lang": "en"}) in seen.tags
    assert any(a.get("name") == "viewport" for _, a in seen.tags)
    assert "<title>Diagnosis of pendulum - casid</title>" in page
    plots = [a for _, a in seen.tags if a.get("class") == "plot"]
    assert len(plots) == FIGURES["page"]
    assert all(a["aria-label"] for a in plots)
    assert page.count("<figcaption>") == FIGURES["page"]


def headings(page: str) -> list[str]:
    return [html.unescape(h) for h in re.findall(r"<h2>(.*?)</h2>", page)]


def test_a_section_stands_only_where_there_is_something_to_say(page, rich):
    assert [h for h in headings(page) if h in SECTIONS] == ["What cannot be distinguished"]
    assert [h for h in headings(rich) if h in SECTIONS] == list(SECTIONS)


def test_every_figure_of_a_diagnosis_stands_on_its_page(rich):
    for name in diagnosis_figures(samples.rich()):
        assert f'id="figure-{name}"' in rich, name
        assert f'id="data-{name}"' in rich, name


def test_what_a_rich_diagnosis_knows_stands_in_the_text(rich):
    d = samples.rich()
    text = Seen(rich).text
    for expected in (
        d.remaining.sentence,
        d.unexplained.sentence,
        "an error of the sensor",  # the other place
        f"{d.remaining.test}: p 0.31",
        "unexplained",
        "0.3300 \u00b1 0.0040",  # d before,
        "0.0810 \u00b1 0.0040",  # and after
        "-62.2",  # standard errors
        "Nearly alike in this record, so that only a large misfit separates them: "
        "delay of gyro, lag of gyro",
        *(i.why for i in d.undetectable),
        *(i.remedy for i in d.undetectable),
        "any record of these channels",
        *(p.description for p in d.proposals),
        "never",  # the same again does not tell
        d.calibration.sentence,
        *d.calibration.notes,
        "swing-11",
    ):
        assert expected in text, expected


def test_a_cause_without_a_name_is_told_by_what_it_does(rich):
    """Kind "unknown": no kind of the catalogue stands in its frame."""
    cause = samples.rich().causes[1]
    frame = re.findall(r"<article class=\"cause\">(.*?)</article>", rich, re.S)[1]
    text = Seen(frame).text
    assert "unidentified term in torque" in text
    assert cause.description in text
    assert "Something that the catalogue has no name for acts in the torque balance." in text
    for kind, _ in sample_parts.KEYS:
        assert kind not in text or kind == "unknown"


def test_the_text_of_a_rich_diagnosis_is_compact():
    text = str(samples.rich())
    lines = text.splitlines()
    for start in (
        "remains",
        "unknown",
        "moved",
        "undetectable",
        "false alarms",
        "next",
    ):
        assert any(line.startswith(f"  {start}") for line in lines), start
    assert len(lines) < 45
    assert "2. unidentified term in torque [unknown] (p = 4.0e-07): It depends on p" in text
    assert "swing-10: h = 0.112 +- 0.008" in text


def test_the_same_diagnosis_gives_the_same_page(page):
    assert page_of(samples.deficient()) == page


def test_hostile_names_stay_text(hostile, rich):
    """No tag, attribute or script beyond those of a harmless page."""
    seen = Seen(hostile)
    assert {t for t, _ in seen.tags} <= {t for t, _ in Seen(rich).tags}
    assert seen.scripts[-2:] == Seen(rich).scripts[-2:]  # plotly.js and ours, unchanged
    assert len(seen.scripts) == FIGURES["hostile"] + 2
    assert html.unescape(seen.text).count("alert(1)") > 20  # shown, not swallowed
    for data in seen.scripts[:-2]:
        json.loads(data)
        assert not re.search(r"[<>&]", data)
    hostile.encode("utf-8")


def test_only_the_two_scripts_named_by_their_hash_may_run(hostile):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', hostile)[1]
    scripts = re.search(r"script-src ([^;]*)", policy)[1]
    assert scripts.count("'sha256-") == 2
    assert "unsafe" not in scripts
    assert policy.startswith("default-src 'none'")


def test_an_unfinished_number_is_named_not_printed_as_nan():
    d = samples.deficient(N=100)
    d = samples.changed(d, fitted={"baseline_rmse": {"gyro": float("nan")}, "extended_rmse": {}})
    text = Seen(page_of(d)).text
    assert "not finite" in text
    assert not re.search(r"\bnan\b", text)


def test_an_estimate_has_a_page_with_its_parameters_and_fit():
    d = samples.adequate()
    page = page_of(d.baseline, d.records)
    text = Seen(page).text
    for expected in ("10.520", "10.481 .. 10.559", "known", "at lower bound", d.baseline.assumes):
        assert expected in text
    assert page.count('class="plot"') == 2
    assert page_of(d.baseline).count('class="plot"') == 1


def test_an_estimate_from_moments_shows_its_records_simulated_or_says_why_not():
    from problems.pendulum import experiments, indirect_model

    made = experiments(duration=30.0)
    model = indirect_model().with_known(k=10.39).with_unknown("I_x", "d")
    found = casid.instrumental_variables(model, made[0], casid.Instruments("ref"))
    page = page_of(found, made[:1])
    assert page.count('class="plot"') == 2
    assert "only its initial state is fitted" in page
    unsimulated = replace(found, estimate=replace(found.estimate, model=None))
    page = page_of(unsimulated, made[:1])
    assert page.count('class="plot"') == 1
    assert "Not simulated: the model has an input that nobody measures" in page
