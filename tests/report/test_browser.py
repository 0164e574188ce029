"""The report in a browser: it draws every figure, fits a phone, and runs no script but its own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import casid
from casid.report.document import Document, Figure, Section
from casid.report.figures.diagnosis import diagnosis_figures
from casid.report.html.page import html_page
from problems import ship
from tests.report.golden_results import assessment, monte_carlo
from tests.support import samples
from tests.support.samples import page_of

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
BROWSER = os.environ.get("CASID_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
in_browser = pytest.mark.skipif(
    BROWSER is None, reason="no Chromium found; name one in CASID_CHROMIUM"
)
WIDTHS = (1280, 390)
PROBE = """<script>window.addEventListener("load", function () {
  document.querySelectorAll("details").forEach(function (d) { d.open = true; });
  var wide = Array.prototype.filter.call(document.querySelectorAll("body *"), function (e) {
    return e.getBoundingClientRect().right > innerWidth + 1 &&
      !e.closest(".scroll, .plot, .equations, svg svg");  // what scrolls by itself, or is clipped
  }).map(function (e) { return e.tagName + "." + e.className; });
  var out = document.createElement("pre");
  out.textContent = "PROBE " + document.documentElement.scrollWidth + " " + innerWidth + " " +
    wide.length + " END";
  document.body.appendChild(out);
  parent.postMessage(out.textContent, "*");
});</script>"""
FRAMES = """<!DOCTYPE html><body style="margin:0"><pre id="out"></pre><script>
window.addEventListener("message", function (e) {
  document.getElementById("out").textContent += e.data; });
</script>"""


def framed(*names: str) -> str:
    """Pages beside one another, each as wide as a screen and as a phone."""
    return FRAMES + "".join(
        f'<iframe src="{name}" style="width:{width}px;height:2000px;border:0"></iframe>'
        for name in names
        for width in WIDTHS
    )


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
        timeout=600,
        check=False,
    )
    console = [s for s in done.stderr.decode(errors="replace").splitlines() if "CONSOLE" in s]
    return done.stdout.decode(errors="replace"), console


@in_browser
def test_a_script_that_slipped_into_the_page_is_refused(rich, tmp_path):
    path = tmp_path / "page.html"
    intruder = "<script>document.title = 'intruder';</script></body></html>"
    path.write_text(rich.replace("</body></html>", intruder), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert "<title>intruder" not in dom
    assert len(console) == 1
    assert "Content Security Policy" in console[0]


def probed(page: str) -> str:
    """The page with a script of the test's own, which its policy would stop."""
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page, count=1)
    return page.replace("</body></html>", PROBE + "</body></html>")


