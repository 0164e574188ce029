"""Signals of a linear system, each a filtered sum of white external signals.

    s_i = sum_k G_ik(q) e_k,   e_k white, independent, zero mean, variance lambda_k            (1)

Linder (2017), (2.1): the externals are the delta and tau of the thesis, measurement noise
included; the signals are whatever is measured, known or estimated with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.linear.filters import Filter, as_filter, require_stable
from casid.unknown_inputs.limits.linear_expressions import as_expression, is_symbolic, linear_terms

Response = Callable[[Array], Array]
Definition = Any  # a formula, or source -> filter


@dataclass(frozen=True, slots=True, eq=False)
class LinearSignals:
    """Signals (1), static with symbols or numbers, or dynamic with numbers.

    Made by `of`, `of_state_space` or `of_response`. Every external is a signal of its own name.

    Attributes
    ----------
    variances : external -> variance (signal unit squared), a number or a sympy expression.
    excess_kurtosis : external -> E e^4 / lambda^2 - 3, where it is not Gaussian: -2 for a random
        binary signal, -1.2 for a uniform one.
    Ts : sample time [s], None for a static system.
    """

    variances: Mapping[str, Any]
    Ts: float | None = None
    excess_kurtosis: Mapping[str, float] = field(default_factory=dict)
    _own: tuple[str, ...] = ()  # signals that `_response` gives
    _response: Response | None = None  # z (M,) -> (M, own, externals)
    _defined: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    _reach: int = 0  # samples of delay that `_response` may hold

    # -- making ------------------------------------------------------------------------------

    @classmethod
    def of(
        cls,
        signals: Mapping[str, Definition],
        variances: Mapping[str, Any],
        *,
        Ts: float | None = None,
        excess_kurtosis: Mapping[str, float] | None = None,
    ) -> LinearSignals:
        """Signals from what they are made of.

        Parameters
        ----------
        signals : signal -> a linear combination of externals and of signals before it, as text
            ("bK*u_K + tau_O"), as a sympy expression, or as a mapping from source to filter. A
            filter is a number, an expression, a pair ([b0, b1, ..], [1, a1, ..]) of polynomials in
            q^-1, or a discrete python-control system.
        variances : external -> variance, number, text or sympy expression.
        Ts : sample time [s]; without it that of the filters, or 1.

        Raises
        ------
        ModelError
            If a source is neither external nor a signal before, an expression is not linear, a
            filter is unstable or improper, sample times differ, or a variance is negative.

        Example
        -------
        >>> import casid
        >>> casid.LinearSignals.of({"u": "delta", "y": "b*u + tau"}, {"delta": 1, "tau": "l"})
        <LinearSignals u, y from delta, tau: static, in b, l>
        """
        checked = {name: _variance(name, value) for name, value in variances.items()}
        if not checked:
            raise ModelError("no external signal; give variances={'tau': 1.0, ..}")
        kurtosis = dict(excess_kurtosis or {})
        for name, value in kurtosis.items():
            _require_known(name, checked, "excess_kurtosis")
            if not value >= -2:
                raise ModelError(
                    f"excess kurtosis of {name} is {value}; no distribution has less than -2"
                )
        start = cls(
            MappingProxyType(checked),
            None if Ts is None else _sample_time(Ts),
            MappingProxyType(kurtosis),
        )
        return start.with_signals(signals)

    @classmethod
    def of_response(
        cls,
        names: Sequence[str],
        response: Response,
        variances: Mapping[str, Any],
        *,
        Ts: float = 1.0,
        excess_kurtosis: Mapping[str, float] | None = None,
        longest_delay: int = 250,
    ) -> LinearSignals:
        """Signals from their frequency response, as a network offers it.

        Parameters
        ----------
        names : of the signals.
        response : function of z (M,) on the unit circle -> (M, signals, externals), stable and
            causal; externals in the order of `variances`.
        variances, Ts, excess_kurtosis : as in `of`; numbers.
        longest_delay : samples of pure delay in the response, at most. A longer one would be
            folded into a shorter one by the grid of frequencies.

        Raises
        ------
        ModelError
            If the response has another shape, or a name is taken by an external.
        """
        empty = cls.of({}, variances, Ts=Ts, excess_kurtosis=excess_kurtosis)
        for name in names:
            if name in empty.variances:
                raise ModelError(f"{name} is a signal and an external; rename one of them")
        try:
            shape = np.asarray(response(np.ones(1, dtype=complex))).shape
        except (ValueError, IndexError, np.linalg.LinAlgError) as error:
            raise ModelError(f"the response cannot be evaluated at z = 1: {error}") from error
        wanted = (1, len(names), len(empty.variances))
        if shape != wanted:
            raise ModelError(
                f"the response at one point has shape {shape}, not (1, signals, externals) = "
                f"{wanted}; name {', '.join(names)} and variances of the externals accordingly"
            )
        return replace(empty, _own=tuple(names), _response=response, _reach=int(longest_delay))

    @classmethod
    def of_state_space(
        cls,
        system: Any,
        variances: Mapping[str, Any],
        *,
        signals: Sequence[str] | None = None,
        Ts: float | None = None,
        excess_kurtosis: Mapping[str, float] | None = None,
    ) -> LinearSignals:
        """Signals as the outputs of a stable discrete state space driven by the externals.

        Parameters
        ----------
        system : (A, B, C, D) of shapes (nx, nx), (nx, ne), (ny, nx), (ny, ne), or a discrete
            python-control StateSpace, whose output labels name the signals. Columns of B and D
            stand for the externals in the order of `variances`, or by the system's input labels.
        signals : names of the ny outputs.

        Raises
        ------
        ModelError
            If shapes or names disagree, or A has an eigenvalue on or outside the unit circle.
        """
        from casid.linear.state_space import checked_state_space

        given = checked_state_space(system, tuple(variances), signals, Ts)
        return cls.of_response(
            given.signals,
            given.response,
            variances,
            Ts=1.0 if given.Ts is None else given.Ts,
            excess_kurtosis=excess_kurtosis,
            longest_delay=len(given.A) + 1,
        )

    def with_signals(
        self, signals: Mapping[str, Definition], *, noncausal: bool = False
    ) -> LinearSignals:
        """The system with more signals, made of externals and signals that are there.

        Parameters
        ----------
        signals : as in `of`.
        noncausal : whether filters may be improper: an input recovered by 1/G from a sensor that
            it reaches a sample late. From a record such a signal can be made, and moments need no
            causality. Poles have to be inside the unit circle all the same.
        """
        defined, Ts = dict(self._defined), self.Ts
        for name, definition in signals.items():
            if name in self.variances or name in self._own or name in defined:
                raise ModelError(f"signal {name} is there already; give the new one another name")
            known = [*self.variances, *self._own, *defined]
            if not isinstance(definition, Mapping):
                terms = linear_terms(definition, known, f"signal {name}")
            else:
                terms = dict(definition)
            row = {}
            for source, value in terms.items():
                _require_known(source, known, f"signal {name}")
                where = f"signal {name}: the filter of {source}"
                row[source], Ts = _entry(value, where, Ts, noncausal)
            defined[name] = row
        made = replace(self, Ts=Ts, _defined=MappingProxyType(defined))
        if made.Ts is None and not made.is_static:
            made = replace(made, Ts=1.0)
        if made.symbols and not made.is_static:
            raise ModelError(
                f"a dynamic system with the symbols {', '.join(map(str, made.symbols))}: symbols "
                "are for static systems; put numbers in their place"
            )
        return made

    def at(self, values: Mapping[Any, float]) -> LinearSignals:
        """The system with numbers in place of symbols; all of them or some.

        Raises
        ------
        ModelError
            If a name is no symbol of the system, or a variance becomes negative.
        """
        import sympy

        symbols_by_name = {str(s): s for s in self.symbols}
        for name in values:
            _require_known(str(name), symbols_by_name, "at")
        swap = {symbols_by_name[str(n)]: sympy.sympify(v) for n, v in values.items()}

        def put(value: Any) -> Any:
            value = value.subs(swap) if isinstance(value, sympy.Basic) else value
            return value if is_symbolic(value) or isinstance(value, Filter) else float(value)

        return replace(
            self,
            variances=MappingProxyType(
                {n: _variance(n, put(v)) for n, v in self.variances.items()}
            ),
            _defined=MappingProxyType(
                {n: {s: put(v) for s, v in row.items()} for n, row in self._defined.items()}
            ),
        )

    # -- properties and responses ------------------------------------------------------------

    @property
    def externals(self) -> tuple[str, ...]:
        """Names of the external signals."""
        return tuple(self.variances)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, externals left out."""
        return (*self._own, *self._defined)

    @property
    def is_static(self) -> bool:
        """Whether no signal remembers another's past."""
        entries = (v for row in self._defined.values() for v in row.values())
        return self._response is None and not any(isinstance(v, Filter) for v in entries)

    @property
    def symbols(self) -> tuple[Any, ...]:
        """The sympy symbols in gains and variances, by name."""
        entries = [v for row in self._defined.values() for v in row.values()]
        found = {s for v in (*entries, *self.variances.values()) for s in _free(v)}
        return tuple(sorted(found, key=str))

    @property
    def reach(self) -> int:
        """Samples that the polynomials of all filters together reach back, a bound on delays."""
        filters = (v for row in self._defined.values() for v in row.values())
        return self._reach + sum(v.reach for v in filters if isinstance(v, Filter))

    @property
    def lead(self) -> int:
        """Samples of the future that all filters together see, a bound for each signal."""
        filters = (v for row in self._defined.values() for v in row.values())
        return sum(v.lead for v in filters if isinstance(v, Filter))

    def gains(self, names: Sequence[str]) -> Array:
        """Gains (signals, externals) of a static system: floats, or sympy expressions as objects.

        Raises
        ------
        ModelError
            If the system is dynamic, or a signal is not there.
        """
        if not self.is_static:
            raise ModelError("a dynamic system has filters, not gains; use `response`")
        rows = self._rows(names, np.eye(len(self.externals), dtype=object), None)
        return np.array(rows, dtype=object if self.symbols else float).reshape(len(names), -1)

    def response(self, z: Array, names: Sequence[str]) -> Array:
        """Frequency response (M, signals, externals) at the points z (M,) of the unit circle."""
        unit = np.repeat(np.eye(len(self.externals))[:, None, :], len(z), axis=1).astype(complex)
        rows = self._rows(names, unit, z)
        return np.stack(rows, axis=1) if rows else np.zeros((len(z), 0, len(self.externals)))

    def _rows(self, names: Sequence[str], unit: Array, z: Array | None) -> list[Array]:
        for name in names:
            _require_known(name, [*self.externals, *self.names], "a requested signal")
        there: dict[str, Array] = dict(zip(self.externals, unit, strict=True))
        if self._response is not None and z is not None:
            own = np.asarray(self._response(z))
            there |= {name: own[:, i, :] for i, name in enumerate(self._own)}
        for name, row in self._defined.items():
            if row:
                parts = (_times(value, there[source], z) for source, value in row.items())
                there[name] = sum(parts, start=0 * unit[0])
            else:
                there[name] = 0 * unit[0]
        return [there[name] for name in names]

    def __repr__(self) -> str:
        symbols_by_name = f", in {', '.join(map(str, self.symbols))}" if self.symbols else ""
        kind = "static" if self.is_static else f"Ts = {self.Ts:g} s"
        signals = ", ".join(self.names) or "none"
        return (
            f"<LinearSignals {signals} from {', '.join(self.externals)}: {kind}{symbols_by_name}>"
        )


