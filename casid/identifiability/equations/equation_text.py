"""Equations written as text, in a mapping of fields, as `System`s.

    states           list of names
    params           list of names, the unknowns (also: parameters)
    known_inputs     list of names (also: inputs)
    unknown_inputs   list of names
    known_constants  list of names (some number each), or name -> number
    definitions      name -> formula, in any order; may be used in every formula
    equations        state -> formula of its time derivative
    outputs          name -> formula
    known_initial    list of states (some number each), or state -> number
    parameters_at    parameter -> number: the answer holds there, not at almost every point
    units            name -> unit, for reports
    data_sets        list of such mappings, one an experiment; each takes the fields it lacks from
                     the mapping around it; parameters of one name are one parameter
    name, description

Formulas are read by `parse`: files may be untrusted, and text never becomes code. Names and numbers
besides a formula's are checked here; other fields are left alone.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca

from casid.algebra.symbolic import exact
from casid.errors import ModelError, nearest
from casid.identifiability.equations.formula_scope import FormulaScope
from casid.identifiability.equations.system import System

_SYMBOLS = ("states", "params", "known_inputs", "unknown_inputs", "known_constants")
_FORMULAS = ("definitions", "equations", "outputs")
_FIELDS = (
    *_SYMBOLS,
    *_FORMULAS,
    *("known_initial", "parameters_at", "units", "data_sets", "name", "description"),
)
_SYNONYMS = {"parameters": "params", "inputs": "known_inputs"}
_MISNOMERS = {
    **dict.fromkeys(("constants", "known_parameters", "known_params", "known"), "known_constants"),
    **dict.fromkeys(("odes", "ode", "dynamics", "rates", "derivatives"), "equations"),
    **dict.fromkeys(("observables", "observations", "measurements", "measured"), "outputs"),
    **dict.fromkeys(
        ("initial", "initial_values", "initial_conditions", "known_ic"), "known_initial"
    ),
    **dict.fromkeys(("intermediates", "auxiliary", "algebraic", "expressions"), "definitions"),
    **dict.fromkeys(("datasets", "experiments"), "data_sets"),
    **dict.fromkeys(("disturbances",), "unknown_inputs"),
}
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")
_RATIO = re.compile(r"\s*([+-]?[0-9]{1,300})\s*/\s*([0-9]{1,300})\s*")


def parse_system(mapping: Mapping[str, Any], *, name: str = "", where: str = "") -> System:
    """One system from a mapping of the fields in this module's docstring.

    Parameters
    ----------
    name : of the system, where the mapping has none.
    where : prefix of error messages; the name by default.

    Raises
    ------
    ModelError
        If the mapping contradicts itself, or holds several data sets.

    Example
    -------
    >>> import casid
    >>> casid.parse_system(
    ...     {
    ...         "states": ["v"],
    ...         "params": ["m", "d"],
    ...         "inputs": ["F"],
    ...         "equations": {"v": "(F - d*v)/m"},
    ...         "outputs": {"speed": "v"},
    ...     },
    ...     name="mass-damper",
    ... )
    <System mass-damper: 1 states, 2 parameters, 1 outputs, 1 known and 0 unknown inputs>
    """
    systems = parse_systems(mapping, name=name, where=where)
    if len(systems) > 1:
        raise ModelError(
            f"{where or name or 'equations'}, data_sets: {len(systems)} data sets are no single "
            "system; use parse_systems"
        )
    return systems[0]


def parse_systems(
    mapping: Mapping[str, Any], *, name: str = "", where: str = ""
) -> tuple[System, ...]:
    """One system for each of the mapping's data sets, each read as by `parse_system`.

    A data set is called by its own name, or "data set 1", "data set 2", ...
    """
    where = where or name or "equations"
    common = _fields(mapping, where)
    name = text_of(common, "name", where) or name or "equations"
    if "data_sets" not in common:
        return (_system(common, name, where),)
    sets = common.pop("data_sets")
    if not isinstance(sets, list | tuple) or not sets:
        raise ModelError(f"{where}, data_sets: expected a list of mappings, one an experiment")
    common.pop("name", None)
    systems: list[System] = []
    for i, entry in enumerate(sets, 1):
        place = f"{where}, data set {i}"
        own = _fields(entry, place)
        if "data_sets" in own:
            raise ModelError(
                f"{place}, data_sets: a data set holds no further ones; put all in one list"
            )
        title = text_of(own, "name", place) or f"data set {i}"
        if title in [s.name for s in systems]:
            raise ModelError(f"{place}, name: {title!r} is taken; give each data set its own")
        systems.append(_system({**common, **own}, title, place))
    return tuple(systems)


# -- fields --------------------------------------------------------------------------------------


def _fields(mapping: Any, where: str) -> dict[str, Any]:
    """The known fields, without synonyms; a misspelt one is refused."""
    if not isinstance(mapping, Mapping):
        raise ModelError(
            f"{where}: expected a mapping of fields (states, params, equations, outputs, ...), got "
            f"{_kind(mapping)}"
        )
    found: dict[str, Any] = {}
    for key, value in mapping.items():
        field = _SYNONYMS.get(key, key)
        if field in found:
            raise ModelError(f"{where}: {key!r} and its synonym are both given; keep one of them")
        if field in _FIELDS:
            found[field] = value
            continue
        low = str(key).strip().lower().replace(" ", "_").replace("-", "_")
        close = difflib.get_close_matches(low, [*_FIELDS, *_SYNONYMS], n=1, cutoff=0.8)
        meant = _MISNOMERS.get(low) or (close[0] if close else None)
        if meant:
            raise ModelError(f"{where}: unknown field {key!r}; did you mean {meant!r}?")
    return found


def text_of(fields: Mapping[str, Any], field: str, where: str) -> str:
    """A field that is text, "" where it is absent.

    Raises
    ------
    ModelError
        If it is something else.
    """
    value = fields.get(field, "")
    if not isinstance(value, str):
        raise ModelError(f"{where}, {field}: expected text, got {_kind(value)}; put it in quotes")
    return value


def _listed(fields: Mapping[str, Any], field: str, where: str) -> tuple[str, ...]:
    """The names in a list, or the keys of a mapping, each a name that a formula can hold."""
    value = fields.get(field, ())
    is_mapping = isinstance(value, Mapping)
    if not is_mapping and not isinstance(value, list | tuple):
        raise ModelError(
            f'{where}, {field}: expected a list of names, such as ["a", "b"], got {_kind(value)}'
        )
    for name in value:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ModelError(
                f"{where}, {field}: {name!r} is not a name; use ASCII letters, digits and _, and a "
                "letter first"
            )
    return tuple(value)


def _mapping(fields: Mapping[str, Any], field: str, where: str, of: str) -> Mapping[str, Any]:
    value = fields.get(field, {})
    if not isinstance(value, Mapping):
        raise ModelError(
            f"{where}, {field}: expected a mapping of name to {of}, got {_kind(value)}; write "
            f'{field} as {{"name": ...}} in JSON, or under [{field}] in TOML'
        )
    _listed(fields, field, where)
    return value


def _numbers(fields: Mapping[str, Any], field: str, where: str) -> dict[str, Fraction]:
    """Exact values: 0.1 is 1/10, and text such as "1/3" is that fraction."""
    values = _mapping(fields, field, where, "number")
    return {name: _number(v, f"{where}, {field}.{name}") for name, v in values.items()}


def _number(value: Any, where: str) -> Fraction:
    ratio = _RATIO.fullmatch(value) if isinstance(value, str) else None
    if ratio and int(ratio[2]) != 0:
        return Fraction(int(ratio[1]), int(ratio[2]))
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        if is_number and math.isfinite(value):
            return Fraction(value) if isinstance(value, int) else exact(value)
    except OverflowError:
        pass
    raise ModelError(f'{where}: {_kind(value)} is no finite number; write 0.5, or "1/3" in quotes')


def _kind(value: Any) -> str:
    text = repr(value)
    return f"{type(value).__name__} {text if len(text) < 40 else text[:36] + ' ...'}"


# -- the system ----------------------------------------------------------------------------------


def _system(fields: Mapping[str, Any], name: str, where: str) -> System:
    listed = {field: _listed(fields, field, where) for field in _SYMBOLS}
    _refuse_twice([*listed.items(), ("definitions", _listed(fields, "definitions", where))], where)
    is_valued = isinstance(fields.get("known_constants"), Mapping)
    values = _numbers(fields, "known_constants", where) if is_valued else {}
    symbols = {n: ca.SX.sym(n) for kind in listed.values() for n in kind if n not in values}
    formulas = {f: _mapping(fields, f, where, "formula") for f in _FORMULAS}
    _refuse_unmatched(listed["states"], formulas["equations"], where)
    if not formulas["outputs"]:
        raise ModelError(
            f"{where}, outputs: there is none, so nothing is measured; add what the sensors give, "
            'such as outputs = {"y1": "x1"}'
        )
    scope: dict[str, Any] = {**symbols, **{n: float(v) for n, v in values.items()}}
    reader = FormulaScope(scope, frozenset(formulas["outputs"]), where)
    reader.define(formulas["definitions"])
    h = reader.read("outputs", formulas["outputs"], formulas["outputs"])
    f = reader.read("equations", formulas["equations"], listed["states"])
    special = isinstance(fields.get("known_initial"), Mapping)
    initial = _listed(fields, "known_initial", where)
    at = _numbers(fields, "parameters_at", where)
    allowed = [*listed["params"], *(c for c in listed["known_constants"] if c not in values)]
    _refuse_unknown(initial, listed["states"], f"{where}, known_initial", "state")
    _refuse_unknown(at, allowed, f"{where}, parameters_at", "parameter")
    units = _mapping(fields, "units", where, "unit")
    return System(
        name=name,
        states=listed["states"],
        parameters=listed["params"],
        outputs=tuple(formulas["outputs"]),
        symbols=symbols,
        f=f,
        h=h,
        constants=() if values else listed["known_constants"],
        inputs=listed["known_inputs"],
        unknown_inputs=listed["unknown_inputs"],
        known_initial=() if special else initial,
        initial_values=_numbers(fields, "known_initial", where) if special else {},
        at=at,
        units={n: text_of(units, n, f"{where}, units") for n in units},
    )


def _refuse_twice(lists: Iterable[tuple[str, Sequence[str]]], where: str) -> None:
    first: dict[str, str] = {}
    for field, declared in lists:
        for name in declared:
            if name in first:
                raise ModelError(
                    f"{where}: {name!r} is declared twice, in {first[name]} and in {field}; remove "
                    "or rename one of them"
                )
            first[name] = field


def _refuse_unknown(given: Iterable[str], known: Sequence[str], where: str, kind: str) -> None:
    for name in given:
        if name not in known:
            raise ModelError(f"{where}: {name!r} is no {kind}{nearest(name, known)}")


def _refuse_unmatched(states: Sequence[str], equations: Mapping[str, Any], where: str) -> None:
    """Each state has one equation, and each equation its state."""
    declared = frozenset(states)
    for name in equations:
        if name not in declared:
            raise ModelError(
                f"{where}, equations.{name}: {name!r} is no state; add it to states, or move the "
                f"formula to definitions if it is no derivative{nearest(name, states)}"
            )
    for state in states:
        if state not in equations:
            raise ModelError(
                f"{where}, equations: state {state!r} has none; add its time derivative, "
                f'"{state}": "..."; a constant state has "0"'
            )
