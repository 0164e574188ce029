"""The recursion of many tangents as machine code, where there is a C compiler.

The steps are those of `wide_tangents`, with the tangents of a sample carried from stage to stage:
they stay in the processor's cache, where arrays over samples go through memory a dozen times.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.integration.machine_code import compiled_formula, compiled_loop

LEAST = 4000
"""Steps of a record from which compiling, 0.3 s, takes less time than it saves."""

_LOOP = """
/* A formula: its code and numbers, the constants that it takes, and the places of its derivatives
   in parameters, which follow its value (n) and its derivatives in states, column by column. */
typedef struct {
  step_t code; double *numbers; const double *own; const long long *row, *column;
  long long n, rows, count;
} formula;

/* tangent (rows, width) = A (rows, nf) reached (nf, width) + B, of a formula's results. */
static void along(const formula *of, const double *found, const double *reached,
                  long long nf, long long width, double *tangent) {
  const double *a = found + of->n, *slopes = a + of->rows * nf;
  long long i, j, c;
  for (i = 0; i < of->rows; ++i) {
    double *to = tangent + i * width;
    for (c = 0; c < width; ++c) to[c] = 0;
    for (j = 0; j < nf; ++j) {
      const double factor = a[j * of->rows + i], *from = reached + j * width;
      if (factor != 0) for (c = 0; c < width; ++c) to[c] += factor * from[c];
    }
  }
  for (c = 0; c < of->count; ++c) tangent[of->row[c] * width + of->column[c]] += slopes[c];
}

static void evaluate(const formula *of, const double *x, const double *u, const double *u_next,
                     const double *place, double *found) {
  const double *arg[5];
  double *res[1];
  arg[0] = x; arg[1] = u; arg[2] = u_next; arg[3] = of->own; arg[4] = place;
  res[0] = found;
  of->code(arg, res, 0, of->numbers, 0);
}

