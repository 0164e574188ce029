"""A model's linearised equations in the Laplace domain, solved symbolically.

Every equation of the model is a row over the columns

    [x, u_I, w, u_K, tau, y_O]

(states, outputs that became inputs, eliminated inputs, other inputs, a disturbance in each balance,
outputs), with rational functions of the parameters and p = d/dt as entries, and the row times the
signals is zero. All transfer functions of a model are solutions of some of these rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.symbolic import exact, to_sympy
from casid.errors import ModelError, nearest
from casid.model.model import Model

Algebra = Any  # a sympy expression or matrix


class Laplace:
    """Laplace-domain equations of an indirect model, and what is solved from them.

    Attributes
    ----------
    p : sympy symbol of d/dt.
    parameters : names of the parameters that are symbols.
    outputs, inputs, unknown, others, disturbances : y_O, u_I, w, u_K and tau by name.
    rows : sympy matrix; the model's own equations, the sensors of u_I, then those of y_O.
    """

    def __init__(
        self, model: Model, equilibrium: Mapping[str, float], values: Mapping[str, float]
    ) -> None:
        import sympy

        equations = model.equations()
        own, sensors = equations[: len(model.states)], equations[len(model.states) :]
        if not sensors:
            raise ModelError(
                f"{model.name}: no input was eliminated, so there is no loop; call "
                "model.eliminate(unknown, using=output) first"
            )
        model.explicit()  # refuses singular equations, with the remedy
        self.name = model.name
        self.inputs = tuple(name.removesuffix(" = ...") for name, _, _ in sensors)
        self.unknown = tuple(w for _, _, w in sensors)
        self.others = tuple(u for u in model.inputs if u not in self.inputs)
        self.outputs = tuple(model.outputs)
        self.disturbances = tuple(model.balances)
        if not self.outputs:
            raise ModelError(f"{model.name}: no output is left; state one with model.output(...)")
        for name in values:
            model.parameter_named(name)
        self.parameters = tuple(n for n in model.parameters if n not in values)
        candidates = ("p", "s", "p_", "s_", "d_dt")
        self.p = sympy.Symbol(next(n for n in candidates if n not in model.parameters))
        self._names = {
            "x": tuple(model.states),
            "I": self.inputs,
            "w": self.unknown,
            "u": self.others,
            "tau": self.disturbances,
            "O": self.outputs,
        }
        self._own = [name for name, _, _ in own]
        self._is_balance = [name in model.balances for name in self._own]
        numbers = {n: sympy.Rational(*exact(v).as_integer_ratio()) for n, v in values.items()}
        self._linearise(model, own, sensors, equilibrium, numbers)

    def _linearise(
        self,
        model: Model,
        own: list[tuple[str, Any, str]],
        sensors: list[tuple[str, Any, str]],
        equilibrium: Mapping[str, float],
        numbers: Mapping[str, Algebra],
    ) -> None:
        import sympy

        signals = [n for kind in ("x", "I", "w", "u") for n in self._names[kind]]
        for name in equilibrium:
            if name not in signals:
                raise ModelError(
                    f"{model.name}: equilibrium of {name!r}, which is neither state nor input"
                    f"{nearest(name, signals)}"
                )
        rates = [model.der(s) for s in model.states]
        z = ca.vertcat(*rates, *[model.symbol(n) for n in signals])
        at = ca.DM([0.0] * len(rates) + [float(equilibrium.get(n, 0.0)) for n in signals])
        residuals = ca.vertcat(*[r for _, r, _ in (*own, *sensors)])
        outputs = ca.vertcat(*[e for e, _ in model.outputs.values()])
        self._check_equilibrium(ca.substitute(residuals, z, at), [r[0] for r in (*own, *sensors)])
        J = ca.substitute(ca.jacobian(ca.vertcat(residuals, outputs), z), z, at)
        table = to_sympy(J, numbers, exact_numbers=True)
        end = 0
        self._columns: dict[str, list[int]] = {}
        for kind, names in self._names.items():
            self._columns[kind] = list(range(end, end + len(names)))
            end += len(names)
        nx, self._n_rows = len(rates), residuals.numel()
        rows = sympy.zeros(table.rows, end)
        for i in range(table.rows):
            for j in range(len(signals)):
                rows[i, j] = table[i, nx + j] + (self.p * table[i, j] if j < nx else 0)
        rate_of = {b.rate: k for k, b in enumerate(model.balances.values())}
        for i, (_, _, state) in enumerate(own):
            if self._is_balance[i]:
                rows[i, self._columns["tau"][rate_of[state]]] = -1
        for k, j in enumerate(self._columns["O"]):
            rows[self._n_rows + k, j] = -1
        self.rows = rows

    def _check_equilibrium(self, residuals: Any, names: list[str]) -> None:
        symbols = ca.symvar(residuals)
        f = ca.Function("residual", [ca.vertcat(*symbols)], [residuals])
        values = np.array(f(np.random.default_rng(3).uniform(0.2, 1.7, len(symbols)))).ravel()
        bad = np.flatnonzero(~(np.abs(values) < 1e-9))
        if bad.size:
            raise ModelError(
                f"{self.name}: {names[int(bad[0])]!r} does not balance at the point of "
                "linearisation; give the equilibrium's states and inputs, equilibrium={...}, or "
                "measure states from the equilibrium"
            )

    # -- solving -----------------------------------------------------------------------------

    def indirect(self) -> Algebra:
        """y_O from [u_I; u_K; tau], (ny, nI + nK + nb)."""
        c = self._columns
        return self._respond([*c["x"], *c["w"]], [*c["I"], *c["u"], *c["tau"]])[1]

    def direct(self) -> Algebra:
        """[y_O; u_I] from [w; u_K; tau], (ny + nI, nI + nK + nb), without the loop."""
        c = self._columns
        solved, y = self._respond([*c["x"], *c["I"]], [*c["w"], *c["u"], *c["tau"]])
        return y.col_join(solved[len(c["x"]) :, :])

    def return_path(self) -> tuple[Algebra, tuple[str, ...]]:
        """u_I from [y_O; w; u_K; tau], (nI, ny + nI + nK + nb), and which equations it took.

        The sensors' rows give u_I = K x + L [w; u_K; tau]; K is a combination of as few other rows
        as it takes, in the order of `_candidates`.
        """
        import sympy

        c = self._columns
        outside = [*c["w"], *c["u"], *c["tau"]]
        sensors = list(range(len(self._own), self._n_rows))
        own = solve(self._pick(sensors, c["I"]), -self._pick(sensors, [*c["x"], *outside]))
        K, L = own[:, : len(c["x"])], own[:, len(c["x"]) :]
        kept: list[int] = []
        for i in self._candidates():
            if rank(self._pick([*kept, i], c["x"])) > len(kept):
                kept.append(i)
                if rank(self._pick(kept, c["x"]).col_join(K)) == len(kept):
                    break
        weights = _combination(self._pick(kept, c["x"]), K)
        rest = -weights * self._pick(kept, [*c["O"], *outside])
        total = rest + sympy.zeros(K.rows, len(c["O"])).row_join(L)
        F = solve(sympy.eye(K.rows) + weights * self._pick(kept, c["I"]), total)
        used = [self._label(i) for k, i in enumerate(kept) if any(weights[:, k])]
        return F, tuple(used)

    def _respond(self, unknowns: list[int], given: list[int]) -> tuple[Algebra, Algebra]:
        """The unknown columns, and y_O, in terms of the given columns."""
        square = list(range(self._n_rows))
        solved = solve(self._pick(square, unknowns), -self._pick(square, given))
        rows = list(range(self._n_rows, self.rows.rows))
        y = self._pick(rows, unknowns) * solved + self._pick(rows, given)
        return solved, y.applyfunc(_cancel)

    def _pick(self, rows: list[int], columns: list[int]) -> Algebra:
        return self.rows.extract(rows, columns)

    def _candidates(self) -> list[int]:
        """Rows in the order in which the return path takes them."""
        c = self._columns
        outputs = list(range(self._n_rows, self.rows.rows))

        def has_unknown(i: int) -> bool:
            return any(self._pick([i], c["w"]))

        def is_static(i: int) -> bool:
            return not has_unknown(i) and not self._pick([i], c["x"]).has(self.p)

        own = list(zip(range(len(self._own)), self._is_balance, strict=True))
        return [
            *[i for i in outputs if is_static(i)],
            *[i for i, balance in own if not balance],
            *[i for i in outputs if not is_static(i)],
            *[i for i, balance in own if balance and not has_unknown(i)],
            *[i for i, balance in own if balance and has_unknown(i)],
        ]

    def _label(self, row: int) -> str:
        if row >= self._n_rows:
            return f"output {self.outputs[row - self._n_rows]}"
        return f"balance {self._own[row]}" if self._is_balance[row] else self._own[row]


# -- matrices of rational functions --------------------------------------------------------------


def solve(matrix: Algebra, right: Algebra) -> Algebra:
    """matrix^-1 right over the field of rational functions, entries cancelled."""
    a, b = _over_one_field(matrix, right)
    return a.lu_solve(b).to_Matrix()


def rank(matrix: Algebra) -> int:
    """Rank over the field of rational functions."""
    (a,) = _over_one_field(matrix)
    return len(a.rref()[1])


def _combination(rows: Algebra, goal: Algebra) -> Algebra:
    """Weights with weights * rows = goal, for independent rows that span the goal."""
    (a,) = _over_one_field(rows)
    columns = list(a.rref()[1])
    square = rows.extract(list(range(rows.rows)), columns)
    return solve(square.T, goal.extract(list(range(goal.rows)), columns).T).T


def _over_one_field(*matrices: Algebra) -> list[Any]:
    """Domain matrices; a root or a cosine of parameters counts as a symbol of its own."""
    import sympy
    from sympy.polys.fields import sfield
    from sympy.polys.matrices import DomainMatrix

    entries = [sympy.Dummy(), *[e for matrix in matrices for e in matrix]]
    quotients, elements = sfield(entries)
    out, k = [], 1
    for matrix in matrices:
        flat = elements[k : k + len(matrix)]
        k += len(matrix)
        table = [flat[i * matrix.cols : (i + 1) * matrix.cols] for i in range(matrix.rows)]
        out.append(DomainMatrix(table, matrix.shape, quotients.to_domain()))
    return out


def _cancel(entry: Algebra) -> Algebra:
    import sympy

    return sympy.cancel(entry)
