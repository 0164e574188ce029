"""A load that is put aboard a ship under way is noticed within minutes, from waves and rudder.

    python -m analysis.load_monitoring [--quick] [--out DIR]

A model ship (1:24, 22 kg) zigzags by 10 deg every 10 s in waves of a significant height of 0.3 m
at full scale. It was calibrated once, empty and with 0.2 kg; it sails with these, and another
0.2 kg (0.9 %) come aboard. A monitor (`parameter_monitor`) gets the moments of every
20 s, reports m, zbar_m, GM and k + S g with 95 % intervals every minute, and raises an alarm where
the load has changed or where k + S g may be below 3 N m/rad.

Shown: false alarms in 24 h of simulated time, the delay of detection, coverage of the intervals,
and the trade-off between delay and false alarms. The ship is the nonlinear one, the model that
watches it is linear; what it gets wrong alike before and after is taken out by a reference stretch
of half an hour with the known load. What it gets wrong in the calibration stays in the parameters:
K_r and K_vdot are off by more than their errors, which the monitor hardly notices, as a change of
load is judged by what it changes. --quick: 3 h instead of 24 h, 2 runs of each load instead of
6. Exit 1 where a target is missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.common.runner import Run, Study, sections
from analysis.common.targets import Target, at_most
from analysis.load_monitoring.records import ABOARD, PERIOD, TS, Calibration, calibrate, instruments
from casid.arrays import Array
from casid.estimation.cross_moments.gram import Moments
from casid.estimation.moments.change_detection import ChangeDetector
from casid.identification.monitor_status import Derived, MonitorSettings, Status
from casid.identification.parameter_monitor import Monitor
from casid.identification.window_estimator import MonitoredParameters
from problems import ship
from problems.ship_4dof import Load, Ship, stability

DAY = 86_400.0
RATE = 0.2 * PERIOD / DAY  # a window: expected false alarms in a day at most 0.2
RATES = (0.01, 0.2, 1.0, 10.0, 50.0, 200.0)  # a day, for the curve
ADDED = (0.02, 0.05, 0.1, 0.2)  # kg
LIMIT = 3.0  # N m/rad
SETTLE = 5 * PERIOD  # s that the windows leave out
BEFORE, AFTER = 1200.0, 600.0  # s in each run
TRAINING, MEMORY = 30, 180  # windows: 10 minutes, 1 hour
SPAN = 15  # windows: 5 minutes


def margin(values: Mapping[str, float]) -> float:
    """k + S g [N m/rad] (8.9)-(8.10)."""
    v = ship.TABLE_8_2
    z_f = values["z_f"]
    S = v["M"] * (v["zbar_g"] + z_f) + values["m"] * (values["zbar_m"] + z_f)
    return values["k"] + S * v["g"]


def metacentric_height(values: Mapping[str, float]) -> float:
    """GM [m]: (k + S g)/((M + m) g); k has no part that grows with the speed here."""
    v = ship.TABLE_8_2
    return margin(values) / ((v["M"] + values["m"]) * v["g"])


def truth(load: Load) -> dict[str, float]:
    """What should be found with a load."""
    hull = Ship()
    GM = stability(hull, load).GM
    return {
        "m": load.m,
        "zbar_m": load.zbar_m,
        "GM": GM,
        "k + S g": GM * (hull.M + load.m) * hull.g,
    }


def with_more(added: float) -> Load:
    """The load aboard and so many more kilograms at the same height."""
    return Load(ABOARD.m + added, ABOARD.zbar_m)


def detector(rate: float = RATE) -> ChangeDetector:
    """Of so many false alarms a window."""
    return ChangeDetector(rate, training=TRAINING, memory=MEMORY)


def watcher(found: Calibration, reference: Sequence[Moments]) -> Monitor:
    """A monitor of the ship with the calibration weight aboard.

    Of a load's height it is taken as known that it is the calibration's within 0.05 m.
    """
    return Monitor(
        ship.problem.model,
        Ts=TS,
        parameters=MonitoredParameters(
            found.known,
            free={"m": ABOARD.m, "zbar_m": ABOARD.zbar_m},
            start={"zbar_m": (ABOARD.zbar_m, 0.05)},
        ),
        reference=reference,
        instruments=instruments(),
        detector=detector(),
        derived={
            "GM": Derived(metacentric_height, "m"),
            "k + S g": Derived(margin, "N m/rad", LIMIT),
        },
        settings=MonitorSettings(every=round(60.0 / PERIOD), span=SPAN),
    )


def watched(
    found: Calibration,
    reference: Sequence[Moments],
    legs: Sequence[tuple[Load, float]],
    *,
    seed: int,
) -> Monitor:
    """A monitor after a voyage; time counts from the end of SETTLE."""
    monitor = watcher(found, reference)
    for window in found.stream(legs, seed=seed):
        monitor.add(window)
    return monitor


def levels(monitor: Monitor) -> tuple[Array, Array]:
    """Times [s] and p-values of a detector that is not started anew by alarms, (n,) each."""
    other, found = detector(), []
    for time, vector, scale in monitor.vectors:
        change = other.add(vector, scale)
        if change is not None:
            found.append((time, change.p_value))
    times, p = np.array(found).T
    return times, p


def alarm_times(levels_: tuple[Array, Array], rate: float) -> list[float]:
    """Alarms at another rate a window [s]; after each the detector learns for TRAINING windows."""
    found: list[float] = []
    for time, p in zip(*levels_, strict=True):
        if p < rate and (not found or time > found[-1] + TRAINING * PERIOD):
            found.append(float(time))
    return found


def covered(statuses: Sequence[Status], load: Load, every: int = SPAN // 3) -> dict[str, float]:
    """Share of intervals that hold the truth, of those that share no window [%]."""
    chosen, wanted = statuses[every - 1 :: every], truth(load)
    return {
        name: 100.0 * float(np.mean([s[name].lower <= t <= s[name].upper for s in chosen]))
        for name, t in wanted.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class Voyages:
    """What was simulated: a long voyage without a change, and short ones with one."""

    hours: float
    quiet: Monitor
    runs: Mapping[float, Sequence[Monitor]]
    example: Monitor
    levels: Mapping[float, Sequence[tuple[Array, Array]]]  # of quiet (0) and of the runs

    def delays(self, added: float, rate: float = RATE) -> Array:
        """(n,) from change to alarm [s]; infinite where there was none."""
        found = []
        for times, p in self.levels[added]:
            late = times[(times > BEFORE + 0.5 * PERIOD) & (p < rate)]
            found.append(float(late[0]) - BEFORE if late.size else math.inf)
        return np.array(found)

    def false_alarms(self, rate: float = RATE) -> float:
        """Per 24 h."""
        return len(alarm_times(self.levels[0.0][0], rate)) * 24.0 / self.hours


def monitored(hours: float, runs: int, *, sizes: Sequence[float] = ADDED) -> Voyages:
    """Simulate everything."""
    found = calibrate()
    reference = found.stream([(ABOARD, 1800.0 + SETTLE)], seed=11)
    print("Calibration, random steps of the rudder, empty and with 0.2 kg")
    errors = np.sqrt(np.diag(found.known.matrix()))
    for (name, value), error in zip(found.known.values.items(), errors, strict=True):
        print(f"  {name:<8}{value:>10.4f} +- {error:<10.4f}true {ship.TABLE_8_2[name]:g}")
    for remark in found.remarks:
        print(f"  {remark}")
    quiet = watched(found, reference, [(ABOARD, hours * 3600.0 + SETTLE)], seed=21)
    changed = {
        added: [
            watched(
                found,
                reference,
                [(ABOARD, BEFORE + SETTLE), (with_more(added), AFTER)],
                seed=100 + 10 * i + j,
            )
            for j in range(runs)
        ]
        for i, added in enumerate(sizes)
    }
    legs = [(ABOARD, 1200.0 + SETTLE), (with_more(0.2), 1200.0), (with_more(0.6), 900.0)]
    every = {0.0: [levels(quiet)]} | {a: [levels(r) for r in rs] for a, rs in changed.items()}
    return Voyages(hours, quiet, changed, watched(found, reference, legs, seed=31), every)


# -- what is shown ---------------------------------------------------------------------------------


def detection(s: Voyages) -> list[Target]:
    """Delays and false alarms at the rate that is set."""
    delay = s.delays(0.2)
    quiet = [a for a in s.quiet.alarms if a.kind == "change"]
    too_soon = sum(
        a.kind == "change" and a.time < BEFORE + 0.5 * PERIOD
        for runs in s.runs.values()
        for run in runs
        for a in run.alarms
    )
    print("  alarms of the run that took longest, 0.2 kg:")
    for alarm in s.runs[0.2][int(np.argmax(delay))].alarms:
        print(f"    {alarm}")
    return [
        at_most("0.2 kg on 22 kg: longest delay of detection", float(delay.max()), 300.0, "s"),
        at_most(f"false alarms in {s.hours:g} h", len(quiet), math.ceil(s.hours / 24.0), ""),
        at_most("false alarms before the change in all runs", too_soon, 1, ""),
    ]


def margins(s: Voyages) -> list[Target]:
    """The alarm of a small margin, raised when it is and not when it is not."""
    print("  alarms of the voyage with 0.2, 0.4, 0.8 kg:")
    for alarm in s.example.alarms:
        print(f"    {alarm}")
    limits = [a for a in s.example.alarms if a.kind == "limit"]
    first = limits[0].time - 2400.0 if limits else math.inf
    false = sum(a.kind == "limit" for a in s.quiet.alarms)
    return [
        at_most(f"k + S g = {truth(with_more(0.6))['k + S g']:.2f}: delay", first, 300.0, "s"),
        Target("no alarm of the margin before that load", f"{first:.0f} s", "> 0 s", first > 0.0),
        at_most(f"false alarms of the margin in {s.hours:g} h", false, 0, ""),
    ]


def intervals(s: Voyages) -> list[Target]:
    """Coverage of five minutes' intervals, without a change and after one."""
    quiet = covered(s.quiet.status, ABOARD)
    last = [run.status[-1] for run in s.runs[0.2]]
    after = covered(last, with_more(0.2), 1)
    typical = s.quiet.status[-1]
    for name, share in quiet.items():
        held = f"{share:.1f} % ({after[name]:.0f} % with 0.4 kg)"
        print(f"  {name:<8} true {truth(ABOARD)[name]:.4g}, typically {typical[name]}: {held}")
    n = len(s.quiet.status) // (SPAN // 3)
    slack = 100.0 * 3.0 * math.sqrt(0.95 * 0.05 / n)
    return [
        Target(
            f"95 % interval of {name} holds the truth, {n} spans of 5 min",
            f"{quiet[name]:.1f} %",
            f">= {95.0 - slack:.1f} %",
            quiet[name] >= 95.0 - slack,
        )
        for name in ("m", "zbar_m")
    ]


