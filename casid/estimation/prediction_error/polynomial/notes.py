"""What spoils a polynomial estimate: offsets, transients, roots near the unit circle."""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.solution import Solution
from casid.estimation.prediction_error.polynomial.orders import (
    Layout,
    Polynomials,
    settling,
)
from casid.estimation.prediction_error.polynomial.start_values import Data
from casid.linear.stability import largest_root

NEAR = 0.999  # a root with this modulus or more is at the unit circle


def offsets(data: Data) -> tuple[str, ...]:
    """Records whose mean is larger than their spread, which a model without an offset fits."""
    notes = []
    for k, (y, u) in enumerate(data):
        where = f" of record {k + 1}" if len(data) > 1 else ""
        for name, x in (("y", y), *u.items()):
            mean, spread = float(np.mean(x)), float(np.std(x))
            if spread > 0 and abs(mean) > spread:
                notes.append(
                    f"{name}{where} has mean {mean:.3g} and spread {spread:.3g}, and the model has "
                    "no offset: take the means off, or give an input of ones"
                )
    return tuple(notes)


def long_transients(
    layout: Layout, theta: Array, data: Data, discarded: tuple[int, ...]
) -> tuple[str, ...]:
    """Records too short to discard the start-up transient of the estimate."""
    name, radius = at_circle(layout, theta)
    p = layout.split(theta)
    settle = settling(p.C, *p.F)
    notes = []
    for k, ((y, _), d) in enumerate(zip(data, discarded, strict=True)):
        if 0.1 < radius <= NEAR and radius ** (d - layout.longest_lag) > 0.1:
            notes.append(
                f"the transient of 1/{name} needs {settle} samples to fall to 1 %, but only {d} of "
                f"the {len(y)} of record {k + 1} are discarded: what came before it may bias the "
                "estimate"
            )
    return tuple(notes)


def at_circle(layout: Layout, theta: Array) -> tuple[str, float]:
    """The polynomial, C or an F, with the root nearest to the unit circle, and its modulus."""
    p = layout.split(theta)
    near = [("C", largest_root(p.C))]
    near += [(f"F[{i}]", largest_root(f)) for i, f in zip(layout.inputs, p.F, strict=True)]
    return max(near, key=lambda item: item[1])


def failure(layout: Layout, solution: Solution) -> str:
    """Why a search ended without an optimum, and how to fix it."""
    name, radius = at_circle(layout, solution.x)
    why = solution.remedy
    if radius > NEAR:
        why = (
            f"the search ran to a root of {name} of modulus {radius:.6f}, on the unit circle, "
            "where the predictor is no longer stable. "
        )
        why += (
            "Lower nc, or do not difference the data more than they need"
            if name == "C"
            else "Lower nf, or use A in place of F (ARMAX), which may be unstable"
        )
    return (
        f"{layout.structure}: {solution.ending} after "
        f"{solution.iterations} iterations (scaled gradient {solution.scaled_gradient:.1e}): {why}"
    )


def doubts(layout: Layout, p: Polynomials, smallest: float, no_noise: bool) -> list[str]:
    """What spoils numbers of the result, in sentences."""
    notes = []
    if no_noise and (layout.nc or layout.nd):
        notes.append("the data hold no noise: C and D mean nothing")
    elif smallest < 1e-7:
        notes.append(
            "polynomials nearly cancel (smallest eigenvalue of the scaled information "
            f"{smallest:.1e}): the orders are too high, and errors of single coefficients large"
        )
    stretch = [("C", p.C), *((f"F[{i}]", f) for i, f in zip(layout.inputs, p.F, strict=True))]
    for name, polynomial in stretch:
        if (radius := largest_root(polynomial)) > NEAR:
            notes.append(
                f"{name} has a root of modulus {radius:.6f}: transients last longer than "
                f"{int(1 / max(1 - radius, 1e-6))} samples, and normal errors are doubtful"
            )
    for name, polynomial in (("A", p.A), ("D", p.D)):
        if (radius := largest_root(polynomial)) >= 1:
            notes.append(f"{name} has a root of modulus {radius:.4f}: the model itself is unstable")
    return notes
