"""Readings that must satisfy equations: their reconciliation, and which of them contradict.

    min sum ((q_i - reading_i) / sd_i)^2   subject to   h(q, p) = 0                         (1)

over the true quantities q and what was not read, p: least squares with errors in all variables
(the Gauss-Helmert model of geodesy). With more equations than unknowns the minimum is a chi-squared
number if all is well; where it is not, the faulty readings are sought by what leaving them out
would gain (W. Baarda, A testing procedure for use in geodetic networks, 1968; P. J. G. Teunissen,
Testing Theory, 2nd ed., 2006, ch. 4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.local_rank import LocalRank, describe_null
from casid.estimation.nlp.compiled import Compiled
from casid.estimation.nlp.nlp import Nlp
from casid.model.quantities import count_text
from casid.presentation import Presented

LEVEL = 0.001
"""Readings contradict where chance would make them differ so in one case out of a thousand."""

SOURCES = (
    "W. Baarda, A testing procedure for use in geodetic networks, 1968",
    "P. J. G. Teunissen, Testing Theory, an introduction, 2nd ed., 2006, ch. 4",
)


@dataclass(frozen=True, slots=True)
class Blame:
    """A reading that contradicts the others, or one out of several that are indistinguishable.

    Attributes
    ----------
    alternatives : the reading, and those that would explain the same as well.
    corrections : what reconciles each alternative with the rest: to be added to the reading.
    std_errors : of the corrections.
    gain : fall of chi-squared when it is set aside after those before it.
    """

    alternatives: tuple[str, ...]
    corrections: tuple[float, ...]
    std_errors: tuple[float, ...]
    units: tuple[str, ...]
    gain: float

    def __str__(self) -> str:
        parts = [
            f"{name} ({correction:+.4g} +- {error:.2g} {unit})"
            for name, correction, error, unit in zip(
                self.alternatives, self.corrections, self.std_errors, self.units, strict=True
            )
        ]
        return " or ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Reconciled(Presented):
    """Quantities that satisfy the equations, with their covariance.

    It assumes independent Gaussian errors of the stated standard deviations, small enough for the
    equations to be linear over them; a chi-squared that is too large is not scaled away.

    Attributes
    ----------
    names : unknowns first, then readings. values, covariance : (n,), (n, n) in that order.
    statistic, degrees, p_value : the equations' contradiction, chi-squared with `degrees`.
    residuals : reading -> (reconciled - reading) / sd.
    blamed : the fewest readings (found one after another) that must be set aside for the rest to
        agree; empty where all agree.
    """

    title: str
    names: tuple[str, ...]
    units: Mapping[str, str]
    values: Array
    covariance: Array
    statistic: float
    degrees: int
    p_value: float
    residuals: Mapping[str, float]
    readings: Mapping[str, tuple[float, float]]
    blamed: tuple[Blame, ...]

    @property
    def is_consistent(self) -> bool:
        """True if chance explains the contradiction of the equations."""
        return self.p_value >= LEVEL

    def __getitem__(self, name: str) -> float:
        return float(self.values[self._index(name)])

    def std_error(self, name: str) -> float:
        """Standard error, in the unit of the quantity."""
        i = self._index(name)
        return float(np.sqrt(max(self.covariance[i, i], 0.0)))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Two-sided confidence interval, Gaussian."""
        from scipy.stats import norm

        half = float(norm.ppf((1 + level) / 2)) * self.std_error(name)
        return self[name] - half, self[name] + half

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Joint covariance of some quantities, (n, n) in the order of `names`."""
        index = [self._index(n) for n in names]
        return np.asarray(self.covariance[np.ix_(index, index)])

    def references(self) -> tuple[str, ...]:
        """The sources of the method."""
        return SOURCES

    def _index(self, name: str) -> int:
        if name not in self.names:
            from casid.errors import nearest

            raise ModelError(
                f"{self.title}: no quantity {name!r}; there are {', '.join(self.names)}"
                f"{nearest(name, self.names, is_listed=True)}"
            )
        return self.names.index(name)

    def __repr__(self) -> str:
        state = "consistent" if self.is_consistent else "CONTRADICTORY"
        return (
            f"<Reconciled {self.title}: {len(self.readings)} readings, {state}, chi2 "
            f"{self.statistic:.3g} with {self.degrees} degrees of freedom>"
        )


@dataclass(slots=True)
class Reconciliation:
    """Readings, unknowns and the equations between them, to be solved together.

    Errors that several readings share (a scale's zero, a misplaced rule) are readings of their own,
    of zero, which enter the equations of each.

    Example
    -------
    >>> import casid
    >>> r = casid.Reconciliation("two scales")
    >>> a, b = r.reading("a", 2.0, 0.1, "kg"), r.reading("b", 2.2, 0.1, "kg")
    >>> m = r.unknown("m", 1.0, "kg")
    >>> r.equation("first", a - m)
    >>> r.equation("second", b - m)
    >>> round(r.solve()["m"], 9)
    2.1
    """

    title: str
    _readings: dict[str, tuple[float, float]] = field(default_factory=dict)
    _unknowns: dict[str, tuple[float, float]] = field(default_factory=dict)
    _units: dict[str, str] = field(default_factory=dict)
    _symbols: dict[str, Any] = field(default_factory=dict)
    _equations: dict[str, Any] = field(default_factory=dict)
    _built: Any = None

    def reading(self, name: str, value: float, sd: float, unit: str = "") -> Any:
        """Declare a quantity that was read; returns its CasADi symbol.

        A standard deviation `sd` of zero states it as exact.
        """
        if not (np.isfinite(value) and np.isfinite(sd) and sd >= 0):
            raise DataError(
                f"{self.title}: reading {name} = {value:g} +- {sd:g}; give a finite value and a "
                "standard deviation that is not negative, or declare it unknown"
            )
        symbol = self._declare(name, unit)
        self._readings[name] = (float(value), float(sd))
        return symbol

    def unknown(self, name: str, start: float, unit: str = "", *, scale: float = 0.0) -> Any:
        """Declare a quantity that was not read; `scale` is its size, by default that of `start`."""
        symbol = self._declare(name, unit)
        self._unknowns[name] = (float(start), float(scale) or abs(float(start)) or 1.0)
        return symbol

    def derived(self, name: str, expression: Any, start: float, unit: str = "") -> Any:
        """Declare a quantity by its formula, to have it with its covariance."""
        symbol = self.unknown(name, start, unit)
        self.equation(f"definition of {name}", symbol - expression)
        return symbol

    def equation(self, name: str, expression: Any) -> None:
        """Require that an expression of the symbols is zero."""
        if name in self._equations:
            raise ModelError(f"{self.title}: equation {name!r} is there twice; give another name")
        self._equations[name] = ca.SX(expression)
        self._built = None

    def _declare(self, name: str, unit: str) -> Any:
        if name in self._symbols:
            raise ModelError(f"{self.title}: {name!r} is declared twice; give another name")
        self._symbols[name], self._units[name] = ca.SX.sym(name), unit
        self._built = None
        return self._symbols[name]

    def solve(self, readings: Mapping[str, float] | None = None) -> Reconciled:
        """Reconcile the readings, or others in their place (name -> value).

        Raises
        ------
        IdentifiabilityError
            If the equations do not determine the unknowns; names what is not identifiable.
        ModelError
            If equations contradict one another whatever the readings, or one is there twice.
        SolveError
            If no solution is found.
        """
        if self._built is None:
            self._built = self._build()
        compiled, slopes, noisy = self._built
        given = {name: value for name, (value, _) in self._readings.items()}
        for name, value in (readings or {}).items():
            if name not in given:
                raise ModelError(f"{self.title}: no reading {name!r}; there are {', '.join(given)}")
            given[name] = float(value)
        read = np.array(list(given.values()))
        x = compiled.solve({"reading": read}).x.copy()
        for _ in range(3):  # Newton steps of Gauss: the solver's tolerance is not the last word
            h, J = (np.array(v) for v in slopes(x, read))
            x = _step(x, h.ravel(), J, len(noisy))
        J = np.array(slopes(x, read)[1])
        return self._reconciled(x, J, read, noisy)

    def _build(self) -> tuple[Compiled, Any, list[str]]:
        """The program in x = [(q - reading) / sd of inexact readings; unknowns / scale]."""
        if not self._equations:
            raise ModelError(f"{self.title}: no equation; state what the readings must satisfy")
        if not self._readings:
            raise ModelError(f"{self.title}: no reading; give what was read with reading()")
        noisy = [name for name, (_, sd) in self._readings.items() if sd > 0]
        nlp = Nlp(self.title)
        given = nlp.parameter("reading", len(self._readings))
        values: list[Any] = []
        errors: list[Any] = []
        for i, (name, (_, sd)) in enumerate(self._readings.items()):
            if sd > 0:
                e = nlp.variable(f"error of {name}", 0.0, scale=1.0)
                errors.append(e)
                values.append(given[i] + sd * e)
            else:
                values.append(given[i])
        inside = []
        for name, (start, scale) in self._unknowns.items():
            z = nlp.variable(name, start / scale, scale=1.0)
            inside.append(z)
            values.append(scale * z)
        order = [*self._readings, *self._unknowns]
        rows = list(self._equations.values())
        try:
            h = ca.Function("h", [self._symbols[name] for name in order], [ca.vertcat(*rows)])
        except RuntimeError as error:
            raise ModelError(
                f"{self.title}: an equation holds symbols that are neither reading nor unknown; "
                "use what reading() and unknown() return"
            ) from error
        residual = h(*values)
        nlp.minimize(ca.sumsqr(ca.vertcat(*errors)) if errors else ca.MX(0) * inside[0])
        nlp.equality(residual)
        x = ca.vertcat(*errors, *inside)
        z, p = ca.SX.sym("x", x.shape[0]), ca.SX.sym("p", len(self._readings))
        parts = ca.Function("parts", [x, given], [residual]).expand()(z, p)
        return nlp.compile(), ca.Function("slopes", [z, p], [parts, ca.jacobian(parts, z)]), noisy

    def _reconciled(self, x: Array, J: Array, read: Array, noisy: list[str]) -> Reconciled:
        """Quantities, covariance and test at the solution `x` of the scaled program."""
        from scipy.stats import chi2

        unknowns, n = tuple(self._unknowns), len(noisy)
        inner = self._covariance(x, J, n)
        scale = np.array([self._unknowns[u][1] for u in unknowns])
        sd = np.array([self._readings[r][1] for r in self._readings])
        # The place of each quantity in x, unknowns first; an exact reading has none.
        inexact = sd > 0
        places = np.full(len(read), -1)
        places[inexact] = np.arange(n)
        residuals = np.zeros(len(read))
        residuals[inexact] = x[:n]
        values = np.concatenate([scale * x[n:], read + sd * residuals])
        size = np.concatenate([scale, sd])
        where = np.concatenate([n + np.arange(len(unknowns)), places])
        covariance = inner[np.ix_(where, where)] * np.outer(size, size)
        statistic, degrees = float(x[:n] @ x[:n]), len(J) - len(unknowns)
        free = np.eye(n) - inner[:n, :n]  # covariance of the scaled residuals: a projector
        names = (*unknowns, *self._readings)
        return Reconciled(
            title=self.title,
            names=names,
            units={name: self._units[name] for name in names},
            values=values,
            covariance=(covariance + covariance.T) / 2,
            statistic=statistic,
            degrees=degrees,
            p_value=float(chi2.sf(statistic, degrees)) if degrees > 0 else 1.0,
            residuals=dict(zip(self._readings, residuals.tolist(), strict=True)),
            readings={
                name: (float(v), float(e))
                for name, v, e in zip(self._readings, read, sd, strict=True)
            },
            blamed=self._blame(x[:n], free, noisy, statistic, degrees),
        )

    def _covariance(self, x: Array, J: Array, n: int) -> Array:
        """Covariance of the scaled variables: the readings' own, on the equations' tangent space.

        `n` is the number of readings that are not exact.
        """
        length = np.linalg.norm(J, axis=1)
        if np.any(length == 0):
            empty = list(self._equations)[int(np.flatnonzero(length == 0)[0])]
            raise ModelError(f"{self.title}: equation {empty!r} holds nothing inexact; drop it")
        rows = J / length[:, None]
        _, s, vt = np.linalg.svd(rows)
        rank = int(np.sum(s > 1e-10))
        if rank < len(rows):
            raise ModelError(
                f"{self.title}: {len(rows) - rank} of the {len(rows)} equations follow from the "
                "others; drop them, or give what they hold an uncertainty"
            )
        Z = vt[rank:].T  # what the equations leave free
        moves = np.linalg.svd(Z[:n], compute_uv=False) if n else np.zeros(0)
        if Z.shape[1] and (len(moves) < Z.shape[1] or moves[-1] < 1e-9):
            self._refuse(Z, n, tuple(self._unknowns), x)
        return np.asarray(Z @ np.linalg.pinv(Z[:n].T @ Z[:n], hermitian=True) @ Z.T)

    def _refuse(self, Z: Array, n: int, unknowns: tuple[str, ...], x: Array) -> None:
        """What the equations leave open, by the direction that no reading depends on."""
        _, _, vt = np.linalg.svd(Z[:n]) if n else (0, 0, np.eye(Z.shape[1]))
        direction = (Z @ vt[-1])[n:]
        own = [i for i, u in enumerate(unknowns) if f"definition of {u}" not in self._equations]
        size = np.where(np.abs(x[n:]) > 1e-6, np.abs(x[n:]), 1.0)
        step = (direction / size)[own]
        step = step / step[np.argmax(np.abs(step))]
        null = {unknowns[i]: float(v) for i, v in zip(own, step, strict=True) if abs(v) > 1e-6}
        text = describe_null(LocalRank(len(unknowns) - 1, len(unknowns), 0.0, (null,)))
        raise IdentifiabilityError(f"{self.title}: {text}, or add a reading")

    def _blame(
        self, errors: Array, free: Array, noisy: list[str], statistic: float, degrees: int
    ) -> tuple[Blame, ...]:
        """Set readings aside, the one that gains most first, until the rest agrees."""
        from scipy.stats import chi2

        found: list[Blame] = []
        chosen: list[int] = []
        sets: list[list[int]] = []
        left, residual, cover = statistic, errors.copy(), free.copy()
        sd = np.array([self._readings[name][1] for name in noisy])
        while len(chosen) < degrees and chi2.sf(left, degrees - len(chosen)) < LEVEL:
            power = np.diag(cover).copy()
            seen = power > 1e-9 * np.maximum(np.diag(free), TINY)
            seen &= power > 1e-12
            if not seen.any():
                break
            gain = np.where(seen, residual**2 / np.where(seen, power, 1.0), 0.0)
            best = int(np.argmax(gain))
            # Fully correlated with the best: the equations do not distinguish them.
            joint = cover[best] ** 2 / np.where(seen, power, 1.0) / power[best]
            same = [i for i in np.flatnonzero(seen).tolist() if joint[i] > 1 - 1e-6]
            same.sort(key=lambda i: (i != best, i))
            chosen.append(best)
            sets.append(sorted(same))
            left -= float(gain[best])
            column = cover[:, best] / power[best]
            residual = residual - column * residual[best]
            cover = cover - np.outer(column, cover[best])
            found.append(Blame((), (), (), (), float(gain[best])))
        # The corrections all together, since one set aside changes what another needs.
        out = []
        for j, (blame, same) in enumerate(zip(found, sets, strict=True)):
            rows = []
            for i in same:
                index = [*chosen[:j], i, *chosen[j + 1 :]]
                block = np.linalg.inv(free[np.ix_(index, index)])
                # errors = -free @ (fault / sd): what to add takes the fault away.
                rows.append(
                    (
                        noisy[i],
                        float(sd[i] * (block @ errors[index])[j]),
                        float(sd[i] * np.sqrt(block[j, j])),
                        self._units[noisy[i]],
                    )
                )
            names, corrections, deviations, units = zip(*rows, strict=True)
            out.append(Blame(names, corrections, deviations, units, blame.gain))
        return tuple(out)

    def __repr__(self) -> str:
        return (
            f"<Reconciliation {self.title}: {count_text(len(self._readings), 'reading')}, "
            f"{count_text(len(self._unknowns), 'unknown')}, "
            f"{count_text(len(self._equations), 'equation')}>"
        )


def _step(x: Array, h: Array, J: Array, n: int) -> Array:
    """The optimum of the program linearised at x: least squares on the tangent of the equations."""
    weight = np.zeros(len(x))
    weight[:n] = 1.0
    m = len(h)
    length = np.linalg.norm(J, axis=1)
    rows, right = J / length[:, None], h / length
    kkt = np.block([[np.diag(weight), rows.T], [rows, np.zeros((m, m))]])
    solution = np.linalg.lstsq(kkt, np.concatenate([-weight * x, -right]), rcond=None)[0]
    return np.asarray(x + solution[: len(x)])
