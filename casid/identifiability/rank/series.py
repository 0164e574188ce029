"""Power series of the outputs and of their sensitivities, at a random point of a prime field.

With y(t) = sum_k y_k t^k along the solution from x(0), the rows d y_k / d(x(0), theta) are
those of the extended observability matrix (2.64) of Linder (2017), divided by k!. They are computed
order by order: in the newest coefficient every operation of a `Program` is linear,

    sum         s_k = sum c_i a_i,k
    product     s_k = b_0 a_k + a_0 b_k + (sum over 0 < j < k of a_j b_{k-j})
    primitive   s_k = g_0 a_k + 1/k (sum over 0 < j < k of j a_j g_{k-j})

and so are their tangents; the sums over j are one batched product of matrices for all operations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from casid.algebra.prime_field import matmul, to_field, to_rational
from casid.arrays import Array
from casid.identifiability.equations.system import System
from casid.identifiability.rank.program import ONE, Program
from casid.identifiability.rank.program_reader import program_of


class SpecialPoint(Exception):
    """The point is no point of the model: a denominator vanishes, or a root does not exist there.

    Attributes
    ----------
    function : the operation that has no value.
    """

    def __init__(self, function: str) -> None:
        super().__init__(function)
        self.function = function


@dataclass(frozen=True, slots=True)
class _Level:
    """Operations whose arguments are on lower levels."""

    sums: Array  # nodes
    terms: Array  # arguments of all sums, one after the other
    offsets: Array  # where each sum's arguments begin
    places: slice  # of the coefficients among all coefficients
    pairs: Array  # nodes of products and primitives
    a: Array
    b: Array
    rows: slice  # of the pairs among all pairs


def _indices(numbers: Sequence[int]) -> Array:
    return np.array(numbers, dtype=np.int64)


class Schedule:
    """A system's program, laid out for evaluation in arrays; independent of point and prime."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.program: Program = program_of(system)
        program = self.program
        nx, np_ = len(system.states), len(system.parameters)
        self.n_columns = nx + np_  # of the tangents: initial states, then parameters
        self.width = 1 + self.n_columns  # the value comes first
        self._levels(program)
        self.moving = self._moving(program, system)
        self._history()
        count = len(program.variables)
        names = system.declared
        self.input_nodes: list[tuple[int, str, int]] = []  # node, input, order of its derivative
        for node in range(count):
            name = names[node]
            if name in system.inputs:
                self.input_nodes.append((node, name, 0))
            elif name in system.input_derivatives:
                self.input_nodes.append((node, *system.input_derivatives[name]))

    def _levels(self, program: Program) -> None:
        level = np.zeros(program.n_nodes, dtype=np.int64)
        for n in program.order:
            level[n] = 1 + max((int(level[a]) for a in program.arguments(n)), default=0)
        self.coefficients: list[Fraction] = []
        self.constants: list[tuple[int, Fraction]] = []  # of sums: node and constant term
        self.pair_nodes: list[int] = []
        left: list[int] = []
        right: list[int] = []
        is_primitive: list[bool] = []
        self.levels: list[_Level] = []
        for depth in range(1, int(level.max(initial=0)) + 1):
            nodes = [n for n in program.order if level[n] == depth]
            sums, terms, offsets, places = self._sums(program, nodes)
            start = len(self.pair_nodes)
            for n in nodes:
                if n in program.products:
                    a, b = program.products[n]
                elif n in program.primitives:
                    a, b = program.primitives[n].argument, program.primitives[n].slope
                else:
                    continue
                self.pair_nodes.append(n)
                left.append(a)
                right.append(b)
                is_primitive.append(n in program.primitives)
            rows = slice(start, len(self.pair_nodes))
            pairs, first, second = (_indices(x[rows]) for x in (self.pair_nodes, left, right))
            self.levels.append(_Level(sums, terms, offsets, places, pairs, first, second, rows))
        self.left, self.right = _indices(left), _indices(right)
        self.is_primitive = np.array(is_primitive, dtype=bool)

    def _sums(self, program: Program, nodes: Sequence[int]) -> tuple[Array, Array, Array, slice]:
        """The sums among `nodes`: nodes, terms, offsets and places of a `_Level`."""
        sums: list[int] = []
        terms: list[int] = []
        offsets: list[int] = []
        first = len(self.coefficients)
        for n in (n for n in nodes if n in program.sums):
            content = program.sums[n]
            if ONE in content:
                self.constants.append((n, content[ONE]))
            own = [(k, c) for k, c in content.items() if k != ONE]
            if not own:
                continue
            sums.append(n)
            offsets.append(len(terms))
            terms += [k for k, _ in own]
            self.coefficients += [c for _, c in own]
        places = slice(first, len(self.coefficients))
        return _indices(sums), _indices(terms), _indices(offsets), places

    def _moving(self, program: Program, system: System) -> Array:
        """(n_nodes,) bool: the node changes with time."""
        moving = np.zeros(program.n_nodes, dtype=bool)
        still = {*system.parameters, *system.constants}
        for i, name in enumerate(program.variables):
            moving[i] = name not in still
        for n in program.order:
            moving[n] = any(moving[a] for a in program.arguments(n))
        return moving

    def _history(self) -> None:
        """Pairs of which both change with time, and the nodes whose past they need."""
        both = self.moving[self.left] & self.moving[self.right]
        self.folded = np.flatnonzero(both)  # among the pairs
        needed = np.unique(np.concatenate([self.left[both], self.right[both]]))
        self.remembered = needed
        place = np.zeros(self.program.n_nodes, dtype=np.int64)
        place[needed] = np.arange(needed.size)
        self.past_left, self.past_right = place[self.left[both]], place[self.right[both]]
        self.folded_primitive = self.is_primitive[both]

    def field_coefficients(self, p: int) -> Array:
        """Coefficients of the sums, modulo p."""
        return np.array([to_field(c, p) for c in self.coefficients], dtype=np.int64)


