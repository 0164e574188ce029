"""Linear regressions: what is regressed on what, with which instruments.

Linder (2017), (2.39)-(2.43): least squares and instrumental variables, prefiltered or not, and in
two stages where a regressor is itself predicted from a measurement (Example 3.8).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from casid.errors import ModelError

Term = str | tuple[str, int]
"""A signal, or a signal and its lag in samples; a minus before the name changes the sign:
("-y", 1) is -y(t-1)."""


@dataclass(frozen=True, slots=True, eq=False)
class FirstStage:
    """A signal that is predicted by regressing a measurement on known signals.

    Parameters
    ----------
    measured : the measurement that the prediction is fitted to.
    known : the signals it is predicted from.
    is_known : the coefficients are known and not estimated, so that they add no uncertainty.
    """

    measured: Term
    known: Sequence[Term]
    is_known: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """output = sum theta_i regressor_i, by least squares or instrumental variables.

    Parameters
    ----------
    output : the signal on the left.
    regressors : coefficient -> signal.
    instruments : as many as regressors, or more (then each regressor is projected on all of
        them: two-stage least squares); None for least squares.
    prefilter : L(q) of output and regressors, as (2.41) has it, and not of instruments: a filter
        as `casid.linear.filters` takes it.
    generated : signal -> its first stage; `regressors` and `instruments` may name these.
    """

    output: Term
    regressors: Mapping[str, Term]
    instruments: Sequence[Term] | None = None
    prefilter: Any = None
    generated: Mapping[str, FirstStage] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.regressors:
            raise ModelError(
                "a regression without regressors; give regressors={'b': 'u', ..}, coefficient "
                "to signal"
            )
        if self.instruments is not None and len(self.instruments) < len(self.regressors):
            raise ModelError(
                f"{len(self.instruments)} instruments for the {len(self.regressors)} coefficients "
                f"{', '.join(self.regressors)}; give at least as many, lags of a reference for "
                "instance"
            )
        object.__setattr__(self, "regressors", MappingProxyType(dict(self.regressors)))
        object.__setattr__(self, "generated", MappingProxyType(dict(self.generated)))


def arx(output: str, inputs: Sequence[str], na: int, nb: int, nk: int = 1) -> dict[str, Term]:
    """Regressors of A y = sum B_i u_i + e, (2.20)-(2.21): a1 .. from -y, b_k[u] from u(t-k)."""
    made: dict[str, Term] = {f"a{k}": (f"-{output}", k) for k in range(1, na + 1)}
    for name in inputs:
        made |= {f"b{k}[{name}]": (name, k) for k in range(nk, nk + nb)}
    return made


def lags(signal: str, first: int, last: int) -> list[Term]:
    """A signal at the lags first .. last."""
    return [(signal, k) for k in range(first, last + 1)]


def split_term(term: Term) -> tuple[float, str, int]:
    """Sign, signal and lag.

    Raises
    ------
    ModelError
        If it is no term.
    """
    given: Any = (term, 0) if isinstance(term, str) else term
    is_pair = isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str)
    name, lag = given if is_pair else ("", -1)
    if isinstance(lag, bool) or not isinstance(lag, int) or lag < 0:
        raise ModelError(
            f"{term!r} is no signal; give a name, or a name and a lag in samples, ('u', 1)"
        )
    return (-1.0, name[1:], lag) if name.startswith("-") else (1.0, name, lag)


def term_text(term: Term) -> str:
    """A term as a reader writes it: "-y(t-1)"."""
    sign, name, lag = split_term(term)
    return f"{'-' if sign < 0 else ''}{name}{f'(t-{lag})' if lag else ''}"


def terms_text(terms: Sequence[Term]) -> str:
    """Several terms, lags of one signal together: "r(t-1..t-5), d"."""
    groups: dict[str, list[int]] = {}
    for term in terms:
        sign, name, lag = split_term(term)
        groups.setdefault(("-" if sign < 0 else "") + name, []).append(lag)
    shown = []
    for name, lags_of in groups.items():
        first, last = min(lags_of), max(lags_of)
        is_run = len(lags_of) > 2 and sorted(lags_of) == list(range(first, last + 1))
        if is_run:
            shown.append(f"{name}({f't-{first}' if first else 't'}..t-{last})")
        else:
            shown += [term_text((name, lag)) for lag in lags_of]
    return ", ".join(shown)
