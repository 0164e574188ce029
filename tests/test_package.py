"""The package as a whole: which way imports run, what is public, and what is light."""

from __future__ import annotations

import ast
import dataclasses
import graphlib
import inspect
import re
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Protocol

import pytest

import casid
from tests.structure import ROOT, statements, tree

SOURCES = sorted((ROOT / "casid").rglob("*.py"))


def name_of(path: Path) -> str:
    """`linear.affine` for casid/linear/affine.py; `linear` for the package itself."""
    parts = path.relative_to(ROOT / "casid").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


HEAVY = "casadi numpy scipy sympy control pandas pyarrow pint joblib plotly rich matplotlib".split()

# Who may import whom: a package imports from those to the right of its name, and from itself.
LAYERS = """
model:
algebra:
data: model
saving: model
linear: model algebra data
estimation: model algebra data saving linear
identifiability: model algebra data saving linear estimation
identification: model algebra data saving linear estimation identifiability
unknown_inputs: model algebra data linear estimation identifiability identification
campaigns: model data saving estimation identification
experiment_design: model data saving linear estimation identifiability
diagnosis: model algebra data saving linear estimation identifiability identification campaigns
  experiment_design
fleets: model data saving estimation identification campaigns diagnosis
export: model data linear estimation
gallery: data
report: model algebra data linear estimation identifiability identification unknown_inputs
  campaigns experiment_design diagnosis fleets
cli: model algebra data linear estimation identifiability identification unknown_inputs campaigns
  experiment_design diagnosis fleets export gallery report saving
__main__: cli
"""

# Modules right below casid, of the standard library and NumPy alone, that every package may use.
GROUND = set(
    "argument_types arrays compiler deprecation diagnosing errors exportable pickling presentation"
    " versions grouping threshold_table time_limit whole_files".split()
)


@cache
def imports_of(path: Path, *, in_folder: bool = False) -> tuple[tuple[str, bool], ...]:
    """Every absolute import of a file: module, and whether it happens at import time.

    Relative imports are refused; with `in_folder` those of files of the same folder are left out.
    """

    def walk(node: ast.AST, now: bool) -> Iterator[tuple[str, bool]]:
        for child in statements(node):
            if isinstance(child, ast.Import):
                yield from ((name.name, now) for name in child.names)
            elif isinstance(child, ast.ImportFrom):
                if in_folder and child.level == 1:
                    continue
                assert child.level == 0, f"{path.name}: relative import"
                assert child.module is not None
                yield child.module, now
                if child.module == "casid":
                    yield from ((f"casid.{name.name}", now) for name in child.names)
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) or (
                isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
            )
            yield from walk(child, now and not inside)

    return tuple(walk(tree(path), True))


def test_casid_imports_neither_problems_nor_analysis() -> None:
    for path in SOURCES:
        roots = {module.partition(".")[0] for module, _ in imports_of(path)}
        assert not roots & {"problems", "analysis", "tests", "benchmarks", "docs"}, name_of(path)


def allowed_imports() -> dict[str, set[str]]:
    """For each package of casid, the packages it may import from."""
    table = (line.partition(":") for line in LAYERS.strip().replace("\n  ", " ").splitlines())
    packages = {name: {name, *GROUND, *rest.split()} for name, _, rest in table}
    return packages | {name: {name, "errors"} for name in GROUND}


def test_the_table_of_layers_has_no_cycle_and_names_every_package() -> None:
    table = allowed_imports()
    assert list(graphlib.TopologicalSorter({k: v - {k} for k, v in table.items()}).static_order())
    assert {name_of(path).partition(".")[0] for path in SOURCES} - {""} == set(table)


