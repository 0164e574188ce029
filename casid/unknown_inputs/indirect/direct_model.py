"""The direct model: an output, its inputs, and direct and indirect measurements of them.

    y_O = G_OK u_K + G_OI u_I + G_OD u_D + H_O tau                                          (4.3)
    y_D = G_DD u_D + H_D tau                                                                (4.4)
    y_I = G_IK u_K + G_II u_I + G_ID u_D + G_IA u_A + H_I tau                               (4.5)

u_K known; u_D measured through known dynamics G_DD; u_I through y_I; u_A additional known signals.
Linder (2017), section 4.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from casid.algebra.transfer_matrix import RationalMatrix, shared_time, transfer_matrix
from casid.errors import ModelError
from casid.unknown_inputs.indirect.blocks import zeros

_ROLES = {
    "O": ("outputs", "y_O"),
    "K": ("known", "u_K"),
    "I": ("indirect", "u_I"),
    "D": ("direct", "u_D"),
    "A": ("additional", "u_A"),
    "yI": ("measured_I", "y_I"),
    "yD": ("measured_D", "y_D"),
    "t": ("noise", "tau"),
}
_BLOCKS = {
    "G_OK": ("O", "K"),
    "G_OI": ("O", "I"),
    "G_OD": ("O", "D"),
    "H_O": ("O", "t"),
    "G_IK": ("yI", "K"),
    "G_II": ("yI", "I"),
    "G_ID": ("yI", "D"),
    "G_IA": ("yI", "A"),
    "H_I": ("yI", "t"),
    "G_DD": ("yD", "D"),
    "H_D": ("yD", "t"),
}


@dataclass(frozen=True, slots=True, eq=False)
class DirectModel:
    """Equations (4.3)-(4.5); blocks are `RationalMatrix`, empty where there are no such signals."""

    G_OK: RationalMatrix
    G_OI: RationalMatrix
    G_OD: RationalMatrix
    H_O: RationalMatrix
    G_IK: RationalMatrix
    G_II: RationalMatrix
    G_ID: RationalMatrix
    G_IA: RationalMatrix
    H_I: RationalMatrix
    G_DD: RationalMatrix
    H_D: RationalMatrix

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of y_O."""
        return self.G_OK.outputs

    @property
    def noise(self) -> tuple[str, ...]:
        """Names of tau."""
        return self.H_O.inputs

    @property
    def time(self) -> tuple[str, float | None]:
        """Variable ("q", "s", "" for constants) and sample time of all blocks."""
        return _time_of({name: getattr(self, name) for name in _BLOCKS})

    def __repr__(self) -> str:
        parts = [
            f"{label} {', '.join(names)}"
            for label, names in (
                ("known", self.G_OK.inputs),
                ("indirectly measured", self.G_OI.inputs),
                ("directly measured", self.G_OD.inputs),
                ("additional", self.G_IA.inputs),
            )
            if names
        ]
        return f"<DirectModel of {', '.join(self.outputs)}: {'; '.join(parts)}>"


def direct_model(
    *,
    G_OK: Any = None,
    G_OI: Any = None,
    G_OD: Any = None,
    H_O: Any = None,
    G_IK: Any = None,
    G_II: Any = None,
    G_ID: Any = None,
    G_IA: Any = None,
    H_I: Any = None,
    G_DD: Any = None,
    H_D: Any = None,
    names: Mapping[str, Sequence[str]] | None = None,
    Ts: float | None = None,
    values: Mapping[str, Any] | None = None,
) -> DirectModel:
    """The direct model from transfer matrices of any kind.

    Parameters
    ----------
    G_OK, G_OI, G_OD, H_O, G_IK, G_II, G_ID, G_IA, H_I, G_DD, H_D : blocks of (4.3)-(4.5), each
        anything `transfer_matrix` reads: one function, rows of them, a `control` object, sympy or
        CasADi. A block that is not given is zero; H_X that are not given have no noise.
    names : "outputs", "known", "indirect", "direct", "additional", "measured_I", "measured_D",
        "noise" -> names of y_O, u_K, u_I, u_D, u_A, y_I, y_D, tau; by default u_K1 and so on.
    Ts, values : sample time [s] and parameter values.

    Raises
    ------
    ModelError
        If blocks disagree on a dimension or on the sample time (which ones), there is no output, or
        fewer measurements than inputs that they measure.
    """
    given = {name: value for name, value in locals().items() if name in _BLOCKS}
    read = {n: transfer_matrix(v, Ts=Ts, values=values) for n, v in given.items() if v is not None}
    labels = _labels(read, names or {})
    blocks = {}
    for name, (row, column) in _BLOCKS.items():
        blocks[name] = (
            RationalMatrix(read[name].rows, labels[row], labels[column])
            if name in read
            else zeros(labels[row], labels[column])
        )
    _time_of(blocks)
    return DirectModel(**blocks)


