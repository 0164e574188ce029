"""The size and shape of the code in numbers: `python -m tests.structure [WORDS]`.

Lines, long functions, functions with many parameters, wide dataclasses, packages, arrows and floors
of imports, and cycles. `test_structure.py` holds the ceilings. With words of the name of a
measure, its entries are listed.
"""

from __future__ import annotations

import ast
import gc
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

LONG, TOO_LONG = 50, 75  # lines of a function, its docstring aside
LONG_FILE = 500
MANY_PARAMETERS = 8
MANY_FIELDS = 15

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def sources(folder: str) -> tuple[Path, ...]:
    """Python files below a folder of the checkout, caches left out."""
    return tuple(sorted(p for p in (ROOT / folder).rglob("*.py") if "__pycache__" not in p.parts))


@cache
def _trees(folder: str) -> dict[Path, ast.Module]:
    """The syntax trees of all files below a folder, kept to the end.

    Going through these millions of nodes in search of garbage would take longer than making them.
    """
    is_searched = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        return {p: ast.parse(p.read_text(encoding="utf-8")) for p in sources(folder)}
    finally:
        gc.freeze()
        if is_searched:
            gc.enable()


def tree(path: Path) -> ast.Module:
    """The syntax tree of a file of the checkout."""
    return _trees(path.relative_to(ROOT).parts[0])[path]


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """What stands right inside a statement and can hold imports, functions and classes."""
    for part in ("body", "handlers", "orelse", "finalbody", "cases"):
        yield from getattr(node, part, ())


