"""A problem: a model with what is known, where its signals come from, and example data."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from casid.argument_types import methods_name_wrong_types, names_wrong_types
from casid.data.derived import Derived, derive
from casid.data.experiment import Experiment, Given, listed_experiments
from casid.data.external_signals import external_signals
from casid.data.problem_module import importing, problem_file
from casid.data.reading.columns import ColumnSpec, as_headed, resolve
from casid.data.reading.file_format import FileFormat
from casid.data.reading.frames import open_frame
from casid.data.reading.opening import open_table
from casid.data.reading.record_file import record_of
from casid.data.reading.several_clocks import on_one_clock
from casid.data.reading.sources import source_of
from casid.data.reading.survey import ReadingOptions
from casid.data.reading.tables import Table
from casid.data.reading.unused_columns import Unused, unused_columns
from casid.data.record import Record
from casid.errors import DataError, ModelError, nearest, require_texts
from casid.model.model import Model
from casid.model.units import difference_to_si
from casid.presentation import Presented

if TYPE_CHECKING:
    import pandas as pd

    from casid.model.effects.user_effects import UserEffect


@methods_name_wrong_types(ModelError)
@dataclass(frozen=True, slots=True, eq=False)
class Problem(Presented):
    """What a file in `problems/` defines and every command takes.

    Parameters
    ----------
    name : short, for folders and reports.
    model : no unknown inputs left (see `Model.eliminate`).
    channels : model signal -> column of the file, with its unit after a colon ("roll_deg:deg")
        where the column's name has none; signals not named have columns of their own name.
    recorded : channels recorded beside the model's, name -> unit; candidate extra inputs. Columns
        of the same name are read where the file has them.
    derived : channels of the model, or recorded beside it, that no file has -> how they are
        computed from others (`Derived`). Their sources are read as channels are, each
        from the column of its own name or the one in `channels`; a column mapped to the derived
        channel itself goes before.
    time : the time column, perhaps with its unit (`Time:h`); found by name where not given.
    load_cases : name -> values of parameters known in that case.
    noise : channel -> standard deviation of its white noise, where known, in the channel's unit;
        that of a derived channel's sources is propagated and noted in the record's provenance.
    example : returns the experiments or records of an example, or one of them.
    simulate : takes a seed and returns the same with noise drawn from it, for Monte Carlo studies;
        the system is to be the same for every seed.
    truth : parameter -> its true value in `simulate`, with which estimates are compared: what the
        model leaves out shows as their bias.
    effects : effects of the user's own, or functions from a model to one or several, that the
        diagnosis tests beside its catalogue (`casid.balance_effect` and its like).
    starts : how many starts an estimation tries.
    form : how the problem's files are written where they are ambiguous, as in the order of dates.
    external : recorded channels or inputs that are independent of all noise and disturbances, as a
        reference is: where least squares is biased, `identify` makes instruments of the first.
    description, references : for reports.
    source : the file it was loaded from; worker processes load it again.

    Every number is in the unit that the model declares for its parameter or channel.
    """

    name: str
    model: Model
    channels: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, str] = field(default_factory=dict)
    derived: Mapping[str, Derived] = field(default_factory=dict, kw_only=True)
    time: str | ColumnSpec | None = None
    load_cases: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    example: Callable[[], Given] | None = None
    simulate: Callable[[int], Given] | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    starts: int = 3
    description: str = ""
    references: tuple[str, ...] = ()
    source: Path | None = None
    effects: Sequence[UserEffect] = field(default=(), kw_only=True)
    form: FileFormat | None = field(default=None, kw_only=True)
    external: Sequence[str] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        from casid.model.dimensions import check_units

        require_texts(f"problem {self.name!r}", name=[self.name])
        for what in ("channels", "recorded", "noise", "truth", "load_cases", "derived"):
            require_texts(f"problem {self.name}", **{what: list(getattr(self, what))})
        require_texts(f"problem {self.name}", channels=list(self.channels.values()))
        require_texts(f"problem {self.name}", recorded=list(self.recorded.values()))
        check_units(self.model)
        self._check_effects()
        signals = [*self.model.inputs, *self.model.outputs]
        self._check_derived(signals)
        known = [*self.recorded, *self.model.inputs]
        object.__setattr__(self, "external", external_signals(self.name, self.external, known))
        sources = {source for entry in self.derived.values() for source in entry.sources}
        for key in (*self.channels, *self.noise):
            if key not in signals and key not in self.recorded and key not in sources:
                raise ModelError(
                    f"problem {self.name}: channel {key!r} is no input or output of the "
                    f"model{nearest(key, signals)}"
                )
        for case, values in self.load_cases.items():
            for key in values:
                if key not in self.model.parameters:
                    raise ModelError(
                        f"problem {self.name}: load case {case} sets {key!r}, which is no "
                        f"parameter{nearest(key, self.model.parameters)}"
                    )
        for key, value in self.truth.items():
            if key not in self.model.parameters or not math.isfinite(value):
                raise ModelError(
                    f"problem {self.name}: truth of {key!r} = {value} is no finite value of a "
                    f"parameter{nearest(key, self.model.parameters)}"
                )
        for key, sd in self.noise.items():
            if not (isinstance(sd, numbers.Real) and 0 <= sd < math.inf):
                raise ModelError(
                    f"problem {self.name}: noise of {key!r} = {sd!r} is no standard deviation; "
                    "give a finite number, 0 or more, in the channel's unit"
                )
        for name in ("channels", "recorded", "derived", "load_cases", "noise", "truth"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def _check_effects(self) -> None:
        entries = (self.effects,) if callable(self.effects) else tuple(self.effects)
        object.__setattr__(self, "effects", entries)
        if not entries:
            return
        from casid.model.effects.user_effects import user_effects
        from casid.model.effects.validity import check_effects

        try:
            check_effects(self.model, user_effects(self.model, entries))
        except ModelError as error:
            raise ModelError(f"problem {self.name}: {error}") from error

    def _check_derived(self, signals: Sequence[str]) -> None:
        there = [*signals, *self.recorded]
        for name, entry in self.derived.items():
            if name not in there:
                raise ModelError(
                    f"problem {self.name}: derived channel {name!r} is no input or output of the "
                    f"model, nor recorded{nearest(name, there)}"
                )
            twice = [s for s in entry.sources if s in self.derived]
            if twice:
                raise ModelError(
                    f"problem {self.name}: {name!r} is derived from {twice[0]!r}, which is derived "
                    f"itself; compute {name!r} from the sources of {twice[0]!r}"
                )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by its fields; functions of a problem file are those of the file, read again."""
        given: dict[str, Any] = {}
        for entry in fields(self):
            value = getattr(self, entry.name)
            given[entry.name] = dict(value) if isinstance(value, MappingProxyType) else value
        if self.source is not None:
            for name in _FUNCTIONS:
                del given[name]
        return _read_again, (given,)

    def __deepcopy__(self, memo: Any) -> Problem:
        return self  # nothing in it changes

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {self.model!r}>"

    def columns(self, mapping: Mapping[str, str] | None = None) -> dict[str, ColumnSpec]:
        """Where each signal is read from: signal -> column, `mapping` before the problem's own.

        In the place of a derived channel there are its sources, unless it is mapped itself.
        """
        merged = {**self.channels, **(mapping or {})}
        units = self._channel_units()
        computed = {n: entry for n, entry in self.derived.items() if n not in merged}
        needed = {source for entry in computed.values() for source in entry.sources}
        own = {*self.model.inputs, *self.model.outputs, *self.recorded}
        for key in merged:
            if key not in units:
                raise DataError(
                    f"problem {self.name} has no channel {key!r} to map{nearest(key, units)}"
                )
        specs = {}
        for signal, target in units.items():
            known = self.model.inputs.get(signal)
            if known is not None and known.kind == "generated":
                continue
            if known is not None and known.kind == "unknown" and signal not in merged:
                continue  # not measured
            if signal in computed or (signal not in own and signal not in needed):
                continue
            text = merged.get(signal, signal)
            # The last colon: a column's own name may hold one, a unit does not.
            column, unit = text.rsplit(":", 1) if ":" in text else (text, "")
            specs[signal] = ColumnSpec(column or signal, unit or None, target)
        return specs

    def columns_in(
        self, there: Collection[str], mapping: Mapping[str, str] | None = None
    ) -> dict[str, ColumnSpec]:
        """The `columns` to read in a file that has the columns `there`, by their names in it.

        Channels beside the model's that the file lacks, and their sources, are left out.
        """
        needed = {*self.model.inputs, *self.model.outputs}
        for name, entry in self.derived.items():
            if name in needed:
                needed |= set(entry.sources)
        needed |= set(mapping or {})
        specs = as_headed(list(there), self.columns(mapping))
        return {n: spec for n, spec in specs.items() if n in needed or spec.column in there}

    def _channel_units(self) -> dict[str, str]:
        """The declared unit of every channel: the model's, those beside it, and sources."""
        units: dict[str, str] = {}
        for entry in self.derived.values():
            units |= entry.sources
        units |= {n: self.model.unit_of(n) for n in (*self.model.inputs, *self.model.outputs)}
        return units | dict(self.recorded)

    def in_si(self) -> Problem:
        """The problem with every number in SI, as the library's own functions take it."""
        model = self.model
        if model.takes_si:
            return self
        return replace(
            self,
            model=model.taking_si(),
            noise=self.noise_in_si(self.noise),
            load_cases={case: model.in_si(values) for case, values in self.load_cases.items()},
            truth=model.in_si(self.truth),
        )

    def noise_in_si(self, noise: Mapping[str, float]) -> dict[str, float]:
        """Standard deviations by channel in SI, given in the channels' units.

        A name that is no channel keeps its number.
        """
        if self.model.takes_si:
            return dict(noise)
        units = self._channel_units()
        return {n: float(difference_to_si(sd, units.get(n, "1"))) for n, sd in noise.items()}

    def read(
        self,
        path: str | Path,
        *,
        mapping: Mapping[str, str] | None = None,
        window: tuple[float, float] | None = None,
        case: str | None = None,
        known: Mapping[str, float] | None = None,
        resample: float | None = None,
        name: str | None = None,
        form: FileFormat | None = None,
        mark_missing: bool = False,
        ignore: Collection[str] = (),
    ) -> Experiment:
        """Read one record in this problem's channels and units, with its load case.

        Columns of numbers that the problem does not use are read beside (`Experiment.unused`), for
        the diagnosis to test them as missing inputs; the record's provenance names every column
        that is not used, and why one is no candidate.

        Parameters
        ----------
        path : of the file; a window may follow it, as in `run.csv@12:194`.
        mapping : signal -> column, with its unit after a colon, before the problem's `channels`.
        case, known : load case, and values of parameters in declared units, of this record.
        window, resample, name, mark_missing : as `casid.read_record`, except that rows that an
            even clock leaves out are missing samples here, as empty cells are.
        form : how the file is written, before the problem's `form`.
        ignore : columns to leave out.

        Raises
        ------
        DataError
            For a file, column or load case that cannot be used.
        """
        source, own_window = source_of(path)
        form = form if self.form is None else self.form.updated(form)
        options = ReadingOptions(
            self.time,
            own_window if window is None else window,
            name,
            resample,
            mark_missing=mark_missing,
            form=form,
            takes_gaps=True,
        )
        record, unused = self._read_table(open_table(source, form), mapping, options, ignore)
        return replace(self.experiment(record, case=case, known=known), unused=unused)

    def _read_table(
        self,
        table: Table,
        mapping: Mapping[str, str] | None,
        options: ReadingOptions,
        ignore: Collection[str] = (),
    ) -> tuple[Record, dict[str, str]]:
        """The record of an open table, and its channels that the problem does not use."""
        table = on_one_clock(table, self.time)
        specs = self.columns_in(table.columns, mapping)
        unused = self._unused(table, specs, ignore)
        held = [name for name, entry in self.model.inputs.items() if entry.hold == "zoh"]
        record = record_of(table, {**specs, **unused.specs}, replace(options, held=held))
        record = replace(record, provenance=(*record.provenance, *unused.lines))
        return record, {name: spec.column for name, spec in unused.specs.items()}

    def _unused(
        self, table: Table, specs: Mapping[str, ColumnSpec], ignore: Collection[str]
    ) -> Unused:
        """The columns that the problem does not use."""
        try:
            _, clock = resolve(table, specs, self.time)
        except DataError:  # refused as the file is read
            return Unused({}, {})
        model = self.model
        taken = {*model.parameters, *model.states, *self._channel_units()}
        return unused_columns(
            table, specs, None if clock is None else clock.column, ignore=ignore, taken=taken
        )

    def read_frame(
        self,
        frame: pd.DataFrame,
        *,
        mapping: Mapping[str, str] | None = None,
        case: str | None = None,
        known: Mapping[str, float] | None = None,
        name: str | None = None,
    ) -> Experiment:
        """Read a pandas DataFrame in this problem's channels and units, as `read` reads a file.

        Raises
        ------
        DataError
            For a table, column or load case that cannot be used.
        """
        options = ReadingOptions(time=self.time, name=name, takes_gaps=True)
        record, unused = self._read_table(open_frame(frame, name=name), mapping, options)
        return replace(self.experiment(record, case=case, known=known), unused=unused)

    def derive(self, record: Record) -> Record:
        """The record with the derived channels that it lacks, cut where their filters end.

        A channel beside the model's is left out where the record lacks its sources.

        Raises
        ------
        DataError
            If a source of one of the model's channels is absent or misses samples.
        """
        signals = {*self.model.inputs, *self.model.outputs}
        wanted = {
            name: entry
            for name, entry in self.derived.items()
            if name in signals or all(source in record for source in entry.sources)
        }
        return derive(record, wanted, self.in_si().noise)

    def experiment(
        self,
        record: Record,
        *,
        case: str | None = None,
        known: Mapping[str, float] | None = None,
    ) -> Experiment:
        """A record with its derived channels, its load case and further known values.

        Raises
        ------
        DataError
            For a load case or a parameter that the problem does not have, and as `derive`.
        """
        record = self.derive(record)
        values: dict[str, float] = {}
        if case is not None:
            if case not in self.load_cases:
                raise DataError(
                    f"problem {self.name} has no load case {case!r}{nearest(case, self.load_cases)}"
                )
            values.update(self.load_cases[case])
        for key, value in (known or {}).items():
            if key not in self.model.parameters:
                raise DataError(
                    f"problem {self.name} has no parameter {key!r} to set"
                    f"{nearest(key, self.model.parameters)}"
                )
            values[key] = float(value)
        name = record.name if case is None else f"{case}:{record.name}"
        return Experiment(record, values, name)

    def examples(self) -> list[Experiment]:
        """The problem's own example experiments.

        Raises
        ------
        DataError
            If it has none, or they are none.
        """
        if self.example is None:
            raise DataError(
                f"problem {self.name} has no example data of its own; name a record behind the "
                f"problem: {self.source.name if self.source else f'{self.name}.py'} data.csv"
            )
        return self._experiments_of(self.example(), "example")

    def simulated(self, seed: int) -> list[Experiment]:
        """Experiments drawn anew with this seed.

        Raises
        ------
        DataError
            If the problem has no simulator, or it returns no experiments.
        """
        if self.simulate is None:
            raise DataError(
                f"problem {self.name} has no simulator; give it one, "
                "casid.Problem(..., simulate=f, truth={name: value}), where f takes a seed and "
                "returns experiments"
            )
        return self._experiments_of(self.simulate(seed), "simulator")

    def _experiments_of(self, given: Given, what: str) -> list[Experiment]:
        """The experiments that a function of the problem returned, one or several."""
        every = listed_experiments(given, f"the {what} of problem {self.name}")
        return [self.experiment(e) if isinstance(e, Record) else e for e in every]

    def with_known(self, known: Mapping[str, float]) -> Problem:
        """A copy whose model knows the given values, in the units that it declares."""
        return replace(self, model=self.model.with_known(**known))

    def with_si_values(self, values: Mapping[str, float]) -> Problem:
        """A copy whose model knows the given values, in SI."""
        return replace(self, model=self.model.with_si_values(values))


