"""Polynomial models as documents."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from casid.arrays import Array
from casid.estimation.covariance import whiteness
from casid.estimation.prediction_error.polynomial.misfit import LAGS
from casid.estimation.prediction_error.polynomial.model import PolynomialModel
from casid.model.quantities import count_text
from casid.report.document import Document, Lines

_LISTED = 5  # records whose first residuals do not count


def polynomial_document(model: PolynomialModel) -> Document:
    """The equation, its polynomials with their errors, and what the estimate rests on."""
    m = model
    polynomials = dict(_polynomials(m))
    width = max(map(len, polynomials), default=0)
    first = ", ".join(map(str, m.discarded[:_LISTED]))
    first += ", .." if len(m.discarded) > _LISTED else ""
    return Document(
        f"{m.structure} model: {_equation(m)}, Ts = {m.Ts:g} s",
        [
            Lines([f"  {name:<{width}} = {text}" for name, text in polynomials.items()]),
            "  (+/- one standard error; a delay shows as the first power of q^-1)",
            ("status", f"{m.status}, {count_text(m.iterations, 'iteration')}, scaled gradient "
             f"{m.scaled_gradient:.0e}"),
            ("start", m.start),
            ("residuals", f"N = {m.N}, {count_text(len(m.residuals), 'record')}, first samples "
             f"that do not count: {first}"),
            ("residual tests", _residual_tests(m)),
            ("noise variance", f"{m.noise_variance:.6g}   loss {m.loss:.6g}"),
            ("fit", f"{m.fit:.2f} % (one step ahead)"),
            f"  AIC {m.aic:.6g}   BIC {m.bic:.6g}",
            ("errors assume", m.assumes),
            *(("NOTE", note) for note in m.notes),
        ],
        label=16,
    )  # fmt: skip


def _equation(m: PolynomialModel) -> str:
    terms = []
    for i in m.inputs:
        mark = _mark(m, i)
        over = len(m.F[i]) > 1
        terms.append(f"{'[' if over else ''}B{mark}(q){f'/F{mark}(q)]' if over else ''} {i}(t)")
    c, d = len(m.C) > 1, len(m.D) > 1
    noise = f"{'[' if d else ''}{'C(q)' if c else '1' if d else ''}{'/D(q)]' if d else ''}"
    terms.append(f"{noise} e(t)".strip())
    return f"{'y(t)' if len(m.A) == 1 else 'A(q) y(t)'} = {' + '.join(terms)}"


def _mark(m: PolynomialModel, name: str) -> str:
    return f"[{name}]" if len(m.inputs) > 1 else ""


def _polynomials(m: PolynomialModel) -> Iterator[tuple[str, str]]:
    """Name and text of every polynomial that is not 1."""
    errors = m.std_errors
    if len(m.A) > 1:
        yield "A(q)", _text(m.A, "a", "", errors)
    for i in m.inputs:
        yield f"B{_mark(m, i)}(q)", _text(m.B[i], "b", f"[{i}]", errors)
    for name, polynomial in (("C", m.C), ("D", m.D)):
        if len(polynomial) > 1:
            yield f"{name}(q)", _text(polynomial, name.lower(), "", errors)
    for i in m.inputs:
        if len(m.F[i]) > 1:
            yield f"F{_mark(m, i)}(q)", _text(m.F[i], "f", f"[{i}]", errors)


def _residual_tests(m: PolynomialModel) -> str:
    """Whiteness, and correlation with each input, as counts of lags."""
    lags = min(LAGS, m.N - 2)
    said = [f"whiteness: {whiteness(m.residual)} of {lags} lags outside 95 %"]
    for name, ratio in m.input_correlation.items():
        outside = int(np.sum(np.abs(ratio) > 1))
        said.append(f"correlation with {name}: {outside} of {len(ratio)} lags outside")
    return "; ".join(said)


def _text(polynomial: Array, letter: str, mark: str, errors: Mapping[str, float]) -> str:
    """1 - 1.5 (+/- 0.01) q^-1 + ..., monic or with leading zeros left out."""
    parts: list[str] = []
    for lag, value in enumerate(polynomial.tolist()):
        error = errors.get(f"{letter}{lag}{mark}")
        if error is None and value == 0.0:
            continue
        sign = "-" if value < 0 else "+" if parts else ""
        size = f"{abs(value):.5g}" + (f" (+/- {error:.2g})" if error is not None else "")
        power = f" q^-{lag}" if lag else ""
        parts.append(f"{sign}{' ' if parts else ''}{size}{power}")
    return " ".join(parts)
