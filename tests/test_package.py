"""The package as a whole: which way imports run, what is public, and what is light."""

from __future__ import annotations

import ast
import graphlib
import inspect
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import casid
from tests.shared import ROOT

SOURCES = sorted((ROOT / "casid").rglob("*.py"))


def name_of(path: Path) -> str:
    """`linear.affine` for casid/linear/affine.py; `linear` for the package itself."""
    parts = path.relative_to(ROOT / "casid").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


HEAVY = "casadi numpy scipy sympy control pandas pyarrow pint joblib plotly rich matplotlib".split()

# A module imports, when it is itself imported, from lines above its own alone. What a method needs
# from below (`record.lowpass`, `diagnosis.write`) it imports when it is called. A module without a
# line here is free, as long as there is no circle. An indented line goes on with the one above.
LAYERS = """
asymptotics.remedy_text campaigns.dask_backend campaigns.progress diagnosis.evidence.plateaus
  diagnosis.evidence.spikes diagnosis_options errors figures.look identifiability.assessment
  identifiability.combinations.readable identifiability.combinations.scalar_flow
  identifiability.rank.program identifiability.records.profile_result instrumental.columns
  instrumental.lag_products instrumental.switching lags linear.loop_text local_rank
  observers.subspaces pages.drawing pages.style transfer.polynomial transfer.roots uncertainty
asymptotics.asymptotics asymptotics.exact_field asymptotics.filters asymptotics.linear_expressions
  asymptotics.regression asymptotics.remedy_figures campaigns.manifest estimate expressions
  identifiability.assessment_text identifiability.rank.prime_field identifiability.rank.terms
  instrumental.change_detection instrumental.column_products instrumental.gram instrumental.long_run
  instrumental.reference_filter linear.linear_constraints linear.symbolic linear.transfer_text
  local_polynomial model options pages.markup prediction.extended_smoother
  prediction.polynomial_orders prediction.polynomial_residuals reading.sources reading.tables
  solving.nlp_solution solving.nlp_solver terminal transfer.rational transfer.text units writing
asymptotics.comparison asymptotics.decision_map asymptotics.linear_signals
  asymptotics.module_response asymptotics.state_space campaigns.parts data diagnosis.remaining
  diagnosis.report.text dimensions effects.effect figures.record_views figures.thinning
  identifiability.combinations.matroid identifiability.combinations.rational_degrees
  identifiability.inputs.generic_zero identifiability.rank.error_bound
  identifiability.rank.immersion identifiability.rank.row_basis identifiability.rank.system
  identifiability_options instrument_options instrumental.moments linear.discrete_loop
  linear.inverse_map linear.laplace linear.parameter_draws linear.vanishing
  networks.estimation.module_fit pages.numbers pages.page prediction.input_models reading.columns
  simulate solving.nlp_criterion solving.nlp_values stages transfer.matrix transfer.minors
  transfer.reading
asymptotics.estimated_row asymptotics.input_measurement asymptotics.second_moments
  campaigns.campaign cli derived diagnosis.result effects.balance_effects effects.channel_effects
  effects.checking effects.decoys effects.parameter_effects effects.periodic effects.user_effects
  figures.panels identifiability.combinations.interpolation identifiability.combinations.subsets
  identifiability.equations.formula_scope identifiability.inputs.signals
  identifiability.mends.candidates identifiability.rank.program_reader
  identifiability.rank.rank_result identifiability.records.excitation indirect.blocks
  instrumental.exogeneity instrumental.windowed_moments linear.closed_loop linear.linear_model
  linear.symbolic_hull networks.network observers.input_estimate pages.estimates
  prediction.coordinated_turn prediction.excitation prediction.noisy_system
  prediction.polynomial_data prediction.polynomial_start prepare reading.faults solving.compiled
  solving.nlp transfer.from_control transfer.realisation
__main__ asymptotics.limits asymptotics.prediction_criterion campaigns.monte_carlo_page
  diagnosis.advice.isolability_figures diagnosis.calibration.calibration_figure
  diagnosis.report.by_record_figure diagnosis.report.cause_parts diagnosis.report.limit_parts
  diagnosis.report.moved_figure diagnosis.report.ranking_figure diagnosis.report.remaining_figure
  diagnosis.report.remaining_parts diagnosis.report.unknown_parts effects.structure_effects
  figures.estimates figures.residuals figures.simulated identifiability.combinations.null_direction
  identifiability.equations.equation_text identifiability.equations.model_system
  identifiability.inputs.input_classes identifiability.inputs.structure_algorithm
  identifiability.rank.series identifiability.symbolic.symbolic_rank indirect.direct_model
  indirect.free_gain linear.discretise networks.dynamics networks.equations
  networks.estimation.reference_responses networks.graph networks.separators
  observers.unknown_input_system prediction.kalman prediction.polynomial_criterion
  prediction.polynomial_model reading.cells reading.clocks reconciliation regression
  simulation_error solving.contenders solving.null_space
asymptotics.network_signals asymptotics.prediction_limit asymptotics.remedies
  diagnosis.evidence.peaks diagnosis.evidence.runaway diagnosis.report.figures effects.catalogue
  identifiability.combinations.family identifiability.equations.equation_file
  identifiability.inputs.elimination identifiability.rank.observability
  identifiability.symbolic.reduced_form indirect.from_model indirect.left_inverse
  indirect.special_cases instrumental.instruments linear.structural_relations networks.elimination
  networks.estimation.exact_reach networks.left_inverse networks.network_text networks.node_sets
  networks.prediction.error_variance networks.residues networks.simulation noise
  observers.equivalent_model observers.output_window observers.read_system observers.split_dynamics
  pages.estimate_page prediction.noisy_model prediction.polynomial reading.chunks reading.resampling
  solving.scipy_solvers
asymptotics.two_stage_limit diagnosis.evidence.scores diagnosis.report.page
  identifiability.combinations.along_family identifiability.combinations.closed_form
  identifiability.inputs.experiments identifiability.inputs.unknown_jets
  identifiability.mends.output_spans identifiability.mends.replicas identifiability.mends.screening
  identifiability.symbolic.lie_derivatives indirect.approximate_inverse indirect.indirect_model
  instrumental.black_box_reference instrumental.estimated_filter instrumental.validation
  linear.affine linear.difference_equation networks.confounding networks.indirect_equations
  networks.prediction.node_predictor networks.principal_minors observers.decoupled_observer
  observers.input_smoother observers.noncausal_inverse prediction.arma prediction.likelihood
  reading.surveying solving.solvers
asymptotics.polynomial_regression checking diagnosis.advice.isolability
  diagnosis.evidence.signatures diagnosis.weighting identifiability.mends.sensor_subsets
  identifiability.requirement identifiability.symbolic.observability_matrix indirect.feedforward
  indirect.output_choice instrumental.image instrumental.moment_equations linear.discretisation_bias
  networks.drawing networks.estimation.module_regression networks.prediction.row_predictor
  networks.propositions networks.rings networks.well_posed observers.figures reading.record_file
asymptotics.module_remedies diagnosis.advice.invisible diagnosis.candidates
  diagnosis.evidence.functions diagnosis.sizes diagnosis.unknown.smoothed_force
  identifiability.mends.cheapest instrumental.moment_nlp instrumental.prefilters
  instrumental.seen_directions instrumental.stage_instruments networks.prediction.observation_choice
  networks.predictor_inputs networks.ring_figure problem
diagnosis.advice.fitted_motion diagnosis.contributions diagnosis.evidence.residual_tests
  diagnosis.refitting diagnosis.unknown.missing_force diagnosis.wording equation_error
  identifiability.asked identifiability.invariants identification instrumental.moment_settings
  networks.estimation.module_equation networks.prediction.eiv_filter networks.prediction.predictors
asymptotics.network_relations campaigns.monte_carlo diagnosis.advice.planned_records
  diagnosis.comparing diagnosis.jumps diagnosis.record_specific diagnosis.unknown.unexplained
  holdout identifiability.answers identifiability.records.planned instrumental.stage_programs
  networks.estimation.consistency networks.estimation.module_data prediction.grey_box
asymptotics.network_remedies diagnosis.advice.next_experiment diagnosis.calibration.null_records
  diagnosis.evidence.spoilt_samples diagnosis.preselection diagnosis.refusals
  diagnosis.unknown.unexplained_figures identifiability.assess
  identifiability.records.practical_result identifiability.records.profiles
  identifiability.records.reference_excitation instrumental.stage networks.estimation.direct
  networks.estimation.joint networks.estimation.module_estimate
  networks.estimation.reference_instruments networks.estimation.two_stage prediction.unknown_input
  wrong_signs
diagnosis.calibration.calibration diagnosis.gain diagnosis.search identifiability.figures
  identifiability.records.practical instrumental.convergence instrumental.propagation
  networks.estimation.by_instruments networks.estimation.response_figure
diagnosis.causes diagnosis.open_rivals diagnosis.ranking diagnosis.reconsidering
  identifiability.page instrumental.estimators networks.estimation.estimate
diagnosis.open_set instrumental.iterative_joint instrumental.monitoring instrumental.resampling
  instrumental.streamed sign_flips
diagnosis.adoption
diagnosis.findings
diagnosis.reporting
diagnosis.diagnosing
"""


