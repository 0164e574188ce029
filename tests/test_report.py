"""The report is one page that opens offline, fits a phone, and runs no code but its own."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from casid.report import diagnosis_page, estimate_page
from tests import samples

FIGURES = 7


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
    return diagnosis_page(samples.deficient())


@pytest.fixture(scope="module")
def hostile() -> str:
    return diagnosis_page(samples.hostile())


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
    text = Seen(diagnosis_page(make())).text
    for word in words:
        assert word in text


def test_everything_the_diagnosis_knows_stands_in_the_text(page):
    d = samples.deficient(N=100)
    text = Seen(page).text
    for expected in (
        "0.034 \u2192 0.0104",  # key numbers
        "\u221269 %",
        "0.349 \u00b1 0.011",
        "0.327 .. 0.371",
        "Could also be:",
        d.causes[0].alternatives[0].why,
        "absorbed by s and I",  # invisible candidate
        "refit gains too little",
        d.advice,
        *d.notes,
        *d.noise.values(),
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


def test_warnings_of_both_fits_are_printed_beside_the_key_numbers():
    d = samples.deficient(N=100)
    d = replace(d, baseline=replace(d.baseline, warnings=("only 1 of 4 starts agrees",)))
    text = Seen(diagnosis_page(d)).text
    assert text.index("Warning: only 1 of 4 starts agrees") < text.index(d.causes[0].sentence)


def test_the_page_loads_nothing_and_carries_plotly_once(page):
    seen = Seen(page)
    for tag, attributes in seen.tags:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base"), tag
        for name in ("src", "href", "action", "srcset", "data"):
            value = attributes.get(name)
            assert value is None or value.startswith("#"), (tag, name, value)
        assert not [a for a in attributes if a.startswith("on")], (tag, attributes)
    assert "@import" not in page
    assert page.count("* plotly.js v") == 1
    kinds = [a.get("type", "") for t, a in seen.tags if t == "script"]
    assert kinds == ["application/json"] * FIGURES + ["", ""]


def test_the_page_has_language_title_viewport_and_a_name_for_every_figure(page):
    seen = Seen(page)
    assert ("html", {"lang": "en"}) in seen.tags
    assert any(a.get("name") == "viewport" for _, a in seen.tags)
    assert "<title>Diagnosis of pendulum - casid</title>" in page
    plots = [a for _, a in seen.tags if a.get("class") == "plot"]
    assert len(plots) == FIGURES
    assert all(a["aria-label"] for a in plots)
    assert page.count("<figcaption>") == FIGURES


def test_the_same_diagnosis_gives_the_same_page(page):
    assert diagnosis_page(samples.deficient()) == page


def test_hostile_names_stay_text(hostile, page):
    """No tag, attribute or script beyond those of a harmless page."""
    seen = Seen(hostile)
    assert {t for t, _ in seen.tags} <= {t for t, _ in Seen(page).tags}
    assert seen.scripts[-2:] == Seen(page).scripts[-2:]  # plotly.js and ours, unchanged
    assert len(seen.scripts) == FIGURES + 2
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
    d = replace(d, fitted={"baseline_rmse": {"gyro": float("nan")}, "extended_rmse": {}})
    text = Seen(diagnosis_page(d)).text
    assert "not finite" in text
    assert not re.search(r"\bnan\b", text)


def test_an_estimate_has_a_page_with_its_parameters_and_fit():
    d = samples.adequate()
    page = estimate_page(d.baseline, d.records)
    text = Seen(page).text
    for expected in ("10.520", "10.481 .. 10.559", "known", "at lower bound", d.baseline.assumes):
        assert expected in text
    assert page.count('class="plot"') == 2
    assert estimate_page(d.baseline).count('class="plot"') == 1


# --- in a browser ---------------------------------------------------------------------------------

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
BROWSER = os.environ.get("CASID_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
in_browser = pytest.mark.skipif(
    BROWSER is None, reason="no Chromium found; name one in CASID_CHROMIUM"
)
PROBE = """<script>window.addEventListener("load", function () {
  var wide = Array.prototype.filter.call(document.querySelectorAll("body *"), function (e) {
    return e.getBoundingClientRect().right > innerWidth + 1 && !e.closest(".scroll, .plot");
  }).map(function (e) { return e.tagName + "." + e.className; });
  var out = document.createElement("pre");
  out.textContent = "PROBE " + document.documentElement.scrollWidth + " " + innerWidth + " " +
    wide.length + " END";
  document.body.appendChild(out);
  parent.postMessage(out.textContent, "*");
});</script>"""
FRAME = """<!DOCTYPE html><body style="margin:0"><pre id="out"></pre><script>
window.addEventListener("message", function (e) {
  document.getElementById("out").textContent = e.data; });
