"""Which observations stand for the unknown inputs of a node, where there are more than needed.

As many as there are unknown inputs make a left inverse (4.22). Which are taken is free, and it
decides what the indirect model's error is: that of a weak or late observation is loud, or the model
cannot be run at all. Every choice is ranked by the exact variance of the error of its predictor as
it is run, without a noise model; infinite where a filter is improper or unstable. Of equal ones
that with the smaller variance beside its noise model is kept, and then the first in node order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, islice
from math import comb

import numpy as np

from casid.algebra.transfer_matrix import RationalMatrix
from casid.deprecation import renamed
from casid.errors import ModelError
from casid.unknown_inputs.indirect.left_inverse import LeftInverse, left_inverse
from casid.unknown_inputs.networks.equations import NodeEquations, node_equations
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_sets import NodeSets, with_observations
from casid.unknown_inputs.networks.nodes import Node, labels, node_label
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor
from casid.unknown_inputs.networks.prediction.row_predictor import row_predictor

MOST = 60  # choices that are evaluated
INDIRECT = "indirect"


@dataclass(frozen=True, eq=False)
class ObservationChoice:
    """One choice of observations, and the predictor that it makes.

    Attributes
    ----------
    sets : with the chosen observations as D and I, the others among O.
    equations : of the target and the observations, the unknown inputs eliminated, (4.24).
    predictor : the target's row of these.
    how : "" for a square choice; of a combination of all observations, how it was found.
    """

    sets: NodeSets
    equations: NodeEquations
    predictor: NodePredictor
    how: str = ""

    @property
    def observations(self) -> tuple[Node, ...]:
        """The nodes that stand for the unknown inputs, in the order of the network."""
        return tuple(n for n in self.sets.A if n in (*self.sets.D, *self.sets.I))

    @cached_property
    def variance(self) -> float:
        """Variance of the predictor's error; infinite where it cannot be run."""
        return float("inf") if self.predictor.obstacle else self.predictor.variance

    @property
    def is_proper(self) -> bool:
        """Whether its predictor has a state space form, which may be unstable."""
        p = self.predictor
        return all(g.is_proper for g in (*p.inputs.values(), *p.excitations.values()))

    @property
    def is_usable(self) -> bool:
        """Whether its predictor can be run and leaves a finite error."""
        return bool(np.isfinite(self.variance))

    @cached_property
    def rank(self) -> tuple[float, float]:
        """What choices are ordered by: the variance, then that beside the noise model."""
        if not self.is_usable:
            return float("inf"), float("inf")
        try:
            whitened = self.predictor.whitened_variance
        except ModelError:  # no term without delay: nothing to whiten
            whitened = self.variance
        return float(f"{self.variance:.9g}"), float(f"{whitened:.9g}")

    def __str__(self) -> str:
        quality = (
            f"{self.variance:.4g}" if self.is_usable else self.predictor.obstacle or "infinite"
        )
        return f"{labels(self.observations)}: {quality}"


@dataclass(frozen=True, slots=True, eq=False)
class ObservationChoices:
    """The choices of observations, best first.

    Attributes
    ----------
    network, sets : of which they are.
    evaluated : at least one; unusable ones at the end, in node order.
    possible : how many choices there are, evaluated or not.
    """

    network: Network
    sets: NodeSets
    evaluated: tuple[ObservationChoice, ...]
    possible: int

    judged = renamed("judged", "evaluated")

    @property
    def best(self) -> ObservationChoice:
        """The choice of least error variance."""
        return self.evaluated[0]

    def require_usable(self) -> ObservationChoice:
        """The best choice, refused where it cannot be run.

        Raises
        ------
        ModelError
            With the observations, the zeros with their frequencies, and the approximations.
        """
        if not self.best.is_usable:
            raise ModelError(self.obstacle())
        return self.best

    def obstacle(self) -> str:
        """Why no choice is usable, and what to use instead; empty where one is."""
        if self.best.is_usable:
            return ""
        target, sU = node_label(self.sets.target), labels(self.sets.sU)
        observed = labels((*self.sets.D, *self.sets.I))
        tried = "; ".join(f"from {c}" for c in self.evaluated[:4])
        more = f" and {len(self.evaluated) - 4} more" * (len(self.evaluated) > 4)
        return (
            f"the indirect predictor of {target} cannot be run forward in time: {sU} from "
            f"{observed} leaves no proper and stable filter ({tried}{more}). {self._zeros()}"
            f"Measure another node that {sU} acts on with less delay, or leave {sU} to immersion"
        )

    def _zeros(self) -> str:
        found = inverse_of_observations(self.network, self.sets)
        if found is None or found.is_usable:
            return ""
        try:
            offered = "; ".join(str(a) for a in found.approximations())
        except ModelError as why:
            offered = str(why)
        return (
            f"Of the inverse f of the modules to {', '.join(found.G.outputs)}: "
            f"{'; '.join(found.obstacles)}. Approximations of f "
            f"(casid.unknown_inputs.indirect.left_inverse): {offered}. "
        )

    def __str__(self) -> str:
        """One line: which is taken, and what the others would give; empty where none is free."""
        if self.best.how:
            return (
                f"{labels(self.sets.sU)} by {labels(self.best.observations)}, {self.best.how}, "
                "since no choice of as many as needed can be run"
            )
        if self.possible <= 1 or not self.best.is_usable:
            return ""
        others = "; ".join(map(str, self.evaluated[1:6])) or "the others do not determine them"
        more = "; ..." * (len(self.evaluated) > 6)
        text = (
            f"{labels(self.sets.sU)} by {self.best}, the least error variance of "
            f"{len(self.evaluated)} choices ({others}{more})"
        )
        if self.possible > MOST:
            text += (
                f"; only the first {MOST} of {self.possible} were evaluated: name better ones with "
                "sets=node_sets(network, target, direct=, indirect=)"
            )
        return text


