"""Whether a method finds the module of an equation consistently, as the network's structure has it.

Direct prediction-error methods need an equation error that no input knows of (no confounders, no
noise on the inputs, no loop without delay); methods with references need references that are not in
that error and move the inputs apart (Linder 2017, (2.44), sections 3.3 and 4.3.1; Van den Hof,
Dankers, Heuberger & Bombois 2013; Dankers et al. 2016).
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.deprecation import renamed
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Layout
from casid.model.quantities import count_text
from casid.unknown_inputs.networks.estimation.module_equation import ModuleEquation
from casid.unknown_inputs.networks.estimation.reachability import independent_references
from casid.unknown_inputs.networks.graph import path_past, upstream
from casid.unknown_inputs.networks.nodes import Node, labels, node_label, path_text
from casid.unknown_inputs.networks.predictor_inputs import predictor_inputs

SEARCHED_MOST = 60  # nodes of a network that is searched for other inputs and sensors


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether a method is consistent on an equation, by the structure of the network.

    Attributes
    ----------
    method : "ls", "iv", "two_stage" or "joint".
    doubts : why the estimate is biased or does not exist; empty where it is consistent.
    remedies : what would help.
    provided : what consistency rests on beside the structure.
    has_references : whether references reach every input, for the methods that need them.
    """

    method: str
    doubts: tuple[str, ...]
    remedies: tuple[str, ...]
    provided: tuple[str, ...]
    has_references: bool = True

    mends = renamed("mends", "remedies")

    @property
    def is_consistent(self) -> bool:
        """Whether nothing in the structure speaks against it."""
        return not self.doubts

    def __str__(self) -> str:
        if self.is_consistent:
            return f"{self.method} is consistent here, provided {'; '.join(self.provided)}"
        return (
            f"{self.method} is not consistent here: {'; '.join(self.doubts)}. "
            f"What would help: {'; or '.join(self.remedies) or 'nothing that was found'}"
        )


def consistency(equation: ModuleEquation, method: str, layout: Layout) -> Consistency:
    """Judge a method on an equation with polynomials of given orders.

    Parameters
    ----------
    layout : of the equation's inputs; its delays and its A matter.
    """
    doubts = list(_improper(equation, layout))
    provided = ["the orders hold the true modules"]
    remedies: list[str] = []
    if doubts:
        remedies.append(
            "a smaller nk; or, where it is improper, the inverse relation as an estimate of its own"
        )
    if method == "ls":
        biases = [*_common_noise(equation), *_algebraic_loop(equation, layout)]
        if biases:
            remedies += [*_by_references(equation), *_by_other_inputs(equation)]
        doubts += biases
        provided += _noise_model(equation, layout)
    else:
        lacking, how = _references(equation, method, layout)
        doubts += lacking
        if lacking:
            remedies += [*_by_more_references(equation), *_by_least_squares(equation)]
        provided += how
    reached = method == "ls" or _are_reached(equation)
    return Consistency(method, tuple(doubts), tuple(remedies), tuple(provided), reached)


# -- the direct method -----------------------------------------------------------------------------


def _common_noise(e: ModuleEquation) -> list[str]:
    found = [str(c) for c in e.confounders]
    noise = e.network.sensor_noise
    for k in e.inputs:
        if noise.get(k, 0.0) > 0:
            found.append(
                f"the sensor noise of {node_label(k)} is in an input (errors in variables)"
            )
    back = feedback(e)
    if noise.get(e.output, 0.0) > 0 and back:
        found.append(
            f"{node_label(e.output)} has sensor noise and acts back on its inputs "
            f"({path_text(back)}), which know its noise-free value"
        )
    return found


def feedback(e: ModuleEquation) -> tuple[Node, ...]:
    """A path from the output to one of its inputs; () if there is none."""
    for k in e.inputs:
        path = path_past(e.network, e.output, k, blocked=(e.output, *e.inputs))
        if path:
            return path
    return ()


def _algebraic_loop(e: ModuleEquation, layout: Layout) -> list[str]:
    """Inputs used without delay that the output reaches without delay."""
    at_once = [k for k, nk in zip(e.inputs, layout.nk, strict=False) if nk == 0]
    slow = {
        edge for edge, g in e.network.modules.items() if not g.parameters and g.is_strictly_proper
    }
    reasons = []
    for k in at_once:
        path = path_past(e.network, e.output, k, without=slow)
        if path:
            reasons.append(
                f"{node_label(k)} is used without delay, and {node_label(e.output)} acts on it "
                f"without delay ({path_text(path)}): an algebraic loop"
            )
    return reasons