</script><iframe src="page.html" style="width:390px;height:2000px;border:0"></iframe>"""


def browse(path: Path, tmp: Path, *arguments: str) -> tuple[str, list[str]]:
    """The DOM after the scripts ran, and what the page said on the console."""
    done = subprocess.run(
        [
            str(BROWSER),
            *"--headless --no-sandbox --disable-gpu --disable-quic --no-first-run".split(),
            *"--disable-background-networking --disable-component-update --disable-sync".split(),
            f"--user-data-dir={tmp / 'profile'}",
            *"--enable-logging=stderr --v=0 --hide-scrollbars".split(),
            "--virtual-time-budget=5000",
            *arguments,
            path.as_uri(),
        ],
        capture_output=True,
        timeout=60,
        check=False,
    )
    console = [s for s in done.stderr.decode(errors="replace").splitlines() if "CONSOLE" in s]
    return done.stdout.decode(errors="replace"), console


@in_browser
def test_a_script_that_slipped_into_the_page_is_refused(page, tmp_path):
    path = tmp_path / "page.html"
    intruder = "<script>document.title = 'intruder';</script></body></html>"
    path.write_text(page.replace("</body></html>", intruder), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert "<title>intruder" not in dom
    assert len(console) == 1
    assert "Content Security Policy" in console[0]


def probed(page: str) -> str:
    """The page with a script of the test's own, which its policy would stop."""
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page, count=1)
    return page.replace("</body></html>", PROBE + "</body></html>")


@in_browser
@pytest.mark.parametrize("name", ["page", "hostile"])
def test_a_browser_draws_every_figure_without_a_complaint(name, request, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(request.getfixturevalue(name), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert console == []  # an error, a refused script or an uncaught exception would be a line
    plots = re.split(r'<div class="plot[ "]', dom)[1:]
    assert len(plots) == FIGURES
    assert all('class="main-svg"' in p for p in plots)
    if name == "hostile":
        assert "<img" not in dom
        assert dom.count("<script") == FIGURES + 2
        assert "&lt;script&gt;alert(1)" in plots[0]  # the axis title, shown as text


@in_browser
@pytest.mark.parametrize("name", ["page", "hostile"])
@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_makes_the_page_scroll_sideways(name, width, request, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(probed(request.getfixturevalue(name)), encoding="utf-8")
    if width == 390:  # headless windows are no narrower than some 500 px: a frame is
        path = tmp_path / "frame.html"
        path.write_text(FRAME, encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert console == []
    scroll, inner, wide = map(int, re.search(r"PROBE (\d+) (\d+) (\d+) END", dom).groups())
    assert inner == width
    assert scroll <= inner
    assert wide == 0


@in_browser
def test_the_screenshot_is_not_blank(page, tmp_path):
    path, picture = tmp_path / "page.html", tmp_path / "page.png"
    path.write_text(page, encoding="utf-8")
    browse(path, tmp_path, "--window-size=1280,2000", f"--screenshot={picture}")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 50_000  # an empty page of this size is a few kB
