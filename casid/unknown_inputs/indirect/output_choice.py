"""Which measurement is the output, and which the input: section 4.4 of Linder (2017).

Of measurements y = G_K u_K + G_I u_I + H tau with n unknown inputs, any n that these act on may
replace them, and the others are outputs. For two measurements and one unknown input:

    y1 = (G1K - G1I/G2I G2K) u_K + (G1I/G2I) y2                                             (4.53)
    y2 = (G2K - G2I/G1I G1K) u_K + (G2I/G1I) y1                                             (4.54)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from casid.algebra.transfer_matrix import RationalMatrix, transfer_matrix
from casid.errors import ModelError, nearest
from casid.model.quantities import count_text
from casid.unknown_inputs.indirect.blocks import noise_gain
from casid.unknown_inputs.indirect.direct_model import direct_model
from casid.unknown_inputs.indirect.indirect_model import IndirectModel, indirect_model


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One choice: these measurements are inputs, the others outputs.

    Attributes
    ----------
    amplification : the equation error over the outputs' own noise, root mean square over
        frequencies; infinite where the model is unstable or improper.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    model: IndirectModel
    amplification: float

    @property
    def is_usable(self) -> bool:
        """Whether the model can be simulated forward in time: proper and stable.

        False where symbols leave that open.
        """
        return not self.model.obstacles and not self.model.matrix.parameters

    def __repr__(self) -> str:
        symbols = ", ".join(self.model.matrix.parameters)
        text = "; ".join(self.model.obstacles) or (
            f"proper; whether it is stable depends on {symbols}"
            if symbols
            else f"proper and stable, noise times {self.amplification:.3g}"
        )
        return f"<Form {', '.join(self.outputs)} from {', '.join(self.inputs)}: {text}>"


@dataclass(frozen=True, slots=True, eq=False)
class OutputChoice:
    """All forms, and the one recommended.

    Attributes
    ----------
    forms : the best first; left_out : choices that are none, and why.
    reason : of the recommendation.
    """

    forms: tuple[Form, ...]
    left_out: tuple[str, ...]
    reason: str

    @property
    def recommended(self) -> Form:
        """The first of the forms."""
        return self.forms[0]

    def __repr__(self) -> str:
        best = self.recommended
        return (
            f"<OutputChoice: {', '.join(best.outputs)} from {', '.join(best.inputs)} of "
            f"{count_text(len(self.forms), 'form')}>"
        )

    def __str__(self) -> str:
        best = self.recommended
        lines = [f"output {', '.join(best.outputs)}, input {', '.join(best.inputs)}: {self.reason}"]
        lines += [f"  {form!r}" for form in self.forms]
        return "\n".join(lines + [f"  {text}" for text in self.left_out])


def choose_output(
    G_I: Any,
    G_K: Any = None,
    H: Any = None,
    *,
    measurements: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    wanted: Sequence[str] = (),
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
) -> OutputChoice:
    """Compare the choices of output and input.

    Parameters
    ----------
    G_I, G_K : (m, n) and (m, nK) from the unknown and the known inputs to the m measurements,
        m > n; anything that `transfer_matrix` reads.
    H : (m, m) noise of the measurements; by default white noise in each, of its own.
    measurements : their names, "y1", .. by default.
    noise : measurement -> standard deviation of its white noise (default one).
    wanted : measurements that are to be outputs: to be predicted, say. Both directions are the same
        relation; the inverse model can be estimated directly.
    Ts, values : sample time [s] and parameter values, as in `direct_model`.

    Returns
    -------
    OutputChoice
        Forms that are proper and stable first, the one least amplifying noise before the others;
        then proper ones, then stable ones. Frequency by frequency all forms have the same ratio of
        signal to noise: what differs is whether they can be simulated, and how white the error is.

    Raises
    ------
    ModelError
        If m <= n, shapes or names do not fit, or no choice determines the unknown inputs (which).
    """
    unknown = transfer_matrix(G_I, Ts=Ts, values=values)
    m, n = unknown.shape
    names = tuple(measurements) or tuple(f"y{i + 1}" for i in range(m))
    _require_measurements(names, unknown, (*(noise or {}), *wanted))
    known = None if G_K is None else transfer_matrix(G_K, Ts=Ts, values=values)
    loud = transfer_matrix(np.eye(m)) if H is None else transfer_matrix(H, Ts=Ts, values=values)
    for label, block in (("G_K", known), ("H", loud)):
        if block is not None and block.shape[0] != m:
            raise ModelError(f"{label} has {block.shape[0]} rows, G_I {m}; give one a measurement")
    sd = [float((noise or {}).get(name, 1.0)) for name in names]
    if H is not None and loud.shape[1] != m:
        sd = [1.0] * loud.shape[1]
    forms, left_out = _all_forms(unknown, known, loud, names, sd, wanted)
    if not forms:
        raise ModelError(
            f"no choice of inputs among {', '.join(names)} determines the unknown ones: "
            f"{'; '.join(left_out) or 'all of them are wanted as outputs'}"
        )
    forms.sort(key=lambda f: (_rank(f.model), f.amplification))
    return OutputChoice(tuple(forms), tuple(left_out), _reason(forms))


def _require_measurements(
    names: tuple[str, ...], unknown: RationalMatrix, used: Sequence[str]
) -> None:
    """Refuse names that do not fit G_I, no more measurements than inputs, and strange names."""
    m, n = unknown.shape
    if len(names) != m:
        raise ModelError(f"{len(names)} measurements are named, G_I has {m} rows; name each")
    if m <= n:
        raise ModelError(
            f"{n} unknown inputs and {m} measurements leave no output; measure more signals than "
            "there are unknown inputs"
        )
    for name in used:
        if name not in names:
            raise ModelError(f"no measurement {name!r}{nearest(name, names)}")


def _all_forms(
    unknown: RationalMatrix,
    known: RationalMatrix | None,
    H: RationalMatrix,
    names: tuple[str, ...],
    sd: list[float],
    wanted: Sequence[str],
) -> tuple[list[Form], list[str]]:
    """The forms of all choices that keep the wanted outputs, and why the other choices are none."""
    m, n = unknown.shape
    forms, left_out = [], []
    for inputs in combinations(range(m), n):
        outputs = [i for i in range(m) if i not in inputs]
        if any(names[i] in wanted for i in inputs):
            continue
        try:
            forms.append(_form(unknown, known, H, list(inputs), outputs, names, sd))
        except ModelError as why:
            left_out.append(f"inputs {', '.join(names[i] for i in inputs)}: {why}")
    return forms, left_out


def _form(
    unknown: RationalMatrix,
    known: RationalMatrix | None,
    H: RationalMatrix,
    inputs: list[int],
    outputs: list[int],
    names: tuple[str, ...],
    sd: Sequence[float],
) -> Form:
    def part(matrix: RationalMatrix, rows: list[int]) -> RationalMatrix:
        return matrix.select(rows, range(matrix.shape[1]))

    blocks: dict[str, Any] = {
        "G_OI": part(unknown, outputs),
        "G_II": part(unknown, inputs),
        "H_O": part(H, outputs),
        "H_I": part(H, inputs),
    }
    if known is not None:
        blocks |= {"G_OK": part(known, outputs), "G_IK": part(known, inputs)}
    labels = {
        "outputs": [names[i] for i in outputs],
        "measured_I": [names[i] for i in inputs],
    }
    model = indirect_model(direct_model(**blocks, names=labels))
    amplification = float("inf")
    weights = np.array(sd)
    if not model.matrix.parameters and not model.obstacles:
        own = noise_gain(model.direct.H_O, weights)
        error = noise_gain(model.H_O, weights)
        amplification = error / own if own > 0 else float("inf") if error > 0 else 0.0
    return Form(
        tuple(names[i] for i in inputs), tuple(names[i] for i in outputs), model, amplification
    )


def _rank(model: IndirectModel) -> int:
    if model.matrix.parameters:
        return 0 if model.is_proper else 3
    return 2 * (not model.is_proper) + (not model.is_stable)


def _reason(forms: Sequence[Form]) -> str:
    best, others = forms[0], forms[1:]
    usable = [f for f in others if f.is_usable]
    if not best.is_usable:
        return (
            "no form is proper and stable, this is the nearest: "
            f"{'; '.join(best.model.obstacles)}; "
            "estimate it from its regression, or use an approximate inverse"
        )
    if best.model.matrix.parameters:
        return "it is proper; whether it is stable depends on parameters without a value"
    if not others:
        return "it is the only form"
    if not usable:
        text = "; ".join(
            f"{', '.join(f.outputs)} from {', '.join(f.inputs)}: {' and '.join(f.model.obstacles)}"
            for f in others
        )
        return f"it alone is proper and stable; {text}"
    return (
        f"of {1 + len(usable)} proper and stable forms its equation error is the smallest beside "
        f"the output's own noise: {best.amplification:.3g} times, the next "
        f"{usable[0].amplification:.3g}"
    )
