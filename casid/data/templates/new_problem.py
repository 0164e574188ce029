"""A problem file to fill in, written from a file of measurements."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from casid.argument_types import names_wrong_types
from casid.data.files import write_text
from casid.data.reading.columns import ColumnSpec, clock_and_unit
from casid.data.reading.file_format import FileFormat
from casid.data.templates.dc_motor import DC_MOTOR
from casid.data.templates.draft import CHECK, WIDTH, Draft
from casid.data.templates.file_channels import (
    FileChannel,
    FileChannels,
    file_channels,
    identifier,
)
from casid.data.templates.free import FREE
from casid.data.templates.mass_spring_damper import MASS_SPRING_DAMPER
from casid.data.templates.roles import Role, assign, same_quantity
from casid.data.templates.tank import TANK
from casid.data.templates.template import Body, Template
from casid.data.templates.thermal import THERMAL
from casid.data.templates.vehicle import VEHICLE
from casid.errors import DataError, nearest
from casid.model.identifiers import quoted

TEMPLATES: Mapping[str, Template] = {
    t.name: t for t in (MASS_SPRING_DAMPER, DC_MOTOR, THERMAL, TANK, VEHICLE, FREE)
}
"""The templates by the names that `--as` takes."""

_CLOCK = "t"  # names the time column in a mapping, as in --map t=COLUMN


@dataclass(frozen=True, slots=True, eq=False)
class NewProblem:
    """A problem file that was written, and what in it is a guess.

    Attributes
    ----------
    text : the Python of the file.
    path : where it was written; None where no path was requested.
    data : the file of measurements, as a command takes it.
    template : its name.
    channels : signal of the model -> column of the file [unit].
    left_out : columns that are in no way used, with the reason.
    """

    text: str
    path: Path | None
    data: str
    template: str
    channels: Mapping[str, str]
    recorded: Mapping[str, str]
    left_out: Mapping[str, str]
    resample: float | None = None

    @property
    def checks(self) -> dict[int, str]:
        """Line of the file (from 1) -> what to check there."""
        found = {}
        for n, line in enumerate(self.text.splitlines(), 1):
            before, sign, what = line.partition(CHECK)
            if sign:
                found[n] = what
        return found

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands to go on with."""
        name = shlex.quote(str(self.path or f"{self.template}.py"))
        data = shlex.quote(self.data)
        stem = shlex.quote(self.template if self.path is None else self.path.stem)
        resample = "" if self.resample is None else f" --resample {self.resample:.6g}"
        return (
            f"casid identify {name} {data}{resample}",
            f"casid diagnose {name} {data}{resample} --out {stem}",
            f"casid export {stem} --as problem --out {stem}_extended.py",
        )

    def __repr__(self) -> str:
        return (
            f"<NewProblem {self.template} from {self.data}: {len(self.channels)} of its signals "
            f"found, {len(self.checks)} lines to check>"
        )

    def __str__(self) -> str:
        lines = [f"{self.path or 'a problem file, not written'}: {TEMPLATES[self.template].title}"]
        for head, channels in (("model", self.channels), ("recorded", self.recorded)):
            for name, column in channels.items():
                lines.append(f"  {head:<9} {name} from {column}")
        lines += [f"  {'left out':<9} {column}: {why}" for column, why in self.left_out.items()]
        lines += [f"  {'check':<9} line {n}: {what}" for n, what in self.checks.items()]
        return "\n".join(
            [*lines, "next:", *(f"  {step}" for step in (*self._edit, *self.commands))]
        )

    @property
    def _edit(self) -> tuple[str, ...]:
        """What to write in the file before the commands: lags are placeholders."""
        if self.template != "free":
            return ()
        others = ", ".join(name for name in TEMPLATES if name != "free")
        return (
            f"put your own equations in place of the lags in {self.path or 'the file'},",
            f"  or begin with those of a template: --as {others}",
        )


@names_wrong_types()
def new_problem(
    data: str | Path,
    template: str = "free",
    out: str | Path | None = None,
    *,
    mapping: Mapping[str, str] | None = None,
    known: Mapping[str, float] | None = None,
    force: bool = False,
    form: FileFormat | None = None,
) -> NewProblem:
    """Look at a file of measurements and write a problem file to fill in.

    The columns are matched with the signals of a template by their units and names; starting
    values come from a regression on the record. What is guessed is marked CHECK in the file. The
    file loads and can be fitted as it is written.

    Parameters
    ----------
    data : path of a file that `read_record` reads, perhaps with a window: `run.csv@12:194`.
    template : mass-spring-damper, dc-motor, thermal, tank, vehicle, or free: a lag of its own for
        every output.
    out : path of the problem file; nothing is written without one.
    mapping : signal of the template -> column, with its unit after a colon: `{"angle": "phi:deg"}`;
        `t` names the time stamps.
    known : values of the template's parameters that are known, in their units: `{"N": 20}`.
    force : write over a file that exists.
    form : how the file is written, where it leaves it open; kept in the problem file.

    Returns
    -------
    NewProblem
        The text, what was guessed and left out, and the commands to go on with.

    Raises
    ------
    DataError
        For a template, signal or parameter that does not exist, a file that cannot be read or lacks
        what the template needs, and an `out` that exists.
    """
    path = None if out is None else Path(out)
    chosen = _template(template)
    _refuse_path(path, force=force)
    draft = _draft(chosen, data, mapping or {}, known or {}, form)
    body = chosen.write(draft)
    text, recorded = _written(chosen, draft, body, path)
    if path is not None:
        write_text(path, text)
    file, used = draft.file, draft.columns
    constant = [c.column for c in file.channels if c.is_constant and c not in used.values()]
    return NewProblem(
        text=text,
        path=path,
        data=file.source,
        template=chosen.name,
        channels={n: f"{c.column!r} [{draft.unit(n)}]" for n, c in used.items()},
        recorded={n: f"{c.column!r} [{c.unit or '1'}]" for n, c in recorded.items()},
        left_out={**file.left_out, **dict.fromkeys(constant, "it is constant")},
        resample=file.resampled,
    )


