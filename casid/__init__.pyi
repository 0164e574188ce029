"""The public names of casid, each with the module it is loaded from at its first use."""

from .algebra.rational import Rational, rational
from .algebra.transfer_matrix import transfer_matrix
from .campaigns.campaign import campaign
from .campaigns.monte_carlo import MonteCarlo, montecarlo
from .data.alignment import Alignment, align
from .data.derived import Derived
from .data.experiment import Experiment
from .data.preparation import decimate, detrend, lowpass
from .data.problem import Problem, load_problem
from .data.quality import CheckReport, check
from .data.reading.file_format import FileFormat
from .data.reading.record_file import read_record
from .data.record import Record
from .data.templates.new_problem import NewProblem, new_problem
from .diagnosis.calibration.calibration import Calibration
from .diagnosis.diagnose import diagnose
from .diagnosis.diagnosis import Diagnosis
from .diagnosis.investigation import Investigation, investigate
from .errors import CasidError, DataError, IdentifiabilityError, ModelError, SolveError, UnitError
from .estimation.cross_moments.moments import Moments
from .estimation.estimate import Estimate
from .estimation.fitted.fitted_model import FittedModel
from .estimation.moments.instruments.exogeneity import reference_depends_on
from .estimation.moments.instruments.instruments import Instruments
from .estimation.moments.instruments.reference_filter import ReferenceFilter
from .estimation.moments.stages.moment_estimate import MomentEstimate
from .estimation.moments.stages.moment_settings import MomentSettings
from .estimation.moments.stages.prior import Prior
from .estimation.moments.stages.stage_plan import StageSpec
from .estimation.moments.validation import validate
from .estimation.nlp.nlp import Nlp
from .estimation.nlp.solver import Solver
from .estimation.nlp.solver_comparison import compare_solvers
from .estimation.prediction_error.coordinated_turn import smooth_track
from .estimation.prediction_error.polynomial.orders import Orders
from .estimation.reconciliation import Reconciliation
from .estimation.regression.regression import regress
from .estimation.simulation.fit import FitSettings
from .experiment_design.aim import Aim
from .experiment_design.design import design_experiment
from .experiment_design.designed_experiment import DesignedExperiment
from .experiment_design.options import DesignOptions
from .fleets.fleet import Fleet, fleet
from .identifiability.assessment import Assessment
from .identifiability.equations.equation_file import EquationFile, parse_system, read_equations
from .identifiability.equations.system import System
from .identifiability.inputs.input_classes import Exosystem
from .identifiability.procedure import assess_identifiability
from .identifiability.question import Assumptions
from .identifiability.rank.observability import observability
from .identifiability.records.practical import practical_identifiability
from .identifiability.records.profile_likelihood import profile_likelihood
from .identifiability.remedies.candidates import (
    Candidate,
    known_initial_state,
    known_parameter,
    replica,
    sensor,
)
from .identifiability.remedies.sensor_subsets import sensor_subsets
from .identifiability.symbolic.observability_matrix import observability_matrix
from .identification.bootstrap import bootstrap
from .identification.estimate_from_moments import estimate_from_moments
from .identification.identify import identify
from .identification.invariants import invariants
from .identification.moment_estimators import (
    instrumental_variables,
    least_squares,
    multistage,
)
from .identification.profile_interval import profile
from .linear.hulls.affine_hull import affine_hull
from .linear.linear_model import linearise
from .linear.loops.closed_loop import closed_loop_view
from .linear.sampled.discretisation_bias import bias_table
from .model.clock_signals import Always, RampOver, StepAt, TimeSince
from .model.declarations import Parameter
from .model.effects.channels.actuator_effects import actuator_lag, input_backlash, rate_limit
from .model.effects.channels.channel_effects import hold, saturation, sensor_lag
from .model.effects.channels.delays import dead_time, time_delay
from .model.effects.channels.digital_filters import digital_filter
from .model.effects.effect import Effect
from .model.effects.user_effects import balance_effect, channel_effect, parameter_effect
from .model.model import Model
from .report.figures.network_drawing import network_figure
from .saving.archive import load
from .unknown_inputs.indirect.direct_model import direct_model
from .unknown_inputs.indirect.feedforward import feedforward
from .unknown_inputs.indirect.indirect_model import indirect_model
from .unknown_inputs.indirect.left_inverse import left_inverse
from .unknown_inputs.indirect.model_reader import direct_model_of
from .unknown_inputs.indirect.output_choice import choose_output
from .unknown_inputs.indirect.special_cases import special_case
from .unknown_inputs.limits.decision_map import decision_map
from .unknown_inputs.limits.input_measurement import InputMeasurement
from .unknown_inputs.limits.linear_signals import LinearSignals
from .unknown_inputs.limits.module_remedies import compare_module_remedies
from .unknown_inputs.limits.network_remedies import network_remedies
from .unknown_inputs.limits.network_signals import network_signals
from .unknown_inputs.limits.prediction_limit import prediction_error_limit
from .unknown_inputs.limits.regression import FirstStage, Regression
from .unknown_inputs.limits.regression_limit import regression_limit
from .unknown_inputs.limits.remedies import Remedy, compare_remedies
from .unknown_inputs.limits.two_stage_limit import two_stage_limit
from .unknown_inputs.networks.confounders import confounders
from .unknown_inputs.networks.elimination import immerse
from .unknown_inputs.networks.estimation.module_estimate import ModuleEstimate
from .unknown_inputs.networks.estimation.module_estimation import estimate_module
from .unknown_inputs.networks.indirect_equations import indirect_equations
from .unknown_inputs.networks.network import Network, Signal, dynamic_network
from .unknown_inputs.networks.node_sets import node_sets
from .unknown_inputs.networks.prediction.eiv_filter import eiv_filter
from .unknown_inputs.networks.prediction.predictors import compare_predictors
from .unknown_inputs.networks.predictor_inputs import predictor_inputs
from .unknown_inputs.networks.propositions import proposition_3_1, proposition_4_1
from .unknown_inputs.networks.recursive_elimination import eliminate_recursively
from .unknown_inputs.networks.simulation import simulate_network
from .unknown_inputs.observers.decoupled_observer import decoupled_observer
from .unknown_inputs.observers.input_smoother import reconstruct_input
from .unknown_inputs.observers.noncausal_inverse import noncausal_inverse
from .unknown_inputs.options import compare_unknown_input_options

