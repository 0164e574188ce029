"""Steps of a simulation as machine code, on machines that have a C compiler.

CasADi interprets a step operation by operation. Compiled, the same operations follow one another in
the same order, to the same result but for numbers below 2.3e-308, which are zero, in about a tenth
of the time. Compiling pays where a step is
taken often: it begins when the interpreter has taken about as long as the compiler will. What was
compiled is kept in a folder of the user's, one file a formula: the numbers in a formula (sample
time, scale of an effect, instant of a jump) are arguments, so that other records find it again. The
loop over samples is one file for all formulas.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.compiler import compiler, shared_library
from casid.errors import DataError

Steps = Callable[[Array, Array, Array, Array, Array, Array, Array, float], None]
"""Runs steps over samples: state (changed in place), inputs (N, nu) with their courses, inputs a
sample later, the parameters, the shares of a sample at which steps begin, have their middle and
end, kept states (N, nx) and outputs (N, ny), which it writes, all in C order; and to what share of
the states one step of a whole sample and two of half of it have to agree for the two to be taken,
0 where none are."""

LOOKED_FOR = 2000
"""Samples after which a step is looked for among those compiled before: reading its formula takes
as long as some hundred samples."""

SHORT = 1500
"""Operations of a step up to which it is optimised at once."""

COMPILED_AFTER = 8_000, 750
"""A longer step of n operations is translated as it is after the first number of samples times
(1 + the second / n): a compiler takes 25 ms and 33 us an operation, and the interpreter, 4 or 5 ns
an operation and sample, four times as long as what it makes."""

OPTIMISED_AFTER = 25_000, 250, 90_000, 4000
"""A short step is optimised after the first number times (1 + the second / n), 0.1 ms an operation;
a longer one after the third, times n over the fourth: the time goes with the square of n, and what
comes out takes a quarter of what the step took as it is."""

FASTER = 8
"""Times that an operation takes longer interpreted than compiled, at least: 4.5 ns against half of
one."""

TO_COME = 4
"""Passes that are expected after the present one, which count as taken: a fit has ten or so."""

LARGEST = 100_000, 20_000
"""Operations beyond which a step is interpreted, and beyond which it is not optimised."""

KEPT = 2000
"""Compiled steps that the folder holds; the quarter that was not used for longest leaves it."""

_FLAGS = ("-ffp-contract=off", "-w")  # the operations as they are written, none fused
_LEVELS = ("-O0", "-O1")

_BARE = ("-nostdlib", "-nostartfiles") if sys.platform == "linux" else ()
"""A step calls nothing but mathematics, and linking is a quarter of what compiling it takes."""

_OF_ONE = "acos asin atan sinh cosh tanh exp log sqrt sin cos tan fabs floor ceil erf log1p expm1"
_OF_TWO = "pow fmod fmin fmax atan2 copysign hypot"
_MATHEMATICS = "".join(
    [f"double {name}(double);\n" for name in _OF_ONE.split()]
    + [f"double {name}(double, double);\n" for name in _OF_TWO.split()]
)
"""Instead of the header, which takes as long to read as a short step takes to compile."""

_EXPORTED = """
#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__ ((visibility ("default")))
#endif
"""

LOOP_BEGINS = (
    """
#include <math.h>
typedef int (*step_t)(const double **, double **, long long *, double *, int);
"""
    + _EXPORTED
    + """
/* Sensitivities to the beginning of a long record decay until they are subnormal, where an
   operation takes a hundred times as long: until `restore` is called, such numbers are zero. */
