"""The model without its unknown input: Hou and Mueller's form, (3.70)-(3.72) of Linder (2017).

    dx/dt = Abar x + B1 u_K + B2 du_K/dt + G1 y + G2 dy/dt,   Py y = Cbar x + Dbar u_K      (1)

with F+ = pinv(F), Py = I - F F+, Pu = I - F+ F, Cbar = Py C, Dbar = Py D, Ctil = Cbar E Pu and
Bbar = E Pu pinv(Ctil). In discrete time x[t+1], u_K[t+1] and y[t+1] stand for the derivatives.

Sources: M. Hou, P. C. Mueller, Disturbance decoupled observer design: a unified viewpoint, IEEE
Trans. Autom. Control 39 (1994) 1338-1341; M. Hou, R. J. Patton, Optimal filtering for systems with
unknown inputs, IEEE Trans. Autom. Control 43 (1998) 445-449.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import ModelError
from casid.linear.subspaces import (
    TOLERANCE,
    Zeros,
    input_scale,
    invariant_zeros,
    pseudo_inverse,
    rank,
    row_space,
    size,
    unobservable_subspace,
)
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentModel:
    """Model (1). A, C (nx, nx), (ny, nx): Abar, Cbar; D = Dbar; P_y (ny, ny) makes ybar of y.

    Attributes
    ----------
    C_til (ny, nu) : what the unknown input does to the derivative of ybar.
    leftover (nx, nu) : E Pu (I - pinv(Ctil) Ctil), what of the unknown input (1) leaves out: zero
        where (1) is exact, up to rounding.
    leftover_size : its largest singular value relative to that of E, inputs scaled to size one.
    """

    system: UnknownInputSystem
    A: Array
    B1: Array
    B2: Array
    G1: Array
    G2: Array
    C: Array
    D: Array
    P_y: Array
    C_til: Array
    leftover: Array
    leftover_size: float

    @property
    def is_exact(self) -> bool:
        """True if no part of the unknown input is left: E Pu (I - pinv(Ctil) Ctil) = 0."""
        return self.leftover_size <= 1e-7


def equivalent_model(
    system: UnknownInputSystem, *, tolerance: float = TOLERANCE
) -> EquivalentModel:
    """Eliminate the unknown input, (3.70).

    Parameters
    ----------
    tolerance : singular values up to this, of F relative to F and of Ctil relative to the factors
        that it is made of, count as zero. Absolute, not relative to Ctil itself: where Pu or Ctil
        vanish in algebra they are 1e-16 in numbers.

    Returns
    -------
    EquivalentModel
        In (3.70) inputs count in units of their columns of [E; F], which changes nothing where F
        has full column rank or vanishes, and for one input. Exact if its `is_exact` says so;
        `existence` says what to do where it is not.
    """
    s = system
    scale = input_scale(s.E, s.F)  # of the inputs: a force in N beside one in kN
    E, F = s.E / scale, s.F / scale
    F_p = pseudo_inverse(F, tolerance * size(F))
    P_y, P_u = np.eye(s.ny) - F @ F_p, np.eye(s.nu) - F_p @ F
    C, D = P_y @ s.C, P_y @ s.D
    E_u = E @ P_u
    C_til = C @ E_u
    into = pseudo_inverse(C_til, tolerance * size(s.C) * size(E))
    B_bar = E_u @ into
    keep = np.eye(s.nx) - B_bar @ C
    leftover = E_u @ (np.eye(s.nu) - into @ C_til)
    return EquivalentModel(
        system=s,
        A=keep @ (s.A - E @ F_p @ s.C),
        B1=keep @ (s.B - E @ F_p @ s.D),
        B2=-B_bar @ D,
        G1=keep @ E @ F_p,
        G2=B_bar @ P_y,
        C=C,
        D=D,
        P_y=P_y,
        C_til=C_til * scale,
        leftover=leftover * scale,
        leftover_size=size(leftover) / max(size(E), TINY),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Existence:
    """Whether an observer exists that is decoupled from the unknown input.

    Attributes
    ----------
    model : the equivalent model.
    zeros : invariant zeros from the unknown input to the outputs.
    unstable : (k,) of those, the ones outside the open stability region.
    hidden : (nx, j) basis of the states that (Abar, Cbar) does not observe.
    reason : why there is none, and the remedy; empty where there is one.
    """

    model: EquivalentModel
    zeros: Zeros
    unstable: Array
    hidden: Array
    reason: str

    @property
    def exists(self) -> bool:
        """True if the observer exists."""
        return not self.reason

    @property
    def fixed_poles(self) -> Array:
        """Poles that no gain moves: eigenvalues of Abar where (Abar, Cbar) is unobservable."""
        V = self.hidden
        return np.asarray(np.linalg.eigvals(V.T @ self.model.A @ V))

    def __str__(self) -> str:
        s = self.model.system
        lines = [repr(s), f"  left of the unknown input: {self.model.leftover_size:.1e} of E"]
        zeros = ", ".join(pole_text(z, s) for z in self.zeros.values) or "none"
        lines.append(f"  zeros from {', '.join(s.unknown)}: {zeros}")
        verdict = "an observer decoupled from the unknown input exists"
        return "\n".join([*lines, f"  {self.reason or verdict}"])


def existence(system: UnknownInputSystem, *, tolerance: float = TOLERANCE) -> Existence:
    """Whether E Pu (I - pinv(Ctil) Ctil) = 0 and (Abar, Cbar) is detectable, Linder's Ass. 3.1.

    Detectability is decided by the invariant zeros from the unknown input to the outputs,

        rank [A - s I, E; C, F] = n + rank [E; F] for all s outside the stability region,  (3.71)

    and it is these that a refusal names. (3.71) alone is not enough: of a double integrator whose
    position is measured it holds, but y'' would be needed.
    """
    s = system
    model = equivalent_model(s, tolerance=tolerance)
    scale = input_scale(s.E, s.F)
    kept = row_space(np.vstack([s.E, s.F]) / scale, tolerance).T / scale[:, None]
    zeros = invariant_zeros(s.A, s.E @ kept, s.C, s.F @ kept, tolerance)
    unstable = np.array([z for z in zeros.values if s.is_unstable(z)], dtype=complex)
    hidden = unobservable_subspace(model.A, model.C, tolerance)
    reason = ""
    if zeros.hidden_inputs.shape[1]:
        reason = _too_many(s, kept @ zeros.hidden_inputs)
    elif not model.is_exact:
        reason = _not_felt(model, bool(len(unstable)))
    elif len(unstable):
        reason = _unstable_zero(s, zeros)
    return Existence(model, zeros, unstable, hidden, reason)


def require_existence(system: UnknownInputSystem, *, tolerance: float = TOLERANCE) -> Existence:
    """`existence`, refused with its reason where there is no observer.

    Raises
    ------
    ModelError
    """
    found = existence(system, tolerance=tolerance)
    if not found.exists:
        raise ModelError(f"{system.name}: {found.reason}")
    return found


def unrecoverable_inputs(system: UnknownInputSystem) -> tuple[str, ...]:
    """Names of unknown inputs that the outputs do not determine, whatever is done with them.

    Input i can be recovered iff G without column i has a rank one lower, G = C (z I - A)^-1 E + F
    the matrix of rational functions; its rank is taken at two points (right with probability one).
    """
    s = system
    lost: set[str] = set(s.unknown)
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        z = complex(*rng.standard_normal(2)) * max(size(s.A), 1.0)
        G = s.C @ np.linalg.solve(z * np.eye(s.nx) - s.A, s.E) + s.F
        G = G / np.maximum(np.linalg.norm(G, axis=0), TINY)  # units of the inputs do not count
        G = G / np.maximum(np.linalg.norm(G, axis=1, keepdims=True), TINY)
        whole = rank(G, TOLERANCE)
        lost &= {
            name
            for i, name in enumerate(s.unknown)
            if rank(np.delete(G, i, axis=1), TOLERANCE) == whole
        }
    return tuple(n for n in s.unknown if n in lost)


def require_recoverable(system: UnknownInputSystem) -> None:
    """Refuse unknown inputs that the outputs do not determine.

    Raises
    ------
    ModelError
        Which names them.
    """
    s = system
    lost = unrecoverable_inputs(s)
    if lost:
        raise ModelError(
            f"{s.name}: {', '.join(lost)} cannot be recovered from {', '.join(s.outputs)}: other "
            "unknown inputs do the same to every output. Add an output that responds to them in "
            "another way, or leave one of them out"
        )


def pole_text(value: complex, system: UnknownInputSystem) -> str:
    """A pole or zero in words: its value, and its frequency in rad/s."""
    letter = "z" if system.is_discrete else "s"
    value = complex(value)
    imaginary = abs(value.imag) > 1e-9 * max(abs(value), 1.0)
    text = f"{value.real:.6g}" + (f"{value.imag:+.6g}j" if imaginary else "")
    if system.is_discrete:
        w = abs(float(np.angle(value))) / system.Ts
    else:
        w = abs(value)
    return f"{letter} = {text} ({w:.4g} rad/s)"


def direction_text(vector: Array, names: Sequence[str]) -> str:
    """The signals that a direction is made of, the largest first."""
    share = np.abs(vector) / max(float(np.max(np.abs(vector), initial=0.0)), TINY)
    order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] > 0.1]
    return ", ".join(names[i] for i in order)


def _unstable_zero(s: UnknownInputSystem, zeros: Zeros) -> str:
    worst = [i for i, z in enumerate(zeros.values) if s.is_unstable(z)]
    worst_zeros = "; ".join(
        f"{pole_text(zeros.values[i], s)}, along {direction_text(zeros.states[:, i], s.states)}"
        for i in worst
        if zeros.values[i].imag >= -1e-12
    )
    where = "on or outside the unit circle" if s.is_discrete else "not in the left half-plane"
    return (
        f"no observer is free of {', '.join(s.unknown)}: transmission zero {worst_zeros}, {where}. "
        "There an input exists that moves these states and that no output of "
        f"{', '.join(s.outputs)} sees. Add an output that sees them, or estimate the input from "
        "the whole record with noncausal_inverse or reconstruct_input"
    )


def _not_felt(model: EquivalentModel, also_unstable: bool) -> str:
    s = model.system
    felt = input_scale(s.E, s.F)
    _, _, Vt = np.linalg.svd(model.leftover / felt)
    step = "the next sample" if s.is_discrete else "the first derivative"
    moved = np.linalg.norm(model.leftover, axis=1)
    more = ", and it has unstable zeros besides" if also_unstable else ""
    return (
        f"no observer is free of {direction_text(Vt[0], s.unknown)}: it moves "
        f"{direction_text(moved, s.states)}, but neither {', '.join(s.outputs)} nor {step} of an "
        "output depends on it "
        f"(E Pu (I - pinv(Ctil) Ctil) is {model.leftover_size:.2g} of E, not 0)"
        f"{more}. Measure a signal nearer to it (a velocity or an acceleration, say), or estimate "
        "the input with reconstruct_input, which uses later samples as well"
    )


def _too_many(s: UnknownInputSystem, directions: Array) -> str:
    lost = unrecoverable_inputs(s) or (direction_text(directions[:, 0], s.unknown),)
    return (
        f"{', '.join(lost)} cannot be distinguished by {', '.join(s.outputs)}: from "
        f"{s.nu} unknown inputs the outputs' transfer matrix has too low a rank at every "
        f"{'z' if s.is_discrete else 's'}. Add an output that responds to them in another way, or "
        "leave one of them out"
    )