def module(path: Path) -> str:
    """`casid.linear.filtering.kalman` for its file, `casid.linear` for the package itself."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def definitions(path: Path) -> tuple[tuple[str, str, ast.AST], ...]:
    """Functions and classes of a file: qualified name, name of the class around it, node."""

    def walk(node: ast.AST, inside: str) -> Iterator[tuple[str, str, ast.AST]]:
        for child in statements(node):
            if isinstance(child, Function | ast.ClassDef):
                yield f"{inside}{child.name}", inside.rstrip("."), child
                yield from walk(child, f"{inside}{child.name}.")
            else:
                yield from walk(child, inside)

    return tuple(walk(tree(path), ""))


def lines(folder: str) -> int:
    """Lines of Python below a folder, blank ones included."""
    return sum(len(p.read_text(encoding="utf-8").splitlines()) for p in sources(folder))


def composition(folder: str) -> dict[str, int]:
    """Lines of code, docstrings, comments and blank lines below a folder."""
    total = dict.fromkeys(("code", "docstring", "comment", "blank"), 0)
    for path in sources(folder):
        documented: set[int] = set()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                documented.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            kind = (
                "comment" if line.lstrip().startswith("#") else "code" if line.strip() else "blank"
            )
            total["docstring" if number in documented else kind] += 1
    return total


def long_files(folder: str, limit: int = LONG_FILE) -> list[str]:
    """Files of more than `limit` lines."""
    sizes = [(len(p.read_text(encoding="utf-8").splitlines()), p) for p in sources(folder)]
    return [f"{n:4d} {p.relative_to(ROOT)}" for n, p in sorted(sizes, reverse=True) if n > limit]


def _extent(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def long_functions(folder: str, limit: int = LONG) -> list[str]:
    """Functions of more than `limit` lines, without their docstrings: an example is no burden."""
    found = []
    for path in sources(folder):
        for name, _, node in definitions(path):
            if isinstance(node, Function):
                size = _extent(node) - (_extent(node.body[0]) if ast.get_docstring(node) else 0)
                if size > limit:
                    found.append(f"{size:4d} {path.relative_to(ROOT)}:{node.lineno} {name}")
    return sorted(found, reverse=True)


def public_names() -> set[str]:
    """The names in `casid/__init__.pyi`."""
    return set(re.findall(r'^    "(\w+)",$', (ROOT / "casid/__init__.pyi").read_text(), re.M))


def many_parameters(folder: str) -> list[str]:
    """Functions with more than eight parameters that are not in the public interface."""
    public, found = public_names(), []
    for path in sources(folder):
        for name, around, node in definitions(path):
            if not isinstance(node, Function) or (around or name).split(".")[0] in public:
                continue
            a = node.args
            own = [x for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg != "self"]
            if len(own) > MANY_PARAMETERS:
                found.append(f"{len(own):3d} {path.relative_to(ROOT)}:{node.lineno} {name}")
    return sorted(found, reverse=True)


def wide_dataclasses(folder: str) -> list[str]:
    """Dataclasses with more than fifteen fields."""
    found = []
    for path in sources(folder):
        for name, _, node in definitions(path):
            if isinstance(node, ast.ClassDef) and any(
                "dataclass" in ast.unparse(d) for d in node.decorator_list
            ):
                fields = sum(
                    isinstance(x, ast.AnnAssign) and "ClassVar" not in ast.unparse(x.annotation)
                    for x in node.body
                )
                if fields > MANY_FIELDS:
                    found.append(f"{fields:3d} {path.relative_to(ROOT)}:{node.lineno} {name}")
    return sorted(found, reverse=True)


@cache
def imports() -> dict[str, set[str]]:
    """Modules of casid that each module imports, inside functions and for types as well."""
    known = {module(p) for p in sources("casid")}
    out: dict[str, set[str]] = {m: set() for m in known}

    def walk(node: ast.AST) -> Iterator[ast.AST]:
        for child in statements(node):
            yield child
            yield from walk(child)

    for path in sources("casid"):
        own = module(path)
        for node in walk(tree(path)):
            names: list[str] = []
            if isinstance(node, ast.ImportFrom) and node.module:
                full = [f"{node.module}.{a.name}" for a in node.names]
                names = [n if n in known else node.module for n in full]
            elif isinstance(node, ast.Import):
                names = [a.name for a in node.names]
            out[own] |= {n for n in names if n in known} - {own}
    return out


def between_packages() -> dict[str, set[str]]:
    """The same between the packages right below casid."""
    out: dict[str, set[str]] = {}
    for own, used in imports().items():
        if "." in own:
            room = own.split(".")[1]
            rooms = {m.split(".")[1] for m in used if "." in m}
            out.setdefault(room, set()).update(rooms - {room})
    return out


def within(folder: Path) -> dict[str, set[str]]:
    """Files and folders right inside a folder of casid -> those that each imports from."""
    room = module(folder / "__init__.py")
    out: dict[str, set[str]] = {}
    for own, used in imports().items():
        if own.startswith(f"{room}."):
            first = own.removeprefix(f"{room}.").partition(".")[0]
            names = {m.removeprefix(f"{room}.") for m in used if m.startswith(f"{room}.")}
            out.setdefault(first, set()).update({n.partition(".")[0] for n in names} - {first})
    return out


def cycles(graph: dict[str, set[str]]) -> list[str]:
    """Strongly connected components of more than one member (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[str] = []

    def visit(v: str) -> None:
        index[v] = low[v] = len(index)
        stack.append(v)
        for w in sorted(graph.get(v, ())):
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in stack:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            part = stack[stack.index(v) :]
            del stack[stack.index(v) :]
            if len(part) > 1:
                found.append(" ".join(sorted(part)))

    for v in sorted(graph):
        if v not in index:
            visit(v)
    return found


def floors(graph: dict[str, set[str]]) -> int:
    """Longest chain of imports in a graph without cycles, counted in members; 0 with cycles."""
    if cycles(graph):
        return 0
    height: dict[str, int] = {}

    def of(v: str) -> int:
        if v not in height:
            height[v] = 1 + max((of(w) for w in graph.get(v, ())), default=0)
        return height[v]

    return max(of(v) for v in graph)


MEASURES = {
    f"files over {LONG_FILE} lines": lambda: long_files("casid"),
    f"functions over {LONG} lines": lambda: long_functions("casid"),
    f"functions over {TOO_LONG} lines": lambda: long_functions("casid", TOO_LONG),
    f"functions with more than {MANY_PARAMETERS} parameters": lambda: many_parameters("casid"),
    f"dataclasses with more than {MANY_FIELDS} fields": lambda: wide_dataclasses("casid"),
    "cycles between packages": lambda: cycles(between_packages()),
    "cycles between modules": lambda: cycles(imports()),
}


def main(words: list[str]) -> None:
    """Print the table, or the entries of the measures that hold all `words`."""
    if words:
        for name, measure in MEASURES.items():
            if all(w in name for w in words):
                print("\n".join([f"{name}:", *measure()]))
        return
    for folder in ("casid", "problems", "analysis", "tests", "benchmarks", "docs"):
        print(f"{lines(folder):8d}  lines of {folder}")
    for kind, count in composition("casid").items():
        print(f"{count:8d}  lines of casid that are {kind}")
    rooms = between_packages()
    packages = [room for room in rooms if (ROOT / "casid" / room).is_dir()]
    print(f"{len(packages):8d}  packages right below casid")
    print(f"{len(rooms) - len(packages):8d}  modules beside them")
    print(f"{sum(map(len, rooms.values())):8d}  arrows between them")
    print(f"{floors(rooms):8d}  floors")
    for name, measure in MEASURES.items():
        print(f"{len(measure()):8d}  {name}")


if __name__ == "__main__":
    main(sys.argv[1:])
