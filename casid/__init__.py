"""Constrained grey-box identification with CasADi.

The names below are the public ones. Each is loaded at its first use, so that `import casid` takes
no longer than importing a small module.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casid.affine import affine_hull
    from casid.checking import CheckReport, check
    from casid.closed_loop import closed_loop_view
    from casid.data import Experiment, Record
    from casid.diagnosing import diagnose
    from casid.diagnosis import Diagnosis
    from casid.discretisation_bias import bias_table
    from casid.effects import Effect
    from casid.errors import (
        CasidError,
        DataError,
        IdentifiabilityError,
        ModelError,
        SolveError,
        UnitError,
    )
    from casid.estimate import Estimate
    from casid.identification import FitSettings, identify
    from casid.instrumental import (
        MomentEstimate,
        Prior,
        StageSpec,
        instrumental_variables,
        least_squares,
        multistage,
    )
    from casid.instruments import Instruments
    from casid.linear import linearise
    from casid.model import Model, Parameter
    from casid.moments import Moments
    from casid.monte_carlo import MonteCarlo, montecarlo
    from casid.nlp import Nlp, Solver
    from casid.prepare import decimate, detrend, lowpass
    from casid.problem import Problem, load_problem
    from casid.reading import read_record
    from casid.reference_filter import ReferenceFilter
    from casid.regression import regress
    from casid.resampling import bootstrap, profile
    from casid.solvers import compare_solvers
    from casid.stage import MomentSettings
    from casid.streamed import estimate_from_moments
    from casid.unknown_input import compare_unknown_input_options
    from casid.validation import validate

__version__ = "0.1.0"

__all__ = [
    "CasidError",
    "CheckReport",
    "DataError",
    "Diagnosis",
    "Effect",
    "Estimate",
    "Experiment",
    "FitSettings",
    "IdentifiabilityError",
    "Instruments",
    "Model",
    "ModelError",
    "MomentEstimate",
    "MonteCarlo",
    "MomentSettings",
    "Moments",
    "Nlp",
    "Parameter",
    "Prior",
    "Problem",
    "Record",
    "ReferenceFilter",
    "SolveError",
    "Solver",
    "StageSpec",
    "UnitError",
    "affine_hull",
    "bias_table",
    "bootstrap",
    "check",
    "closed_loop_view",
    "compare_solvers",
    "compare_unknown_input_options",
    "decimate",
    "detrend",
    "diagnose",
    "estimate_from_moments",
    "identify",
    "instrumental_variables",
    "least_squares",
    "linearise",
    "load_problem",
    "lowpass",
    "montecarlo",
    "multistage",
    "profile",
    "read_record",
    "regress",
    "validate",
]

_HOME = {
    name: home
    for home, names in {
        "checking": "CheckReport check",
        "data": "Experiment Record",
        "diagnosing": "diagnose",
        "affine": "affine_hull",
        "closed_loop": "closed_loop_view",
        "diagnosis": "Diagnosis",
        "discretisation_bias": "bias_table",
        "effects": "Effect",
        "errors": "CasidError DataError IdentifiabilityError ModelError SolveError UnitError",
        "estimate": "Estimate",
        "identification": "FitSettings identify",
        "instrumental": "MomentEstimate Prior StageSpec instrumental_variables least_squares "
        "multistage",
        "instruments": "Instruments",
        "linear": "linearise",
        "model": "Model Parameter",
        "moments": "Moments",
        "monte_carlo": "MonteCarlo montecarlo",
        "nlp": "Nlp Solver",
        "prepare": "decimate detrend lowpass",
        "problem": "Problem load_problem",
        "reading": "read_record",
        "reference_filter": "ReferenceFilter",
        "regression": "regress",
        "resampling": "bootstrap profile",
        "solvers": "compare_solvers",
        "stage": "MomentSettings",
        "streamed": "estimate_from_moments",
        "unknown_input": "compare_unknown_input_options",
        "validation": "validate",
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        import difflib

        near = difflib.get_close_matches(name, __all__, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'casid' has no attribute {name!r}{hint}")
    value = getattr(importlib.import_module(f"casid.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
