// The button of the search shows its keys beside its name: a screen reader reads what is shown.
document.addEventListener("DOMContentLoaded", function () {
  document.querySelectorAll(".search-button-field[aria-label]").forEach(function (button) {
    var shown = button.innerText.replace(/\s+/g, " ").trim();
    if (shown) { button.setAttribute("aria-label", shown); }
  });
  // A table that is wider than the page scrolls by itself, also by the keyboard.
  function scrollable() {
    document.querySelectorAll(".bd-article table").forEach(function (table) {
      if (table.scrollWidth > table.clientWidth) { table.tabIndex = 0; }
    });
  }
  scrollable();
  window.addEventListener("resize", scrollable);
});
