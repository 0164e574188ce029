"""What is displayed how: for each class of result, the functions that make its forms.

A function is named by module and name, and its module is loaded when it is needed: the text of an
estimate loads no figures. `casid.presentation` reads this table, and nothing else does.
"""

from __future__ import annotations

import html
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from casid.data.files import write_json, write_text

RENDERERS: Mapping[str, Mapping[str, str]] = {
    "Assessment": {
        "text": "texts.assessment.as_text",
        "figures": "figures.identifiability.figures",
        "page": "pages.identifiability_page.assessment_page",
    },
    "Asymptotics": {"text": "texts.remedies.asymptotics_text"},
    "Calibration": {"figure": "figures.calibration.calibration_figure"},
    "ClosedLoopView": {"text": "texts.closed_loop.closed_loop_text"},
    "Comparison": {
        "text": "texts.remedies.comparison_text",
        "figure": "figures.remedy_figures.comparison_figure",
    },
    "DecisionMap": {"figure": "figures.decision_map.decision_map_figure"},
    "Diagnosis": {
        "text": "texts.diagnosis.diagnosis_text",
        "figure": "figures.simulated.diagnosis_figure",
        "figures": "figures.diagnosis.diagnosis_figures",
        "page": "pages.diagnosis_page.diagnosis_page",
    },
    "Estimate": {"figure": "figures.estimates.estimate_figure"},
    "Isolability": {"figure": "figures.isolability.isolability_figure"},
    "MonteCarlo": {
        "figure": "pages.monte_carlo_page.histogram_figure",
        "page": "pages.monte_carlo_page.montecarlo_page",
    },
    "Network": {"text": "texts.networks.page"},
    "NodeEquations": {"text": "texts.networks.equations_text"},
    "Profile": {"figure": "figures.profiles.moment_profile_figure"},
    "Profiles": {"figure": "figures.profiles.profiles_figure"},
    "SolverComparison": {"figure": "figures.solvers.solver_figure"},
    "TransferMatrix": {"text": "texts.transfer_functions.transfer_text"},
    "Validation": {"figure": "figures.validation.validation_figure"},
}
"""Name of a class -> form -> function that makes it, below `casid.report`."""

JSON_FILES = {
    "Assessment": "identifiability.json",
    "Diagnosis": "diagnosis.json",
    "MonteCarlo": "montecarlo.json",
}
"""Name of a class -> file beside its page."""


def renderer(kind: type, form: str) -> Callable[..., Any]:
    """The function that makes `form` of a result of class `kind`.

    Raises
    ------
    LookupError
        If there is none.
    """
    if form in _DERIVED:
        return _DERIVED[form]
    for name in (c.__name__ for c in kind.__mro__):
        path = RENDERERS.get(name, {}).get(form)
        if path is not None:
            module, _, function = path.rpartition(".")
            found: Callable[..., Any] = getattr(
                importlib.import_module(f"casid.report.{module}"), function
            )
            return found
    raise LookupError(f"casid.report has no {form} of {kind.__name__}")


def _html(result: object) -> str:
    return f"<pre>{html.escape(str(result))}</pre>"


def _files(result: Any, folder: Path) -> Path:
    page = renderer(type(result), "page")(result)  # before anything is written: both files or none
    write_json(folder / JSON_FILES[type(result).__name__], result.to_json())
    return write_text(folder / "report.html", page)


_DERIVED: dict[str, Callable[..., Any]] = {"html": _html, "files": _files}