def _noise_model(e: ModuleEquation, layout: Layout) -> list[str]:
    back = feedback(e)
    if layout.na:
        return ["the noise model, 1/A among it, holds the true one"]
    if back:
        return [f"the noise model holds the true one, as there is feedback ({path_text(back)})"]
    return ["tau and delta are independent"]


def _by_references(e: ModuleEquation) -> list[str]:
    if _are_reached(e):
        return [f"method='iv' with {', '.join(f'delta_{n}' for n in e.references)}"]
    return _by_more_references(e)


def _by_other_inputs(e: ModuleEquation) -> list[str]:
    """Inputs, with the sensors there are and with more of them, that have no confounder."""
    net = e.network
    if len(net.nodes) > SEARCHED_MOST:
        return []
    j, i = e.module
    noisy = {n for n, v in net.sensor_noise.items() if v > 0}
    for sensors, what in ((net.measured, "inputs="), (net.nodes, "sensors for inputs=")):
        try:
            search = predictor_inputs(
                net, j, i, sensors=sensors, without_confounders=True, tries=200
            )
        except ModelError:
            continue
        fit = [s.inputs for s in search.sets if not noisy & set(s.inputs)]
        if fit:
            more = [n for n in fit[0] if n not in net.measured]
            own = f" (a sensor on {labels(more)})" if more else ""
            return [f"{what}{tuple(fit[0])!r}{own}"]
    return []


# -- references ------------------------------------------------------------------------------------


def _references(e: ModuleEquation, method: str, layout: Layout) -> tuple[list[str], list[str]]:
    own = [f"delta_{n}" for n in e.excitations]
    aside = f" ({', '.join(own)} enters the equation past the inputs)" if own else ""
    provided = ["delta is independent of every tau and of the sensors' noise"]
    if not e.references:
        return [f"there is no reference that acts through the inputs alone{aside}"], provided
    most, lost = independent_references(e.equations, e.inputs, e.references)
    acting = ", ".join(f"delta_{n}" for n in e.references)
    if lost:
        return [f"{labels(lost)} is not reached by {acting}{aside}"], provided
    few = (
        f"{acting} move {labels(e.inputs)} in {most} of {len(e.inputs)} independent ways at a "
        "frequency"
    )
    if method == "joint" and most < len(e.inputs):
        return [f"{few}, so that their responses cannot be divided"], provided
    if most < len(e.inputs):
        provided.append(f"the orders are low and known: {few}")
    if method == "two_stage" and layout.na:
        return [
            "A is shared with the noise: past outputs in the second stage know the equation error; "
            "give nf instead of na"
        ], provided
    return [], provided


def _are_reached(e: ModuleEquation) -> bool:
    most, lost = independent_references(e.equations, e.inputs, e.references)
    return most > 0 and not lost


def _by_more_references(e: ModuleEquation) -> list[str]:
    """One more excited node that adds a direction to the motion of the inputs."""
    net, own = e.network, e.equations.F[e.output]
    candidates = [
        n
        for n in net.nodes
        if n not in net.excitations
        and (n not in own or (n == e.output and own[n] == 1))
        and any(n == k or n in upstream(net, k) for k in e.inputs)
    ]
    before, lost = independent_references(e.equations, e.inputs, e.references)
    helpful = []
    for n in candidates:
        after, still = independent_references(e.equations, e.inputs, (*e.references, n))
        if after > before or len(still) < len(lost):
            helpful.append(n)
    if not helpful:
        return []
    return [f"an excitation of {' or '.join(node_label(n) for n in helpful)}"]


def _by_least_squares(e: ModuleEquation) -> list[str]:
    if e.confounders or _common_noise(e):
        return []
    return ["method='ls', as no disturbance is common to output and inputs"]


# -- modules ---------------------------------------------------------------------------------------


def _improper(e: ModuleEquation, layout: Layout) -> list[str]:
    """Entries of the true equation that polynomials with these delays cannot hold."""
    reasons = []
    for name, nk in zip(e.names, layout.nk, strict=True):
        delay = e.delays.get(name)
        if delay is None or delay >= nk:
            continue
        what = f"the transfer function from {name} to {node_label(e.output)} in this equation"
        if delay < 0:
            reasons.append(
                f"{what} is improper: it needs {name} {count_text(-delay, 'sample')} ahead"
            )
        else:
            reasons.append(
                f"{what} has a delay of {count_text(delay, 'sample')}, and nk = {nk} "
                "leaves its beginning out"
            )
    return reasons