def _times(value: Any, row: Array, z: Array | None) -> Array:
    """A filter, number or expression times the response or gains of its source."""
    if isinstance(value, Filter) and z is not None:
        return np.asarray(value(z)[:, None] * row)
    return np.asarray(row * value)


def _entry(value: Any, where: str, Ts: float | None, noncausal: bool) -> tuple[Any, float | None]:
    """One filter as it is kept, and the sample time that holds from here on."""
    if isinstance(value, str) or is_symbolic(value):
        return as_expression(value, where), Ts
    made = as_filter(value, where, noncausal=noncausal)
    require_stable(made, where)
    if made.Ts is not None:
        if Ts is not None and not np.isclose(made.Ts, Ts, rtol=1e-9, atol=0):
            raise ModelError(
                f"{where} has sample time {made.Ts:g} s, the system {Ts:g} s; resample it, or give "
                f"Ts={made.Ts:g}"
            )
        Ts = made.Ts
    is_gain = len(made.a) == 1 and not np.any(made.b[1:]) and not made.lead
    return (float(made.b[0] / made.a[0]) if is_gain else made), Ts


def _variance(name: str, value: Any) -> Any:
    expression = as_expression(value, f"variance of {name}")
    if is_symbolic(expression):
        if expression.is_negative:
            raise ModelError(f"variance of {name} is {expression}, below zero; give a positive one")
        return expression
    number = float(expression)
    if not (np.isfinite(number) and number >= 0):
        raise ModelError(f"variance of {name} is {number:g}; give a finite number, 0 or more")
    return number


def _sample_time(Ts: Any) -> float:
    if not (np.isfinite(Ts) and Ts > 0):
        raise ModelError(f"Ts = {Ts!r}; give a sample time above 0 s")
    return float(Ts)


def _require_known(name: Any, known: Any, where: str) -> None:
    if name not in known:
        names = [str(k) for k in known]
        raise ModelError(
            f"{where}: {name!r} is not known there; known are {', '.join(names)}"
            f"{nearest(str(name), names, is_listed=True)}"
        )


def _free(value: Any) -> set[Any]:
    return value.free_symbols if is_symbolic(value) else set()