_FUNCTIONS = ("derived", "example", "simulate", "effects")
"""Fields of a problem that hold functions."""


def _read_again(given: Mapping[str, Any]) -> Problem:
    source = given.get("source")
    functions = {}
    if source is not None:
        file = load_problem(source)
        functions = {name: getattr(file, name) for name in _FUNCTIONS}
    return Problem(**given, **functions)


@names_wrong_types()
def load_problem(path: str | Path) -> Problem:
    """The `problem` that a Python file defines; the file runs as the user who calls this.

    The file defines `problem = casid.Problem(...)`, or a function `problem()` that returns one.

    Parameters
    ----------
    path : of the Python file.

    Raises
    ------
    DataError
        If the file does not exist or is not Python.
    ModelError
        If it fails to load (with the line) or defines no problem.
    """
    path = problem_file(path)
    with importing(path) as module:
        found = getattr(module, "problem", None)
        if callable(found) and not isinstance(found, Problem):
            found = found()
    if not isinstance(found, Problem):
        names = [k for k, v in vars(module).items() if isinstance(v, Problem)]
        hint = f"; rename {names[0]!r} to 'problem'" if names else ""
        raise ModelError(
            f"problem file {path} defines no `problem` (a casid.Problem, or a function returning "
            f"one){hint}"
        )
    return replace(found, source=path.resolve())
