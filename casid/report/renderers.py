"""What is displayed how: for each class of result, the functions that make its forms.

A function is named by module and name, and its module is loaded when it is needed: the text of an
estimate loads no figures. `casid.presentation` reads this table, and nothing else does.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from casid.data.files import staged, write_json, write_text
from casid.report.document import Document, Figure
from casid.report.terminal import terminal_text

RENDERERS: Mapping[str, Mapping[str, str]] = {
    "Advice": {"document": "texts.diagnosis.advice_document"},
    "AlongFamily": {"document": "texts.moments.family_document"},
    "Assessment": {
        "document": "texts.assessment.assessment_document",
        "figures": "figures.identifiability.figures",
        "report": "pages.identifiability_page.assessment_report",
    },
    "Asymptotics": {"document": "texts.remedies.asymptotics_document"},
    "BiasTable": {"document": "texts.identifiability.bias_document"},
    "BlackBoxReferences": {"document": "texts.moments.black_box_document"},
    "Calibration": {
        "document": "texts.diagnosis.calibration_document",
        "figure": "figures.calibration.calibration_figure",
    },
    "CheckReport": {"document": "texts.records.check_document"},
    "ClosedLoopView": {"document": "texts.closed_loop.closed_loop_document"},
    "Comparison": {
        "document": "texts.remedies.comparison_document",
        "figure": "figures.remedy_figures.comparison_figure",
    },
    "Convergence": {"document": "texts.moments.convergence_document"},
    "DecisionMap": {"figure": "figures.decision_map.decision_map_figure"},
    "DesignedExperiment": {
        "document": "texts.designed_experiments.design_document",
        "figure": "figures.designed_input.designed_input_figure",
        "report": "pages.design_page.design_report",
    },
    "Diagnosis": {
        "document": "texts.diagnosis.diagnosis_document",
        "figure": "figures.simulated.diagnosis_figure",
        "figures": "figures.diagnosis.diagnosis_figures",
        "report": "pages.diagnosis_page.diagnosis_report",
    },
    "Estimate": {
        "document": "texts.estimates.estimate_document",
        "figure": "figures.estimates.estimate_figure",
        "report": "pages.estimate_page.estimate_report",
    },
    "Experiment": {"view": "pages.model_page.experiment_view"},
    "FirFilter": {"document": "texts.records.filter_document"},
    "FittedModel": {"view": "pages.model_page.fitted_view"},
    "Fleet": {
        "document": "texts.fleets.fleet_document",
        "figure": "figures.fleets.cause_figure",
        "figures": "figures.fleets.fleet_figures",
        "report": "pages.fleet_page.fleet_report",
    },
    "Invariants": {"document": "texts.moments.invariants_document"},
    "Investigation": {
        "document": "texts.investigations.investigation_document",
        "report": "pages.investigation_page.investigation_report",
    },
    "Isolability": {
        "document": "texts.diagnosis.isolability_document",
        "figure": "figures.isolability.isolability_figure",
    },
    "IterativeJoint": {"document": "texts.estimates.iterative_document"},
    "Model": {"view": "pages.model_page.model_view"},
    "ModelComparison": {
        "document": "texts.estimates.model_comparison_document",
        "figure": "figures.channels.model_comparison_figure",
    },
    "ModuleEstimate": {"document": "texts.networks.module_document"},
    "MomentEstimate": {
        "document": "texts.estimates.moment_estimate_document",
        "report": "pages.estimate_page.moment_report",
    },
    "MonteCarlo": {
        "document": "texts.estimates.monte_carlo_document",
        "figure": "figures.histograms.histogram_figure",
        "report": "pages.monte_carlo_page.monte_carlo_report",
    },
    "Network": {"document": "texts.networks.network_document"},
    "NodeEquations": {"document": "texts.networks.equations_document"},
    "NodeSets": {"document": "texts.networks.node_sets_document"},
    "ObservabilityMatrix": {"document": "texts.identifiability.observability_document"},
    "PolynomialModel": {"document": "texts.polynomial_models.polynomial_document"},
    "Practical": {"document": "texts.identifiability.practical_document"},
    "Prediction": {"document": "texts.estimates.prediction_document"},
    "PredictorTable": {"document": "texts.networks.predictors_document"},
    "Problem": {
        "document": "pages.model_page.problem_document",
        "view": "pages.model_page.problem_view",
    },
    "Profile": {"figure": "figures.profiles.moment_profile_figure"},
    "Profiles": {"figure": "figures.profiles.profiles_figure"},
    "Reconciled": {"document": "texts.estimates.reconciled_document"},
    "Record": {
        "document": "texts.records.record_document",
        "figure": "figures.channels.record_figure",
    },
    "ReducedForm": {"document": "texts.identifiability.reduced_document"},
    "RegressionEstimate": {"document": "texts.estimates.regression_document"},
    "SensorSubsets": {"document": "texts.identifiability.subsets_document"},
    "Solution": {"document": "texts.solvers.solution_document"},
    "SolverComparison": {
        "document": "texts.solvers.solver_document",
        "figure": "figures.solvers.solver_figure",
    },
    "TransferMatrix": {"document": "texts.transfer_functions.transfer_document"},
    "UnknownInputComparison": {"document": "texts.remedies.options_document"},
    "Validation": {
        "document": "texts.moments.validation_document",
        "figure": "figures.channels.validation_figure",
    },
}
"""Name of a class -> form -> function that makes it, below `casid.report`."""

JSON_FILES = {
    "Assessment": "identifiability.json",
    "DesignedExperiment": "design.json",
    "Diagnosis": "diagnosis.json",
    "Fleet": "fleet.json",
    "Investigation": "investigation.json",
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
        sources, make = _DERIVED[form]
        if any(_listed(kind, source) is not None for source in sources):
            return make
    path = _listed(kind, form)
    if path is None:
        raise LookupError(f"casid.report has no {form} of {kind.__name__}")
    module, _, function = path.rpartition(".")
    found: Callable[..., Any] = getattr(importlib.import_module(f"casid.report.{module}"), function)
    return found


def _listed(kind: type, form: str) -> str | None:
    names = (c.__name__ for c in kind.__mro__)
    return next((RENDERERS[n][form] for n in names if form in RENDERERS.get(n, {})), None)


def _text(result: object, *arguments: Any) -> str:
    return terminal_text(renderer(type(result), "document")(result, *arguments))


def _html(result: object) -> str:
    """What there is most of: a view or report; else what is printed, with the figure."""
    from casid.report.html.notebook import notebook_html  # what the terminal prints needs no HTML

    kind = type(result)
    for form in ("view", "report"):
        if _listed(kind, form) is not None:
            return notebook_html(renderer(kind, form)(result))
    document = Document(kind.__name__, [])
    if _listed(kind, "document") is not None:
        document = renderer(kind, "document")(result)
    drawn = [Figure("figure", f) for f in _figures(result)]
    return notebook_html(replace(document, parts=[*document.parts, *drawn]))


def _figures(result: object) -> list[Any]:
    if _listed(type(result), "figure") is None:
        return []
    try:
        return [renderer(type(result), "figure")(result)]
    except ValueError:  # nothing to draw
        return []


def _page(result: object, *arguments: Any) -> str:
    from casid.report.html.page import html_page

    return html_page(renderer(type(result), "report")(result, *arguments))


def _files(result: Any, folder: Path) -> Path:
    page = _page(result)
    with staged(folder) as temporary:
        write_json(temporary / JSON_FILES[type(result).__name__], result.to_json())
        write_text(temporary / "report.html", page)
    return folder / "report.html"


_DERIVED: Mapping[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "text": (("document",), _text),
    "html": (("view", "report", "document", "figure"), _html),
    "page": (("report",), _page),
    "files": (("report",), _files),
}
"""Form -> the listed forms of which one must be there, and how it is made."""
