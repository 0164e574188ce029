"""`fleet`: every record of every asset diagnosed, one table of causes, its errors controlled."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Unpack

import numpy as np

from casid.argument_types import names_wrong_types
from casid.campaigns.campaign import campaign
from casid.campaigns.manifest import read_manifest
from casid.campaigns.parquet_parts import explained
from casid.campaigns.problem_origin import digest
from casid.data.problem import Problem, load_problem
from casid.diagnosis.settings import require_settings
from casid.errors import DataError
from casid.fleets.false_discoveries import SOURCES as RATE_SOURCES
from casid.fleets.false_discoveries import false_alarms_per_month
from casid.fleets.findings import Finding, Key, findings_of
from casid.fleets.fleet_settings import (
    REFERENCES,
    FleetOptions,
    FleetSettings,
    Reference,
    reference_of,
)
from casid.fleets.fleet_table import (
    CAUSES,
    PARAMETERS,
    cause_table,
    column,
    laws_of,
    outcomes_of,
    parameter_table,
    record_table,
)
from casid.fleets.fleet_task import (
    Budget,
    RecordTask,
    ReferenceTask,
    end_process,
    packed,
    packed_records,
    pickled_work,
)
from casid.fleets.random_effects import SOURCES as EFFECT_SOURCES
from casid.fleets.random_effects import ParameterEffects, Sample, parameter_effects
from casid.fleets.record_files import RecordFile, files_of
from casid.fleets.record_list import UNKNOWN, FleetRecord, Labels, RecordList
from casid.fleets.thresholds import RECORD_BUDGET
from casid.model.effects.names import effect_words
from casid.model.units import to_si
from casid.presentation import Presented, present, write
from casid.whole_files import replacing

REFERENCE_FILE = "references.json"
YEAR = float(to_si(365.25, "d"))
"""Seconds, the unit of time of drifts where times are dates."""

ASSUMPTIONS = (
    "Benjamini-Hochberg: the records are independent, or depend on each other positively (PRDS). "
    "Records of one voyage, one sea or one sensor depend on each other.",
    "e-BH: nothing is assumed of how records depend on each other; the price is power.",
    "Both: each record's p is valid, which is what the diagnosis of one record assumes (noise that "
    "is stationary after whitening, with a short correlation time). A record that is not searched, "
    "or without an adopted cause, counts with p = 1.",
    "The false discovery rate is the expected share of adequate records among those called "
    "deficient. It is a rate of records, not of findings, which consist of several records.",
)
"""What the rates over a fleet assume."""


@dataclass(frozen=True, slots=True, eq=False)
class Fleet(Presented):
    """The result over all records of a fleet.

    Attributes
    ----------
    records : pandas.DataFrame, a row a record: asset, time, verdict, p, e-value, what is decided.
    causes : pandas.DataFrame, a row a record and cause.
    findings : the same cause in consecutive records of an asset is one of them; strongest first.
    effects : parameters over assets and records.
    level : of false discoveries.
    new : records that this call has done; the others were there.
    is_dated : times are seconds since 1970-01-01, else numbers.
    laws : cause -> what it is called by beside its kind: a constant voltage that opposes i.
    """

    problem: str
    folder: Path | None
    records: Any
    causes: Any
    findings: tuple[Finding, ...]
    effects: tuple[ParameterEffects, ...]
    level: float
    new: int
    is_dated: bool
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    not_done: int = 0
    laws: Mapping[Key, str] = field(default_factory=dict)
    SOURCES: ClassVar[tuple[str, ...]] = (*RATE_SOURCES, *EFFECT_SOURCES)

    @property
    def assets(self) -> tuple[str, ...]:
        """Names, in the order of their first records."""
        return tuple(dict.fromkeys(self.records["asset"].tolist()))

    @property
    def refusals(self) -> dict[str, str]:
        """Record -> why it has no outcome."""
        refused = self.records[self.records["refusal"] != ""]
        return dict(zip(refused["record"].tolist(), refused["refusal"].tolist(), strict=True))

    @property
    def unlabelled(self) -> tuple[str, ...]:
        """Names of records whose asset neither path nor columns say, where some do."""
        rows = self.records[self.records["asset"] == UNKNOWN]
        return tuple(rows["record"].tolist()) if len(rows) < len(self.records) else ()

    @property
    def undecided(self) -> dict[str, str]:
        """Record -> why it does not determine whether the model is adequate."""
        rows = self.records[self.records["verdict"] == "undecided"]
        return dict(zip(rows["record"].tolist(), rows["why"].tolist(), strict=True))

    @property
    def discoveries(self) -> int:
        """Records that are called deficient at the level, by Benjamini-Hochberg."""
        return int(self.records["discovered"].sum())

    @property
    def discoveries_e(self) -> int:
        """Discoveries by e-BH, valid for any dependence of the records."""
        return int(self.records["discovered_e"].sum())

    @property
    def alarms(self) -> Any:
        """The rows of records that raised an alarm when they arrived (LORD++)."""
        return self.records[self.records["alarm"]]

    @property
    def false_alarms_per_month(self) -> float:
        """At most how many false alarms are expected a month; NaN without dates."""
        when = column(self.records, "when")
        days = float(np.ptp(when)) / 86400.0 if self.is_dated and len(when) > 1 else math.nan
        return false_alarms_per_month(column(self.records, "alarm_level"), days)

    @property
    def searched(self) -> int:
        """Records that had the full search."""
        return int((self.records["stage"] == "searched").sum())

    def time_text(self, when: float) -> str:
        """A time as a date, or as the number that it is."""
        if not math.isfinite(when):
            return "before the first record"
        if not self.is_dated:
            return f"{when:g}"
        return str(np.datetime64(round(when), "s").astype("datetime64[D]"))

    def to_json(self) -> dict[str, Any]:
        """The content of `fleet.json` (schema casid.fleet/1)."""
        return {
            "schema": "casid.fleet/1",
            "problem": self.problem,
            "level": self.level,
            "records": len(self.records),
            "assets": list(self.assets),
            "new": self.new,
            "not_done": self.not_done,
            "searched": self.searched,
            "refused": len(self.refusals),
            "refusals": self.refusals,
            "undecided": len(self.undecided),
            "discoveries": {"benjamini_hochberg": self.discoveries, "e_bh": self.discoveries_e},
            "alarms": self.alarms["record"].tolist(),
            "false_alarms_per_month": _or_none(self.false_alarms_per_month),
            "findings": [_finding(f, self) for f in self.findings],
            "parameters": [_plain(asdict(e)) for e in self.effects],
            "assumptions": list(ASSUMPTIONS),
            "settings": dict(self.settings),
            "versions": dict(self.versions),
        }

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.SOURCES

    def __repr__(self) -> str:
        return (
            f"<Fleet {self.problem}: {len(self.records)} records of {len(self.assets)} assets, "
            f"{len(self.findings)} findings>"
        )

    def plot(self) -> Any:
        """The findings over assets and time, as a Plotly figure."""
        return present(self, "figure")

    def write(self, folder: str | Path) -> Path:
        """Write `fleet.json` and `report.html` into `folder`; returns the report's path."""
        return write(self, folder)


