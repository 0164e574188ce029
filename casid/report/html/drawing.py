"""The script that draws a page's figures, wide or narrow, on screen or paper."""

from __future__ import annotations

# Panels side by side stand one above another where the page is narrow; a finger scrolls the page
# and zooms only after the menu's zoom is chosen; on paper a figure takes the paper's width.
DRAW = """
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
      place.textContent = "This figure could not be drawn; its numbers are in the tables.";
    }
  });
})();
"""
