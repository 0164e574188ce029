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
from casid.report.document import terminal_text

RENDERERS: Mapping[str, Mapping[str, str]] = {
    "Advice": {"document": "texts.diagnosis.advice_document"},
    "AlongFamily": {"document": "texts.moments.family_document"},
    "Assessment": {
        "document": "texts.assessment.assessment_document",
        "figures": "figures.identifiability.figures",
        "page": "pages.identifiability_page.assessment_page",
    },
    "Asymptotics": {"document": "texts.remedies.asymptotics_document"},
    "BiasTable": {"document": "texts.identifiability.bias_document"},
    "BlackBoxReferences": {"document": "texts.moments.black_box_document"},
    "Calibration": {
        "document": "texts.diagnosis.calibration_document",
        "figure": "figures.calibration.calibration_figure",
    },
    "CheckReport": {"document": "texts.records.check_document"},
    "ClosedLoopView": {"text": "texts.closed_loop.closed_loop_text"},
    "Comparison": {
        "document": "texts.remedies.comparison_document",
        "figure": "figures.remedy_figures.comparison_figure",
    },
    "Convergence": {"document": "texts.moments.convergence_document"},
    "DecisionMap": {"figure": "figures.decision_map.decision_map_figure"},
    "Diagnosis": {
        "document": "texts.diagnosis.diagnosis_document",
        "figure": "figures.simulated.diagnosis_figure",
        "figures": "figures.diagnosis.diagnosis_figures",
        "page": "pages.diagnosis_page.diagnosis_page",
    },
    "Estimate": {
        "document": "texts.estimates.estimate_document",
        "figure": "figures.estimates.estimate_figure",
    },
    "Invariants": {"document": "texts.moments.invariants_document"},
    "Isolability": {
        "document": "texts.diagnosis.isolability_document",
        "figure": "figures.isolability.isolability_figure",
    },
    "ModuleEstimate": {"document": "texts.networks.module_document"},
    "MomentEstimate": {"document": "texts.estimates.moment_estimate_document"},
    "MonteCarlo": {
        "document": "texts.estimates.monte_carlo_document",
        "figure": "pages.monte_carlo_page.histogram_figure",
        "page": "pages.monte_carlo_page.montecarlo_page",
    },
    "Network": {"text": "texts.networks.network_text"},
    "NodeEquations": {"text": "texts.networks.equations_text"},
    "Practical": {"document": "texts.identifiability.practical_document"},
    "PredictorTable": {"document": "texts.networks.predictors_document"},
    "Profile": {"figure": "figures.profiles.moment_profile_figure"},
    "Profiles": {"figure": "figures.profiles.profiles_figure"},
    "Reconciled": {"document": "texts.estimates.reconciled_document"},
    "Record": {"document": "texts.records.record_document"},
    "RegressionEstimate": {"document": "texts.estimates.regression_document"},
    "SolverComparison": {
        "document": "texts.solvers.solver_document",
        "figure": "figures.solvers.solver_figure",
    },
    "TransferMatrix": {"text": "texts.transfer_functions.transfer_text"},
    "UnknownInputComparison": {"document": "texts.remedies.options_document"},
    "Validation": {
        "document": "texts.moments.validation_document",
        "figure": "figures.validation.validation_figure",
    },
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
    for name in (c.__name__ for c in kind.__mro__):
        path = RENDERERS.get(name, {}).get(form)
        if path is not None:
            module, _, function = path.rpartition(".")
            loaded = importlib.import_module(f"casid.report.{module}")
            found: Callable[..., Any] = getattr(loaded, function)
            return found
    if form in _DERIVED:
        return _DERIVED[form]
    raise LookupError(f"casid.report has no {form} of {kind.__name__}")


def _text(result: object) -> str:
    return terminal_text(renderer(type(result), "document")(result))


def _html(result: object) -> str:
    try:
        document = renderer(type(result), "document")
    except LookupError:  # text alone
        return f"<pre>{html.escape(str(result))}</pre>"
    from casid.report.pages.markup import fragment  # what the terminal prints needs no HTML

    return fragment(document(result))


def _files(result: Any, folder: Path) -> Path:
    page = renderer(type(result), "page")(result)  # before anything is written: both files or none
    write_json(folder / JSON_FILES[type(result).__name__], result.to_json())
    return write_text(folder / "report.html", page)


_DERIVED: dict[str, Callable[..., Any]] = {"text": _text, "html": _html, "files": _files}
