"""One predictor of a node: what it uses, what it leaves, how large that is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.arrays import Array
from casid.data.record import Record
from casid.errors import ModelError
from casid.linear.filtering.kalman import Predictor
from casid.unknown_inputs.networks.network import Network, Signal
from casid.unknown_inputs.networks.nodes import Node, node_label
from casid.unknown_inputs.networks.prediction.error_variance import innovations, variance
from casid.unknown_inputs.networks.simulation import filtered, signal_of

Signals = Record | Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class NodePredictor:
    """what_j = sum_k inputs[k] w_k + sum_n excitations[n] delta_n, and the error w_j - what_j.

    Attributes
    ----------
    kind : the class of predictor, as (6.1)-(6.11) of Linder (2017) have them.
    inputs : node -> filter of its signal.
    excitations : node -> filter of its delta.
    error : external signal -> filter; their sum is the error. Externals are tau_n, delta_n of
        excitations that are not used, and sensor_k where a sensor is noisy.
    sources : external signal -> its `Signal`.
    """

    network: Network
    target: Node
    kind: str
    inputs: Mapping[Node, Rational]
    excitations: Mapping[Node, Rational]
    error: Mapping[str, Rational]
    sources: Mapping[str, Signal]

    @property
    def is_stable(self) -> bool:
        """Whether it can be run: all its filters are proper and stable."""
        return not self.obstacle

    @property
    def obstacle(self) -> str:
        """The filter that keeps it from being run, and why; empty if there is none."""
        named = {node_label(k): g for k, g in self.inputs.items()}
        named |= {f"delta_{n}": g for n, g in self.excitations.items()}
        for name, g in named.items():
            if not g.is_proper:
                return f"the filter of {name} is improper: {g}"
            if not g.is_stable:
                pole = next(r for r in g.poles() if not r.is_stable)
                return f"the filter of {name} is unstable, pole {pole}"
        return ""

    @cached_property
    def variance(self) -> float:
        """Exact variance of the error; infinite where it is not stationary."""
        return variance(self.error, self.sources)

    @cached_property
    def whitening(self) -> Predictor:
        """The noise model Hc: the error as predicted from its own past, (6.5)."""
        return innovations(self.error, self.sources, self.network.Ts or 1.0)

    @property
    def whitened_variance(self) -> float:
        """Residual variance when the noise model is used as well, (6.6) with Hc^-1."""
        if self.variance == 0 or not np.isfinite(self.variance):
            return self.variance
        return float(self.whitening.F[0, 0])

    def predict(self, signals: Signals, *, whiten: bool = False) -> Array:
        """(N,) prediction of the node from rest.

        Parameters
        ----------
        signals : w1, w2 ... and delta_j by name; w of the target only with `whiten`.
        whiten : use the noise model too: the error's own past, (6.5).

        Raises
        ------
        ModelError
            If a filter is improper or not stable.
        DataError
            If a signal is not there.
        """
        if self.obstacle:
            raise ModelError(
                f"{self.kind} predictor of {node_label(self.target)}: {self.obstacle}. It cannot "
                "be run; choose other nodes as inputs"
            )
        parts = [filtered(g, signal_of(signals, node_label(k))) for k, g in self.inputs.items()]
        parts += [
            filtered(g, signal_of(signals, f"delta_{n}")) for n, g in self.excitations.items()
        ]
        if not parts:
            length = len(signal_of(signals, node_label(self.target)))
            parts = [np.zeros(length)]
        plain = np.sum(parts, axis=0)
        if not whiten:
            return np.asarray(plain)
        w = signal_of(signals, node_label(self.target))
        new = self.whitening.run((w - plain)[:, None]).innovations[:, 0]
        return np.asarray(w - new)

    def fit(self, signals: Signals, *, whiten: bool = False, skip: int = 0) -> float:
        """NRMSE fit of the prediction [%]: 100 (1 - ||w - what|| / ||w - mean w||).

        The first `skip` samples are left out.
        """
        w = signal_of(signals, node_label(self.target))[skip:]
        left = w - self.predict(signals, whiten=whiten)[skip:]
        return float(100 * (1 - np.linalg.norm(left) / np.linalg.norm(w - w.mean())))

    def row(self) -> dict[str, Any]:
        """A row of a table."""
        used = [node_label(k) for k in self.inputs] + [f"delta_{n}" for n in self.excitations]
        can = not self.obstacle
        return {
            "predictor": self.kind,
            "uses": ", ".join(used) or "nothing",
            "error variance": self.variance if can else float("inf"),
            "with its own past": self.whitened_variance if can else float("inf"),
            "remark": self.obstacle,
        }

    def __repr__(self) -> str:
        return f"<{self.kind} predictor of {node_label(self.target)}, variance {self.variance:.4g}>"
