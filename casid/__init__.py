"""Constrained grey-box identification with CasADi.

The names below are the public ones. Each is loaded at its first use, so that `import casid` takes
no longer than importing a small module.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casid.asymptotics.decision_map import decision_map
    from casid.asymptotics.input_measurement import InputMeasurement
    from casid.asymptotics.limits import regression_limit
    from casid.asymptotics.linear_signals import LinearSignals
    from casid.asymptotics.module_remedies import compare_module_remedies
    from casid.asymptotics.network_remedies import network_remedies
    from casid.asymptotics.network_signals import network_signals
    from casid.asymptotics.prediction_limit import prediction_error_limit
    from casid.asymptotics.regression import FirstStage, Regression
    from casid.asymptotics.remedies import Remedy, compare_remedies
    from casid.asymptotics.two_stage_limit import two_stage_limit
    from casid.campaigns.monte_carlo import MonteCarlo, montecarlo
    from casid.checking import CheckReport, check
    from casid.data import Experiment, Record
    from casid.derived import Derived
    from casid.diagnosis.calibration.calibration import Calibration
    from casid.diagnosis.diagnosing import diagnose
    from casid.diagnosis.result import Diagnosis
    from casid.effects.effect import Effect
    from casid.effects.user_effects import balance_effect, channel_effect, parameter_effect
    from casid.errors import (
        CasidError,
        DataError,
        IdentifiabilityError,
        ModelError,
        SolveError,
        UnitError,
    )
    from casid.estimate import Estimate
    from casid.identifiability.asked import Assumptions
    from casid.identifiability.assess import assess_identifiability
    from casid.identifiability.assessment import Assessment
    from casid.identifiability.equations.equation_file import (
        EquationFile,
        parse_system,
        read_equations,
    )
    from casid.identifiability.inputs.input_classes import Exosystem
    from casid.identifiability.invariants import invariants
    from casid.identifiability.mends.candidates import (
        Candidate,
        known_initial_state,
        known_parameter,
        replica,
        sensor,
    )
    from casid.identifiability.mends.sensor_subsets import sensor_subsets
    from casid.identifiability.rank.observability import observability
    from casid.identifiability.rank.system import System
    from casid.identifiability.records.practical import practical_identifiability
    from casid.identifiability.records.profiles import profile_likelihood
    from casid.identifiability.symbolic.observability_matrix import observability_matrix
    from casid.identification import FitSettings, identify
    from casid.indirect.direct_model import direct_model
    from casid.indirect.feedforward import feedforward
    from casid.indirect.from_model import direct_model_of
    from casid.indirect.indirect_model import indirect_model
    from casid.indirect.left_inverse import left_inverse
    from casid.indirect.output_choice import choose_output
    from casid.indirect.special_cases import special_case
    from casid.instrumental.estimators import (
        MomentEstimate,
        Prior,
        StageSpec,
        instrumental_variables,
        least_squares,
        multistage,
    )
    from casid.instrumental.exogeneity import reference_depends_on
    from casid.instrumental.instruments import Instruments
    from casid.instrumental.moment_settings import MomentSettings
    from casid.instrumental.moments import Moments
    from casid.instrumental.reference_filter import ReferenceFilter
    from casid.instrumental.resampling import bootstrap, profile
    from casid.instrumental.streamed import estimate_from_moments
    from casid.instrumental.validation import validate
    from casid.linear.affine import affine_hull
    from casid.linear.closed_loop import closed_loop_view
    from casid.linear.discretisation_bias import bias_table
    from casid.linear.linear_model import linearise
    from casid.model import Model, Parameter
    from casid.networks.confounding import confounders
    from casid.networks.drawing import network_figure
    from casid.networks.elimination import immerse
    from casid.networks.estimation.estimate import estimate_module
    from casid.networks.estimation.module_estimate import ModuleEstimate
    from casid.networks.indirect_equations import indirect_equations
    from casid.networks.network import Network, Signal, dynamic_network
    from casid.networks.node_sets import node_sets
    from casid.networks.prediction.eiv_filter import eiv_filter
    from casid.networks.prediction.predictors import compare_predictors
    from casid.networks.predictor_inputs import predictor_inputs
    from casid.networks.propositions import proposition_3_1, proposition_4_1
    from casid.networks.rings import eliminate_recursively
    from casid.networks.simulation import simulate_network
    from casid.observers.decoupled_observer import decoupled_observer
    from casid.observers.input_smoother import reconstruct_input
    from casid.observers.noncausal_inverse import noncausal_inverse
    from casid.prediction.coordinated_turn import smooth_track
    from casid.prediction.polynomial_orders import Orders
    from casid.prediction.unknown_input import compare_unknown_input_options
    from casid.prepare import decimate, detrend, lowpass
    from casid.problem import Problem, load_problem
    from casid.reading.record_file import read_record
    from casid.reconciliation import Reconciliation
    from casid.regression import regress
    from casid.solving.nlp import Nlp, Solver
    from casid.solving.solvers import compare_solvers
    from casid.transfer.matrix import transfer_matrix
    from casid.transfer.rational import Rational
    from casid.transfer.reading import rational

__version__ = "0.1.0"

__all__ = [
    "Assessment",
    "Assumptions",
    "Calibration",
    "Candidate",
    "CasidError",
    "CheckReport",
    "DataError",
    "Derived",
    "Diagnosis",
    "Effect",
    "EquationFile",
    "Estimate",
    "Exosystem",
    "Experiment",
    "FirstStage",
    "FitSettings",
    "IdentifiabilityError",
    "InputMeasurement",
    "Instruments",
    "LinearSignals",
    "Model",
    "ModelError",
    "ModuleEstimate",
    "MomentEstimate",
    "MomentSettings",
    "Moments",
    "MonteCarlo",
    "Network",
    "Nlp",
    "Orders",
    "Parameter",
    "Prior",
    "Problem",
    "Rational",
    "Reconciliation",
    "Record",
    "ReferenceFilter",
    "Regression",
    "Remedy",
    "Signal",
    "SolveError",
    "Solver",
    "StageSpec",
    "System",
    "UnitError",
    "affine_hull",
    "assess_identifiability",
    "balance_effect",
    "bias_table",
    "bootstrap",
    "channel_effect",
    "check",
    "choose_output",
    "closed_loop_view",
    "compare_module_remedies",
    "compare_predictors",
    "compare_remedies",
    "compare_solvers",
    "compare_unknown_input_options",
    "confounders",
    "decimate",
    "decision_map",
    "decoupled_observer",
    "detrend",
    "diagnose",
    "direct_model",
    "direct_model_of",
    "dynamic_network",
    "eiv_filter",
    "eliminate_recursively",
    "estimate_from_moments",
    "estimate_module",
    "feedforward",
    "identify",
    "immerse",
    "indirect_equations",
    "indirect_model",
    "instrumental_variables",
    "invariants",
    "known_initial_state",
    "known_parameter",
    "least_squares",
    "left_inverse",
    "linearise",
    "load_problem",
    "lowpass",
    "montecarlo",
    "multistage",
    "network_figure",
    "network_remedies",
    "network_signals",
    "node_sets",
    "noncausal_inverse",
    "observability",
    "observability_matrix",
    "parameter_effect",
    "parse_system",
    "practical_identifiability",
    "prediction_error_limit",
    "predictor_inputs",
    "profile",
    "profile_likelihood",
    "proposition_3_1",
    "proposition_4_1",
    "rational",
    "read_equations",
    "read_record",
    "reconstruct_input",
    "reference_depends_on",
    "regress",
    "regression_limit",
    "replica",
    "sensor",
    "sensor_subsets",
    "simulate_network",
    "smooth_track",
    "special_case",
    "transfer_matrix",
    "two_stage_limit",
    "validate",
]

_HOME = {
    name: home
    for home, names in {
        "reconciliation": "Reconciliation",
        "instrumental.exogeneity": "reference_depends_on",
        "derived": "Derived",
        "prediction.coordinated_turn": "smooth_track",
        "checking": "CheckReport check",
        "data": "Experiment Record",
        "diagnosis.diagnosing": "diagnose",
        "linear.affine": "affine_hull",
        "linear.closed_loop": "closed_loop_view",
        "diagnosis.result": "Diagnosis",
        "linear.discretisation_bias": "bias_table",
        "diagnosis.calibration.calibration": "Calibration",
        "effects.effect": "Effect",
        "effects.user_effects": "balance_effect channel_effect parameter_effect",
        "errors": "CasidError DataError IdentifiabilityError ModelError SolveError UnitError",
        "estimate": "Estimate",
        "identifiability.asked": "Assumptions",
        "identifiability.assess": "assess_identifiability",
        "identifiability.assessment": "Assessment",
        "identifiability.inputs.input_classes": "Exosystem",
        "identifiability.invariants": "invariants",
        "identifiability.mends.candidates": "Candidate known_initial_state known_parameter replica "
        "sensor",
        "identifiability.equations.equation_file": "EquationFile parse_system read_equations",
        "identifiability.rank.observability": "observability",
        "identifiability.symbolic.observability_matrix": "observability_matrix",
        "identifiability.records.practical": "practical_identifiability",
        "identifiability.records.profiles": "profile_likelihood",
        "identifiability.mends.sensor_subsets": "sensor_subsets",
        "identifiability.rank.system": "System",
        "identification": "FitSettings identify",
        "instrumental.estimators": "MomentEstimate Prior StageSpec instrumental_variables "
        "least_squares multistage",
        "instrumental.instruments": "Instruments",
        "linear.linear_model": "linearise",
        "model": "Model Parameter",
        "instrumental.moments": "Moments",
        "campaigns.monte_carlo": "MonteCarlo montecarlo",
        "solving.nlp": "Nlp Solver",
        "prepare": "decimate detrend lowpass",
        "problem": "Problem load_problem",
        "reading.record_file": "read_record",
        "instrumental.reference_filter": "ReferenceFilter",
        "regression": "regress",
        "instrumental.resampling": "bootstrap profile",
        "solving.solvers": "compare_solvers",
        "instrumental.moment_settings": "MomentSettings",
        "instrumental.streamed": "estimate_from_moments",
        "prediction.unknown_input": "compare_unknown_input_options",
        "instrumental.validation": "validate",
        "transfer.rational": "Rational",
        "transfer.reading": "rational",
        "networks.network": "Network Signal dynamic_network",
        "networks.node_sets": "node_sets",
        "networks.prediction.predictors": "compare_predictors",
        "networks.simulation": "simulate_network",
        "asymptotics.linear_signals": "LinearSignals",
        "asymptotics.remedies": "Remedy compare_remedies",
        "asymptotics.limits": "regression_limit",
        "observers.decoupled_observer": "decoupled_observer",
        "observers.input_smoother": "reconstruct_input",
        "indirect.direct_model": "direct_model",
        "indirect.indirect_model": "indirect_model",
        "indirect.feedforward": "feedforward",
        "asymptotics.regression": "FirstStage Regression",
        "asymptotics.prediction_limit": "prediction_error_limit",
        "asymptotics.decision_map": "decision_map",
        "observers.noncausal_inverse": "noncausal_inverse",
        "networks.elimination": "immerse",
        "networks.indirect_equations": "indirect_equations",
        "networks.predictor_inputs": "predictor_inputs",
        "networks.drawing": "network_figure",
        "networks.prediction.eiv_filter": "eiv_filter",
        "asymptotics.network_signals": "network_signals",
        "indirect.from_model": "direct_model_of",
        "indirect.output_choice": "choose_output",
        "networks.estimation.estimate": "estimate_module",
        "networks.estimation.module_estimate": "ModuleEstimate",
        "networks.rings": "eliminate_recursively",
        "networks.propositions": "proposition_3_1 proposition_4_1",
        "networks.confounding": "confounders",
        "transfer.matrix": "transfer_matrix",
        "indirect.left_inverse": "left_inverse",
        "indirect.special_cases": "special_case",
        "asymptotics.input_measurement": "InputMeasurement",
        "asymptotics.module_remedies": "compare_module_remedies",
        "prediction.polynomial_orders": "Orders",
        "asymptotics.network_remedies": "network_remedies",
        "asymptotics.two_stage_limit": "two_stage_limit",
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
