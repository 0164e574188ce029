"""A fleet of simulated ships: false discoveries, power, onsets and the cost of screening.

    python -m analysis.fleet [--records N] [--ships N] [--seed S] [--jobs N] [--kills N]
                             [--out DIR] [--quick]

Voyages of 20 ships (`voyages`, a simulator that shares nothing with casid): 5 % have a cause of
lambda 60 to 3000 (a load that shifted, drag, a gyro that drifted or is late), some of these in
stretches that last, and 20 % are in seas. `casid.fleet` diagnoses them; the records with a cause,
and twice as many without (with --quick as many), are then searched one by one in full, which says
what the same records show singly, what the screening loses and what it saves. Then the main process
of 40 of them is killed (kill -9) at random moments. With --out, a run that was stopped goes on.

Targets: false discoveries at most 5 %, power at least 95 % of what the same records reach singly at
the same level, the onset of lasting causes within one voyage in 90 %, the screening at least 5
times cheaper at no more than 2 % lost power, the same table after ten kills.
"""

from __future__ import annotations

import contextlib
import json
import resource
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor

import casid
from analysis.common.rates import rate, reaches, stays_within
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target, holds
from analysis.fleet.kills import survives
from analysis.fleet.voyages import CAUSES, Voyage, parameters, plan, write

RECORDS, QUICK_RECORDS = 500, 40
SHIPS, QUICK_SHIPS = 20, 4
KILLS, QUICK_KILLS, KILLED = 10, 0, 40
LEVEL = 0.05
PROBLEM = Path(__file__).with_name("roll.py")
LABELS = "{asset}_{time}.parquet"


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of processor time and of wall time, and records."""

    processor: float
    wall: float
    records: int

    @property
    def each(self) -> float:
        """Processor seconds a record."""
        return self.processor / max(self.records, 1)


def of_fleet(
    files: Sequence[Path], out: Path, n_jobs: int, *, screen: bool
) -> tuple[casid.Fleet, Cost]:
    """The fleet's result, and what it took."""
    begun, used = time.perf_counter(), _processor()
    with joblib.parallel_config(n_jobs=n_jobs):
        found = casid.fleet(
            PROBLEM, files, asset=LABELS, out=out, level=LEVEL, screen=screen, progress=True
        )
    get_reusable_executor().shutdown(wait=True)  # the time of workers counts when they have ended
    cost = Cost(_processor() - used, time.perf_counter() - begun, found.new)
    # Of a part that was done in one go before, what it took then.
    kept = out / "cost.json"
    if found.new == len(files):
        kept.write_text(json.dumps(asdict(cost)))
    elif kept.exists():
        cost = Cost(**json.loads(kept.read_text()))
    return found, cost