class Series:
    """Coefficients of the outputs' series, order by order, with their sensitivities.

    Parameters
    ----------
    schedule : of the system.
    values : name -> value modulo p of every parameter, constant and initial state.
    inputs : draws the next coefficient of a known input.
    p : the prime.
    branches : for each kink, +1 or -1.
    rng : draws the initial values of transcendental functions.

    Raises
    ------
    SpecialPoint
        If a denominator vanishes at the point, or a root does not exist in the field.
    """

    def __init__(
        self,
        schedule: Schedule,
        values: Mapping[str, int],
        p: int,
        rng: np.random.Generator,
        branches: Sequence[int] = (),
    ) -> None:
        self.schedule, self.p, self._rng = schedule, p, rng
        self.system = schedule.system
        self._inputs: dict[str, list[int]] = {u: [] for u in self.system.inputs}
        self._coefficients = schedule.field_coefficients(p)
        self._now = np.zeros((schedule.program.n_nodes, schedule.width), dtype=np.int64)
        self._past = np.zeros((schedule.remembered.size, 8, schedule.width), dtype=np.int64)
        self._cosine: dict[int, int] = {}  # of each sine
        self.order = -1
        self._start(values, branches)

    def rows(self) -> Iterator[Array]:
        """(ny, nx + np) sensitivities of the outputs' coefficients, for k = 0, 1, 2, ..."""
        outputs = np.array(self.schedule.program.h, dtype=np.int64)
        while True:
            self.order += 1
            if self.order:
                self._advance()
            yield self._now[outputs, 1:]

    def outputs(self) -> Array:
        """(ny,) the outputs' coefficients of the present order."""
        return self._now[self.schedule.program.h, 0]

    @property
    def bytes(self) -> int:
        """Memory of the series."""
        return int(self._now.nbytes + self._past.nbytes)

    # -- order zero ---------------------------------------------------------------------------

    def _start(self, values: Mapping[str, int], branches: Sequence[int]) -> None:
        s, p, now = self.schedule, self.p, self._now
        program, system = s.program, self.system
        value = [values.get(n, 0) for n in program.variables] + [0] * len(program.order)
        for node, name, order in s.input_nodes:
            value[node] = self._input(name, order, 0)
        signs = dict(zip(program.kinks, branches, strict=False))
        for n in program.order:
            if n in program.sums:
                total = sum(
                    to_field(c, p) * (1 if k == ONE else value[k])
                    for k, c in program.sums[n].items()
                )
                value[n] = total % p
            elif n in program.products:
                a, b = program.products[n]
                value[n] = value[a] * value[b] % p
            elif n in program.primitives:
                value[n] = self._primitive_start(n, value)
            else:
                value[n] = signs.get(n, 1) % p
        now[:, 0] = value
        for i in range(len(system.states)):
            now[i, 1 + i] = 1
        for i in range(len(system.parameters)):
            now[len(system.states) + i, 1 + len(system.states) + i] = 1
        self._slopes(now[:, 0].copy())
        # Tangents of order zero: the same linear maps, without earlier coefficients.
        kept = now[:, 0].copy()
        now[:, 0] = 0
        nothing = np.zeros((len(s.pair_nodes), s.width), dtype=np.int64)
        self._pass(nothing, np.zeros((program.n_nodes, s.width), dtype=np.int64))
        self._first = now.copy()  # tangents of order zero, values left out
        now[:, 0] = kept
        self._remember(0)

    def _primitive_start(self, n: int, value: list[int]) -> int:
        primitive, p = self.schedule.program.primitives[n], self.p
        a = value[primitive.argument]
        if primitive.start == "inverse":
            if a == 0:
                raise SpecialPoint("a denominator vanishes")
            return pow(a, -1, p)
        if primitive.start == "root":
            root = _square_root(a, p)
            if root is None or root == 0:
                raise SpecialPoint("a square root does not exist in the field")
            # Of a special value such as 4 the positive root; elsewhere either will do.
            number = to_rational(root, p)
            return p - root if number is not None and number < 0 else root
        if primitive.start == "partner":
            return self._cosine[primitive.partner]
        if primitive.start == "circle":
            if a == 0:
                self._cosine[n] = 1
                return 0
            t = int(self._rng.integers(2, p - 1))
            while (1 + t * t) % p == 0:
                t = int(self._rng.integers(2, p - 1))
            scale = pow(1 + t * t, -1, p)
            self._cosine[n] = (1 - t * t) * scale % p
            return 2 * t * scale % p
        if primitive.pinned is not None and a == primitive.pinned[0]:
            return primitive.pinned[1]
        return int(self._rng.integers(1, p))

    def _slopes(self, value: Array) -> None:
        """Factors of the newest coefficients: alpha of a_k, beta of b_k."""
        s = self.schedule
        self._alpha = value[s.right][:, None]
        self._beta = np.where(s.is_primitive, 0, value[s.left])[:, None]

    # -- higher orders ------------------------------------------------------------------------

    def _advance(self) -> None:
        s, p, k = self.schedule, self.p, self.order
        now = self._now
        f = now[s.program.f] if s.program.f else now[:0]
        new = f * pow(k, -1, p) % p
        folded = self._folded(k)
        now[:] = 0
        now[: len(s.program.f)] = new
        for node, name, order in s.input_nodes:
            now[node, 0] = self._input(name, order, k)
        self._pass(folded, self._first)
        self._remember(k)

    def _folded(self, k: int) -> Array:
        """(pairs, width) the sums over 0 < j < k, with their tangents."""
        s, p = self.schedule, self.p
        total = np.zeros((len(s.pair_nodes), s.width), dtype=np.int64)
        if k < 2 or s.folded.size == 0:
            return total
        left, right = self._past[s.past_left, 1:k], self._past[s.past_right, 1:k]
        a, b = left[:, ::-1, 0], right[:, ::-1, 0]
        j = np.arange(1, k)
        primitive = s.folded_primitive[:, None]
        a = np.where(primitive, a * j[::-1] % p, a)
        b = np.where(primitive, b * j % p, b)
        part = matmul(a[:, None, :], right, p)[:, 0]
        part[:, 1:] = (part[:, 1:] + matmul(b[:, None, :], left[:, :, 1:], p)[:, 0]) % p
        if s.folded_primitive.any():
            part[s.folded_primitive] = part[s.folded_primitive] * pow(k, -1, p) % p
        total[s.folded] = part
        return total

    def _pass(self, folded: Array, first: Array) -> None:
        """One sweep over the levels: newest coefficients and tangents of every node."""
        s, p, now = self.schedule, self.p, self._now
        for level in s.levels:
            if level.sums.size:
                products = self._coefficients[level.places, None] * now[level.terms] % p
                now[level.sums] = np.add.reduceat(products, level.offsets, axis=0) % p
            if level.pairs.size:
                a, b = now[level.a], now[level.b]
                rows = level.rows
                new = (self._alpha[rows] * a + self._beta[rows] * b + folded[rows]) % p
                factor = np.where(s.is_primitive[rows, None], 0, b[:, :1])
                new += (first[level.a] * factor + first[level.b] * a[:, :1]) % p
                now[level.pairs] = new % p

    def _remember(self, k: int) -> None:
        nodes = self.schedule.remembered
        if k == self._past.shape[1]:
            more = np.zeros_like(self._past)
            self._past = np.concatenate([self._past, more], axis=1)
        self._past[:, k] = self._now[nodes]

    def _input(self, name: str, order: int, k: int) -> int:
        """Coefficient k of the order-th derivative of an input."""
        drawn = self._inputs[name]
        while len(drawn) <= k + order:
            drawn.append(int(self._rng.integers(1, self.p)))
        value = drawn[k + order]
        for i in range(k + 1, k + order + 1):
            value = value * i % self.p
        return value


def _square_root(a: int, p: int) -> int | None:
    """A root of a modulo p, or None (Tonelli and Shanks)."""
    if a == 0:
        return 0
    if pow(a, (p - 1) // 2, p) != 1:
        return None
    if p % 4 == 3:
        return pow(a, (p + 1) // 4, p)
    odd, twos = p - 1, 0
    while odd % 2 == 0:
        odd, twos = odd // 2, twos + 1
    z = 2
    while pow(z, (p - 1) // 2, p) != p - 1:
        z += 1
    m, c, t, r = twos, pow(z, odd, p), pow(a, odd, p), pow(a, (odd + 1) // 2, p)
    while t != 1:
        i, square = 0, t
        while square != 1:
            square, i = square * square % p, i + 1
        b = pow(c, 1 << (m - i - 1), p)
        m, c, t, r = i, b * b % p, t * b * b % p, r * b % p
    return r
