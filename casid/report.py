"""The report: one self-contained HTML page that opens offline.

The page carries plotly.js once and its figures as JSON; it loads nothing. Two things keep text from
a file from becoming code: every string is escaped where it enters the page, and the page's content
security policy lets only its own two scripts run, named by their SHA-256.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from casid.diagnosis import Cause, Diagnosis
from casid.estimate import Estimate, Estimated, RecordView
from casid.plotting import (
    before_and_after,
    diagnosis_figures,
    output_units,
    p_text,
    parameter_figure,
    simulation_figure,
    visible_text,
)

_VERDICTS = {
    "adequate": "The model explains this record",
    "deficient": "The model is missing something",
    "undecided": "This record cannot decide",
}
_FIGURE_NAMES = {
    "simulation": "Measured against simulated",
    "residual_time": "Simulation error against time",
    "residual_against": "Simulation error against states and inputs",
    "residual_spectrum": "Simulation error in frequency",
}


class _Html(str):
    """Text that is markup already; everything else is escaped on its way into the page."""

    __slots__ = ()

    def __add__(self, other: str) -> _Html:
        return _Html(str(self) + str(_safe(other)))

    def __radd__(self, other: str) -> _Html:
        return _Html(str(_safe(other)) + str(self))


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """The diagnosis as one HTML page; the same diagnosis gives the same page, byte for byte."""
    d = diagnosis
    figures = diagnosis_figures(d)
    page = _Page(figures)
    estimates = before_and_after(d)
    warnings = [w for e in estimates.values() for w in e.warnings]

    page.section("", _banner(d), _key_numbers(d), _notice(d.notes, warnings))
    page.section(
        "Causes",
        _join(_cause(i, c) for i, c in enumerate(d.causes, 1)) or _p(_no_cause(d)),
        _element("div", _element("h3", "Advice") + _p(d.advice), class_="advice")
        if d.advice
        else "",
    )
    for name, heading in _FIGURE_NAMES.items():
        if name in figures:
            page.section(heading, page.figure(name))
    page.section("Ranked candidates", _ranking_table(d), page.figure("ranking"))
    page.section(
        "Parameters",
        _parameter_table(estimates),
        page.figure("parameters"),
        _join(_p(line) for line in _error_bars(estimates)),
    )
    page.section("Gain", _gain_table(d), page.figure("gain"))
    page.section("What could not be separated", _inseparable(d))
    page.section("Noise", _mapping(d.noise, ("channel", "what is known of its noise")))
    page.section("May the fits be trusted?", _evidence_table(estimates))
    page.section("Provenance", *_provenance(d.provenance, d.settings, d.versions))
    page.section("References", _list(d.sources))
    return page.text(f"Diagnosis of {visible_text(d.problem)}", "Diagnosis", d.problem)


def estimate_page(estimate: Estimate, records: Sequence[RecordView] = ()) -> str:
    """The estimate as one HTML page, with measured against simulated where records are given.

    `records` hold the simulation at the estimate as `baseline`, and no `extended`.
    """
    e = estimate
    figures: dict[str, Any] = {}
    if any(not p.known and math.isfinite(p.value) for p in e.parameters):
        figures["parameters"] = parameter_figure({"estimate": e})
    if records:
        figures["simulation"] = simulation_figure(records)
    page = _Page(figures)
    page.section("", _estimate_banner(e), _notice((), (*e.suspects, *e.warnings)))
    page.section(
        "Parameters",
        _parameter_table({"estimate": e}),
        page.figure("parameters"),
        _p(f"Error bars: {e.assumes}"),
    )
    page.section("Fit", _fit_table(e), page.figure("simulation"))
    page.section("May the fit be trusted?", _evidence_table({"estimate": e}))
    page.section("Provenance", *_provenance(e.provenance, {}, e.versions))
    page.section("References", _list(e.sources))
    return page.text(f"Estimate of {visible_text(e.problem)}", "Estimate", e.problem)


# --- parts of the page ----------------------------------------------------------------------------


def _banner(d: Diagnosis) -> _Html:
    verdict = d.verdict if d.verdict in _VERDICTS else "undecided"
    return _element(
        "div",
        _element("p", _element("b", d.verdict) + _safe(_VERDICTS[verdict]), class_="word")
        + _element("p", d.sentence, class_="sentence"),
        class_=f"banner {verdict}",
        role="status",
    )


def _estimate_banner(e: Estimate) -> _Html:
    word = "converged" if e.is_converged else "NOT converged"
    starts = f"{e.starts_agreeing} of {e.starts_tried} starts agree"
    return _element(
        "div",
        _element("p", _element("b", word) + _safe(f"{e.method}"), class_="word")
        + _element("p", f"{e.status} in {e.iterations} iterations; {starts}.", class_="sentence"),
        class_="banner " + ("adequate" if e.is_converged else "deficient"),
        role="status",
    )


def _key_numbers(d: Diagnosis) -> _Html:
    units = output_units(d)
    cards = []
    for part, numbers in (("held out", d.held_out), ("fitted", d.fitted)):
        for output, before in numbers.get("baseline_rmse", {}).items():
            after = numbers.get("extended_rmse", {}).get(output)
            floor = numbers.get("noise_floor", {}).get(output)
            unit = units.get(output, "")
            if after is None:
                value, rest = _number(before), ""
            else:
                value = f"{_number(before)} \u2192 {_number(after)}"
                rest = f"error {_gain(before, after)}"
            if floor is not None:
                rest += ("; " if rest else "") + f"noise floor {_number(floor)}"
            cards.append(
                _element("dt", f"rms error of {output}, {part}")
                + _element("dd", _safe(value + " ") + _element("small", unit))
                + _element("dd", rest, class_="rest")
            )
        if cards:
            break  # held-out numbers say it all; the table below has the rest
    for c in d.causes[:1]:
        for p in c.parameters[:2]:
            cards.append(
                _element("dt", f"{p.name}, new parameter")
                + _element("dd", _safe(_plus_minus(p) + " ") + _element("small", p.unit))
                + _element("dd", f"{c.kind} in {c.where}", class_="rest")
            )
    if not cards:
        return _Html("")
    return _element(
        "dl", _join(_element("div", c, class_="card") for c in cards[:8]), class_="cards"
    )


def _notice(notes: Sequence[str], warnings: Sequence[str]) -> _Html:
    items = [_element("li", _element("b", "Warning: ") + _safe(w)) for w in dict.fromkeys(warnings)]
    items += [_element("li", n) for n in notes]
    return _element("ul", _join(items), class_="notice") if items else _Html("")


def _cause(i: int, c: Cause) -> _Html:
    title = _safe(f"{i}. ") + _element("code", c.kind) + " in " + _element("code", c.where)
    facts = f"family-wise p {p_text(c.p_value)}"
    if c.share > 0:
        facts += f"; removes {100 * c.share:.0f} % of the misfit"
    parts = [_element("h3", _Html(title)), _p(c.sentence), _element("p", facts, class_="facts")]
    if c.parameters:
        parts.append(
            _table(
                "Parameters of this effect",
                ("parameter", "estimate", "std. error", "95 % interval", "unit", "note"),
                [(p.name, *_estimated(p), p.unit, p.note) for p in c.parameters],
                numbers=(1, 2, 3),
            )
        )
    if c.alternatives:
        parts.append(
            _p("Could also be:")
            + _element(
                "ul",
                _join(
                    _element(
                        "li",
                        _element("code", a.kind)
                        + _safe(" in ")
                        + _element("code", a.where)
                        + _safe(
                            f" (p {p_text(a.p_value)} against the named one)"
                            + (f": {a.why}" if a.why else "")
                        ),
                    )
                    for a in c.alternatives
                ),
            )
        )
    return _element("article", _join(parts), class_="cause")


def _no_cause(d: Diagnosis) -> str:
    if d.verdict == "adequate":
        return (
            "None. No effect of the catalogue explains more than chance would, at a false-alarm "
            f"rate of {d.false_alarm_rate:.2g} for the whole catalogue."
        )
    if d.verdict == "deficient":
        return "Something is missing, but nothing in the catalogue explains it."
    return "None can be named: the record cannot support an answer."


def _ranking_table(d: Diagnosis) -> _Html:
    if not d.ranking:
        return _Html("")
    return _table(
        "Every candidate as the first round saw it. p: of the candidate alone; family-wise: for "
        "the whole catalogue; gain: fall of the criterion after a refit",
        ("", "effect", "where", "p", "family-wise p", "gain", "status", "why"),
        [
            (
                str(i),
                _element("code", r.kind),
                _element("code", r.where),
                p_text(r.p_value),
                p_text(r.adjusted),
                "\u2013" if r.gain is None else _number(r.gain),
                _element("span", r.status, class_=f"status {_status_class(r.status)}"),
                r.why,
            )
            for i, r in enumerate(d.ranking, 1)
        ],
        numbers=(3, 4, 5),
    )


def _parameter_table(estimates: Mapping[str, Estimate]) -> _Html:
    several = len(estimates) > 1
    names = dict.fromkeys(n for e in estimates.values() for n in e.names)
    found = {
        label: {p.name: p for p in (*e.parameters, *e.initial_states)}
        for label, e in estimates.items()
    }
    header = ["parameter", "unit"]
    for label in estimates:
        before = f"{label}: " if several else ""
        header += [f"{before}estimate", "std. error", "95 % interval"]
    header += ["start", "note"]
    rows = []
    for name in names:
        here = [found[label].get(name) for label in estimates]
        any_one = next(p for p in here if p is not None)
        cells = [name, any_one.unit]
        for p in here:
            cells += ["\u2013"] * 3 if p is None else list(_estimated(p))
        notes = [
            (f"{label}: " if several else "") + p.note
            for label, p in zip(estimates, here, strict=True)
            if p is not None and p.note
        ]
        if several and len({p.note for p in here if p is not None}) == 1 and None not in here:
            notes = [any_one.note] if any_one.note else []
        start = "" if any_one.start is None else _number(any_one.start)
        rows.append([*cells, start, "; ".join(notes) or ("known" if any_one.known else "")])
    if not rows:
        return _Html("")
    width = 3 * len(estimates)
    return _table(
        "Estimates with standard errors and normal 95 % intervals, SI units",
        header,
        rows,
        numbers=tuple(range(2, 3 + width)),
    )


def _error_bars(estimates: Mapping[str, Estimate]) -> list[str]:
    assumed = {label: e.assumes for label, e in estimates.items() if e.assumes}
    if len(set(assumed.values())) == 1:
        return [f"Error bars: {next(iter(assumed.values()))}"]
    return [f"Error bars {label}: {text}" for label, text in assumed.items()]


def _gain_table(d: Diagnosis) -> _Html:
    units = output_units(d)
    rows = []
    for part, numbers in (("fitted", d.fitted), ("held out", d.held_out)):
        for output, before in numbers.get("baseline_rmse", {}).items():
            after = numbers.get("extended_rmse", {}).get(output)
            floor = numbers.get("noise_floor", {}).get(output)
            rows.append(
                (
                    part,
                    output,
                    units.get(output, ""),
                    _number(before),
                    "\u2013" if after is None else _number(after),
                    "\u2013" if after is None else _gain(before, after),
                    "\u2013" if floor is None else _number(floor),
                )
            )
    if not rows:
        return _Html("")
    return _table(
        "Root mean square simulation error",
        ("part", "output", "unit", "before", "after", "change", "noise floor"),
        rows,
        numbers=(3, 4, 5, 6),
    )


def _fit_table(e: Estimate) -> _Html:
    rows = []
    for part, rmse, fit in (
        ("fitted", e.rmse, e.nrmse_fit),
        ("held out", e.held_out_rmse, e.held_out_fit),
    ):
        for record, outputs in rmse.items():
            for output, value in outputs.items():
                per_cent = fit.get(record, {}).get(output)
                rows.append(
                    (
                        part,
                        record,
                        output,
                        _number(value),
                        e.units.get(output, ""),
                        "\u2013" if per_cent is None else f"{per_cent:.1f}",
                    )
                )
    if not rows:
        return _Html("")
    return _table(
        e.fit_is,
        ("part", "record", "output", "rms error", "unit", "fit [%]"),
        rows,
        numbers=(3, 5),
    )


def _inseparable(d: Diagnosis) -> _Html:
    rows: list[tuple[str, ...]] = [
        (
            _element("code", a.kind),
            _element("code", a.where),
            _Html(f"not told from {_element('code', c.kind)} in {_element('code', c.where)}"),
            a.why,
        )
        for c in d.causes
        for a in c.alternatives
    ]
    told = {(a.kind, a.where) for c in d.causes for a in c.alternatives}
    for r in d.ranking:
        if r.status == "cannot be rejected" and (r.kind, r.where) not in told:
            rows.append((_element("code", r.kind), _element("code", r.where), r.status, r.why))
    for r in d.ranking:
        if r.status == "invisible":
            rows.append(
                (
                    _element("code", r.kind),
                    _element("code", r.where),
                    "invisible to this record",
                    r.why,
                )
            )
    if not rows:
        return _p("Nothing: every candidate was either named or rejected.") if d.ranking else _p("")
    return _table(
        "Effects that this record can neither name nor exclude",
        ("effect", "where", "what", "why"),
        rows,
    )


def _evidence_table(estimates: Mapping[str, Estimate]) -> _Html:
    columns = []
    for e in estimates.values():
        i = e.identifiability
        seen = "all unknowns" if i.rank == i.unknowns else i.unseen or "not all unknowns"
        facts = {
            "method": e.method,
            "status": e.status if e.is_converged else f"NOT converged: {e.status}",
            "solver": f"{e.iterations} iterations, largest scaled gradient {e.scaled_gradient:.0e}",
            "starts": f"{e.starts_agreeing} of {e.starts_tried} agree",
            "identifiable": f"{seen} (rank {i.rank} of {i.unknowns} at the estimate, smallest "
            f"singular value {i.smallest_singular_value:.2g}, scaled)",
            **({"whatever the data": i.structural} if i.structural else {}),
        }
        residuals = {f"residual of {k}": v for k, v in e.whiteness.items()}
        columns.append(facts | dict(e.evidence) | residuals)
    rows = dict.fromkeys(k for facts in columns for k in facts)
    return _table(
        "Solver, identifiability and residuals",
        ("", *estimates),
        [(k, *(facts.get(k, "\u2013") for facts in columns)) for k in rows],
    )


def _provenance(
    lines: Sequence[str], settings: Mapping[str, str], versions: Mapping[str, str]
) -> Iterable[_Html]:
    if lines:
        yield _element("h3", "Data")
        yield _element(
            "ol", _join(_element("li", _element("code", s)) for s in lines), class_="lines"
        )
    if settings:
        yield _element("h3", "Settings")
        yield _mapping(settings, ("setting", "value"))
    if versions:
        yield _element("h3", "Versions")
        yield _mapping(versions, ("package", "version"))


# --- numbers as text ------------------------------------------------------------------------------


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "not finite"


def _decimals(std_error: float) -> int | None:
    """Decimals that show two digits of the error, None where fixed notation gets too long."""
    if not math.isfinite(std_error) or std_error <= 0:
        return None
    places = 1 - math.floor(math.log10(std_error))
    return max(places, 0) if -2 <= places <= 6 else None


def _estimated(p: Estimated) -> tuple[str, str, str]:
    """Estimate, standard error and interval, with the digits that the error leaves meaningful."""
    interval = p.interval
    if p.std_error is None or interval is None:
        return _value(p.value), "\u2013", "\u2013"
    places = _decimals(p.std_error)
    if places is None or abs(p.value) >= 1e7:
        between = f"{_number(interval[0])} .. {_number(interval[1])}"
        return _value(p.value), f"{p.std_error:.2g}", between
    return (
        f"{p.value:.{places}f}",
        f"{p.std_error:.{places}f}",
        f"{interval[0]:.{places}f} .. {interval[1]:.{places}f}",
    )


def _value(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "not finite"


def _plus_minus(p: Estimated) -> str:
    value, error, _ = _estimated(p)
    return value if p.std_error is None else f"{value} \u00b1 {error}"


def _gain(before: float, after: float) -> str:
    if not (math.isfinite(before) and math.isfinite(after)) or before <= 0:
        return "\u2013"
    change = 100 * (after / before - 1)
    return f"{change:+.0f} %".replace("-", "\u2212")


# --- markup ---------------------------------------------------------------------------------------


def _safe(text: object) -> _Html:
    return text if isinstance(text, _Html) else _Html(html.escape(visible_text(text)))


def _join(parts: Iterable[str]) -> _Html:
    return _Html("".join(_safe(p) for p in parts))


def _element(tag: str, content: object = "", **attributes: str) -> _Html:
    text = "".join(
        f' {k.rstrip("_").replace("_", "-")}="{html.escape(visible_text(v))}"'
        for k, v in attributes.items()
    )
    return _Html(f"<{tag}{text}>{_safe(content)}</{tag}>")


def _p(text: str) -> _Html:
    return _element("p", text) if text else _Html("")


def _list(items: Sequence[str]) -> _Html:
    return _element("ul", _join(_element("li", i) for i in items)) if items else _Html("")


def _table(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
) -> _Html:
    def cell(tag: str, i: int, content: str) -> _Html:
        return _element(tag, content, class_="n") if i in numbers else _element(tag, content)

    head = _join(
        _element("th", h, class_="n" if i in numbers else "", scope="col")
        for i, h in enumerate(header)
    )
    body = _join(_element("tr", _join(cell("td", i, c) for i, c in enumerate(r))) for r in rows)
    table = _element(
        "table",
        _element("thead", _element("tr", head)) + _element("tbody", body),
        aria_label=caption,
    )
    scroll = _element(
        "div", table, class_="scroll", tabindex="0", role="region", aria_label=caption
    )
    # The caption stands outside of what scrolls: on a phone it must not run off the side.
    return _element("div", _element("p", caption, class_="caption") + scroll, class_="table")


def _mapping(pairs: Mapping[str, str], header: tuple[str, str]) -> _Html:
    return _table(" and ".join(header), header, list(pairs.items())) if pairs else _Html("")


def _status_class(status: str) -> str:
    known = ("named", "cannot be rejected", "rejected", "not significant", "invisible")
    return status.replace(" ", "-") if status in known else "other"


class _Page:
    """Sections of a page, and the figures that its script draws."""

    def __init__(self, figures: Mapping[str, Any]) -> None:
        self.figures = figures
        self.sections: list[tuple[str, str, _Html]] = []
        self.data: list[_Html] = []

    def figure(self, name: str) -> _Html:
        """The named figure's place with its caption, nothing where there is no such figure."""
        if name not in self.figures:
            return _Html("")
        figure = self.figures[name]
        caption = str(figure.layout.meta["caption"])
        self.data.append(
            _Html(
                f'<script type="application/json" id="data-{name}">{_figure_json(figure)}</script>'
            )
        )
        place = (
            f'<div class="plot" id="figure-{name}" role="img" '
            f'style="height:{int(figure.layout.height)}px" '
            f'aria-label="{html.escape(visible_text(caption))}"></div>'
        )
        return _element("figure", _Html(place) + _element("figcaption", caption))

    def section(self, heading: str, *parts: str) -> None:
        """Add a section, unless it is empty."""
        content = _join(parts)
        if content:
            self.sections.append((f"s{len(self.sections)}", heading, content))

    def text(self, title: str, kind: str, problem: str) -> str:
        """The whole page."""
        from plotly.offline import get_plotlyjs

        library = _script(get_plotlyjs())
        drawing = _script(_DRAW)
        policy = (
            "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
            f"script-src {_hash(library)} {_hash(drawing)}; base-uri 'none'; form-action 'none'"
        )
        links = _join(
            _element("a", heading, href=f"#{anchor}")
            for anchor, heading, _ in self.sections
            if heading
        )
        body = _join(
            _element("section", (_element("h2", heading) if heading else "") + content, id=anchor)
            for anchor, heading, content in self.sections
        )
        return "\n".join(
            (
                "<!DOCTYPE html>",
                '<html lang="en"><head><meta charset="utf-8">',
                f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
                '<meta name="viewport" content="width=device-width, initial-scale=1">',
                '<meta name="referrer" content="no-referrer">',
                _element("title", f"{title} - casid"),
                f"<style>{_STYLE}</style></head><body>",
                _element(
                    "header",
                    _element("p", f"casid \u00b7 {kind}", class_="kicker")
                    + _element("h1", problem),
                ),
                _element("nav", links, aria_label="Sections") if links else "",
                "<noscript><p>The figures need JavaScript; every number also stands in a table."
                "</p></noscript>",
                _element("main", body),
                *self.data,
                f"<script>{library}</script>" if self.data else "",
                f"<script>{drawing}</script>" if self.data else "",
                "</body></html>\n",
            )
        )