@in_browser
@pytest.mark.parametrize("name", ["rich", pytest.param("hostile", marks=pytest.mark.slow)])
def test_a_browser_draws_every_figure_without_a_complaint(name, request, tmp_path):
    path = tmp_path / "page.html"
    page = request.getfixturevalue(name)
    path.write_text(page.replace("<details", "<details open"), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert console == []  # an error, a refused script or an uncaught exception would be a line
    plots = re.split(r'<div class="plot[ "]', dom)[1:]
    figures = len(diagnosis_figures(getattr(samples, name)()))
    assert len(plots) == figures
    assert all('class="main-svg"' in p for p in plots)
    if name == "hostile":
        assert "<img" not in dom
        assert dom.count("<script") == figures + 3  # packed, unpacked, ours
        assert "&lt;script&gt;alert(1)" in plots[0]  # the axis title, shown as text


def other_pages() -> list[str]:
    """Pages of an estimate, an assessment and a study, and equations in what a notebook shows."""
    viewport = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    view = ship.problem._repr_html_() + samples.rich()._repr_html_()
    notebook = f"<!DOCTYPE html><html><head>{viewport}</head><body>{view}</body></html>"
    adequate = samples.adequate()
    estimate = page_of(adequate.baseline, adequate.records)
    return [estimate, page_of(assessment()), page_of(monte_carlo()), notebook]


@in_browser
def test_a_figure_is_drawn_when_its_section_unfolds(rich, tmp_path):
    """The page opens with the two that decide, the motion and its error; fifteen take seconds."""
    path = tmp_path / "page.html"
    path.write_text(rich, encoding="utf-8")
    dom, _ = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    plots = re.split(r'<div class="plot[ "]', dom)[1:]
    assert ['class="main-svg"' in p for p in plots] == [True] * 2 + [False] * (len(plots) - 2)


KEYS = """<script>window.addEventListener("load", function () {
  var waiting = setInterval(function () {
    var place = document.querySelector(".plot"), toggle = place.querySelector(".legendtoggle");
    if (!toggle || !toggle.onkeydown) { return; }
    clearInterval(waiting);
    function seen() { return place.data.map(function (t) { return String(t.visible); }).join(); }
    var list = document.querySelector(".choice select"), out = [seen()];
    toggle.dispatchEvent(new KeyboardEvent("keydown", { key: " " }));
    out.push(seen());
    list.selectedIndex = 1;
    list.dispatchEvent(new Event("change"));
    out.push(seen());
    document.title = "KEYS " + out.join(" ");
  }, 50);
});</script>"""


@in_browser
def test_the_keyboard_chooses_the_record_and_hides_a_curve(tmp_path):
    """plotly's own menu and legend take only a pointer: the page has a list and check boxes."""
    path = tmp_path / "page.html"
    page = page_of(samples.deficient(records=2, N=200))
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page, count=1)
    path.write_text(page.replace("</body></html>", KEYS + "</body></html>"), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    assert console == []
    seen = re.search(r"<title>KEYS (\S+) (\S+) (\S+)</title>", dom)
    assert seen, "the page has no list of records, or no check boxes"
    first, hidden, second = seen.groups()
    assert first == "true,true,true,false,false,false"
    assert hidden == "legendonly,true,true,false,false,false"
    assert second == "false,false,false,true,true,true"
    assert re.findall(r"<option>([^<]*)</option>", dom)[:2] == ["swing-07", "swing-08"]


SIZES = """<script>window.addEventListener("load", function () {
  var waiting = setInterval(function () {
    var buttons = Array.from(document.querySelectorAll(".plot .modebar-btn"));
    if (!buttons.length) { return; }
    clearInterval(waiting);
    var sides = buttons.map(function (b) {
      var box = b.getBoundingClientRect();
      return Math.min(box.width, box.height);
    });
    document.title = "SIDES " + Math.min.apply(null, sides);
  }, 50);
});</script>"""


@in_browser
def test_the_buttons_of_a_figure_are_large_enough_to_hit(rich, tmp_path):
    """At least 24 pixels wide and high (WCAG 2.2, 2.5.8)."""
    path = tmp_path / "page.html"
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", rich, count=1)
    path.write_text(page.replace("</body></html>", SIZES + "</body></html>"), encoding="utf-8")
    dom, _ = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom")
    seen = re.search(r"<title>SIDES ([\d.]+)</title>", dom)
    assert seen, "no figure has buttons"
    assert float(seen[1]) >= 24


@in_browser
@pytest.mark.parametrize(
    "name", ["rich", *(pytest.param(n, marks=pytest.mark.slow) for n in ("hostile", "others"))]
)
def test_nothing_makes_the_page_scroll_sideways(name, request, tmp_path):
    """On a screen and on a phone: headless windows are no narrower than 500 px, frames are."""
    pages = other_pages() if name == "others" else [request.getfixturevalue(name)]
    files = [f"page_{i}.html" for i in range(len(pages))]
    for file, page in zip(files, pages, strict=True):
        (tmp_path / file).write_text(probed(page), encoding="utf-8")
    path = tmp_path / "frames.html"
    path.write_text(framed(*files), encoding="utf-8")
    dom, console = browse(path, tmp_path, "--window-size=1700,2100", "--dump-dom")
    assert console == []
    probes = [tuple(map(int, p)) for p in re.findall(r"PROBE (\d+) (\d+) (\d+) END", dom)]
    assert sorted(inner for _, inner, _ in probes) == sorted(WIDTHS * len(pages))
    for scroll, inner, wide in probes:
        assert scroll <= inner
        assert wide == 0


@in_browser
def test_the_screenshot_is_not_blank(rich, tmp_path):
    path, picture = tmp_path / "page.html", tmp_path / "page.png"
    path.write_text(rich, encoding="utf-8")
    browse(path, tmp_path, "--window-size=1280,2000", f"--screenshot={picture}")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 50_000  # an empty page of this size is a few kB


@in_browser
def test_what_a_network_says_is_legible_in_the_dark(tmp_path):
    """The names at its arrows are in the ink of the page, and so is what is behind them."""
    q = casid.Rational.shift(Ts=1.0)
    plant = casid.dynamic_network({("y", "u"): 0.5 / (q - 0.6)}, excitations={"u": 1.0})
    drawn = Figure("network", casid.network_figure(plant))
    path = tmp_path / "page.html"
    document = Document("network", [Section("Network", [drawn], is_open=True)])
    path.write_text(html_page(document), encoding="utf-8")
    dark = "--blink-settings=preferredColorScheme=0"
    for arguments, behind in (((), "rgb(255, 255, 255)"), ((dark,), "rgb(20, 24, 29)")):
        dom, console = browse(path, tmp_path, "--window-size=1280,2000", "--dump-dom", *arguments)
        assert console == []
        names = re.findall(r'<rect class="bg"[^>]*style="[^"]*fill: ([^;]*);[^"]*"', dom)
        assert behind in names