def _draft(
    template: Template,
    data: str | Path,
    mapping: Mapping[str, str],
    known: Mapping[str, float],
    form: FileFormat | None,
) -> Draft:
    """The file looked through, and its columns in the roles of the template."""
    names = {name: clock_and_unit(text) for name, text in mapping.items()}
    clock = names.pop(_CLOCK, None)
    time = None if clock is None else ColumnSpec(clock[0], clock[1], "s")
    file = file_channels(data, time, [(c, unit) for c, unit in names.values() if unit], form)
    file = file.without_copies({column for column, _ in names.values()})
    roles = {role.name: role for role in template.roles(file)}
    columns = _columns(template, file, roles, names)
    likely = {c.column: roles[n].likely_unit(c) for n, c in columns.items() if c.unit is None}
    file = file.in_units(likely)
    columns = {n: file.column(c.column, n) for n, c in columns.items()}
    return Draft(file, roles, columns, dict(known))


def _template(name: str) -> Template:
    if name not in TEMPLATES:
        raise DataError(f"there is no template {name!r}{nearest(name, TEMPLATES)}")
    return TEMPLATES[name]


def _refuse_path(path: Path | None, *, force: bool) -> None:
    if path is None:
        return
    if path.suffix != ".py":
        raise DataError(f"{path}: a problem file is Python; give it a name that ends with .py")
    if path.exists() and not force:
        raise DataError(f"{path} exists; name another file with --out, or add --force")


def _columns(
    template: Template,
    file: FileChannels,
    roles: Mapping[str, Role],
    names: Mapping[str, tuple[str, str | None]],
) -> dict[str, FileChannel]:
    """The column of every role, the user's own before the guessed ones, in the template's order."""
    for name in names:
        if name not in roles:
            raise DataError(
                f"template {template.name} has no signal {name!r}{nearest(name, roles)}"
            )
    chosen = {name: file.column(column, name) for name, (column, _) in names.items()}
    for name, channel in chosen.items():
        units = roles[name].units
        if channel.unit and not any(same_quantity(channel.unit, unit) for unit in units):
            raise DataError(
                f"{file.path.name}: column {channel.column!r} [{channel.unit}] is no "
                f"{name} [{' or '.join(units)}]; map another column, or where the file's unit is "
                f"wrong, the unit that its numbers are in, as in {name}={channel.column}:UNIT"
            )
    free = [role for name, role in roles.items() if name not in chosen]
    rest = [c for c in file.channels if c not in chosen.values()]
    found = {**chosen, **assign(free, rest)}
    needless = {r.name for r in free if r.instead_of in found}
    return {name: found[name] for name in roles if name in found and name not in needless}


def _written(
    template: Template, draft: Draft, body: Body, path: Path | None
) -> tuple[str, dict[str, FileChannel]]:
    """The text of the file, and the columns recorded beside the model's."""
    unused = sorted(set(draft.given) - set(draft.declared))
    if unused:
        raise DataError(
            f"template {template.name} has no parameter {unused[0]!r} for this file"
            f"{nearest(unused[0], draft.declared)}"
        )
    file = draft.file
    title = f"{template.title[0].upper()}{template.title[1:]}, to fill in for {file.path.name}."
    span = f"{file.N} samples, one every {duration(file.Ts)}, {duration(file.N * file.Ts)} long"
    about = (
        f"The record has {span}. Lines with CHECK contain a guess or need a value from you; delete "
        "the remark when the line is right. Numbers are in the unit beside them."
    )
    paragraphs = [textwrap.fill(text, WIDTH) for text in (body.advice, about) if text]
    equations = "\n".join(f"    {line}" for line in body.equations if line)
    imports = ["import casid"]
    if template.needs_casadi:
        imports = ["import casadi as ca", "", "import casid"]
    declared = "\n".join(body.paragraphs())
    taken = set(re.findall(r'm\.\w+\("(\w+)"', declared))
    name = identifier(file.path.stem) if path is None else path.stem
    beside, problem = draft.problem(name, template.title, taken)
    head = "\n\n".join([f'"""{title}', equations, *paragraphs]) + '\n"""'
    parts = [
        head,
        "\n".join(imports),
        f"m = casid.Model({quoted(template.title)})",
        *body.paragraphs(),
        problem,
    ]
    return "\n\n".join(parts) + "\n", beside


def duration(seconds: float) -> str:
    """A time in the unit that people would take: `5 ms`, `40 s`, `14 days`."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.4g} s" if seconds >= 1 else f"{1e3 * seconds:.4g} ms"