def _figure_json(figure: Any) -> str:
    """The figure as JSON that cannot end its script block; its title, the caption, taken out."""
    content = json.loads(figure.to_json(engine="json"))
    content["layout"].pop("title", None)
    content["layout"]["margin"]["t"] = 40
    content["layout"]["height"] = figure.layout.height - figure.layout.margin.t + 40
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=True)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _script(text: str) -> str:
    """A script as the page's parser will see it: one kind of line end, no end tag inside."""
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("</script", "<\\/script")


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


# Panels side by side stand one above another where the page is narrow; a finger scrolls the page
# and zooms only after the menu's zoom is chosen; on paper a figure takes the paper's width.
_DRAW = """
"use strict";
(function () {
  var coarse = window.matchMedia("(pointer: coarse)").matches;
  var narrowBelow = 620;
  function adapt(layout, wide, width) {
    var meta = wide.meta, n = meta.panels;
    if (meta.columns < 2) { return layout; }
    var narrow = width < narrowBelow;
    var gap = Math.max(meta.gap, 56), inside = n * meta.row_height + (n - 1) * gap;
    for (var i = 0; i < n; i++) {
      var end = i ? String(i + 1) : "";
      var x = "xaxis" + end, y = "yaxis" + end;
      layout[x].domain = narrow ? [0, 1] : wide[x].domain.slice();
      layout[y].domain = narrow
        ? [1 - (i * (meta.row_height + gap) + meta.row_height) / inside,
           1 - i * (meta.row_height + gap) / inside]
        : wide[y].domain.slice();
      layout[y].showticklabels = narrow ? true : wide[y].showticklabels !== false;
    }
    layout.height = narrow ? inside + wide.margin.t + meta.bottom : wide.height;
    return layout;
  }
  function draw(place) {
    var figure = JSON.parse(document.getElementById(place.id.replace("figure-", "data-"))
      .textContent);
    var wide = JSON.parse(JSON.stringify(figure.layout));
    var layout = adapt(figure.layout, wide, place.clientWidth);
    var wasNarrow = place.clientWidth < narrowBelow;
    if (coarse) { layout.dragmode = false; }
    function size() { place.style.height = layout.height + "px"; }
    size();
    Plotly.newPlot(place, figure.data, layout, {
      responsive: true,
      displaylogo: false,
      displayModeBar: coarse ? true : "hover",
      modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]]  // nothing that sends data
    });
    function refit(width) {
      var narrow = width < narrowBelow;
      if (narrow === wasNarrow) { return; }
      wasNarrow = narrow;
      layout = adapt(place.layout, wide, width);
      size();
      Plotly.react(place, place.data, layout);
    }
    window.addEventListener("resize", function () { refit(place.clientWidth); });
    window.addEventListener("beforeprint", function () {
      Plotly.relayout(place, { autosize: false, width: 640 });
    });
    window.addEventListener("afterprint", function () {
      Plotly.relayout(place, { autosize: true, width: null });
    });
  }
  document.querySelectorAll(".plot").forEach(function (place) {
    try { draw(place); } catch (error) {
      console.error("error in " + place.id + ": " + error);
      place.textContent = "This figure could not be drawn; its numbers stand in the tables.";
    }
  });
})();
"""