def test_imports_between_packages_run_one_way() -> None:
    """Imports for the type checker and inside functions count like all others."""
    table = allowed_imports()
    for path in SOURCES:
        if path == ROOT / "casid" / "__init__.py":
            continue
        if path.stem == "__init__":
            assert not [m for m, _ in imports_of(path) if m.startswith("casid")], name_of(path)
            continue
        allowed = table[name_of(path).partition(".")[0]]
        used = {m.split(".")[1]: m for m, _ in imports_of(path) if m.startswith("casid.")}
        used.pop("__version__", None)
        assert not {p: m for p, m in used.items() if p not in allowed}, name_of(path)


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
    beside one by bare name, which is what a file loaded by its path runs. Files of a folder beside
    a problem import each other by relative imports, which are the same in both.
    """
    allowed = {"casid", "numpy", "casadi", "__future__", *sys.stdlib_module_names}
    for path in (ROOT / "problems").glob("*/*.py"):
        roots = {module.partition(".")[0] for module, _ in imports_of(path, in_folder=True)}
        assert roots <= allowed, f"{path.name}: {roots - allowed}"
    for path in (ROOT / "problems").glob("*.py"):
        beside = {p.stem for p in path.parent.iterdir()}
        imports = [(*module.partition(".")[::2], now) for module, now in imports_of(path)]
        packaged = {part for root, part, now in imports if root == "problems" and not now}
        roots = {root for root, part, _ in imports if part not in packaged}
        assert roots <= allowed | beside, f"{path.name}: {roots - allowed - beside}"
        assert packaged <= {name for name, _ in imports_of(path)}, f"{path.name}: by one name alone"


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
        "from casid.cli.main import main\n"
        f"try:\n    main({arguments!r})\nexcept SystemExit:\n    pass"
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


FUNCTIONS = [name for name in casid.__all__ if inspect.isfunction(getattr(casid, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_of_a_public_function_names_every_parameter(name: str) -> None:
    function = getattr(casid, name)
    words = set(re.findall(r"\w+", inspect.getdoc(function) or ""))
    assert not set(inspect.signature(function).parameters) - words


def test_public_functions_stay_functions_when_their_modules_load() -> None:
    """No submodule has the name of a public function, so loading one cannot hide it."""
    program = (
        "import casid\ncasid.diagnose\nassert callable(casid.identify)\n"
        "import casid.data.quality\nassert callable(casid.check)\n"
        "from casid.identification.identify import split_records\nassert callable(casid.identify)\n"
    )
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_a_misspelt_name_is_told_the_nearest() -> None:
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        casid.diagnos  # noqa: B018
    with pytest.raises(ImportError):
        exec("from casid import nothing_of_the_kind")


def public_functions(path: Path) -> Iterator[tuple[str, ast.FunctionDef | ast.ClassDef]]:
    for node in tree(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, node
            if isinstance(node, ast.ClassDef):
                for child in node.body:
                    if isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
                        yield f"{node.name}.{child.name}", child


def test_every_public_function_says_what_it_does() -> None:
    for path in SOURCES:
        assert ast.get_docstring(tree(path)), f"{name_of(path)} does not say what it holds"
        silent = [name for name, node in public_functions(path) if not ast.get_docstring(node)]
        assert not silent, name_of(path)


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
                # In a worktree of git, .git is a file that holds where the repository is.
                if hidden or {"site", "__pycache__", ".git"} & set(path.parts):
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
    assert project["project"]["scripts"]["casid"] == "casid.cli.main:main"


def test_every_import_of_casid_is_declared() -> None:
    """What casid imports is a dependency; inside a function it may be one of a user's extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def names(entries: list[str]) -> set[str]:
        return {re.split(r"[<>=\[; ]", entry)[0].lower() for entry in entries}

    extras = project["optional-dependencies"]
    optional = [e for x in extras if x not in ("test", "dev", "docs", "bench") for e in extras[x]]
    always = {*names(project["dependencies"]), "casid", *sys.stdlib_module_names}
    for path in SOURCES:
        imported = [(m.partition(".")[0], now) for m, now in imports_of(path)]
        assert {m for m, now in imported if now} <= always, path.name
        assert {m for m, _ in imported} <= always | names(optional), path.name


@cache
def result_classes() -> dict[str, type]:
    """The classes of casid that public functions and methods of public classes return, by name."""
    returned = []
    for value in (getattr(casid, name) for name in casid.__all__):
        members = [value] if inspect.isfunction(value) else vars(value).values()
        for member in members:
            function = member.fget if isinstance(member, property) else member
            if inspect.isfunction(function) and not function.__name__.startswith("_"):
                for word in re.findall(r"\w+", str(function.__annotations__.get("return", ""))):
                    found = function.__globals__.get(word)
                    if inspect.isclass(found) and found.__module__.startswith("casid."):
                        returned += [] if Protocol in found.__bases__ else [found]
    return {value.__qualname__: value for value in returned}


@pytest.mark.parametrize("name", result_classes())
def test_the_repr_of_what_a_user_gets_holds_no_array_and_no_address(name: str) -> None:
    """A generated repr is right for a few plain values alone; other classes write a line."""
    value = result_classes()[name]
    if dataclasses.is_dataclass(value) and "__repr__" not in _written_methods(value):
        types = {field.name: str(field.type) for field in dataclasses.fields(value) if field.repr}
        assert not [n for n, kind in types.items() if re.search("Array|Callable", kind)]
    else:
        assert value.__repr__ is not object.__repr__


def _written_methods(value: type) -> set[str]:
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(value))).body
    assert isinstance(node, ast.ClassDef)
    return {child.name for child in node.body if isinstance(child, ast.FunctionDef)}