def words_of(found: Fleet, key: Key) -> str:
    """A cause of a fleet in words: dry friction, or the voltage that has its law."""
    return effect_words(*key, description=found.laws.get(key, ""))


@names_wrong_types()
def fleet(
    problem: Problem | str | Path,
    records: str | Path | Iterable[str | Path],
    *,
    asset: str | None = None,
    time: str | None = None,
    out: str | Path | None = None,
    resume: bool = True,
    progress: bool | Callable[[str], None] = False,
    **options: Unpack[FleetOptions],
) -> Fleet:
    """Diagnose every record of a fleet, and control the errors over all of them.

    Runs on the backend of `joblib.parallel_config`, by default in one process. The table is the
    same to the last bit whatever the backend, and however often the call was interrupted. Repeated,
    the same call diagnoses only records that are new.

    Parameters
    ----------
    problem : loaded from a file, or its path.
    records : files, folders, or patterns such as ``voyages/*.parquet``; addresses, too, where
        fsspec is installed: ``s3://bucket/voyages/*.parquet``, ``zip://*.csv::voyages.zip``.
    asset : what a record was taken on: a pattern of the path with {asset} in it, such as
        "{asset}_{time}.csv", or a column of the files. Default the folder that a file is in.
    time : when: a pattern with {time}, or a column; dates or numbers. Default the {time} of
        `asset`, or else the natural order of the names.
    out : folder for the tables, where an interrupted call continues.
    resume : False begins anew, and deletes what `out` holds of a fleet.
    progress : as `casid.campaign` has it.
    options : those of `FleetOptions`.

    Returns
    -------
    Fleet
        Tables of records and causes, findings over assets and time, and parameters over the fleet.

    Raises
    ------
    DataError
        No record, a folder of another fleet (with what differs), a record that was changed, a full
        disk (with what is kept).
    ModelError
        A problem that other processes cannot load.
    """
    if not isinstance(problem, Problem):
        problem = load_problem(problem)
    rest: dict[str, Any] = {**options}
    budget = Budget(
        rest.pop("budget", RECORD_BUDGET.seconds), rest.pop("memory", RECORD_BUDGET.memory)
    )
    labels = Labels(asset, time)
    ignore = dict.fromkeys((*labels.columns, *rest.pop("ignore", ())))
    settings = FleetSettings(ignore=tuple(ignore), **rest)
    _require(settings.level, budget)
    require_settings(problem, settings.level, settings.max_causes, settings.without)
    run = _Run(problem, settings, labels, budget, out, progress)
    try:
        return run.done(files_of(records), resume=resume)
    finally:
        end_process()


