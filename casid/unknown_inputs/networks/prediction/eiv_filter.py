"""The errors-in-variables Kalman filter of an indirect model: (6.13)-(6.21) of Linder (2017).

The nodes that stand for an unmeasured input add their own disturbances, so the inputs of an
indirect model are noisy. Where G_II = G_ID = G_IUt = 0,

    w_j = G_jK w_K + G_jO w_O + G_jI (w_I - delta_I - tau_I) + G_jD (w_D - delta_D - tau_D)
          + F_jj (delta_j + tau_j),

the same disturbances drive the state and the output, and a Kalman filter separates them
from the innovation: it predicts w_j, and estimates w_j, w_I and w_D without their disturbances.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.algebra.rational import Rational
from casid.algebra.realisation import matrices
from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.data.record import Record
from casid.errors import ModelError
from casid.linear.filtering.kalman import Predictor, steady_state, step, time_varying
from casid.linear.filtering.noisy_system import NoisySystem
from casid.model.quantities import count_text
from casid.unknown_inputs.networks.network import Network, Signal
from casid.unknown_inputs.networks.node_sets import NodeSets, sets_for
from casid.unknown_inputs.networks.nodes import Edge, Node, edge_label, labels, node_label
from casid.unknown_inputs.networks.prediction.observation_choice import observation_choices
from casid.unknown_inputs.networks.simulation import refuse_continuous, signal_of


@dataclass(frozen=True, slots=True, eq=False)
class EivFiltered:
    """The result of the filter on a record.

    Attributes
    ----------
    prediction : (N,) of w_j one step ahead.
    innovations : (N,) w_j - prediction; white where the model is right.
    variances : (N,) of the innovations.
    noise_free : node -> (N,) estimate of w_n - tau_n, for the target and its noisy inputs (6.21).
    std_errors : node -> (N,) of those estimates.
    """

    prediction: Array
    innovations: Array
    variances: Array
    noise_free: Mapping[Node, Array]
    std_errors: Mapping[Node, Array]

    def __repr__(self) -> str:
        rms = float(np.sqrt(np.mean(self.innovations**2)))
        return f"<EivFiltered {len(self.prediction)} samples: rms of the innovations {rms:.3g}>"


@dataclass(frozen=True, slots=True, eq=False)
class EivFilter:
    """The realisation (6.17)-(6.20) of an indirect model with noisy inputs.

    Attributes
    ----------
    inputs : signals of the known input: nodes, and delta_j as "delta_j".
    noisy : the target and the nodes whose disturbance enters, in the order of `tau`.
    system : x+ = A x + B u + n_x, w_j - D u = C x + n_y. Its state holds, behind that of the model,
        the states of coloured disturbances.
    tau : (M, N) with tau = M x + N e: the disturbances of `noisy` from state and white noise e.
    white : (m, m) covariance of e.
    direct : (1, m) how e enters the output.
    """

    network: Network
    target: Node
    inputs: tuple[tuple[str, Node | None], ...]
    noisy: tuple[Node, ...]
    system: NoisySystem
    tau: tuple[Array, Array]
    white: Array
    direct: Array

    @property
    def steady(self) -> Predictor:
        """The filter when it has settled."""
        return steady_state(self.system)

    @property
    def variance(self) -> float:
        """Variance of the settled one-step error."""
        return float(self.steady.F[0, 0])

    def noise_free_variances(self) -> dict[Node, float]:
        """Settled error variances of the estimates of w_n - tau_n."""
        found = self.steady
        _, left = self._gain(found.P, found.F)
        return dict(zip(self.noisy, np.diag(left).tolist(), strict=True))

    def run(self, signals: Record | Mapping[str, Array]) -> EivFiltered:
        """Filter w1, w2 ... and delta_j, with the time-varying filter (2.35) from rest.

        Raises
        ------
        DataError
            If a signal is not there.
        """
        w = signal_of(signals, node_label(self.target))
        u = np.column_stack([self._input(signals, *i) for i in self.inputs] or [np.zeros(len(w))])
        found = time_varying(self.system, w[:, None], u[:, : self.system.nu])
        eps, F = found.innovations[:, 0], found.covariances[:, 0, 0]
        estimates, errors = self._disturbances(found, eps, F)
        read = {n: signal_of(signals, node_label(n)) for n in self.noisy}
        return EivFiltered(
            prediction=np.asarray(w - eps),
            innovations=np.asarray(eps),
            variances=np.asarray(F),
            noise_free={n: read[n] - estimates[:, i] for i, n in enumerate(self.noisy)},
            std_errors={n: errors[:, i] for i, n in enumerate(self.noisy)},
        )

    def _input(self, signals: Any, name: str, node: Node | None) -> Array:
        signal = signal_of(signals, name)
        if node is not None and node in self.network.excitations and node in self.noisy:
            signal = signal - signal_of(signals, f"delta_{node}")
        return signal

    def _gain(self, P: Array, F: Array) -> tuple[Array, Array]:
        """(m, 1) gain of tau on the innovation, and the residual covariance."""
        M, N = self.tau
        with_new = M @ P @ self.system.C.T + N @ self.white @ self.direct.T
        gain = with_new / F[0, 0]
        own = M @ P @ M.T + N @ self.white @ N.T
        return gain, own - gain @ with_new.T

    def _disturbances(self, found: Any, eps: Array, F: Array) -> tuple[Array, Array]:
        """(N, m) filtered estimates of tau and their standard errors, while P settles and after."""
        M, _ = self.tau
        estimates = np.asarray(found.x[:-1] @ M.T)
        errors = np.empty_like(estimates)
        P: NDArray[Any] = np.zeros((self.system.nx, self.system.nx))
        settled = found.converged_at if found.converged_at is not None else len(eps)
        for t in range(settled):
            own, _, after = step(self.system, P)
            gain, left = self._gain(P, own)
            estimates[t] += gain[:, 0] * eps[t]
            errors[t] = np.sqrt(np.maximum(np.diag(left), 0.0))
            P = after
        gain, left = self._gain(P, np.atleast_2d(F[-1]))
        estimates[settled:] += eps[settled:, None] * gain[:, 0]
        errors[settled:] = np.sqrt(np.maximum(np.diag(left), 0.0))
        return estimates, errors

    def __repr__(self) -> str:
        inputs = ", ".join(name for name, _ in self.inputs)
        return (
            f"<EivFilter of {node_label(self.target)} from {inputs}; noisy {labels(self.noisy)}; "
            f"{count_text(len(self.system.A), 'state')}>"
        )


@names_wrong_types(ModelError)
def eiv_filter(
    network: Network,
    target: Node,
    *,
    sensors: Iterable[Node] | None = None,
    known: Collection[Edge] = (),
    sets: NodeSets | None = None,
) -> EivFilter:
    """The Kalman filter of a node's indirect model, (6.13)-(6.21).

    Parameters
    ----------
    network, target : the network and its node j.
    sensors, known : as for `node_sets`; or the sets themselves. Of more observations than unknown
        inputs those of least error variance are taken (`observation_choice`), among those to which
        (6.13) applies.

    Raises
    ------
    ModelError
        If a module from another input observation or a remaining unobserved node into an indirect
        one is there (it is named), the model is improper (with zeros, their frequencies and
        approximations), or the target has no disturbance.
    """
    refuse_continuous(network, "filtered sample by sample")
    if sensors is not None:
        network = network.with_sensors(sensors)
    sets = sets_for(network, target, sets, known)
    choices = observation_choices(network, sets, accept=lambda s: not _module_between(network, s))
    _refuse_other_modules(network, choices.best.sets)
    # What is unstable is steadied by the filter's gain; what is improper has no state.
    chosen = next((c for c in choices.evaluated if c.is_proper), None) or choices.require_usable()
    row, sets = chosen.equations, chosen.sets
    noisy = (target, *(n for n in (*sets.I, *sets.D) if n in row.G[target]))
    _refuse_quiet(network, target)
    own = row.filter(target, target)
    noise = [own, *(-row.module(target, n) for n in noisy[1:])]
    known_inputs: list[tuple[str, Node | None, Rational]] = [
        (node_label(k), k, row.module(target, k)) for k in row.G[target]
    ]
    if target in network.excitations:
        known_inputs.append((f"delta_{target}", None, own))
    return _realised(network, target, known_inputs, noisy, noise)


def _realised(
    network: Network,
    target: Node,
    inputs: list[tuple[str, Node | None, Rational]],
    noisy: tuple[Node, ...],
    noise: list[Rational],
) -> EivFilter:
    names = (*(name for name, _, _ in inputs), *(f"tau_{n}" for n in noisy))
    row = (*(g for _, _, g in inputs), *noise)
    A, B, C, D = matrices(RationalMatrix((row,), (node_label(target),), names))
    nu = len(inputs)
    signals = [network.disturbances.get(n, Signal(0.0)) for n in noisy]
    a, b, c, d = matrices(_diagonal([s.model for s in signals]))
    white = np.diag([s.variance for s in signals])
    # Behind the model's state that of the coloured disturbances: tau = c x_h + d e.
    n, h = len(A), len(a)
    A_all = np.block([[A, B[:, nu:] @ c], [np.zeros((h, n)), a]])
    G = np.vstack([B[:, nu:] @ d, b])
    E = D[:, nu:] @ d
    system = NoisySystem(
        A_all,
        np.vstack([B[:, :nu], np.zeros((h, nu))]),
        np.hstack([C, D[:, nu:] @ c]),
        D[:, :nu],
        0.5 * (G @ white @ G.T + (G @ white @ G.T).T),
        E @ white @ E.T,
        G @ white @ E.T,
        network.Ts or 1.0,
        outputs=(node_label(target),),
        inputs=tuple(name for name, _, _ in inputs),
    )
    M = np.hstack([np.zeros((len(noisy), n)), c])
    return EivFilter(
        network=network,
        target=target,
        inputs=tuple((name, node) for name, node, _ in inputs),
        noisy=noisy,
        system=system,
        tau=(M, d),
        white=white,
        direct=E,
    )


def _diagonal(models: list[Rational]) -> RationalMatrix:
    zero = Rational(())
    rows = [tuple(g if i == k else zero for k in range(len(models))) for i, g in enumerate(models)]
    return RationalMatrix(tuple(rows))


def _module_between(network: Network, sets: NodeSets) -> Edge | None:
    """A module that (6.13) does not allow: from I, D or the remaining unobserved nodes into I."""
    for to in sets.I:
        for source in (*sets.I, *sets.D, *sets.Ut):
            if (to, source) in network.modules:
                return to, source
    return None


def _refuse_other_modules(network: Network, sets: NodeSets) -> None:
    edge = _module_between(network, sets)
    if edge is not None:
        raise ModelError(
            f"{network.name}: {edge_label(edge)} acts on the indirect observation "
            f"{node_label(edge[0])}, so the errors of its model are filtered twice and (6.13) does "
            f"not hold. Measure another node than {labels([edge[0]])} for the unknown inputs "
            "(indirect= of node_sets), or use the predictor of compare_predictors"
        )


def _refuse_quiet(network: Network, target: Node) -> None:
    if network.disturbances.get(target, Signal(0.0)).variance <= 0:
        raise ModelError(
            f"{network.name}: {node_label(target)} has no disturbance, so the filter has nothing "
            f"new at every sample; give it one, disturbances={{{target!r}: variance}}"
        )
