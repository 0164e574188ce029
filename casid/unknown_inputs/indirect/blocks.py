"""Transfer matrices as blocks of a larger one; a block without rows or columns is allowed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from casid.algebra.rational import Rational
from casid.algebra.roots import Root
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import Array


def zeros(outputs: Sequence[str], inputs: Sequence[str]) -> RationalMatrix:
    """The zero matrix with these names; either may be none."""
    row = tuple(Rational(()) for _ in inputs)
    return RationalMatrix(tuple(row for _ in outputs), tuple(outputs), tuple(inputs))


def identity(names: Sequence[str]) -> RationalMatrix:
    """The identity matrix with these names."""
    one, zero = Rational.shift() ** 0, Rational(())
    rows = tuple(
        tuple(one if i == k else zero for k in range(len(names))) for i in range(len(names))
    )
    return RationalMatrix(rows, tuple(names), tuple(names))


def product(a: RationalMatrix, b: RationalMatrix) -> RationalMatrix:
    """a b, also where they share no signal."""
    if 0 in a.shape or 0 in b.shape:
        return zeros(a.outputs, b.inputs)
    return a @ b


def difference(a: RationalMatrix, b: RationalMatrix) -> RationalMatrix:
    """a - b, also of empty blocks."""
    return a if 0 in a.shape else a - b


def beside(*blocks: RationalMatrix) -> RationalMatrix:
    """Blocks with the same rows put side by side."""
    first = blocks[0]
    rows = tuple(tuple(g for block in blocks for g in block.rows[i]) for i in range(first.shape[0]))
    return RationalMatrix(rows, first.outputs, tuple(n for b in blocks for n in b.inputs))


def same(a: RationalMatrix, b: RationalMatrix) -> bool:
    """Whether two blocks are equal, decided exactly."""
    return a.shape == b.shape and (0 in a.shape or a.equals(b))


def frequency_grid(matrices: Sequence[RationalMatrix], points: int = 400) -> Array:
    """(F,) frequencies [rad/s] that show a transfer matrix.

    In discrete time evenly up to half the sampling frequency; in continuous time geometrically,
    two decades to either side of the poles and zeros. [rad/sample] where Ts is not known.
    """
    entries = [g for m in matrices for row in m.rows for g in row if not g.is_zero]
    Ts = next((g.Ts for g in entries if g.Ts), None) or 1.0
    if not any(g.variable == "s" for g in entries):
        return np.asarray(np.pi / Ts * (np.arange(points) + 0.5) / points)
    found = [r.frequency for g in entries for r in (*g.poles(), *g.zeros())]
    speeds = [w for w in found if w > 0 and np.isfinite(w)] or [1.0]
    return np.geomspace(min(speeds) / 100, max(speeds) * 100, points)


def is_stable(matrix: RationalMatrix) -> bool:
    """Whether every entry is stable: by its poles in floats, exactly where they are near the edge.

    The exact test alone takes fractions whose length doubles with every degree.
    """
    return all(_is_stable(g) for row in matrix.rows for g in row)


def _is_stable(g: Rational) -> bool:
    poles = np.array([r.value for r in g.poles()])
    inside = -poles.real if g.variable == "s" else 1 - np.abs(poles)
    size = np.maximum(np.abs(poles), 1e-9) if g.variable == "s" else np.ones(len(poles))
    if np.all(inside > 1e-3 * size):  # multiple roots are found to a few digits only
        return True
    return False if np.any(inside < -1e-2 * size) else g.is_stable


def lies_outside(root: Root) -> bool:
    """Whether a root in floats is not stable; on the edge, to rounding, it is not."""
    v = root.value
    return v.real >= -1e-7 * abs(v) if root.variable == "s" else abs(v) >= 1 - 1e-7


def unstable_poles(matrix: RationalMatrix) -> tuple[Root, ...]:
    """Poles of entries that are not stable, each once."""
    found: list[Root] = []
    for row in matrix.rows:
        for g in row:
            for r in g.poles():
                if lies_outside(r) and not any(abs(r.value - k.value) < 1e-7 for k in found):
                    found.append(r)
    return tuple(found)


def noise_gain(matrix: RationalMatrix, weights: Array | None = None) -> float:
    """Root mean square over the frequencies of what white noise of size one does through it.

    `weights` : (columns,) standard deviations instead of one.
    """
    if 0 in matrix.shape:
        return 0.0
    response = np.abs(matrix.frequency_response(frequency_grid([matrix]))) ** 2
    sd = np.ones(matrix.shape[1]) if weights is None else np.asarray(weights, dtype=float)
    return float(np.sqrt(np.mean(np.sum(response * sd**2, axis=(1, 2)))))


def improper_entries(matrix: RationalMatrix) -> Iterator[tuple[str, str, Rational]]:
    """Output, input and transfer function of every entry that looks into the future."""
    for output, row in zip(matrix.outputs, matrix.rows, strict=True):
        for name, g in zip(matrix.inputs, row, strict=True):
            if not g.is_zero and not g.is_proper:
                yield output, name, g


def excess(matrix: RationalMatrix) -> int:
    """How far a matrix is improper: samples it looks ahead, or derivatives that it takes."""
    return max((-g.relative_degree for _, _, g in improper_entries(matrix)), default=0)
