"""Results as plain values, and back: dataclasses of casid, arrays, models, symbolic expressions.

What JSON knows stands as it is; everything else is a mapping with one key that begins with a dollar
sign. Arrays of many samples are not in it: they are columns of tables, by the path of the attribute
that they are the value of. CasADi expressions are numbers of entries in one text.

A class is named by its place below `casid`; reading instantiates dataclasses of casid and nothing
else, so that a file of a stranger runs no code.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import DataError
from casid.saving.symbolic_trees import is_symbolic, symbolic_of, tree_of

LARGE = 64
"""Entries from which on an array is kept in a table."""

MOVED: Mapping[str, str] = {
    "campaigns.monte_carlo.Accuracy": "campaigns.accuracy.Accuracy",
    "data.record.Experiment": "data.experiment.Experiment",
    "diagnosis.calibration.false_alarm_rate.Calibration": (
        "diagnosis.calibration.calibration.Calibration"
    ),
    **{
        f"diagnosis.evidence.residual_tests.{name}": (
            f"diagnosis.evidence.residual.residual_tests.{name}"
        )
        for name in ("Band", "Correlated", "ResidualTests")
    },
    **{
        f"model.model.{name}": f"model.declarations.{name}"
        for name in ("Balance", "Blend", "Input", "Parameter", "Stage", "State")
    },
}
"""Place of a class when files were saved -> where it is now."""


def _blends_of_ramp(held: dict[str, Any]) -> dict[str, Any]:
    """An input was once blended with one other hold, by the parameter `ramp`."""
    if "ramp" in held:
        ramp, toward = held.pop("ramp"), "foh" if held["hold"] == "zoh" else "zoh"
        held["blends"] = (
            () if ramp is None else (class_at("model.declarations.Blend")(ramp, toward),)
        )
    return held


def _bound_of_note(held: dict[str, Any]) -> dict[str, Any]:
    """That a parameter was at a bound once stood in its note alone."""
    said = re.match("at (lower|upper) bound", held.get("note", ""))
    return {"bound": said[1] if said else "", **held}


def _tests_of_sentences(held: dict[str, Any]) -> dict[str, Any]:
    """The tests of residuals were once kept in words."""
    if "whiteness" in held:
        said = held.pop("whiteness")
        test = class_at("estimation.whiteness.Whiteness")
        held["whiteness_tests"] = {k: test.of_sentence(text) for k, text in said.items()}
    return held


CHANGED: Mapping[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "model.model.Input": _blends_of_ramp,
    "estimation.estimate.Agreement": _tests_of_sentences,
    "estimation.estimate.Estimated": _bound_of_note,
}
"""Class -> what makes its fields of those that earlier versions saved."""

_MODEL = "model.model.Model"
_CLASS = re.compile(r"[a-z_][a-z_0-9.]*\.[A-Za-z_]\w*")


def columns_of(path: str, shape: Sequence[int]) -> list[str]:
    """Names of the columns of an array (N,) at a path, p; of one (N, ...), p[0], p[1] ..."""
    return [path] if len(shape) == 1 else [f"{path}[{j}]" for j in range(math.prod(shape[1:]))]


class Encoder:
    """Collects the arrays and expressions of one result while it is turned into plain values.

    Attributes
    ----------
    arrays : path of an attribute -> (N, ...) array.
    expressions : SX, in the order in which they were met.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, Array] = {}
        self.expressions: list[Any] = []

    def plain(self, value: Any, path: str) -> Any:
        """`value`, the attribute at `path`, as what JSON knows.

        Raises
        ------
        DataError
            For a value that no file can hold, such as a function: where it is.
        """
        if value is None or isinstance(value, str | bool):
            return value
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, int):
            return int(value)
        if isinstance(value, float):
            return float(value) if math.isfinite(value) else {"$float": repr(float(value))}
        if isinstance(value, complex):
            return {"$complex": [self.plain(value.real, path), self.plain(value.imag, path)]}
        if isinstance(value, np.ndarray):
            return self._array(value, path)
        if isinstance(value, Mapping):
            return self._mapping(value, path)
        if isinstance(value, list | tuple):
            items = [self.plain(v, f"{path}.{i}") for i, v in enumerate(value)]
            return items if isinstance(value, list) else {"$tuple": items}
        if isinstance(value, set | frozenset):
            return {"$set": [self.plain(v, path) for v in sorted(value)]}
        if isinstance(value, Path):
            return {"$path": str(value)}
        return self._object(value, path)

    def _object(self, value: Any, path: str) -> Any:
        kind = type(value)
        place = f"{kind.__module__}.{kind.__qualname__}"
        if place.startswith("casid."):
            place = place.removeprefix("casid.")
            if place == _MODEL:
                held = {n: v for n, v in vars(value).items() if n != "_explicit"}
                return {"$class": place, "fields": self._fields(held, path)}
            if is_dataclass(value):
                held = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
                return {"$class": place, "fields": self._fields(held, path)}
        if place == "casadi.casadi.SX":
            self.expressions.append(value)
            return {"$expression": len(self.expressions) - 1}
        if is_symbolic(value):
            return {"$symbolic": tree_of(value)}
        if kind.__module__.partition(".")[0] == "pandas" and hasattr(value, "columns"):
            return self._frame(value, path)
        what = f"the function {value.__qualname__}" if callable(value) else f"a {kind.__name__}"
        raise DataError(
            f"{path} holds {what}, which no file can keep; save what it computes, or the problem "
            "file beside the result"
        )

    def _fields(self, held: Mapping[str, Any], path: str) -> dict[str, Any]:
        return {name: self.plain(v, f"{path}.{name}" if path else name) for name, v in held.items()}

    def _mapping(self, value: Mapping[Any, Any], path: str) -> Any:
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return {key: self.plain(v, f"{path}.{key}") for key, v in value.items()}
        rows = [[self.plain(k, path), self.plain(v, f"{path}.{k}")] for k, v in value.items()]
        return {"$items": rows}

    def _frame(self, value: Any, path: str) -> Any:
        """A pandas DataFrame: columns of numbers as arrays, others entry by entry."""
        columns = []
        for name in value.columns:
            kind, entries = str(value[name].dtype), value[name].to_numpy()
            held = entries if entries.dtype.kind in "biuf" else entries.tolist()
            columns.append([str(name), kind, self.plain(held, f"{path}.{name}")])
        return {"$frame": columns}

    def _array(self, value: Array, path: str) -> Any:
        shape, kind = list(value.shape), str(value.dtype)
        if value.dtype.kind in "biuf" and value.size >= LARGE:
            path = path.encode("utf-8", "backslashreplace").decode()  # as a name of a column
            taken = {n for p, a in self.arrays.items() for n in columns_of(p, a.shape)}
            while taken & set(columns_of(path, shape)):
                path += "'"
            self.arrays[path] = value
            return {"$array": path, "shape": shape, "dtype": kind}
        if value.dtype.kind not in "biufcU":
            raise DataError(f"{path} holds an array of {kind}, which no file can keep")
        entries = [self.plain(v, path) for v in value.ravel().tolist()]
        return {"$entries": entries, "shape": shape, "dtype": kind}