def _labels(
    read: Mapping[str, RationalMatrix], names: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, ...]]:
    """Names of the signals of each role; refused where they or the blocks do not fit."""
    for key in names:
        if key not in {role for role, _ in _ROLES.values()}:
            raise ModelError(
                f"names has no {key!r}; there are {', '.join(role for role, _ in _ROLES.values())}"
            )
    counts = _counts(read, names)
    labels = {
        role: tuple(names.get(key, ()))
        or tuple(f"{base}{i + 1}" if counts[role] > 1 else base for i in range(counts[role]))
        for role, (key, base) in _ROLES.items()
    }
    for role, (key, _) in _ROLES.items():
        if len(labels[role]) != counts[role]:
            raise ModelError(
                f"{len(labels[role])} {key} are named, but the blocks have {counts[role]}; name "
                "each of them"
            )
    if counts["O"] == 0:
        raise ModelError("no output: give G_OK, G_OI or G_OD, from the inputs to y_O")
    for measured, role, block in (("yI", "I", "G_II"), ("yD", "D", "G_DD")):
        if counts[measured] < counts[role]:
            raise ModelError(
                f"{counts[role]} inputs {', '.join(labels[role])} are to be had from "
                f"{counts[measured]} measurements; give {block} with at least as many rows as "
                "columns, or count some of these inputs as noise"
            )
    return labels


def _counts(
    read: Mapping[str, RationalMatrix], names: Mapping[str, Sequence[str]]
) -> dict[str, int]:
    """How many signals of each role; blocks that disagree are refused."""
    found: dict[str, tuple[int, str]] = {}
    for name, matrix in read.items():
        for role, count, side in zip(_BLOCKS[name], matrix.shape, ("rows", "columns"), strict=True):
            if role in found and found[role][0] != count:
                other = found[role]
                raise ModelError(
                    f"{name} has {count} {side} for {_ROLES[role][1]}, but {other[1]} has "
                    f"{other[0]}; give both the same number of these signals"
                )
            found.setdefault(role, (count, name))
    out = {role: found[role][0] if role in found else 0 for role in _ROLES}
    for role, (key, _) in _ROLES.items():
        if role not in found and key in names:
            out[role] = len(names[key])
    return out


def _time_of(blocks: Mapping[str, RationalMatrix]) -> tuple[str, float | None]:
    """Variable and sample time that blocks share; two that differ are named."""
    first: tuple[str, RationalMatrix] | None = None
    for name, block in blocks.items():
        variable, Ts = block.time
        if not variable:
            continue
        if first is not None:
            other, own_time = first[0], first[1].time
            if own_time[0] != variable:
                raise ModelError(
                    f"{other} is in {own_time[0]}, {name} in {variable}; convert both to discrete "
                    "or both to continuous time first (control.c2d)"
                )
            if None not in (own_time[1], Ts) and own_time[1] != Ts:
                raise ModelError(
                    f"{other} has the sample time {own_time[1]:g} s, {name} {Ts:g} s; resample one"
                )
        if first is None or first[1].time[1] is None:
            first = (name, block)
    return shared_time([g for b in blocks.values() for row in b.rows for g in row])