def _require(level: float, budget: Budget) -> None:
    if not 0.0 < level < 1.0:
        raise DataError(
            f"level = {level:g} is no rate between 0 and 1; give the share of false discoveries "
            "that is allowed, for example 0.05 (--level 0.05)"
        )
    for name, value, unit in (
        ("budget", budget.seconds, "seconds"),
        ("memory", budget.memory, "megabytes"),
    ):
        if not 0.0 < value < math.inf:
            raise DataError(
                f"{name} = {value:g}: give the {unit} that one record may take, a positive number"
            )


class _Run:
    """One call: the list of records, the references, the rows, and what is made of them."""

    def __init__(
        self,
        problem: Problem,
        settings: FleetSettings,
        labels: Labels,
        budget: Budget,
        out: str | Path | None,
        progress: bool | Callable[[str], None],
    ) -> None:
        self.problem, self.settings, self.labels, self.budget = problem, settings, labels, budget
        self.folder = None if out is None else Path(out)
        self.progress = progress
        self.work = pickled_work(problem, settings)
        self.described = {
            "problem": problem.name,
            "problem sha256": digest(problem),
            **asdict(settings),
            "asset": labels.asset,
            "time": labels.time,
            "budget": budget.seconds,
            "memory": budget.memory,
        }

    def done(self, files: Sequence[RecordFile], *, resume: bool) -> Fleet:
        """Diagnose the records that are left, and return the result over all."""
        if self.folder is not None:
            _require_folder(self.folder)
            if not resume:
                _delete(self.folder)
            with explained(self.folder, "nothing was begun"):
                self.folder.mkdir(parents=True, exist_ok=True)
        listed = RecordList(self.folder)
        listed.add(files, self.labels)
        if self.folder is not None:
            with explained(self.folder, "what was done before is kept"):
                listed.write()
        references = self._references(listed) if self.settings.screen else {}
        task = RecordTask(
            self.work,
            packed_records(listed.records),
            packed({a: [r.path, r.values] for a, r in references.items()}),
            self.budget,
        )
        rows = campaign(
            task,
            len(listed.records),
            seed=self.settings.seed,
            out=self._sub("records"),
            settings=self.described,
            progress=self.progress,
        )
        return self._result(listed, rows.table, len(rows.table) - rows.found, rows.not_done)

    def _sub(self, name: str) -> Path | None:
        return None if self.folder is None else self.folder / name

    def _references(self, listed: RecordList) -> dict[str, Reference]:
        """The reference of each asset, made once and kept."""
        chosen, found = self._kept_references()
        known = {listed.records[i].asset for i in chosen}
        count: dict[str, int] = {}
        for i, record in enumerate(listed.records):
            n = count[record.asset] = count.get(record.asset, 0) + 1
            if record.asset not in known and n <= REFERENCES:
                chosen.append(i)
        self._keep_references(chosen, found)
        records = [listed.records[i] for i in chosen]
        fits = campaign(
            ReferenceTask(self.work, packed_records(records), self.budget),
            len(records),
            seed=self.settings.seed,
            out=self._sub("references"),
            settings=self.described,
            progress=False,
        ).table
        by_asset: dict[str, list[tuple[FleetRecord, Mapping[str, float]]]] = {}
        for run, values in zip(fits["run"], fits.get("values", [None] * len(fits)), strict=True):
            if isinstance(values, str):
                record = records[int(run)]
                by_asset.setdefault(record.asset, []).append((record, json.loads(values)))
        for asset, own in by_asset.items():
            if asset not in found and (reference := reference_of(own)) is not None:
                found[asset] = reference
        self._keep_references(chosen, found)
        return found

    def _kept_references(self) -> tuple[list[int], dict[str, Reference]]:
        path = self._sub(REFERENCE_FILE)
        if path is None or not path.exists():
            return [], {}
        content = json.loads(path.read_text(encoding="utf-8"))
        found = {
            a: Reference(p, tuple((n, v) for n, v in values))
            for a, (p, values) in content["assets"].items()
        }
        return content["records"], found

    def _keep_references(self, chosen: Sequence[int], found: Mapping[str, Reference]) -> None:
        path = self._sub(REFERENCE_FILE)
        if path is None:
            return
        assets = {a: [r.path, r.values] for a, r in found.items()}
        content = json.dumps({"records": list(chosen), "assets": assets}, indent=1)
        with explained(path.parent, "what was done before is kept"):
            with replacing(path, is_synced=True) as file:
                file.write(content.encode())

    def _result(self, listed: RecordList, rows: Any, new: int, not_done: int) -> Fleet:
        """Rates, findings and effects of all rows; the tables are kept in the folder."""
        from casid.versions import versions

        level = self.settings.level
        table = record_table(rows, listed.frame(), level)
        causes = cause_table(table)
        parameters = parameter_table(table)
        is_dated = any(r.is_dated for r in listed.records)
        found = Fleet(
            problem=self.problem.name,
            folder=self.folder,
            records=table,
            causes=causes,
            findings=findings_of(outcomes_of(table)),
            laws=laws_of(table),
            effects=tuple(_effects(parameters, YEAR if is_dated else 1.0)),
            level=level,
            new=new,
            is_dated=is_dated,
            settings=self.described,
            versions=versions(),
            not_done=not_done,
        )
        if self.folder is not None:
            with explained(self.folder, f"all {len(table)} records are kept in records"):
                _write_table(self.folder / CAUSES, causes)
                _write_table(self.folder / PARAMETERS, parameters)
        return found