class Decoder:
    """Turns plain values back into what was saved.

    Parameters
    ----------
    columns : (N,) arrays by the names that `columns_of` gives.
    expressions : SX.
    """

    def __init__(self, columns: Mapping[str, Array], expressions: list[Any]) -> None:
        self.columns, self.expressions = columns, expressions

    def value(self, plain: Any) -> Any:
        """What `plain` stands for.

        Raises
        ------
        DataError
            For values that no result holds: a damaged file, or one of a later version.
        """
        if isinstance(plain, list):
            return [self.value(v) for v in plain]
        if not isinstance(plain, dict):
            return plain
        tag = next((key for key in plain if key.startswith("$")), None)
        if tag is None:
            return {key: self.value(v) for key, v in plain.items()}
        content = plain[tag]
        if tag == "$float":
            return float(content)
        if tag == "$complex":
            return complex(*(self.value(v) for v in content))
        if tag == "$tuple":
            return tuple(self.value(v) for v in content)
        if tag == "$set":
            return frozenset(self.value(v) for v in content)
        if tag == "$items":
            return {self.value(k): self.value(v) for k, v in content}
        if tag == "$path":
            return Path(content)
        if tag == "$array":
            names = columns_of(content, plain["shape"])
            return self._shaped(np.column_stack([self.columns[n] for n in names]), plain)
        if tag == "$entries":
            entries = np.array([self.value(v) for v in content], dtype=plain["dtype"])
            return self._shaped(entries, plain)
        if tag == "$frame":
            return self._frame(content)
        if tag == "$expression":
            return self.expressions[content]
        if tag == "$symbolic":
            return symbolic_of(content)
        if tag == "$class":
            return self._instance(content, plain["fields"])
        raise DataError(f"holds {tag!r}, which this version of casid does not know; upgrade casid")

    def _frame(self, columns: Sequence[Any]) -> Any:
        import pandas as pd

        held = {name: pd.Series(self.value(v), dtype=kind) for name, kind, v in columns}
        return pd.DataFrame(held)

    @staticmethod
    def _shaped(entries: Array, plain: Mapping[str, Any]) -> Array:
        return entries.astype(plain["dtype"]).reshape(plain["shape"])

    def _instance(self, place: str, held: Mapping[str, Any]) -> Any:
        kind = class_at(MOVED.get(place, place))
        values = CHANGED.get(place, dict)({name: self.value(v) for name, v in held.items()})
        if place == _MODEL:
            model = kind.__new__(kind)
            model.__dict__.update(vars(kind("")) | values)
            return model
        known = {f.name for f in fields(kind)}
        foreign = [name for name in values if name not in known]
        if foreign:
            raise DataError(
                f"{place} has {', '.join(foreign)}, which this version of casid does not know; "
                "upgrade casid"
            )
        return kind(**values)


def class_at(place: str) -> Any:
    """The dataclass of casid at a place such as ``estimation.estimate.Estimate``, or `Model`.

    Raises
    ------
    DataError
        If there is none.
    """
    found: Any = None
    if _CLASS.fullmatch(place):
        module, _, name = place.rpartition(".")
        try:
            found = getattr(importlib.import_module(f"casid.{module}"), name, None)
        except ImportError:
            found = None
    is_own = isinstance(found, type) and found.__module__.startswith("casid.")
    if not is_own or not (is_dataclass(found) or place == _MODEL):
        raise DataError(f"names {place!r}, which is no result of this version of casid")
    return found