def observation_choices(
    network: Network,
    sets: NodeSets,
    *,
    use_excitations: bool = True,
    accept: Callable[[NodeSets], bool] = lambda sets: True,
) -> ObservationChoices:
    """Evaluate the choices of as many observations as there are unknown inputs.

    Parameters
    ----------
    sets : of the target; D and I are chosen from.
    use_excitations : False: known delta count as disturbances.
    accept : False for sets that are not to be evaluated.

    Returns
    -------
    ObservationChoices
        Of at most 60 choices, the first in node order; each costs an elimination and a norm, some
        tenths of a second for a dozen nodes with numbers. A network with symbols, or in s, has no
        such variances: its first choice represents all. Where no choice can be run, a combination
        of all observations is tried (`casid.unknown_inputs.indirect.left_inverse`).

    Raises
    ------
    ModelError
        If the observations do not determine the unknown inputs; these are named.
    """
    equations = node_equations(network)
    observed = tuple(n for n in sets.A if n in (*sets.D, *sets.I))
    n = len(sets.sU)
    is_free = len(observed) > n and not network.parameters and network.variable != "s"
    chosen = combinations(observed, n) if is_free else iter([observed])
    found: list[ObservationChoice] = []
    for nodes in islice(chosen, MOST):
        now = with_observations(sets, nodes)
        if not accept(now):
            continue
        try:
            found.append(_choice(network, now, equations, use_excitations))
        except ModelError:
            if not is_free:
                raise
    if not found:  # the error names the unknown inputs that are lost
        found.append(_choice(network, sets, equations, use_excitations))
    if network.parameters or network.variable == "s":
        return ObservationChoices(network, sets, (found[0],), 1)
    found.sort(key=lambda c: c.rank)
    if is_free and not found[0].is_usable and accept(sets):
        found = [*_combined(network, sets, equations, use_excitations), *found]
    return ObservationChoices(network, sets, tuple(found), comb(len(observed), n) if is_free else 1)


def chosen_sets(network: Network, sets: NodeSets, inputs: Collection[Node] = ()) -> NodeSets:
    """The sets with as many observations as unknown inputs, those of least error variance.

    Parameters
    ----------
    inputs : nodes that the target's equation is to have, if they are not free.
    """
    if len(sets.D) + len(sets.I) <= len(sets.sU):
        return sets
    square = [c for c in observation_choices(network, sets).evaluated if not c.how]
    wanted = [c for c in square if inputs and set(c.equations.G[sets.target]) == set(inputs)]
    return (wanted or square)[0].sets


def inverse_of_observations(network: Network, sets: NodeSets) -> LeftInverse | None:
    """A left inverse of the modules from sU to D and I, with its zeros; None where there is none.

    `left_inverse`, given which modules of the target it is seen through.
    """
    observed = tuple(n for n in sets.A if n in (*sets.D, *sets.I))
    names = tuple(map(node_label, sets.sU))
    G = RationalMatrix(
        tuple(tuple(network.module(m, u) for u in sets.sU) for m in observed),
        tuple(map(node_label, observed)),
        names,
    )
    through = RationalMatrix(
        (tuple(network.module(sets.target, u) for u in sets.sU),),
        (node_label(sets.target),),
        names,
    )
    try:
        return left_inverse(G, seen_through=through)
    except ModelError:
        return None


def _needed(equations: NodeEquations, sets: NodeSets) -> NodeEquations:
    """Without the rows of measured nodes that nothing is eliminated by."""
    kept = {sets.target, *sets.sU, *sets.Ut, *sets.D, *sets.I}
    nodes = tuple(n for n in equations.nodes if n in kept)
    return replace(
        equations,
        nodes=nodes,
        G={n: equations.G[n] for n in nodes},
        F={n: equations.F[n] for n in nodes},
    )


def _choice(
    network: Network,
    sets: NodeSets,
    equations: NodeEquations,
    use_excitations: bool,
    filters: dict[tuple[Node, Node], object] | None = None,
    how: str = "",
) -> ObservationChoice:
    found = indirect_equations(_needed(equations, sets), sets, filters=filters)
    made = row_predictor(network, found, sets.target, INDIRECT, use_excitations=use_excitations)
    return ObservationChoice(sets, found, made, how)


def _combined(
    network: Network, sets: NodeSets, equations: NodeEquations, use_excitations: bool
) -> list[ObservationChoice]:
    """The combination of all observations with a free gain, where it can be run."""
    inverse = inverse_of_observations(network, sets)
    if inverse is None:
        return []
    observed = tuple(n for n in sets.A if n in (*sets.D, *sets.I))
    filters: dict[tuple[Node, Node], object] = {
        (u, m): inverse.f[i, k]
        for i, u in enumerate(sets.sU)
        for k, m in enumerate(observed)
        if not inverse.f[i, k].is_zero
    }
    try:
        found = _choice(network, sets, equations, use_excitations, filters, inverse.how)
    except ModelError:  # rounding: not a left inverse exactly
        return []
    return [found] if found.is_usable else []
