"""Notebooks show results, models, problems and records as tables, equations and small figures."""

from __future__ import annotations

import html
import re
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.fitted.equations import equations_of
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.presentation import present
from casid.report.document import Document, Equations
from casid.report.html.notebook import notebook_html
from casid.report.html.thumbnail import thumbnail
from problems import pendulum, roll_decay
from tests.report import golden_results
from tests.report.test_pages import Seen
from tests.support import samples

CELLS = {
    "model": "from problems import roll_decay\nroll_decay.problem.model",
    "problem": "roll_decay.problem",
    "record": "record = roll_decay.simulate(duration=8.0)\nrecord",
    "experiment": "import casid\ncasid.Experiment(record, {'phi_0': 0.01}, 'released')",
    "estimate": "estimate = casid.identify(roll_decay.problem, record)\nestimate",
    "fitted model": "estimate.model",
    "assessment": "casid.assess_identifiability(roll_decay.problem, record)",
    "diagnosis": "from tests.support import samples\nsamples.rich()",
}


@pytest.fixture(scope="module")
def shown() -> dict[str, str]:
    """What a notebook asks each object for: the value of the last line of its cell."""
    names: dict[str, object] = {}
    found = {}
    for name, cell in CELLS.items():
        *lines, last = cell.splitlines()
        exec("\n".join(lines), names)
        found[name] = eval(last, names)._repr_html_()
    return found


@pytest.fixture(scope="module")
def executed() -> dict[str, str]:
    """What an executed notebook holds of each cell."""
    pytest.importorskip("ipykernel", reason="no ipykernel; pip install 'casid[test]'")
    nbclient = pytest.importorskip("nbclient", reason="no nbclient; pip install 'casid[test]'")
    nbformat = pytest.importorskip("nbformat", reason="no nbformat; pip install 'casid[test]'")
    cells = [nbformat.v4.new_code_cell(source) for source in CELLS.values()]
    notebook = nbformat.v4.new_notebook(cells=cells)
    root = str(Path(__file__).parents[2])
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": root}}).execute()
    found = zip(CELLS, notebook.cells, strict=True)
    return {name: cell.outputs[-1]["data"]["text/html"] for name, cell in found}


@pytest.mark.slow
def test_an_executed_notebook_shows_every_kind_of_object(executed):
    for name, words in {
        "model": ("<math", "B_1", "0 .. 5"),
        "problem": ("<math", "Channels"),
        "record": ("<svg", "every Ts = 0.02 s", "<polyline"),
        "experiment": ("phi_0", "0.01"),
        "estimate": ("The model reproduces", "95 % interval", "<svg", "measured"),
        "fitted model": ("<math", "std. error"),
        "assessment": ("rank", "identifiable", "verdict"),
        "diagnosis": ("deficient", "quadratic_damping", "<svg", "0.349"),
    }.items():
        for word in words:
            assert word in executed[name], (name, word)
        assert "<script" not in executed[name]
        assert "<table" in executed[name]


def test_pictures_and_equations_in_a_notebook_are_well_formed(shown):
    for name, content in shown.items():
        for part in re.findall(r"<svg.*?</svg>(?!</svg>)|<math.*?</math>", content, re.S):
            whole = part if part.count("<svg") == part.count("</svg>") else part + "</svg>"
            text = whole.replace("&InvisibleTimes;", "\u2062")
            if whole.count("<svg") == whole.count("</svg>"):
                assert ElementTree.fromstring(text) is not None, name


@pytest.mark.parametrize("name", ["network", "node_sets", "calibration"])
def test_what_is_printed_is_shown_as_html(name):
    result = golden_results.TEXTS[name]()
    shown = Seen(result._repr_html_()).text
    for word in set(re.findall(r"[a-z]{4,}", str(result))):
        assert word in shown, word


def test_names_that_are_attacks_stay_text_in_a_notebook():
    shown = Seen(samples.hostile()._repr_html_())
    assert not {"script", "img", "iframe"} & {tag for tag, _ in shown.tags}
    assert not [a for _, attributes in shown.tags for a in attributes if a.startswith("on")]
    model = casid.Model("<img src=x>")
    x = model.state("<b>", "m")
    model.derivative(x, -x)
    model.output("<i>y", x, "m")
    tags = {tag for tag, _ in Seen(model._repr_html_()).tags}
    assert not {"img", "b", "i"} & tags


def test_the_equation_before_and_after_has_the_new_term_marked():
    before = roll_decay.problem.model
    found = equations_of(before.extend(quadratic_damping(before, "torque")), before)
    shown = notebook_html(Document("", [Equations(found.before), Equations(found.changed)]))
    first, second = re.findall(r"<math.*?</math>", shown, re.S)
    assert "<mtext>new</mtext>" not in first
    new = re.findall(r'<munder class="new">(.*?)<mtext>new</mtext>', second, re.S)
    assert len(new) == 1
    assert "<mi>d</mi>" in new[0]  # d_2 |p| p alone
    assert "<mi>B</mi>" not in new[0]


def test_equations_of_every_problem_can_be_shown():
    for problem in (pendulum.problem, roll_decay.problem):
        for e in equations_of(problem.model).after:
            for mathml in (e.left_mathml, *(term.mathml for term in e.terms)):
                assert ElementTree.fromstring(
                    f"<math>{mathml}</math>".replace("&InvisibleTimes;", "\u2062")
                )


def test_an_operation_that_algebra_does_not_set_is_written():
    model = casid.Model("choice")
    x, v = model.state("x", "m"), model.state("v", "m/s")
    k = model.parameter("k", "m/s")
    model.derivative(x, ca.if_else(x > 0, k, 1))
    model.balance(v, "force", inertia=ca.if_else(x > 0, 2, 1), terms=[-v], unit="m/s^2")
    model.output("x_m", x, "m")
    shown = model._repr_html_()
    choice, balance, _ = equations_of(model).after
    assert choice.terms[0].mathml == balance.left_mathml == ""
    for equation in (choice, balance):
        assert f"<code>{html.escape(str(equation).partition('   ')[0])}</code>" in shown


def test_a_thumbnail_puts_points_where_their_values_are():
    """Four points of a line whose axes are known: pixels are linear in the values."""
    from casid.report.figures.panels import Panels

    panels = Panels(row_height=200, gap=0)
    x, y = np.array([0.0, 2.0, 6.0, 10.0]), np.array([1.0, 3.0, 2.0, 5.0])
    panels.add(0, x=x, y=y, name="line", mode="lines")
    panels.x_range(0, [0.0, 10.0])
    panels.y_range(0, [0.0, 5.0])
    svg = ElementTree.fromstring(thumbnail(panels.done("a line", ()), "a line"))
    frame = next(e for e in svg.iter("rect") if e.get("fill") == "none")
    left, top, width, height = (float(frame.get(k)) for k in ("x", "y", "width", "height"))
    drawn = next(svg.iter("polyline")).get("points").split()
    pixels = np.array([[float(v) for v in point.split(",")] for point in drawn])
    expected = np.column_stack([left + width * x / 10, top + height * (1 - y / 5)])
    assert np.abs(pixels - expected).max() < 0.11  # one decimal is written
    assert svg.get("aria-label") == "a line"


def test_a_figure_with_bars_maps_and_errors_is_drawn():
    for name, figure in (
        ("rect", present(golden_results.monte_carlo(), "figure")),
        ("rect", present(golden_results.TEXTS["isolability"](), "figure")),
        ("line", present(samples.estimate(), "figure")),
    ):
        svg = ElementTree.fromstring(thumbnail(figure, name))
        assert len(list(svg.iter(name))) >= 3
