"""The scripts that draw figures, wide or narrow, light or dark, on screen or paper.

A page carries plotly.js 4.1.1 (the bundle "cartesian", MIT licence) compressed, and its figures as
JSON. `DRAW` unpacks the library, and draws a figure when the section that it is in is unfolded.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from casid.report.document import Figure
from casid.report.figures.style import visible_text

# Panels side by side stand one above another where the page is narrow; a finger scrolls the page
# and zooms only after the menu's zoom is chosen; on paper a figure takes the paper's width.
DRAW = """
"use strict";
(function () {
  var coarse = window.matchMedia("(pointer: coarse)").matches;
  var narrowBelow = 620;
  var light = { ink: "#222222", grid: "#e8e8e8", fine: "#f3f3f3", zero: "#bdbdbd",
    icon: "#767676",
    under: "rgba(255,255,255,0.8)" };
  var dark = { ink: "#d5dbe3", grid: "#343c47", fine: "#262c35", zero: "#59636f",
    icon: "#8b96a3",
    under: "rgba(20,24,29,0.8)" };
  var inks = ["black", light.ink, dark.ink];
  var drawn = [];
  function palette() {
    var theme = document.documentElement.dataset.theme;
    var isDark = theme ? theme === "dark"
      : window.matchMedia("(prefers-color-scheme: dark)").matches;
    return isDark ? dark : light;
  }
  function tint(data, layout, look) {
    layout.font = Object.assign(layout.font || {}, { color: look.ink });
    layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
    layout.modebar = Object.assign(layout.modebar || {},
      { bgcolor: "rgba(0,0,0,0)", color: look.icon, activecolor: look.ink });
    Object.keys(layout).forEach(function (key) {
      if (!/^[xy]axis/.test(key)) { return; }
      layout[key].gridcolor = look.grid;
      layout[key].zerolinecolor = look.zero;
      if (layout[key].minor) { layout[key].minor.gridcolor = look.fine; }
    });
    function ink(part) {
      if (part && inks.indexOf(part.color) >= 0) { part.color = look.ink; }
    }
    function label(shape) {
      if (shape.label) { shape.label.font.color = look.ink; }
      ink(shape.line);
    }
    (layout.shapes || []).forEach(label);
    (layout.annotations || []).forEach(function (note) {
      if (note.bgcolor) { note.bgcolor = look.under; }
    });
    (layout.meta.choices || []).forEach(function (choice) {
      (choice.args[1].shapes || []).forEach(label);
    });
    data.forEach(function (trace) { ink(trace.line); ink(trace.marker); });
  }
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
  function chooser(place, menu, meta) {  // the menu as a list of the page, for the keyboard
    var label = document.createElement("label"), list = document.createElement("select");
    meta.choices = menu.buttons;
    menu.buttons.forEach(function (button, i) {
      var entry = document.createElement("option");
      entry.textContent = meta.names[i];
      list.appendChild(entry);
    });
    list.addEventListener("change", function () {
      var args = menu.buttons[list.selectedIndex].args;
      Plotly.update(place, args[0], args[1]);
    });
    label.className = "choice";
    label.append("Record ", list);
    place.insertAdjacentElement("afterend", label);
  }
  function equip(place) {  // what a click in the legend does, by the keyboard
    place.querySelectorAll(".legend .traces").forEach(function (entry, i) {
      var toggle = entry.querySelector(".legendtoggle");
      var trace = entry.__data__ && entry.__data__[0] && entry.__data__[0].trace;
      if (!toggle || !trace) { return; }
      function isOn() { return place.data[trace.index].visible !== "legendonly"; }
      toggle.setAttribute("tabindex", "0");
      toggle.setAttribute("role", "checkbox");
      toggle.setAttribute("aria-label", "show " + entry.textContent.trim());
      toggle.setAttribute("aria-checked", String(isOn()));
      if (place.dataset.toggled === String(i)) {  // plotly has drawn the legend anew
        delete place.dataset.toggled;
        toggle.focus();
      }
      toggle.onkeydown = function (event) {
        if (event.key !== " " && event.key !== "Enter") { return; }
        event.preventDefault();
        place.dataset.toggled = i;
        var group = place.data[trace.index].legendgroup, alike = [];
        place.data.forEach(function (other, k) {
          var isShown = other.visible !== false;  // of another record it is not
          var isAlike = k === trace.index || (group && other.legendgroup === group);
          if (isShown && isAlike) { alike.push(k); }
        });
        Plotly.restyle(place, { visible: isOn() ? "legendonly" : true }, alike);
      };
    });
  }
  function draw(place) {
    var figure = JSON.parse(document.getElementById(place.id.replace("figure-", "data-"))
      .textContent);
    var menu = (figure.layout.updatemenus || [])[0];
    if (menu) {
      delete figure.layout.updatemenus;
      chooser(place, menu, figure.layout.meta);
      var height = figure.layout.meta.menu;  // of what is no longer there
      figure.layout.margin.b -= height;
      figure.layout.meta.bottom -= height;
      figure.layout.height -= height;
    }
    var wide = JSON.parse(JSON.stringify(figure.layout));
    var layout = adapt(figure.layout, wide, place.clientWidth);
    var wasNarrow = place.clientWidth < narrowBelow;
    if (coarse) { layout.dragmode = false; }
    function size() { place.style.height = layout.height + "px"; }
    size();
    tint(figure.data, layout, palette());
    Plotly.newPlot(place, figure.data, layout, {
      responsive: true,
      displaylogo: false,
      displayModeBar: wasNarrow ? false : coarse ? true : "hover",
      modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]]  // nothing that sends data
    });
    equip(place);
    place.on("plotly_afterplot", function () { equip(place); });
    function refit(width) {
      var narrow = width < narrowBelow;
      if (narrow === wasNarrow || !width) { return; }
      wasNarrow = narrow;
      layout = adapt(place.layout, wide, width);
      size();
      Plotly.react(place, place.data, layout);
    }
    window.addEventListener("resize", function () { refit(place.clientWidth); });
    drawn.push(place);
  }
  function retint(look) {
    drawn.forEach(function (place) {
      tint(place.data, place.layout, look);
      Plotly.react(place, place.data, place.layout);
    });
  }
  function attempt(place) {
    if (place.dataset.state || place.closest("details:not([open])")) { return; }
    place.dataset.state = "drawn";
    try { draw(place); } catch (error) {
      console.error("error in " + place.id + ": " + error);
      place.textContent = "This figure could not be drawn; its numbers are in the tables.";
    }
  }
  function every(run) { document.querySelectorAll(".plot").forEach(run); }
  function gradually() {  // one figure at a time: the first is seen before the next is drawn
    var waiting = Array.prototype.find.call(document.querySelectorAll(".plot"), function (place) {
      return !place.dataset.state && !place.closest("details:not([open])");
    });
    if (waiting) {
      attempt(waiting);
      setTimeout(gradually);
    }
  }
  function begin() {
    gradually();
    document.querySelectorAll("details").forEach(function (d) {
      d.addEventListener("toggle", gradually);
    });
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", function () {
      retint(palette());
    });
    new MutationObserver(function () { retint(palette()); })
      .observe(document.documentElement, { attributeFilter: ["data-theme"] });
  }
  function unfold() {  // a link into a folded section opens it
    var target = location.hash && document.getElementById(location.hash.slice(1));
    var folded = target && (target.matches("details") ? target : target.querySelector("details"));
    if (folded) { folded.open = true; target.scrollIntoView(); }
  }
  window.addEventListener("hashchange", unfold);
  document.addEventListener("click", function (event) {  // also where the address stays the same
    if (event.target.closest("a[href^='#']")) { setTimeout(unfold); }
  });
  unfold();
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (d) {
      if (!d.open) { d.open = true; d.dataset.folded = ""; }
    });
    if (!window.Plotly) { return; }
    every(attempt);
    retint(light);
    drawn.forEach(function (p) { Plotly.relayout(p, { autosize: false, width: 640 }); });
  });
  window.addEventListener("afterprint", function () {
    document.querySelectorAll("details[data-folded]").forEach(function (d) {
      d.open = false;
      d.removeAttribute("data-folded");
    });
    if (!window.Plotly) { return; }
    retint(palette());
    drawn.forEach(function (p) { Plotly.relayout(p, { autosize: true, width: null }); });
  });
  function refuse(error) {
    console.error("the figures cannot be drawn: " + error);
    every(function (place) {
      place.style.height = "auto";
      place.textContent = "This browser cannot draw the figure; its numbers are in the tables.";
    });
  }
  function unpack(text) {
    var packed = atob(text), bytes = new Uint8Array(packed.length);
    for (var i = 0; i < packed.length; i++) { bytes[i] = packed.charCodeAt(i); }
    var stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  }
  var packed = document.getElementById("library");
  if (window.Plotly) { begin(); } else if (packed && document.querySelector(".plot")) {
    try {
      unpack(packed.textContent.trim()).then(function (text) {
        var script = document.createElement("script");
        script.textContent = text;
        document.head.appendChild(script);
        begin();
      }).catch(refuse);
    } catch (error) { refuse(error); }
  }
})();
"""


def _packed() -> bytes:
    return resources.files(__package__).joinpath("plotly-cartesian.min.js.gz").read_bytes()


@cache
def library() -> str:
    """The text of plotly.js."""
    return gzip.decompress(_packed()).decode("utf-8")


def packed_library() -> str:
    """plotly.js compressed (gzip), in base 64."""
    return base64.b64encode(_packed()).decode("ascii")


def place_html(figure: Figure) -> str:
    """The place that a figure is drawn in."""
    return (
        f'<div class="plot" id="figure-{figure.name}" role="group" '
        f'style="height:{_height(figure.drawing)}px" '
        f'aria-label="{html.escape(visible_text(figure.caption))}"></div>'
    )


def data_html(figure: Figure) -> str:
    """The data of a figure, for the script that draws it."""
    content = figure_json(figure.drawing)
    return f'<script type="application/json" id="data-{figure.name}">{content}</script>'


_TOP = 40  # pixels above the panels, for the legend; the title becomes the caption


def figure_json(figure: Any) -> str:
    """The figure as JSON that cannot end its script block; its title, the caption, taken out."""
    content = json.loads(figure.to_json(engine="json"))
    layout = content["layout"]
    layout.pop("title", None)
    if "font" not in layout:  # not one of casid's own
        layout.pop("template", None)
    layout.setdefault("meta", {"panels": 1, "columns": 1})
    margin = layout.setdefault("margin", {})
    # The mode bar is beside the plot, never on it.
    layout["margin"] = {**margin, "t": _TOP, "r": max(margin.get("r", 0), 44)}
    layout["height"] = _height(figure)
    text = json.dumps(_in_single_precision(content), separators=(",", ":"), ensure_ascii=True)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _height(figure: Any) -> int:
    """Pixels of a figure whose title has become its caption."""
    above = figure.layout.margin.t
    return int((figure.layout.height or 420) - (_TOP if above is None else above) + _TOP)


def _in_single_precision(content: Any) -> Any:
    """Arrays with seven digits: more than a screen shows, in half the bytes."""
    if isinstance(content, dict):
        if content.get("dtype") == "f8":
            values = np.frombuffer(base64.b64decode(content["bdata"]), dtype="<f8")
            with np.errstate(over="ignore"):
                single = values.astype("<f4")
            if np.isinf(single).sum() > np.isinf(values).sum():  # beyond 3e38
                return content
            packed = base64.b64encode(single.tobytes()).decode("ascii")
            return {**content, "dtype": "f4", "bdata": packed}
        return {k: _in_single_precision(v) for k, v in content.items()}
    if isinstance(content, list):
        return [_in_single_precision(v) for v in content]
    return content
