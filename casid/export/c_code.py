"""A fitted model as C: CasADi's generated code of the equations and the step, and a header."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca

from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.casadi_function import function_of
from casid.export.naming import checked_path, identifiers, written_by
from casid.export.plain_model import PlainModel, expressions, plain_model
from casid.model.identifiers import identifier


def write_c(fitted: FittedModel, path: Path, *, without_delays: bool = False) -> Path:
    """Write `path` (.c) and the header beside it; returns the path of the C file.

    The code needs nothing but a C compiler and libm. All quantities are in SI units. The step of a
    model whose sensors or inputs are delayed takes and gives a memory of past ones.

    Raises
    ------
    ModelError
        If an input is a function of the user's own.
    """
    plain = plain_model(fitted, what="C", without_delays=without_delays)
    path = checked_path(path, "c")
    prefix = identifier(path.stem)
    path.write_text(source(plain, prefix, header=path.with_suffix(".h").name), encoding="utf-8")
    path.with_suffix(".h").write_text(header(plain, prefix), encoding="utf-8")
    return path


def header(plain: PlainModel, prefix: str) -> str:
    """The header: what the arrays hold, the estimated values, and the two functions."""
    names = {"X": plain.states, "U": plain.inputs, "Y": plain.outputs, "P": plain.parameters}
    counts = {f"N{letter}": len(own) for letter, own in names.items()}
    memory = plain.memory_size
    if memory:
        counts["NPAST"] = memory
    guard = f"{prefix.upper()}_H"
    lines = [
        f"/* {_safe(plain.name)}: a fitted model in SI units, written by {written_by()}.",
        "",
        *_paragraphs(plain.notes),
        f"   {prefix}_step goes one sample of {plain.Ts:.9g} s by {plain.substeps} Runge-Kutta "
        f"step{'s' if plain.substeps > 1 else ''},",
        "   as the model was fitted: each input moves along a straight line to u_next, or is held.",
        f"   {prefix}_equations gives the right-hand sides and the outputs for another integrator.",
        *_of_the_memory(plain, prefix),
        "   t is the time of the fitted record's clock [s]; no pointer may be null.",
        "*/",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *(f"#define {prefix.upper()}_{k} {n}" for k, n in counts.items()),
        f"#define {prefix.upper()}_TS {plain.Ts!r} /* s */",
        "",
        *_places(plain, prefix, "x", "States", plain.states),
        *_places(plain, prefix, "u", "Inputs", plain.inputs),
        *_places(plain, prefix, "y", "Outputs", plain.outputs),
        *_places(plain, prefix, "p", "Parameters", plain.parameters),
        "/* Initial states of the fitted record, and the values of the parameters. */",
        f"extern const double {prefix}_x0[{max(counts['NX'], 1)}];",
        f"extern const double {prefix}_p[{max(counts['NP'], 1)}];",
        "",
        f"void {prefix}_equations(const double *x, const double *u, double t, const double *p,",
        "    double *dx, double *y);",
        *_step_head(prefix, memory, ";"),
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        f"#endif /* {guard} */",
    ]
    return "\n".join(lines) + "\n"


def source(plain: PlainModel, prefix: str, *, header: str) -> str:
    """CasADi's code, and the two functions of the header that call it."""
    whole = function_of(plain, plain.parameters)
    symbols = whole.sx_in()
    _, *stepped = whole.call(symbols)
    found = expressions(plain)
    s = found.symbols
    equations = ca.Function(
        f"{prefix}_casadi_equations", [s.x, s.u, s.t, s.p], [ca.densify(found.dx), found.y]
    )
    step = ca.Function(f"{prefix}_casadi_step", symbols, stepped)
    past, past_next = (["past"], ["past_next"]) if plain.memory_size else ([], [])
    lines = [
        f'#include "{header}"',
        "",
        f"const double {prefix}_x0[{max(len(plain.states), 1)}] = {{{_values(plain.x0)}}};",
        f"const double {prefix}_p[{max(len(plain.parameters), 1)}] = {{{_values(plain.p)}}};",
        "",
        f"void {prefix}_equations(const double *x, const double *u, double t, const double *p,",
        "    double *dx, double *y) {",
        *_call(equations, ["x", "u", "&t", "p"], ["dx", "y"]),
        "}",
        "",
        *_step_head(prefix, plain.memory_size, " {"),
        *_call(step, ["x", "u", "u_next", "&t", "p", *past], ["y", "x_next", *past_next]),
        "}",
    ]
    return _generated((equations, step)) + "\n" + "\n".join(lines) + "\n"


