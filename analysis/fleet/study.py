"""A fleet of simulated ships: false discoveries, power, onsets and the cost of screening.

    python -m analysis.fleet [--records N] [--ships N] [--seed S] [--jobs N] [--kills N]
                             [--out DIR] [--quick]

Voyages of 20 ships (`voyages`, a simulator that shares nothing with casid): 5 % have a cause of
lambda 60 to 3000 (a load that shifted, drag, a gyro that drifted or is late), some of these in
stretches that last, and 20 % are in seas. `casid.fleet` diagnoses them; those with a cause that
the screening dismissed are then searched one by one in full, which says what it loses. Records with
a cause, in seas and in calm water, up to 25 of each kind spread over the fleet, are all searched in
full, which says what it saves: each kind counts as the fleet has it. Then the main process
of 40 of them is killed (kill -9) at random moments. With --out, a run that was stopped goes on.

Targets: false discoveries at most 5 % (of 10 000 voyages the upper bound of their 95 % interval at
most 6.5 %), power at least 95 % of what the same records reach singly at
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
TIMED, QUICK_TIMED = 25, 4  # records of each kind whose full search is timed
LEVEL = 0.05
UPPER, MANY = 0.065, 10_000  # bound of the rate of false discoveries, of as many voyages or more
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
    fleet : with the screening over all.
    dismissed : without it, of the records with a cause that the screening dismissed, if any.
    """

    truth: dict[str, Voyage]
    fleet: casid.Fleet
    dismissed: casid.Fleet | None

    @property
    def discovered(self) -> set[str]:
        """Records that are discoveries at the level."""
        rows = self.fleet.records
        return set(rows["record"][rows["discovered"]])

    @property
    def alone(self) -> set[str]:
        """Records with a cause that are deficient when they are diagnosed singly.

        A search in full knows nothing of the screening.
        """
        every = [self.fleet.records]
        if self.dismissed is not None:
            every.append(self.dismissed.records)
        found = {n for rows in every for n in rows["record"][rows["p"] <= LEVEL]}
        return found & self.caused

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
        rows = fleet.records
        screened = set(rows["record"][rows["stage"] == "screened"])
        lost = [v for v in voyages if v.cause and v.name in screened]
        judged = Judged(truth, fleet, _in_full(lost, folder, "dismissed", options.jobs)[0])
        run.output.table("voyages", [asdict(v) for v in voyages])
        if run.folder is not None:
            fleet.write(folder / "fleet")
        yield from _errors(judged, quick=quick)
        yield from _screening(judged)
        full = _cost_in_full(voyages, folder, options.jobs, QUICK_TIMED if quick else TIMED)
        if cost.records == len(files) and full is not None:
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


def _in_full(
    voyages: Sequence[Voyage], folder: Path, name: str, n_jobs: int
) -> tuple[casid.Fleet | None, Cost | None]:
    """Voyages without the screening, in a folder of that name; None of no voyages."""
    if not voyages:
        return None, None
    files = [folder / "voyages" / v.name for v in voyages]
    return of_fleet(files, folder / name, n_jobs, screen=False)


def _cost_in_full(voyages: Sequence[Voyage], folder: Path, n_jobs: int, timed: int) -> float | None:
    """Processor seconds a record that the full search takes, each kind as the fleet has it.

    Searches in seas take several times as long as others, and a few of them far longer: a sample
    over all kinds would have as many of these as chance has it. The start of the processes, which
    the fleet makes once, does not count. None where a run was stopped.
    """
    calm = [v for v in voyages if not v.cause and not v.sea]
    kinds = {
        "in calm water": calm,
        "in seas": [v for v in voyages if not v.cause and v.sea],
        "with a cause": [v for v in voyages if v.cause],
    }
    costs = {"one alone": _in_full(calm[:1], folder, "one alone", n_jobs)[1]}
    for name, every in kinds.items():
        places = np.unique(np.linspace(0, len(every) - 1, min(timed, len(every))).astype(int))
        costs[name] = _in_full([every[i] for i in places], folder, name, n_jobs)[1]
    if any(cost is None or not cost.records for cost in costs.values()):
        return None
    took = {name: (cost.processor, cost.records) for name, cost in costs.items() if cost}
    whole, n = took["in calm water"]
    start = took["one alone"][0] - (whole - took["one alone"][0]) / max(n - 1, 1)
    shares = {name: len(every) / len(voyages) for name, every in kinds.items()}
    return sum(share * (took[k][0] - start) / took[k][1] for k, share in shares.items())


def _errors(j: Judged, *, quick: bool) -> Iterator[Target | str]:
    found, caused = j.discovered, j.caused
    false, of = len(found - caused), max(len(found), 1)
    yield "errors over the fleet"
    r = rate(false, of)
    yield holds(
        "false discoveries (Benjamini-Hochberg)",
        f"{false} of {len(found)}, up to {100 * r['high']:.1f} %",
        "at most 5 %, of 10 000 voyages up to 6.5 %",
        stays_within(false, of, LEVEL, quick=quick or len(found) < RECORDS)
        and (r["high"] <= UPPER or len(j.truth) < MANY),
    )
    e = j.fleet.records
    by_e = set(e["record"][e["discovered_e"]])
    text = f"{len(by_e - caused)} of {len(by_e)}"
    yield holds(
        "false discoveries (e-BH)", text, "at most 5 %", len(by_e - caused) <= LEVEL * len(by_e)
    )
    alarms = set(e["record"][e["alarm"]])
    yield f"alarms on arrival (LORD++): {len(alarms & caused)} right, {len(alarms - caused)} false"
    alone = j.alone
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
    alone = j.alone
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