def trade_off(s: Voyages) -> list[Target]:
    """Delay against false alarms, and whether the rate that is stated holds."""
    print(
        "  stated, a day   seen in 24 h   "
        + "".join(f"{f'+{added:g} kg':>18}" for added in s.runs)
        + "   median (found) delay, s"
    )
    out = []
    for rate in RATES:
        seen = s.false_alarms(rate * PERIOD / DAY)
        cells = []
        for added in s.runs:
            d = s.delays(added, rate * PERIOD / DAY)
            cells.append(f"{np.median(d):>10.0f} ({np.isfinite(d).sum()}/{d.size})")
        print(f"  {rate:>13g}{seen:>15.1f}   " + "".join(f"{c:>18}" for c in cells))
        expected = rate * s.hours / 24.0
        # Alarms are at most Poisson where they are rare; three standard deviations and one.
        limit = (expected + 3.0 * math.sqrt(expected) + 1.0) * 24.0 / s.hours
        out.append(at_most(f"at most {rate:g} false alarms a day stated: seen", seen, limit, ""))
    return out


def figure(s: Voyages) -> Any:
    """Delay against false alarms; and the mass over the voyage with three loads."""
    titles = (
        "Delay of detection against false alarms, as stated and as seen",
        "Load over a voyage: 0.2, 0.4, 0.8 kg, with 95 % intervals of up to 5 min",
    )
    chart = Chart("A load that comes aboard under way", 800, rows=2, subplot_titles=titles)
    rates = [rate * PERIOD / DAY for rate in RATES]
    seen = [s.false_alarms(rate) for rate in rates]
    for added in s.runs:
        medians = [float(np.median(s.delays(added, rate))) for rate in rates]
        y = [d if math.isfinite(d) else None for d in medians]
        for x, dash, what in ((list(RATES), "solid", "stated"), (seen, "dot", "seen")):
            chart.line(x, y, f"+{added:g} kg, {what}", dash=dash, mode="lines+markers")
    t = [status.time / 60.0 for status in s.example.status]
    m = [status["m"] for status in s.example.status]
    bare: dict[str, Any] = {"at": (2, 1), "line": {"width": 0}}
    chart.line(t, [i.upper for i in m], **bare)
    chart.line(t, [i.lower for i in m], "95 % interval of m", fill="tonexty", **bare)
    chart.line(t, [i.value for i in m], "m", "#1b9e77", at=(2, 1))
    for alarm in s.example.alarms:
        colour = "#d95f02" if alarm.kind == "change" else "#7570b3"
        chart.figure.add_vline(x=alarm.time / 60.0, line_color=colour, row=2, col=1)
    chart.x_axis("false alarms a day", type="log", row=1)
    chart.y_axis("median delay [s]", row=1)
    chart.x_axis("time [min]", row=2)
    chart.y_axis("mass of the load m [kg]", row=2)
    return chart.figure


SECTIONS = {
    "Detection": detection,
    "Small margin": margins,
    "Intervals of m, zbar_m, GM, k + S g, every minute": intervals,
    "Trade-off": trade_off,
}


def study(run: Run) -> Iterator[Target | str]:
    """All targets, a section at a time."""
    hours, runs = (3.0, 2) if run.quick else (24.0, 6)
    if run.quick:
        print(f"quick: {hours:g} h without a change instead of 24 h, {runs} runs of each load")
    s = monitored(hours, runs)
    yield from sections(SECTIONS, s)
    if run.folder is not None:
        run.output.figure("load_monitoring", figure(s))


STUDY = Study(
    study,
    quick="3 h and 2 runs of each load",
    out="folder for load_monitoring.json and .html",
    file="load_monitoring.json",
)