EXPORTED
void loop(const formula *rate, const formula *out, const formula *late, const long long *sizes,
          const double *x, const double *after, const double *u, const double *u_next,
          const double *places, double Ts, double *state, double *dy, double *dlate,
          double *room) {
  const long long count = sizes[0], substeps = sizes[1], nx = sizes[2], nu = sizes[3];
  const long long at = sizes[4], nf = sizes[5], width = sizes[6], all = nf * width;
  static const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
  static const int instant[4] = {0, 1, 1, 2};
  double *here = room, *point = here + nx, *k = point + nx, *mean = k + nx;
  double *dk = mean + nx, *dmean = dk + all, *reached = dmean + all, *found = reached + all;
  long long n, i, j, s;
  const unsigned long long before = flush_subnormal();
  for (n = 0; n < count; ++n) {
    const double *at_n = places + n * substeps * 3 * at;
    const double *u_n = u + n * nu, *next_n = u_next + n * nu;
    evaluate(out, x + n * nx, u_n, next_n, at_n, found);
    along(out, found, state, nf, width, dy + n * out->rows * width);
    for (j = 0; j < nx; ++j) here[j] = x[n * nx + j];
    for (i = 0; i < substeps; ++i) {
      const double *at_i = at_n + i * 3 * at;
      const double h = Ts * (at_i[2 * at] - at_i[0]);
      for (j = 0; j < nx; ++j) k[j] = mean[j] = 0;
      for (j = 0; j < all; ++j) dk[j] = dmean[j] = 0;
      for (s = 0; s < 4; ++s) {
        for (j = 0; j < nx; ++j) point[j] = here[j] + reach[s] * h * k[j];
        for (j = 0; j < all; ++j) reached[j] = state[j] + reach[s] * h * dk[j];
        evaluate(rate, point, u_n, next_n, at_i + instant[s] * at, found);
        along(rate, found, reached, nf, width, dk);
        for (j = 0; j < nx; ++j) { k[j] = found[j]; mean[j] += weight[s] * k[j]; }
        for (j = 0; j < all; ++j) dmean[j] += weight[s] * dk[j];
      }
      for (j = 0; j < nx; ++j) here[j] += h / 6 * mean[j];
      for (j = 0; j < all; ++j) state[j] += h / 6 * dmean[j];
    }
    if (late->rows) {
      const double *end = at_n + ((substeps - 1) * 3 + 2) * at;
      evaluate(late, after + n * nx, u_n, next_n, end, found);
      along(late, found, state, nf, width, dlate + n * late->rows * width);
    }
  }
  restore(before);
}
"""
_ARGUMENTS = (*[ctypes.c_void_p] * 9, ctypes.c_double, *[ctypes.c_void_p] * 4)


class _Formula(ctypes.Structure):
    _fields_ = (
        *[(name, ctypes.c_void_p) for name in ("code", "numbers", "own", "row", "column")],
        *[(name, ctypes.c_longlong) for name in ("n", "rows", "count")],
    )


@dataclass(frozen=True, slots=True, eq=False)
class Formula:
    """A value and its derivatives, (n,), then (rows, nf) by columns, then those at `places`.

    Attributes
    ----------
    code : address of the function (x, u, u_next, own, place) -> what stands above, and its numbers.
    places : rows and columns of the derivatives in parameters that are not zero.
    """

    code: tuple[ctypes.c_void_p, Array]
    n: int
    rows: int
    places: tuple[Array, Array]

    @classmethod
    def of(cls, function: Any, n: int, rows: int, places: tuple[Array, Array]) -> Formula | None:
        """The same of a CasADi function; None where nothing can be compiled."""
        code = compiled_formula(function)
        row, column = (each.astype(np.int64) for each in places)
        return None if code is None else cls(code, n, rows, (row, column))

    def for_loop(self, own: Array) -> _Formula:
        """As the loop takes it, with its constants `own`, which have to outlive it."""
        address, numbers = self.code
        row, column = self.places
        pointers = (each.ctypes.data for each in (numbers, own, row, column))
        return _Formula(address, *pointers, self.n, self.rows, len(row))


@dataclass(frozen=True, slots=True, eq=False)
class CompiledTangents:
    """The recursion of a model's tangents, with the formulas of its rates and outputs."""

    loop: Any
    rate: Formula
    out: Formula
    late: Formula

    @classmethod
    def of(cls, formulas: Sequence[Formula | None]) -> CompiledTangents | None:
        """The same, or None where there is no compiler."""
        rate, out, late = formulas
        loop = compiled_loop(_LOOP, _ARGUMENTS, "-O3")
        if loop is None or rate is None or out is None or late is None:
            return None
        return cls(loop, rate, out, late)

    def along(
        self,
        motion: tuple[Array, Array, Array, Array, Array],
        constants: Sequence[Array],
        Ts: float,
        start: Array,
    ) -> tuple[Array, Array, Array]:
        """Tangents of the outputs (N, ny, nc), of the late ones, and of the last state (nf, nc).

        Parameters
        ----------
        motion : states, those a sample later, inputs, those a sample later, and places.
        constants : that the formulas take in the place of the parameters.
        start : (nf, nc) tangents of the first state; nc are parameters, then initial states.
        """
        x, _, u, _, places = motion
        (N, nx), (nf, width) = x.shape, start.shape
        formulas = (self.rate, self.out, self.late)
        own = [np.ascontiguousarray(each, dtype=float) for each in constants]
        given = [f.for_loop(c) for f, c in zip(formulas, own, strict=True)]
        dy, late = (np.empty((N, f.rows, width)) for f in formulas[1:])
        state = np.array(start, dtype=float, order="C")
        sizes = np.array([N, places.shape[1], nx, u.shape[1], places.shape[3], nf, width])
        longest = max(f.n + f.rows * nf + len(f.places[0]) for f in formulas)
        room = np.empty(4 * nx + 3 * nf * width + longest)
        arrays = [np.ascontiguousarray(each, dtype=float) for each in motion]
        written = [each.ctypes.data for each in (state, dy, late, room)]
        self.loop(
            *(ctypes.byref(each) for each in given),
            sizes.astype(np.int64).ctypes.data,
            *(each.ctypes.data for each in arrays),
            Ts,
            *written,
        )
        return dy, late, state