def _processor() -> float:
    """Processor time of this process and of those that have ended."""
    total = 0.0
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        used = resource.getrusage(who)
        total += used.ru_utime + used.ru_stime
    return total


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What was found of the voyages.

    Attributes
    ----------
    truth : name of a record -> its voyage.
    fleet, singly : with the screening over all; without it, of some records.
    """

    truth: dict[str, Voyage]
    fleet: casid.Fleet
    singly: casid.Fleet

    @property
    def discovered(self) -> set[str]:
        """Records that are discoveries at the level."""
        rows = self.fleet.records
        return set(rows["record"][rows["discovered"]])

    @property
    def alone(self) -> set[str]:
        """Records that are deficient when they are diagnosed singly."""
        rows = self.singly.records
        return set(rows["record"][rows["p"] <= LEVEL])

    @property
    def caused(self) -> set[str]:
        """Records with a cause."""
        return {name for name, v in self.truth.items() if v.cause}

    def named_right(self) -> int:
        """Discoveries whose cause, or a rival that the record does not separate, is the truth."""
        rows = self.fleet.causes
        right = set()
        for name, kind, where, rivals in zip(
            rows["record"], rows["kind"], rows["where"], rows["rivals"], strict=True
        ):
            wanted = CAUSES.get(self.truth[name].cause)
            if wanted is not None and (
                (kind, where) == wanted or f"{wanted[0]} in {wanted[1]}" in str(rivals)
            ):
                right.add(name)
        return len(right & self.discovered & self.caused)

    def onsets(self) -> tuple[int, int]:
        """Lasting causes whose onset is found within one voyage, and all of them."""
        runs: dict[int, list[Voyage]] = {}
        for v in self.truth.values():
            if v.cause:
                runs.setdefault(v.run, []).append(v)
        lasting = [sorted(r, key=lambda v: v.number) for r in runs.values() if len(r) > 1]
        numbers = dict(zip(self.fleet.records["number"], self.fleet.records["record"], strict=True))
        hits = 0
        for run in lasting:
            found = [
                min(self.truth[numbers[i]].number for i in f.records)
                for f in self.fleet.findings
                if f.asset == f"ship{run[0].ship:02d}" and f.is_lasting
            ]
            hits += any(abs(first - run[0].number) <= 1 for first in found)
        return hits, len(lasting)


def study(run: Run) -> Iterator[Target | str]:
    """The targets, one by one."""
    options, quick = run.options, run.quick
    records = options.records or (QUICK_RECORDS if quick else RECORDS)
    ships = options.ships or (QUICK_SHIPS if quick else SHIPS)
    with contextlib.ExitStack() as stack:
        folder = run.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        voyages = write(plan(records, ships, options.seed), folder / "voyages", options.seed)
        truth = {v.name: v for v in voyages}
        files = [folder / "voyages" / name for name in truth]
        yield f"{len(files)} voyages of {ships} ships"
        fleet, cost = of_fleet(files, folder / "fleet", options.jobs, screen=True)
        caused, plain = _some(voyages, beside=1 if quick else 2)
        singly, with_cause = of_fleet(
            [folder / "voyages" / v.name for v in caused],
            folder / "singly",
            options.jobs,
            screen=False,
        )
        _, without = of_fleet(
            [folder / "voyages" / v.name for v in plain],
            folder / "without cause",
            options.jobs,
            screen=False,
        )
        judged = Judged(truth, fleet, singly)
        run.output.table("voyages", [asdict(v) for v in voyages])
        if run.folder is not None:
            fleet.write(folder / "fleet")
        yield from _errors(judged, quick=quick)
        yield from _screening(judged)
        if cost.records == len(files) and with_cause.records and without.records:
            share = len(caused) / len(files)  # each kind counts as the fleet has it
            full = share * with_cause.each + (1.0 - share) * without.each
            yield from _cost(cost, full, quick=quick)
        else:
            yield "the costs are those of a run that was not stopped on the way"
        yield from _spreads(fleet, options.seed, ships)
        kills = options.kills if options.kills is not None else (QUICK_KILLS if quick else KILLS)
        if kills:
            some = files[:KILLED]
            same = survives(some, PROBLEM, LABELS, folder / f"kills of {len(some)}", kills)
            text = "the same, bit for bit" if same else "another table"
            yield holds(f"table after {kills} kills of the main process", text, "the same", same)


def _some(voyages: Sequence[Voyage], beside: int) -> tuple[list[Voyage], list[Voyage]]:
    """All voyages with a cause, and `beside` times as many without, spread over the fleet."""
    caused = [v for v in voyages if v.cause]
    plain = [v for v in voyages if not v.cause]
    wanted = beside * max(len(caused), 1)
    return caused, plain[:: max(1, len(plain) // wanted)][:wanted]


def _errors(j: Judged, *, quick: bool) -> Iterator[Target | str]:
    found, caused = j.discovered, j.caused
    false, of = len(found - caused), max(len(found), 1)
    yield "errors over the fleet"
    r = rate(false, of)
    yield holds(
        "false discoveries (Benjamini-Hochberg)",
        f"{false} of {len(found)}, up to {100 * r['high']:.1f} %",
        "at most 5 %",
        stays_within(false, of, LEVEL, quick=quick or len(found) < RECORDS),
    )
    e = j.fleet.records
    by_e = set(e["record"][e["discovered_e"]])
    text = f"{len(by_e - caused)} of {len(by_e)}"
    yield holds(
        "false discoveries (e-BH)", text, "at most 5 %", len(by_e - caused) <= LEVEL * len(by_e)
    )
    alarms = set(e["record"][e["alarm"]])
    yield f"alarms on arrival (LORD++): {len(alarms & caused)} right, {len(alarms - caused)} false"
    alone = j.alone & caused
    kept = len(found & caused) / max(len(alone), 1)
    yield holds(
        "power beside that of the records singly",
        f"{len(found & caused)} to {len(alone)} of {len(caused)}",
        "at least 95 %",
        kept >= 0.95 or (quick and len(alone) - len(found & caused) <= 1),
    )
    right = len(found & caused)
    yield f"of {right} true discoveries {j.named_right()} named or tied with the truth"
    hits, of = j.onsets()
    yield holds(
        "onset of lasting causes within one voyage",
        f"{hits} of {of}",
        "at least 90 %",
        reaches(hits, max(of, 1), 0.9, quick=True) if of else True,
    )


def _screening(j: Judged) -> Iterator[Target | str]:
    """What the screening loses."""
    yield "screening"
    rows = j.fleet.records.set_index("record")
    alone = j.alone & j.caused
    lost = {n for n in alone if rows.loc[n, "stage"] == "screened"}
    yield holds(
        "power lost to the screening",
        f"{len(lost)} of {len(alone)}",
        "at most 2 %",
        len(lost) <= 0.02 * len(alone),
    )
    yield f"{j.fleet.searched} of {len(rows)} records were searched in full"


def _cost(cost: Cost, full: float, *, quick: bool) -> Iterator[Target | str]:
    """What the screening saves; `full` is the processor time of a full search a record."""
    yield f"processor seconds a record: {cost.each:.3f} with screening, {full:.3f} without"
    yield f"the fleet took {cost.wall:.0f} s and {cost.processor / 3600:.3f} core-hours"
    factor = full / cost.each
    is_met = factor >= 5.0 or quick  # references and start are most of a short run
    yield holds("times cheaper than the full search", f"{factor:.2g}", "at least 5", is_met)


def _spreads(fleet: casid.Fleet, seed: int, ships: int) -> Iterator[Target | str]:
    """The spread of the parameters between ships beside the true one."""
    yield "parameters as random effects"
    true = [parameters(s, seed) for s in range(ships)]
    for e in fleet.effects:
        spread = float(np.std([p[e.name] for p in true], ddof=1))
        yield (
            f"  {e.name}: between {e.between:.3g} (of the true values {spread:.3g}), within "
            f"{e.within:.2g}, drift {e.drift:.2g} +- {e.drift_error:.1g} a year"
        )


_OPTIONS: dict[str, dict[str, Any]] = {
    "--records": {"type": int, "help": f"voyages (default {RECORDS}, quick {QUICK_RECORDS})"},
    "--ships": {"type": int, "help": f"ships (default {SHIPS}, quick {QUICK_SHIPS})"},
    "--seed": {"type": int, "default": 1, "help": "of the voyages (default 1)"},
    "--kills": {"type": int, "help": f"of the main process (default {KILLS}, quick none)"},
    **jobs(1),
}

STUDY = Study(study, options=_OPTIONS)