def imports_of(path: Path) -> Iterator[tuple[str, bool]]:
    """Every absolute import of a file: module, and whether it happens at import time."""

    def walk(node: ast.AST, now: bool) -> Iterator[tuple[str, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                yield from ((name.name, now) for name in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{path.name}: relative import"
                assert child.module is not None
                yield child.module, now
                if child.module == "casid":
                    yield from ((f"casid.{name.name}", now) for name in child.names)
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) or (
                isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
            )
            yield from walk(child, now and not inside)

    yield from walk(ast.parse(path.read_text(encoding="utf-8")), True)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_casid_imports_neither_problems_nor_analysis(path: Path) -> None:
    roots = {module.partition(".")[0] for module, _ in imports_of(path)}
    assert not roots & {"problems", "analysis", "tests", "benchmarks", "docs"}


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_imports_inside_casid_run_one_way(path: Path) -> None:
    lines = LAYERS.replace("\n  ", " ").split("\n")
    layer = {name: i for i, line in enumerate(lines) for name in line.split()}
    if path.stem == "__init__":
        assert not [m for m, now in imports_of(path) if now and m.startswith("casid")]
        return
    for module, now in imports_of(path):
        name = module.removeprefix("casid.")
        own = name_of(path)
        if now and module.startswith("casid.") and {name, own} <= layer.keys():
            assert layer[name] < layer[own], f"{own} imports {name}"


def test_no_imports_run_in_a_circle() -> None:
    graph = {
        f"casid.{name_of(path)}": {
            m for m, now in imports_of(path) if now and m.startswith("casid.")
        }
        for path in SOURCES
    }
    assert list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError


def test_problems_import_casid_and_files_beside_them_alone() -> None:
    """A problem file is what a user writes: the library's own problems have no more means.

    That they are a package as well is for studies and the type checker: an import from it stands
    beside one by bare name, which is what a file loaded by its path runs.
    """
    allowed = {"casid", "numpy", "casadi", "__future__", *sys.stdlib_module_names}
    for path in (ROOT / "problems").glob("*.py"):
        beside = {p.stem for p in path.parent.glob("*.py")}
        imports = [(*module.partition(".")[::2], now) for module, now in imports_of(path)]
        packaged = {part for root, part, now in imports if root == "problems" and not now}
        roots = {root for root, part, _ in imports if part not in packaged}
        assert roots <= allowed | beside, f"{path.name}: {roots - allowed - beside}"
        assert packaged <= {root for root, _, _ in imports}, f"{path.name}: by one name alone"


def modules_after(statement: str) -> set[str]:
    run = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys\nprint('\\n' + ' '.join(sys.modules))"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return {name.partition(".")[0] for name in run.stdout.splitlines()[-1].split()}


def test_import_casid_loads_nothing_heavy() -> None:
    loaded = modules_after("import casid; casid.errors_are = dir(casid)")
    assert not loaded & set(HEAVY)
    assert "click" not in loaded


@pytest.mark.parametrize(
    "arguments", [["--help"], ["diagnose", "--help"], ["--version"], ["wrong"]]
)
def test_the_help_loads_nothing_heavy(arguments: list[str]) -> None:
    loaded = modules_after(
        f"from casid.cli import main\ntry:\n    main({arguments!r})\nexcept SystemExit:\n    pass"
    )
    assert "click" in loaded
    assert not loaded & set(HEAVY)


@pytest.mark.parametrize("name", casid.__all__)
def test_public_names_are_there_and_say_what_they_are(name: str) -> None:
    value = getattr(casid, name)
    assert name in dir(casid)
    assert inspect.isclass(value) or inspect.isfunction(value)
    assert value.__module__.startswith("casid.")
    assert len(inspect.getdoc(value) or "") > 20


def test_public_functions_stay_functions_when_their_modules_load() -> None:
    """No submodule has the name of a public function, so loading one cannot hide it."""
    program = (
        "import casid\ncasid.diagnose\nassert callable(casid.identify)\n"
        "import casid.checking\nassert callable(casid.check)\n"
        "from casid.identification import fit_model\nassert callable(casid.identify)\n"
    )
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_a_misspelt_name_is_told_the_nearest() -> None:
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        casid.diagnos  # noqa: B018
    with pytest.raises(ImportError):
        exec("from casid import nothing_of_the_kind")


def public_functions(path: Path) -> Iterator[tuple[str, ast.FunctionDef | ast.ClassDef]]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, node
            if isinstance(node, ast.ClassDef):
                for child in node.body:
                    if isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
                        yield f"{node.name}.{child.name}", child


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_every_public_function_says_what_it_does(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{path.name} does not say what it holds"
    silent = [name for name, node in public_functions(path) if not ast.get_docstring(node)]
    assert not silent


def test_no_path_of_a_machine_stands_in_the_repository() -> None:
    """`/home/someone`, `C:\\Users`: what runs on one machine only."""
    paths = re.compile(r"(?<![\w/.])/(?:home|root|work|Users|mnt|opt|tmp|data)/\w|\b[A-Z]:\\+\w")
    kinds = {".py", ".md", ".toml", ".yml", ".yaml", ".json", ".txt", ".cfg", ""}
    found = []
    for folder in ("casid", "problems", "analysis", "tests", "benchmarks", "docs", ".ci", "."):
        pattern = "*" if folder == "." else "**/*"
        for path in (ROOT / folder).glob(pattern):
            hidden = any(part.startswith(".") for part in path.relative_to(ROOT).parts[1:])
            if path.is_file() and path.suffix in kinds and path.name != Path(__file__).name:
                if hidden or "site" in path.parts or "__pycache__" in path.parts:
                    continue
                for n, line in enumerate(path.read_text("utf-8", "ignore").splitlines(), 1):
                    if paths.search(line):
                        found.append(f"{path.relative_to(ROOT)}:{n}: {line.strip()}")
    assert not found


def test_version_and_wheel_are_as_pyproject_has_them() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["version"] == casid.__version__
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["casid"]
    assert (ROOT / "casid" / "py.typed").exists()
    assert project["project"]["scripts"]["casid"] == "casid.cli:main"


def test_every_import_of_casid_is_declared() -> None:
    """What casid imports is a dependency, and what is a dependency is imported."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {re.split(r"[<>=\[; ]", entry)[0].lower() for entry in project["dependencies"]}
    imported = {m.partition(".")[0] for path in SOURCES for m, _ in imports_of(path)}
    assert imported - {"casid", *sys.stdlib_module_names} <= declared
