"""The tables of a fleet: a row a record and cause, and a row a record and parameter."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.fleets.false_discoveries import (
    benjamini_hochberg,
    e_benjamini_hochberg,
    e_values,
    lord,
)
from casid.fleets.findings import Key, Outcome
from casid.model.effects.names import law_of

CAUSES, PARAMETERS = "causes.parquet", "parameters.parquet"
"""Their files in the folder of a fleet."""


def record_table(rows: Any, records: Any, level: float) -> Any:
    """pandas.DataFrame: a row a record, with what is decided of it.

    Parameters
    ----------
    rows : of the campaign, by `run`.
    records : `RecordList.frame`, of the same length or longer.

    Returns
    -------
    number, record, asset, when, path, the columns of the rows, and p, e_value, discovered
    (Benjamini-Hochberg), discovered_e (e-BH), alarm and alarm_level (LORD++, in the records' order
    of arrival).
    """
    table = records.merge(rows, left_on="number", right_on="run", how="inner")
    columns = ("refusal", "verdict", "stage", "causes", "parameters", "quality", "why", "screen")
    for name in columns:
        text = table[name] if name in table.columns else ""
        table[name] = text
        table[name] = table[name].astype(object).where(table[name].notna(), "")
    crashed = table["failed"].notna()
    table.loc[crashed, "refusal"] = table.loc[crashed, "failed"].astype(object)
    table.loc[crashed, "stage"] = "refused"
    for name in ("p", "gain", "p_screen"):
        values = table[name] if name in table.columns else np.nan
        table[name] = values
        table[name] = table[name].astype(float)
    p = table["p"].fillna(1.0).to_numpy(float)
    e = e_values(p)
    table["p"], table["e_value"] = p, e
    table["discovered"] = benjamini_hochberg(p, level)
    table["discovered_e"] = e_benjamini_hochberg(e, level)
    table["alarm"], table["alarm_level"] = lord(p, level)
    return table.drop(columns=["run", "failed"])


def cause_table(table: Any) -> Any:
    """pandas.DataFrame: a row a record and cause; a record without a cause has one row, too."""
    import pandas as pd

    rows = []
    for entry in table.to_dict("records"):
        common = {
            "record": entry["record"],
            "asset": entry["asset"],
            "when": entry["when"],
            "stage": entry["stage"],
            "verdict": entry["verdict"],
            "p": entry["p"],
            "e_value": entry["e_value"],
            "discovered": entry["discovered"],
            "discovered_e": entry["discovered_e"],
            "alarm": entry["alarm"],
        }
        after = {
            "gain_held_out": entry["gain"],
            "quality": entry["quality"],
            "refusal": entry["refusal"],
            "number": entry["number"],
        }
        causes = json.loads(entry["causes"] or "[]") or [{}]
        for cause in causes:
            rivals = ", ".join(f"{kind} in {where}" for kind, where, *_ in cause.get("rivals", ()))
            rows.append(
                common
                | {
                    "kind": cause.get("kind"),
                    "where": cause.get("where"),
                    "p_cause": cause.get("p"),
                    "size": cause.get("size"),
                    "std_error": cause.get("std_error"),
                    "unit": cause.get("unit"),
                    "share": cause.get("share"),
                    "rivals": rivals,
                }
                | after
            )
    frame = pd.DataFrame(rows)
    numbers = ("p_cause", "size", "std_error", "share", "gain_held_out")
    return frame.astype({n: float for n in numbers if n in frame.columns})


def parameter_table(table: Any) -> Any:
    """pandas.DataFrame: a row a record and parameter, with its error and unit."""
    import pandas as pd

    rows = [
        (n, record, asset, when, name, value, error, unit)
        for n, record, asset, when, text in table[
            ["number", "record", "asset", "when", "parameters"]
        ].itertuples(index=False)
        for name, value, error, unit in json.loads(text or "[]")
    ]
    columns = ["number", "record", "asset", "when", "parameter", "value", "std_error", "unit"]
    return pd.DataFrame(rows, columns=columns).astype({"value": float, "std_error": float})


def outcomes_of(table: Any) -> dict[str, list[Outcome]]:
    """asset -> its records in order of time, each with its discoveries."""
    found: dict[str, list[Outcome]] = {}
    ordered = table.sort_values(["when", "number"], kind="stable")
    for entry in ordered.to_dict("records"):
        causes: dict[Key, frozenset[Key]] = {}
        sizes: dict[Key, tuple[float, float]] = {}
        units: dict[Key, str] = {}
        if entry["discovered"]:
            for c in json.loads(entry["causes"] or "[]"):
                key = (c["kind"], c["where"])
                causes[key] = frozenset((k, w) for k, w, *_ in c["rivals"])
                sizes[key] = (_number(c["size"]), _number(c["std_error"]))
                units[key] = c["unit"]
        found.setdefault(entry["asset"], []).append(
            Outcome(
                int(entry["number"]),
                float(entry["when"]),
                entry["verdict"] in ("adequate", "deficient"),
                causes,
                sizes,
                float(entry["e_value"]),
                units,
            )
        )
    return found


def laws_of(table: Any) -> dict[Key, str]:
    """Cause -> what it is called by beside its kind (`law_of`), where a record says it."""
    found: dict[Key, str] = {}
    for text in table["causes"]:
        for cause in json.loads(text or "[]"):
            own = cause["kind"], cause["where"], cause.get("description", "")
            for kind, where, *description in (own, *cause["rivals"]):
                if law := law_of(kind, "".join(description)):
                    found.setdefault((kind, where), law)
    return found


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def column(table: Any, name: str) -> Array:
    """(n,) a column as numbers."""
    return np.asarray(table[name].to_numpy(float))