_STYLE = """
:root { --ink: #1b1f24; --soft: #57606a; --line: #d8dee4; --paper: #fff; --wash: #f6f8fa; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; }
body { margin: 0 auto; max-width: 1080px; padding: 0 20px 60px; background: var(--paper);
  color: var(--ink); overflow-wrap: anywhere;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
header { padding: 28px 0 6px; }
.kicker { margin: 0; color: var(--soft); font-size: 14px; letter-spacing: .04em; }
h1 { margin: 2px 0 0; font-size: 30px; line-height: 1.2; }
h2 { margin: 44px 0 12px; padding-top: 14px; border-top: 1px solid var(--line); font-size: 21px;
  line-height: 1.3; }
h3 { margin: 20px 0 6px; font-size: 17px; }
p, ul, ol { margin: 8px 0; max-width: 76ch; }
code { font: .92em/1.4 ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  background: var(--wash); border-radius: 4px; padding: 1px 4px; }
nav { display: flex; flex-wrap: wrap; gap: 4px 16px; padding: 10px 0 4px; font-size: 14px; }
a { color: #0550ae; }
nav a { padding: 4px 0; }
.banner { margin: 16px 0; padding: 16px 20px; border-radius: 10px; border: 1px solid;
  border-left-width: 8px; }
.banner p { max-width: none; margin: 0; }
.banner .word { color: var(--soft); }
.banner .word b { display: inline-block; margin-right: 10px; font-size: 20px; color: inherit;
  text-transform: capitalize; }
.banner .sentence { margin-top: 6px; font-size: 18px; line-height: 1.45; }
.adequate { background: #eaf6f1; border-color: #00795a; }
.adequate .word b { color: #005f47; }
.deficient { background: #fdf1e8; border-color: #b84f00; }
.deficient .word b { color: #963f00; }
.undecided { background: #f3f3f7; border-color: #5f6073; }
.undecided .word b { color: #444559; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(240px, 100%), 1fr));
  gap: 12px; margin: 16px 0; }
.card { border: 1px solid var(--line); border-radius: 10px; padding: 12px 16px; min-width: 0; }
.card dt { color: var(--soft); font-size: 14px; }
.card dd { margin: 2px 0 0; font-size: 22px; font-weight: 600; line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.card small { font-size: 14px; font-weight: 400; }
.card .rest { font-size: 14px; font-weight: 400; color: var(--soft); }
.notice { padding: 10px 16px 10px 34px; background: #fff8d6; border: 1px solid #d8b400;
  border-radius: 10px; max-width: none; }
.cause { border: 1px solid var(--line); border-radius: 10px; padding: 4px 18px 10px;
  margin: 12px 0; }
.cause h3 { margin-top: 12px; }
.facts { color: var(--soft); }
.advice { border-left: 4px solid #0072b2; padding: 2px 0 2px 16px; margin: 16px 0; }
.advice h3 { margin-top: 4px; }
.table { margin: 12px 0; border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }
.caption { margin: 0; max-width: none; padding: 8px 9px; color: var(--soft); font-size: 14px;
  line-height: 1.4; background: var(--wash); }
.scroll { overflow-x: auto; background:
  linear-gradient(90deg, #fff 30%, #fff0) 0 0 / 40px 100% no-repeat local,
  linear-gradient(270deg, #fff 30%, #fff0) 100% 0 / 40px 100% no-repeat local,
  linear-gradient(90deg, #0003, #0000) 0 0 / 12px 100% no-repeat scroll,
  linear-gradient(270deg, #0003, #0000) 100% 0 / 12px 100% no-repeat scroll, #fff; }
.scroll:focus-visible { outline: 2px solid #0550ae; outline-offset: -2px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; line-height: 1.4; }
th, td { padding: 6px 9px; text-align: left; vertical-align: top; border-top: 1px solid
  var(--line); overflow-wrap: break-word; min-width: 4ch; max-width: 44ch; }
th { font-weight: 600; vertical-align: bottom; }
td:last-child:not(.n) { min-width: 11ch; }
.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
th.n { white-space: normal; }
td code { background: none; padding: 0; }
.status { white-space: nowrap; }
.status::before { content: ""; display: inline-block; width: 10px; height: 10px; margin-right: 6px;
  border: 1px solid #444; border-radius: 2px; background: #f0e442; }
.status.named { font-weight: 600; }
.status.named::before { background: #0072b2; }
.status.cannot-be-rejected::before { background: #e69f00; }
.status.rejected::before { background: #8a8a8a; }
.status.not-significant::before { background: #cfcfcf; }
.status.invisible::before { background: #fff; }
.lines { font-size: 14px; max-width: none; padding-left: 28px; }
figure { margin: 16px 0; }
.plot { width: 100%; overflow: hidden; }
figcaption { color: var(--soft); font-size: 14px; max-width: 90ch; margin-top: 4px; }
@media (max-width: 620px) {
  body { padding: 0 14px 40px; }
  header { padding-top: 16px; }
  h1 { font-size: 25px; }
  .banner { padding: 12px 14px; }
  .banner .sentence { font-size: 17px; }
  .cause { padding: 2px 12px 8px; }
  th, td { max-width: 34ch; }
  table { width: max-content; min-width: 100%; }
  figure { margin: 12px -6px; }
  figcaption { margin-left: 6px; }
}
@media print {
  body { max-width: none; padding: 0; font-size: 11pt; }
  nav { display: none; }
  h2 { break-after: avoid; margin-top: 24px; }
  .card, .cause, .banner, figure, tr { break-inside: avoid; }
  .table { overflow: visible; }
  .scroll { overflow: visible; background: none; }
  .n, .status { white-space: normal; }
  table { font-size: 9pt; }
}
"""