__version__: str

__all__ = [
    "Aim",
    "Alignment",
    "Always",
    "Assessment",
    "Assumptions",
    "Calibration",
    "Candidate",
    "CasidError",
    "CheckReport",
    "DataError",
    "Derived",
    "DesignOptions",
    "DesignedExperiment",
    "Diagnosis",
    "Effect",
    "EquationFile",
    "Estimate",
    "Exosystem",
    "Experiment",
    "FileFormat",
    "FirstStage",
    "FitSettings",
    "FittedModel",
    "Fleet",
    "IdentifiabilityError",
    "InputMeasurement",
    "Instruments",
    "Investigation",
    "LinearSignals",
    "Model",
    "ModelError",
    "ModuleEstimate",
    "MomentEstimate",
    "MomentSettings",
    "Moments",
    "MonteCarlo",
    "Network",
    "NewProblem",
    "Nlp",
    "Orders",
    "Parameter",
    "Prior",
    "Problem",
    "RampOver",
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
    "StepAt",
    "System",
    "TimeSince",
    "UnitError",
    "actuator_lag",
    "affine_hull",
    "align",
    "assess_identifiability",
    "balance_effect",
    "bias_table",
    "bootstrap",
    "campaign",
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
    "dead_time",
    "decimate",
    "decision_map",
    "decoupled_observer",
    "design_experiment",
    "detrend",
    "diagnose",
    "digital_filter",
    "direct_model",
    "direct_model_of",
    "dynamic_network",
    "eiv_filter",
    "eliminate_recursively",
    "estimate_from_moments",
    "estimate_module",
    "feedforward",
    "fleet",
    "hold",
    "identify",
    "immerse",
    "indirect_equations",
    "indirect_model",
    "input_backlash",
    "instrumental_variables",
    "invariants",
    "investigate",
    "known_initial_state",
    "known_parameter",
    "least_squares",
    "left_inverse",
    "linearise",
    "load",
    "load_problem",
    "lowpass",
    "montecarlo",
    "multistage",
    "network_figure",
    "network_remedies",
    "network_signals",
    "new_problem",
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
    "rate_limit",
    "rational",
    "read_equations",
    "read_record",
    "reconstruct_input",
    "reference_depends_on",
    "regress",
    "regression_limit",
    "replica",
    "saturation",
    "sensor",
    "sensor_lag",
    "sensor_subsets",
    "simulate_network",
    "smooth_track",
    "special_case",
    "time_delay",
    "transfer_matrix",
    "two_stage_limit",
    "validate",
]