#if defined(__x86_64__)
static unsigned long long flush_subnormal(void) {
  const unsigned before = __builtin_ia32_stmxcsr();
  __builtin_ia32_ldmxcsr(before | 0x8040);
  return before;
}
static void restore(unsigned long long before) { __builtin_ia32_ldmxcsr((unsigned)before); }
#elif defined(__aarch64__)
static unsigned long long flush_subnormal(void) {
  unsigned long long before;
  __asm__ __volatile__("mrs %0, fpcr" : "=r"(before));
  __asm__ __volatile__("msr fpcr, %0" : : "r"(before | 1ull << 24));
  return before;
}
static void restore(unsigned long long before) {
  __asm__ __volatile__("msr fpcr, %0" : : "r"(before));
}
#else
static unsigned long long flush_subnormal(void) { return 0; }
static void restore(unsigned long long before) { (void)before; }
#endif
"""
)
"""Before the EXPORTED function `loop` of a C text, which calls formulas."""

_LOOP = """
EXPORTED
void loop(step_t step, const long long *sizes, long long count, long long substeps, double *state,
           const double *u, const double *after, const double *p, const double *shares,
           double *numbers, double *kept, double *out, double *room, double easy) {
  static const double parts[3][3] = {{0, 0.5, 1}, {0, 0.25, 0.5}, {0.5, 0.75, 1}};
  const long long n_state = sizes[0], n_out = sizes[1], row = sizes[2], nx = sizes[3];
  const long long nu = sizes[4], nb = sizes[5], *banded = sizes + 6;
  const long long inside = 2 * substeps - 1, width = nu + nb * inside;
  const double *arg[5];
  double *res[3];
  double *next = room, *once = next + n_state, *half = once + n_state;
  double *within = half + n_state, *spare = within + 3 * (1 + nb);
  long long k, i, j;
  int is_easy;
  const unsigned long long before = flush_subnormal();
  arg[3] = p;
  for (k = 0; k < count; ++k) {
    arg[0] = state; arg[1] = u + k * width; arg[2] = after + k * nu; arg[4] = within;
    res[0] = next;
    is_easy = easy > 0;
    if (is_easy) {
      arg[4] = parts[0]; res[0] = once; res[1] = out + k * row; res[2] = spare;
      step(arg, res, 0, numbers, 0);
      arg[4] = parts[1]; res[0] = half; res[1] = spare;
      step(arg, res, 0, numbers, 0);
      arg[0] = half; arg[4] = parts[2]; res[0] = next;
      res[2] = out + k * row + n_out;
      step(arg, res, 0, numbers, 0);
      for (j = 0; j < n_state; ++j)
        is_easy = is_easy
          && fabs(next[j] - once[j]) <= easy * fmax(fabs(state[j]), fabs(next[j]));
      arg[0] = state; arg[4] = within;
    }
    if (is_easy)
      for (j = 0; j < n_state; ++j) state[j] = next[j];
    for (i = 0; i < substeps && !is_easy; ++i) {
      for (j = 0; j < 3; ++j) within[j] = shares[2 * i + j];
      for (j = 0; j < nb; ++j) {
        const double begin = arg[1][banded[j]], end = arg[2][banded[j]];
        const double *course = arg[1] + nu + j * inside + 2 * i;
        within[3 + 3 * j] = i > 0 ? course[-1] : begin;
        within[4 + 3 * j] = course[0];
        within[5 + 3 * j] = i < substeps - 1 ? course[1] : begin + (end - begin);
      }
      res[1] = i > 0 ? spare : out + k * row;
      res[2] = i < substeps - 1 ? spare : out + k * row + n_out;
      step(arg, res, 0, numbers, 0);
      for (j = 0; j < n_state; ++j) state[j] = next[j];
    }
    for (j = 0; j < nx; ++j) kept[k * nx + j] = next[j];
  }
  restore(before);
}
"""
"""Through samples with any step: compiled once."""

_ARGUMENTS = (
    *[ctypes.c_void_p] * 2,
    *[ctypes.c_longlong] * 2,
    *[ctypes.c_void_p] * 9,
    ctypes.c_double,
)


class MachineCode:
    """The machine code of one step, once enough samples were taken for it to pay.

    Parameters
    ----------
    function : (state, inputs, inputs a sample later, parameters, place within the sample) -> (next
        state, outputs, outputs at the end), all dense columns; the place as in `Simulator`.
    nx : entries of the state that are kept of every sample.
    banded : columns of the inputs that are band-limited between samples.
    """

    def __init__(self, function: Any, nx: int, banded: Sequence[int] = ()) -> None:
        self._function = function
        n_out, row = function.numel_out(1), function.numel_out(1) + function.numel_out(2)
        sizes = [function.numel_out(0), n_out, row, nx, function.numel_in(1), len(banded), *banded]
        self._sizes = np.array(sizes, dtype=np.int64)  # as the loop reads them
        self._count = int(function.n_instructions())
        self._enough = _enough(self._count)
        self._taken = 0.0  # samples, as long as they take interpreted
        self._source: tuple[str, Array] | None = None
        self._steps: Steps | None = None
        self._level = 0  # of what was tried: interpreted, as it is, optimised

    def before(self, samples: int) -> Steps | None:
        """The steps over `samples` more, each substep a sample; None: to be interpreted."""
        if self._level == len(_LEVELS):
            return self._steps
        expected = self._taken + (1 + TO_COME) * samples
        self._taken += samples
        wanted = max((i + 1 for i, n in enumerate(self._enough) if expected >= n), default=0)
        if wanted > self._level or (self._source is None and self._taken >= LOOKED_FOR):
            self._find(wanted)
        return self._steps

    def stands_in_for(self, other: MachineCode, samples: int) -> bool:
        """Whether to take this longer step, which is compiled, for a part of it that is not yet.

        The part counts its samples by what they take so, and is compiled later or not at all.
        """
        share = self._count / (FASTER * other._count)
        if self._steps is None or other._steps is not None or share >= 1.0:
            return False
        if other._taken + (1 + TO_COME) * share * samples >= min(other._enough):
            return False
        other._taken += share * samples
        return True

    def _find(self, wanted: int) -> None:
        """Load the best that there is, compiling what is `wanted` where that is better."""
        folder = cache_folder()
        if folder is None or compiler() is None:
            self._level = len(_LEVELS)
            return
        if self._source is None:
            self._source = source_of(self._function)
        text, numbers = self._source
        for level in range(len(_LEVELS), self._level, -1):
            step = _library(text, _LEVELS[level - 1], folder, compile_it=level == wanted)
            loop = None if step is None else compiled_loop(_LOOP, _ARGUMENTS)
            if loop is not None:
                self._steps, self._level = _called(loop, step, self._sizes, numbers), level
                return
        self._level = max(self._level, wanted)


def _enough(n: int) -> tuple[float, float]:
    """Samples after which a step of `n` operations is compiled as it is, and optimised."""
    as_it_is, fixed = COMPILED_AFTER
    short, extra, long, square = OPTIMISED_AFTER
    if n <= SHORT:
        return np.inf, short * (1 + extra / max(n, 1))
    most, most_optimised = LARGEST
    return (
        as_it_is * (1 + fixed / n) if n <= most else np.inf,
        long * max(1.0, n / square) if n <= most_optimised else np.inf,
    )


def _called(loop: Any, step: Any, sizes: Array, numbers: Array) -> Steps:
    address = ctypes.cast(step, ctypes.c_void_p)
    n_state, _, row, _, _, banded, *_ = sizes.tolist()

    def steps(
        state: Array,
        u: Array,
        after: Array,
        p: Array,
        shares: Array,
        kept: Array,
        out: Array,
        easy: float,
    ) -> None:
        """Step through all samples in machine code; `kept` and `out` are written in place."""
        room = np.empty(3 * n_state + 3 * (1 + banded) + row + 1)
        arrays = (state, u, after, p, shares, numbers, kept, out, room)
        count, substeps = len(u), len(shares) // 2
        given = (each.ctypes.data for each in arrays)
        loop(address, sizes.ctypes.data, count, substeps, *given, easy)

    return steps


def source_of(function: Any) -> tuple[str, Array]:
    """C of a step, and the numbers that were taken out of it.

    They come as the working memory that CasADi's code takes, of which a formula needs none.
    """
    generator = ca.CodeGenerator(
        "step.c", {"with_header": False, "with_export": False, "verbose": False}
    )
    generator.add(function)
    numbers: list[float] = []

    def taken_out(match: re.Match[str]) -> str:
        numbers.append(float(match.group(1)))
        return f"=w[{len(numbers) - 1}];"

    text = str(generator.dump())
    text = re.sub(r"arg\[(\d)\]\? (arg\[\d\]\[\d+\]) : 0;", r"\2;", text)
    text = re.sub(r"if \(res\[\d\]!=0\) ", "", text)
    text = re.sub(r"=(-?\d[^;a-z\[]*(?:e[-+]\d+)?);", taken_out, text)
    (function_begins,) = re.finditer(r"^static (?=int casadi_f\d+\()", text, re.MULTILINE)
    helpers, step = text[: function_begins.start()], text[function_begins.end() :]
    step = step[: step.index("\n}\n") + 3].replace("casadi_f0(", "step(", 1)
    text = f"{helpers}{_EXPORTED}EXPORTED {step}"
    called = set(re.findall(r"\b([a-z]\w*)\(", re.sub(r"\w*(casadi|CASADI)\w*", "", text)))
    if called <= {*_OF_ONE.split(), *_OF_TWO.split(), "step", "sizeof"}:
        text = text.replace("#include <math.h>", _MATHEMATICS)
    return text, np.array(numbers)


def compiled_loop(text: str, arguments: tuple[Any, ...], level: str = _LEVELS[-1]) -> Any:
    """The function `loop` of a C text that goes over samples; None where it cannot be compiled."""
    folder = cache_folder()
    return None if folder is None else _loop(folder, text, arguments, level)


@functools.lru_cache(maxsize=8)
def _loop(folder: Path, text: str, arguments: tuple[Any, ...], level: str) -> Any:
    inside = folder / "loop"
    with contextlib.suppress(OSError):
        inside.mkdir(mode=0o700, exist_ok=True)
    entry = _library(LOOP_BEGINS + text, level, inside, compile_it=True)
    if entry is not None:
        entry.argtypes, entry.restype = arguments, None
    return entry


def compiled_formula(function: Any) -> tuple[ctypes.c_void_p, Array] | None:
    """The address of a formula's machine code, and its numbers; None where there is no compiler.

    It is compiled at once, if it was not before: whether it is does not depend on what was computed
    earlier, where what takes its place rounds otherwise.
    """
    folder = cache_folder()
    if folder is None or compiler() is None:
        return None
    text, numbers = source_of(function)
    level = _LEVELS[-1] if function.n_instructions() <= LARGEST[1] else _LEVELS[0]
    step = _library(text, level, folder, compile_it=True)
    return None if step is None else (ctypes.cast(step, ctypes.c_void_p), numbers)


@functools.lru_cache(maxsize=4096)
def _loaded(path: str) -> Any:
    """The function of a library; None where it cannot be loaded."""
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(path)
        return library.loop if Path(path).parent.name == "loop" else library.step
    return None


def _library(text: str, level: str, folder: Path, *, compile_it: bool) -> Any:
    """The compiled loop of a C text: from the folder, or compiled into it if `compile_it`.

    None where the folder does not hold it and it is not to be compiled, or cannot be.
    """
    what = "\n".join((text, level, *_FLAGS, sys.platform, platform.machine(), str(compiler())))
    path = folder / f"{hashlib.sha256(what.encode()).hexdigest()[:40]}.so"
    if path.exists():
        with contextlib.suppress(OSError):
            os.utime(path)
        return _loaded(str(path))
    if not compile_it:
        return None
    try:
        with tempfile.TemporaryDirectory(dir=folder) as inside:
            written = Path(inside, "step.c")
            written.write_text(text, encoding="utf-8")
            made = shared_library([written], Path(inside, path.name), level, *_FLAGS, *_BARE)
            made.replace(path)  # whole or not at all: others may be looking
        _forget_oldest(folder)
    except (OSError, DataError):
        return None
    return _loaded(str(path))


def _forget_oldest(folder: Path) -> None:
    """Remove the steps that were not used for longest, where there are more than `KEPT`."""
    kept = list(folder.glob("*.so"))
    if len(kept) > KEPT:
        for path in sorted(kept, key=lambda p: p.stat().st_mtime)[: len(kept) // 4]:
            path.unlink(missing_ok=True)


@functools.lru_cache(maxsize=8)
def _cache_folder(named: str | None) -> Path | None:
    if named == "":
        return None
    if named is not None:
        folder = Path(named)
    elif sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "casid"
    elif sys.platform == "darwin":
        folder = Path.home() / "Library" / "Caches" / "casid"
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "casid"
    folder = folder / "steps"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_own = os.name == "nt" or (
            folder.stat().st_uid == os.getuid() and not folder.stat().st_mode & 0o022
        )
        if is_own and os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return None


def cache_folder() -> Path | None:
    """Where compiled steps are kept: in `CASID_CACHE`, or where this system has users' caches.

    None where that variable is empty, and where the folder cannot be written or others can write
    to it, for what lies there is run.
    """
    return _cache_folder(os.environ.get("CASID_CACHE"))