def _step_head(prefix: str, memory: int, end: str) -> list[str]:
    """The declaration of the step, which has a memory where something is delayed."""
    inside, after = (" const double *past,", ", double *past_next") if memory else ("", "")
    return [
        f"void {prefix}_step(const double *x, const double *u, const double *u_next, double t,",
        f"    const double *p,{inside} double *x_next, double *y{after}){end}",
    ]


def _of_the_memory(plain: PlainModel, prefix: str) -> list[str]:
    """What the header says of delayed sensors and inputs."""
    if not plain.memory_size:
        return []
    lines = []
    for what, delays, says in (
        (
            "Sensors are delayed",
            plain.delays,
            "y of {0}_step is what they give, y of {0}_equations what arrives at them.",
        ),
        (
            "Inputs act late",
            plain.dead_times,
            "u of {0}_step is what is given, u of {0}_equations what acts.",
        ),
    ):
        if delays:
            late = ", ".join(f"{n} by {d:.6g} s" for n, d in delays.items())
            lines += _paragraphs([f"{what} ({late})."])[:-1]
            lines.append(f"   {says.format(prefix)}")
    return [
        *lines,
        f"   past holds {prefix.upper()}_NPAST numbers, zeros in the first step, past_next those",
        "   of the next one.",
    ]


def _generated(functions: Iterable[Any]) -> str:
    """CasADi's C of some functions."""
    generator = ca.CodeGenerator("model.c", {"with_header": False, "indent": 2})
    for function in functions:
        generator.add(function)
    with TemporaryDirectory() as folder:
        written = generator.generate(f"{folder}/")
        return Path(written).read_text(encoding="utf-8")


def _call(function: Any, arguments: Sequence[str], results: Sequence[str]) -> list[str]:
    """Statements that call a function of CasADi with arrays of its own sizes."""
    sizes = function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w()
    n_arg, n_res, n_iw, n_w = (max(int(n), 1) for n in sizes)
    return [
        f"  const double *arg[{n_arg}];",
        f"  double *res[{n_res}];",
        f"  casadi_int iw[{n_iw}];",
        f"  double w[{n_w}];",
        *(f"  arg[{i}] = {text};" for i, text in enumerate(arguments)),
        *(f"  res[{i}] = {text};" for i, text in enumerate(results)),
        f"  {function.name()}(arg, res, iw, w, 0);",
    ]


def _places(
    plain: PlainModel, prefix: str, letter: str, title: str, names: Sequence[str]
) -> list[str]:
    """An enumeration of the places in an array, with units."""
    if not names:
        return []
    texts = identifiers(names)
    rows = [
        f"  {prefix}_{letter}_{texts[n]}{',' if i + 1 < len(names) else ''}"
        f" /* {_safe(plain.unit(n))} */"
        for i, n in enumerate(names)
    ]
    return [f"/* {title}: places in {letter}[]. */", "enum {", *rows, "};", ""]


def _values(values: Iterable[float]) -> str:
    return ", ".join(repr(float(v)) for v in values) or "0.0"


def _paragraphs(notes: Sequence[str]) -> list[str]:
    lines = [f"   {line}" for note in notes for line in textwrap.wrap(_safe(note), 90)]
    return [*lines, ""] if lines else []


def _safe(text: str) -> str:
    """Text that ends no comment."""
    return text.replace("*/", "* /")
