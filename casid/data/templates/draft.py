"""The lines of a problem file as they are written: declarations, guesses, and what to check."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from casid.arrays import FloatArray
from casid.data.reading.header_units import header_unit
from casid.data.templates.file_channels import FileChannel, FileChannels, free_name
from casid.data.templates.roles import Role, is_command, same_quantity
from casid.errors import DataError
from casid.model.identifiers import quoted
from casid.model.units import parse_unit, si_unit

WIDTH = 100
CHECK = "# CHECK: "
_DECADES = 3  # of a positive parameter below its start, and one less above it


def number(value: float) -> str:
    """A number with the digits that a guess has."""
    rounded = float(f"{value:.2g}")
    return str(int(rounded)) if rounded.is_integer() and abs(rounded) < 1e4 else f"{rounded:g}"


def _between(value: float, low: float, high: float) -> str:
    """A guess between bounds, or one of them: two digits where they are exact, to their thousandth.

    Two digits of 295 K are 300 K.
    """
    step = 10.0 ** (math.floor(math.log10(high - low)) - 3)
    plain = number(value)
    return plain if abs(float(plain) - value) <= step else f"{round(value / step) * step:.12g}"


def in_unit(value: float, unit: str) -> float:
    """A value in SI units, in `unit`."""
    parsed = parse_unit(unit)
    return (value - parsed.offset) / parsed.factor


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """A problem file on its way: which columns play which part, and what its user knows.

    Attributes
    ----------
    columns : role -> the column that plays it.
    given : values that the user gives to parameters of the template, in their units.
    declared : names of all parameters written so far.
    guessed : those of them whose start the record does not suggest.
    """

    file: FileChannels
    roles: Mapping[str, Role]
    columns: Mapping[str, FileChannel]
    given: Mapping[str, float] = field(default_factory=dict)
    declared: list[str] = field(default_factory=list)
    guessed: list[str] = field(default_factory=list)

    def has(self, *roles: str) -> bool:
        """True if every one of these signals has a column."""
        return all(role in self.columns for role in roles)

    def __getitem__(self, role: str) -> FloatArray:
        """The (N,) samples of a signal, SI units."""
        return self.columns[role].values

    def unit(self, role: str) -> str:
        """The unit in which a signal is written in the file."""
        unit = self.columns[role].unit
        return self.roles[role].units[0] if unit is None else unit

    def value(self, name: str, default: float) -> float:
        """What the user gives for a parameter, else `default`."""
        return float(self.given.get(name, default))

    def require_one_of(self, *roles: str) -> None:
        """Refuse a file that has none of these signals.

        Raises
        ------
        DataError
            Naming the units that were sought, and how to name the column.
        """
        if any(self.has(role) for role in roles):
            return
        sought = " or ".join(f"{role} ({' or '.join(self.roles[role].units)})" for role in roles)
        columns = ", ".join(
            c.column if header_unit(c.column) else f"{c.column} [{c.unit or 'no unit'}]"
            for c in self.file.channels
        )
        for column in self.file.spoilt:  # perhaps the one that is sought
            raise DataError(
                f"{self.file.path.name}: no column for {sought} among {columns}; column "
                f"{column!r} is left out: {self.file.left_out[column]}. Correct the cells, or name "
                "text that stands for no value with --missing TEXT."
            )
        raise DataError(
            f"{self.file.path.name}: no column for {sought} among {columns}. Name it, for example "
            f"--map {self._suggestion(roles)}, or take another template."
        )

    def _suggestion(self, roles: tuple[str, ...]) -> str:
        """How to name the likeliest column of those that play no part, and its unit if it shows."""
        taken = {c.column for c in self.columns.values()}
        free = [c for c in self.file.channels if c.column not in taken] or self.file.channels
        role, channel = max(
            ((self.roles[name], c) for c in free for name in roles),
            key=lambda pair: pair[0].likeness(pair[1]),
        )
        unit = "" if header_unit(channel.column) else f":{role.likely_unit(channel) or 'UNIT'}"
        return f"{role.name}={quoted(channel.column)}{unit}"

    # -- lines -------------------------------------------------------------------------------

    def input(self, role: str, symbol: str, what: str) -> str:
        """The declaration of a recorded input."""
        channel = self.columns[role]
        is_held = channel.is_held or channel.is_switched or is_command(channel)
        known = ", known=True" if channel.is_switched else ""  # no sensor, no noise
        unit, hold = quoted(self.unit(role)), quoted("zoh" if is_held else "foh")
        call = f"{symbol} = m.input({quoted(role)}, {unit}, hold={hold}{known})"
        return _line(call, what, self._doubt(role))

    def output(self, role: str, expression: str) -> str:
        """The declaration of a measured output."""
        call = f"m.output({quoted(role)}, {expression}, {quoted(self.unit(role))})"
        return _line(call, "", self._doubt(role))

    def unknown(
        self,
        name: str,
        unit: str,
        start: float | None,
        what: str,
        *,
        default: float = 1.0,
        sign: Literal["positive", "zero", "any"] = "positive",
        within: tuple[float, float] | None = None,
    ) -> str:
        """The declaration of a parameter to estimate; known where the user gives its value.

        `start` [in `unit`] is what the record suggests, `default` the start where that is no number
        of its sign. `within` are the bounds; some decades around the start where not given.
        """
        if name in self.given:
            return self.known(name, unit, self.given[name], what)
        self.declared.append(name)
        usable = start is not None and math.isfinite(start) and (sign == "any" or start > 0)
        value = start if usable and start is not None else default
        if not usable:
            self.guessed.append(name)
        size = math.floor(math.log10(abs(value))) if value else 0
        shown = number(value)
        if within is not None:
            shown, *ends = (_between(x, *within) for x in (value, *within))
            bounds = f", lower={ends[0]}, upper={ends[1]}"
        elif sign == "any":
            bounds = ""
        else:
            lowest = 0.0 if sign == "zero" else 10.0 ** (size - _DECADES)
            bounds = f", lower={lowest:g}, upper={10.0 ** (size + _DECADES - 1):g}"
        call = f"{name} = m.parameter({quoted(name)}, {quoted(unit)}, start={shown}{bounds})"
        return _line(call, what, "" if usable else "the start is a guess")

    def known(self, name: str, unit: str, value: float, what: str) -> str:
        """The declaration of a constant, to be checked unless the user gives its value."""
        self.declared.append(name)
        given = name in self.given
        shown = f"{self.given[name]:.12g}" if given else number(value)
        call = f"{name} = m.constant({quoted(name)}, {shown}, {quoted(unit)})"
        return _line(call, "" if not given else what, "" if given else f"{what}; put in its value")

    def around(self, role: str) -> tuple[float, float]:
        """The range of a signal and as much on either side, in its unit: bounds of its rest."""
        low, high = float(self[role].min()), float(self[role].max())
        low, high = in_unit(low, self.unit(role)), in_unit(high, self.unit(role))
        return 2 * low - high, 2 * high - low

    def first(self, role: str) -> float:
        """The first value of a signal, in its unit: a start of its state."""
        return in_unit(float(self[role][0]), self.unit(role))

    def _doubt(self, role: str) -> str:
        """What is not sure about the column of a signal."""
        channel = self.columns[role]
        if channel.unit is None or channel.doubt:
            return f"{channel.doubt or 'the file gives no unit'}; taken as {self.unit(role)}"
        rivals = [
            other.column
            for other in self.file.channels
            if other not in self.columns.values()
            and other.unit is not None
            and same_quantity(other.unit, channel.unit)
            and not channel.is_constant
        ]
        return f"from {channel.column!r}; {rivals[0]!r} has such a unit too" if rivals else ""

    # -- blocks ------------------------------------------------------------------------------

    def problem(
        self, name: str, description: str, names: Iterable[str]
    ) -> tuple[dict[str, FileChannel], str]:
        """The columns beside the model's, and the call that makes the problem.

        `names` are those that the model has taken.
        """
        used, taken = self.columns, {*self.columns, *names}
        beside: dict[str, FileChannel] = {}
        for channel in self.file.channels:
            if channel not in used.values() and not channel.is_constant:
                label = free_name(channel.name, taken)
                taken.add(label)
                beside[label] = channel
        lines = ["problem = casid.Problem(", f"    {quoted(name)},", "    m,"]
        if self.file.time is not None:
            unit = f":{self.file.time_unit}" if self.file.time_unit else ""
            if self.file.time_doubt:
                lines.append(f"    {CHECK}{self.file.time_doubt}")
            lines.append(f"    time={quoted(self.file.time + unit)},")
        if self.file.form is not None and self.file.form.given:
            lines.append(f"    form={self.file.form.code},")
        lines.append("    # signal of the model: column of the file, and the unit it is written in")
        lines.append("    channels={")
        for role, channel in used.items():
            lines.append(f"        {quoted(role)}: {_column(channel, self.unit(role))},")
        for label, channel in beside.items():
            lines.append(f"        {quoted(label)}: {_column(channel, channel.unit or '1')},")
        lines.append("    },")
        if beside:
            lines.append("    # columns beside the model's: candidates for what it leaves out")
            lines.append("    recorded={")
            for label, channel in beside.items():
                doubt = f"  {CHECK}{channel.doubt}" if channel.doubt else ""
                unit = si_unit(channel.unit or "1")
                lines.append(f"        {quoted(label)}: {quoted(unit)},{doubt}")
            lines.append("    },")
        if not self.guessed:
            lines.append("    starts=1,  # one is enough: it comes from the record")
        lines += [f"    description={quoted(description)},", ")"]
        return beside, "\n".join(lines)


def _column(channel: FileChannel, unit: str) -> str:
    return quoted(f"{channel.column}:{unit}")


def _line(call: str, what: str, doubt: str) -> str:
    """A statement with its comment, above it where it would grow too long."""
    comment = f"{CHECK}{doubt}" if doubt else (f"# {what}" if what else "")
    if doubt and what:
        comment = f"{CHECK}{what}; {doubt}"
    if not comment:
        return call
    joined = f"{call}  {comment}"
    return joined if len(joined) <= WIDTH else f"{comment}\n{call}"