def _effects(parameters: Any, unit_of_time: float) -> Iterable[ParameterEffects]:
    for (name, unit), rows in parameters.groupby(["parameter", "unit"], sort=False):
        sample = Sample(
            str(name),
            str(unit),
            column(rows, "value"),
            column(rows, "std_error"),
            column(rows, "when"),
            rows["asset"].tolist(),
        )
        found = parameter_effects(sample, unit_of_time=unit_of_time)
        if found is not None:
            yield found


def _require_folder(folder: Path) -> None:
    """Refuse a folder that holds something else."""
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder} is a file, not a folder; name a folder")
    if read_manifest(folder) is not None:
        raise DataError(f"{folder} holds a campaign; name another folder")


def _delete(folder: Path) -> None:
    """Delete what a fleet left in its folder, and nothing else."""
    import shutil

    for name in ("records", "references"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("records.json", REFERENCE_FILE, CAUSES, PARAMETERS, "fleet.json", "report.html"):
        (folder / name).unlink(missing_ok=True)


def _write_table(path: Path, frame: Any) -> None:
    with replacing(path, is_synced=True) as file:
        frame.to_parquet(file, index=False)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {k: _plain(v) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(v) for v in content]
    return _or_none(content) if isinstance(content, float) else content


def _finding(f: Finding, of: Fleet) -> dict[str, Any]:
    names = of.records.set_index("number")["record"]
    content: dict[str, Any] = _plain(asdict(f))
    content["records"] = [str(names[i]) for i in f.records]
    content["is_lasting"] = f.is_lasting
    return content
