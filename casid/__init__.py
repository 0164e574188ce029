"""Constrained grey-box identification with CasADi.

The names below are the public ones. Each is loaded at its first use, so that `import casid` takes
no longer than importing a small module.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casid.checking import CheckReport, check
    from casid.data import Experiment, Record
    from casid.diagnosing import diagnose
    from casid.diagnosis import Diagnosis
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
    from casid.model import Model, Parameter
    from casid.nlp import Nlp, Solver
    from casid.prepare import decimate, detrend, lowpass
    from casid.problem import Problem, load_problem
    from casid.reading import read_record
    from casid.regression import regress

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
    "Model",
    "ModelError",
    "Nlp",
    "Parameter",
    "Problem",
    "Record",
    "SolveError",
    "Solver",
    "UnitError",
    "check",
    "decimate",
    "detrend",
    "diagnose",
    "identify",
    "load_problem",
    "lowpass",
    "read_record",
    "regress",
]

_HOME = {
    name: home
    for home, names in {
        "checking": "CheckReport check",
        "data": "Experiment Record",
        "diagnosing": "diagnose",
        "diagnosis": "Diagnosis",
        "effects": "Effect",
        "errors": "CasidError DataError IdentifiabilityError ModelError SolveError UnitError",
        "estimate": "Estimate",
        "identification": "FitSettings identify",
        "model": "Model Parameter",
        "nlp": "Nlp Solver",
        "prepare": "decimate detrend lowpass",
        "problem": "Problem load_problem",
        "reading": "read_record",
        "regression": "regress",
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
