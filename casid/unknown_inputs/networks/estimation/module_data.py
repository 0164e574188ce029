"""The signals of a module's equation, taken from a record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import DataError
from casid.unknown_inputs.networks.estimation.module_equation import ModuleEquation
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import node_label


@dataclass(frozen=True, slots=True, eq=False)
class ModuleData:
    """Signals of one equation, means taken off.

    Attributes
    ----------
    y : (N,) the output, delta_j subtracted where its factor is one.
    inputs : channel -> (N,) of the model's inputs: w, then delta that enter the equation.
    references : channel -> (N,) of every reference.
    Ts : sample time [s].
    """

    y: Array
    inputs: Mapping[str, Array]
    references: Mapping[str, Array]
    Ts: float
    name: str

    @property
    def N(self) -> int:
        """Samples."""
        return len(self.y)


def module_data(equation: ModuleEquation, record: Record) -> ModuleData:
    """The signals of an equation.

    Raises
    ------
    DataError
        If channels are not there or have missing samples, a reference never moves, or the record
        has another sample time than the network.
    """
    net = equation.network
    output = node_label(equation.output)
    references = tuple(f"delta_{n}" for n in net.excitations)
    require_channels(record, (output, *equation.names, *references), net)
    signals = {}
    for name in dict.fromkeys((output, *equation.names, *references)):
        if np.any(record.is_missing(name)):
            raise DataError(
                f"{record.name}: {name} has missing samples; cut the record there "
                "(record.between), or fill them (record.filled)"
            )
        x = np.asarray(record[name], dtype=np.float64)
        if name in references and np.ptp(x) == 0.0:
            raise DataError(
                f"{record.name}: {name} never moves, so it is no reference; leave its node out of "
                "references=, or use a record in which it is excited"
            )
        signals[name] = x - x.mean()
    if net.variable == "q" and net.Ts and not np.isclose(net.Ts, record.Ts, rtol=1e-9, atol=0):
        raise DataError(
            f"{record.name} is sampled every {record.Ts:g} s, the network {net.name} every "
            f"{net.Ts:g} s; decimate the record, or give the network of its sample time"
        )
    y = signals[output]
    if equation.subtracted:
        y = y - signals[f"delta_{equation.output}"]
    return ModuleData(
        y,
        {n: signals[n] for n in equation.names},
        {n: signals[n] for n in references},
        record.Ts,
        record.name,
    )


def require_channels(record: Record, names: Iterable[str], network: Network) -> None:
    """Refuse a record that lacks channels.

    Raises
    ------
    DataError
        Which names all of them.
    """
    lacking = [n for n in dict.fromkeys(names) if n not in record]
    if lacking:
        raise DataError(
            f"{record.name} has no channel {', '.join(lacking)}; it has {', '.join(record.names)}. "
            "Rename the channels that are these (record.rename), take the nodes out of the "
            f"measured ones of {network.name}, or leave excitations out by references="
        )
