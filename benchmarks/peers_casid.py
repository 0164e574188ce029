"""The task solved by casid: its model, its gradient, its solver, by the public names only."""

from __future__ import annotations

import casadi as ca

import casid
from benchmarks.oscillator import START, TS, read_record, report


def problem() -> casid.Problem:
    """The oscillator as a casid problem."""
    m = casid.Model("mass, spring and quadratic damper")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("F", "N", hold="foh")
    mass = m.parameter("m", "kg", start=START["m"], lower=1e-3)
    d = m.parameter("d", "N s/m", start=START["d"])
    d_2 = m.parameter("d_2", "N s^2/m^2", start=START["d_2"])
    k = m.parameter("k", "N/m", start=START["k"])
    m.derivative(x, v)
    terms = [-d * v, -d_2 * ca.fabs(v) * v, -k * x, force]
    m.balance(v, "force", inertia=mass, terms=terms)
    m.output("position", x, "m")
    return casid.Problem("oscillator", m)


def main() -> None:
    """Fit and report."""
    force, position = read_record()
    record = casid.Record(
        channels={"F": force, "position": position}, units={"F": "N", "position": "m"}, Ts=TS
    )
    estimate = casid.identify(problem(), record, settings=casid.FitSettings(starts=1, substeps=1))
    (rmse,) = (by_output["position"] for by_output in estimate.rmse.values())
    rows = [*estimate.parameters, *estimate.initial_states]
    report(len(position) * rmse**2, {row.name: row.value for row in rows})


if __name__ == "__main__":
    main()
