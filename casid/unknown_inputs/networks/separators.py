"""How many more inputs a set of predictor inputs needs at least: disjoint open paths (Menger)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import TypeAlias

from casid.unknown_inputs.networks.nodes import Node

Port: TypeAlias = tuple[Node, int]  # a node's entry (0) and exit (1)


def disjoint_open_paths(
    readers: Mapping[Node, Iterable[Node]],
    target: Node,
    source: Node,
    inputs: Collection[Node],
    sensors: Collection[Node],
) -> float:
    """The greatest number of open paths and loops that share no measured node.

    Each needs a node of its own in a larger set of inputs, so it bounds what is missing from below.

    Parameters
    ----------
    readers : node -> nodes it acts on.
    inputs : nodes that block, `source` among them; the module source -> target is no open path.
    eyes : nodes that may become inputs; infinity where a path passes none of them.
    """
    flow: dict[tuple[Port, Port], int] = {}
    count = 0
    while True:
        trail = _augmenting(readers, target, source, inputs, sensors, flow)
        if not trail:
            return count
        if count == len(sensors):  # more paths than nodes to part them
            return math.inf
        ports = [(trail[k], trail[k + 1]) for k in range(len(trail) - 1)]
        for a, b in ports:
            if flow.get((b, a), 0) > 0:
                flow[b, a] -= 1
            else:
                flow[a, b] = flow.get((a, b), 0) + 1
        count += 1


def _augmenting(
    readers: Mapping[Node, Iterable[Node]],
    target: Node,
    source: Node,
    inputs: Collection[Node],
    sensors: Collection[Node],
    flow: Mapping[tuple[Port, Port], int],
) -> list[Port]:
    """A path from the exits of source and target to the entry of target that has room left."""
    back: dict[Port, list[Port]] = {}
    for (a, b), amount in flow.items():
        if amount > 0:
            back.setdefault(b, []).append(a)
    starts: list[Port] = [(source, 1), (target, 1)]
    came: dict[Port, Port | None] = dict.fromkeys(starts)
    front = list(starts)
    while front:
        later: list[Port] = []
        for port in front:
            node, side = port
            if side == 1:
                onward = [(r, 0) for r in readers[node] if (node, r) != (source, target)]
            else:
                is_full = node in inputs or (node in sensors and flow.get((port, (node, 1)), 0) > 0)
                onward = [] if is_full else [(node, 1)]
            for step in (*onward, *back.get(port, ())):
                if step == (target, 0):
                    return _trail(came, port, step)
                if step not in came:
                    came[step] = port
                    later.append(step)
        front = later
    return []


def _trail(came: Mapping[Port, Port | None], port: Port, goal: Port) -> list[Port]:
    path = [goal]
    step: Port | None = port
    while step is not None:
        path.append(step)
        step = came[step]
    return path[::-1]
