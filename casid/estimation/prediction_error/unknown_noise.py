"""The unknowns of a prediction-error criterion: parameters, sizes of noise, initial states."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.unknowns import Unknowns, refuse_strangers
from casid.linear.filtering.noisy_model import NoisePlaces
from casid.model.model import Model


class NoisyUnknowns:
    """Which unknowns there are in each experiment.

    Parameters
    ----------
    unknowns : with the parameters of the model, to which the others are added.
    doubted : states whose initial value is not estimated: it has a covariance instead.
    given : start values by variable name, which have to name variables.

    Attributes
    ----------
    index : for each experiment (nv,) the variable of each local unknown or -1: free parameters,
        variances of `places.sources`, initial states.

    Raises
    ------
    ModelError
        For a start of what is no variable, or a state that there is not.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        places: NoisePlaces,
        data: Sequence[Signals],
        doubted: Collection[str],
        given: Mapping[str, float],
    ) -> None:
        self.unknowns, self.places, self.data = unknowns, places, data
        self.model: Model = places.model
        for name in doubted:
            if name not in self.model.states:
                raise ModelError(
                    f"{self.model.name} has no state {name!r} to start in doubt; it has "
                    f"{', '.join(self.model.states)}"
                )
        self.index = self._lay_out(doubted)
        refuse_strangers(self.model, [*unknowns.names, *unknowns.own], given)

    def _lay_out(self, doubted: Collection[str]) -> list[Array]:
        unknowns, places, index = self.unknowns, self.places, []
        unknowns.add_shared()
        for w in places.noise:
            if not w.is_known:
                # An output without noise has no predictor; a balance without noise is a balance.
                low = 1e-8 * w.sd**2 if w.where in places.outputs else 0.0
                key, size = places.noise_name(w), w.sd**2
                unknowns.share(key, unknowns.add(key, w.where, size, (low, np.inf), size))
        for e in range(len(self.data)):
            place = unknowns.add_own(e)
            local = [place.get(f, -1) for f in unknowns.free]
            local += [place.get(places.noise_name(w), -1) for w in places.sources]
            for name, state in self.model.states.items():
                if name in doubted or state.initial is not None:
                    local.append(-1)
                    continue
                scale = abs(state.start) or self._size_of(state.unit)
                bounds = state.lower, state.upper
                tag = f"{name}(0){unknowns.label(e)}"
                local.append(unknowns.add(tag, name, state.start, bounds, scale))
            index.append(np.array(local))
        return index

    def _size_of(self, unit: str) -> float:
        """The spread of the first output that has this unit, or one."""
        for i, (_, other) in enumerate(self.model.outputs.values()):
            if other == unit:
                return float(np.std(self.data[0].y[:, i])) or 1.0
        return 1.0

    def parameters(self, x: Array, e: int) -> dict[str, float]:
        """Every parameter of the model in one experiment at `x`."""
        return self.unknowns.parameters(x, e, self.index[e])

    def variances(self, x: Array, e: int) -> Array:
        """Variances of `places.sources` in one experiment at `x`."""
        sources, at = self.places.sources, len(self.unknowns.free)
        index = self.index[e][at : at + len(sources)]
        return np.array([x[i] if i >= 0 else w.sd**2 for w, i in zip(sources, index, strict=True)])

    def initial_state(self, x: Array, e: int) -> Array:
        """Initial state (nx,) of one experiment at `x`."""
        at = len(self.unknowns.free) + len(self.places.sources)
        return self.unknowns.initial_state(x, self.index[e][at:])
