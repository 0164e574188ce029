"""Named arrays of a file as tables: vectors of one length are columns of one table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from casid.data.reading.formats.groups import Group


def groups_of(
    arrays: Mapping[str, Any], units: Mapping[str, str] | None = None
) -> dict[str, Group]:
    """Tables of vectors (N,), (N, 1) or (1, N), and of the columns of matrices (N, n).

    A matrix has its samples along the dimension that a vector of the file has, else along the first
    where that is the longer one. Parts of a name before its last point or slash (a struct, a group)
    name the table, with the length where there are several.

    Parameters
    ----------
    arrays : name -> array; what is not numeric, and scalars, are left out.
    units : name -> unit.
    """
    import pandas as pd

    numeric = {n: np.asarray(v) for n, v in arrays.items()}
    numeric = {n: v for n, v in numeric.items() if v.dtype.kind in "fiubmM" and v.size > 1}
    lengths = {v.size for v in numeric.values() if v.size == max(v.shape)}
    columns: dict[tuple[str, int], dict[str, Any]] = {}
    left_out: list[str] = [f"{n} is no vector of numbers" for n in arrays if n not in numeric]
    for name, values in numeric.items():
        parent, leaf = _parent(name)
        if values.size == max(values.shape):
            columns.setdefault((parent, values.size), {})[leaf] = values.ravel()
            continue
        if values.ndim == 2 and values.shape[1] in lengths and values.shape[0] not in lengths:
            values = values.T
        if values.ndim != 2 or values.shape[0] < values.shape[1]:
            left_out.append(
                f"{name} has shape {values.shape}, more columns than rows: transpose it"
            )
            continue
        for k in range(values.shape[1]):
            columns.setdefault((parent, values.shape[0]), {})[f"{leaf}_{k + 1}"] = values[:, k]
    parents = [p for p, _ in columns]
    found = {}
    for (parent, length), table in columns.items():
        several = parents.count(parent) > 1
        label = parent if parent and not several else f"{parent or 'length'} {length}".strip()
        label = "" if not parent and not several and len(columns) == 1 else label
        named = {_parent(n)[1]: u for n, u in (units or {}).items() if _parent(n)[0] == parent}
        found[label] = Group(pd.DataFrame(table), named, tuple(left_out))
    return found


def _parent(name: str) -> tuple[str, str]:
    for mark in ("/", "."):
        parent, point, leaf = name.rpartition(mark)
        if point:
            return parent, leaf
    return "", name
