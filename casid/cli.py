"""The command line: arguments to one library call, its result to a folder and to standard output.

Nothing heavy is imported before a command has its arguments: `casid --help` answers at once. What
a user did wrong ends with status 2 and one message `error: ...` on standard error; an exception
that casid does not raise on purpose is a fault of casid, and keeps its traceback.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from casid import __version__
from casid.errors import CasidError, DataError, ModelError

if TYPE_CHECKING:
    from casid.checking import CheckReport
    from casid.data import Experiment, Record
    from casid.problem import Problem
    from casid.reading import ColumnSpec

DONE, UNUSABLE, INTERRUPTED = 0, 2, 130
TIME = "t"  # --map t=column names the time column, where no channel has that name


# ---------------------------------------------------------------------- the command and its errors


class _Casid(click.Group):
    """A group of commands whose every refusal is one message and one exit status."""

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command and exit with its status."""
        extra.setdefault("prog_name", "casid")
        sys.exit(self._status(args, *rest, **{**extra, "standalone_mode": False}))

    def _status(self, *args: Any, **extra: Any) -> int:
        for stream in (sys.stdout, sys.stderr):
            # A terminal that cannot show a sign gets its escape, not a crash.
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
        try:
            status = super().main(*args, **extra)
        except click.Abort:
            return _refuse("interrupted; nothing was written", INTERRUPTED)
        except click.UsageError as error:
            path = error.ctx.command_path if error.ctx else "casid"
            return _refuse(f"{error.format_message()} (see {path} --help)")
        except click.ClickException as error:
            return _refuse(error.format_message())
        except CasidError as error:
            return _refuse(str(error))
        except MemoryError:
            return _refuse(
                "out of memory; take a part with --window, or a larger sample time with --resample"
            )
        except OSError as error:
            what = error.strerror or str(error)
            if error.filename is None:
                return _refuse(f"{what}; mend that and run the command again")
            return _refuse(f"{error.filename}: {what}; check the path and its permissions")
        return status if isinstance(status, int) else DONE

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, naming the nearest where there is none."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and self.get_command(ctx, name) is None:
            known = self.list_commands(ctx)
            ctx.fail(f"no command {name!r}; there are {', '.join(known)}{_near(name, known)}")
        return super().resolve_command(ctx, args)


def _refuse(message: str, status: int = UNUSABLE) -> int:
    _say(f"error: {message}")
    return status


def _say(text: str) -> None:
    """Write to standard error, where there is one."""
    # Not click.echo: told of an ASCII stream, it writes UTF-8 all the same.
    with contextlib.suppress(OSError):
        if sys.stderr is not None:
            print(text, file=sys.stderr, flush=True)


def _near(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _print(text: str) -> None:
    """Write to standard output; a reader that has gone away (`| head`) is no error."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # What is left in the buffer would raise once more when Python closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_json(content: Any) -> None:
    from casid.writing import plain

    _print(json.dumps(plain(content), indent=1, allow_nan=False))


# ---------------------------------------------------------------------- what options mean


class Mapping(NamedTuple):
    """`--map gyro=column` or `--map phi=roll:deg`: signal, column, unit of the column."""

    signal: str
    column: str
    unit: str | None


def parse_mapping(text: str) -> Mapping:
    """Read `signal=column` or `signal=column:unit`.

    Raises
    ------
    DataError
        If a part is missing.
    """
    signal, equals, rest = text.partition("=")
    column, colon, unit = rest.partition(":")
    parts = [signal.strip(), column.strip(), unit.strip()]
    if not equals or not all(parts[:2]) or (colon and not parts[2]):
        raise DataError(
            f"--map {text}: write it as signal=column or signal=column:unit, "
            "for example --map phi=roll:deg"
        )
    return Mapping(parts[0], parts[1], parts[2] or None)


def parse_setting(text: str) -> tuple[str, float]:
    """Read `name=value`, the value a finite number in SI units.

    Raises
    ------
    DataError
        If it is not.
    """
    name, equals, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not equals or not name.strip() or not math.isfinite(number):
        raise DataError(
            f"--set {text}: write it as name=value with a finite number in SI units, "
            "for example --set M=22.04"
        )
    return name.strip(), number


@dataclass(frozen=True, slots=True)
class Source:
    """One file named on the command line: load case, path and window [s]."""

    case: str | None
    path: Path
    window: tuple[float, float] | None

    def __str__(self) -> str:
        window = self.window
        if window is None:
            return str(self.path)
        return f"{self.path}@" + ":".join(f"{x:g}" if math.isfinite(x) else "" for x in window)


def _source(text: str, common: tuple[float, float] | None = None) -> Source:
    from casid.reading import parse_case

    case, path, window = parse_case(text)
    return Source(case, path, window or common)


def _refuse_overlap(sources: Sequence[Source]) -> None:
    """Refuse samples that are named twice: they would count twice, or be fitted and held out."""
    everything = (-math.inf, math.inf)
    for i, a in enumerate(sources):
        for b in sources[:i]:
            first, second = a.window or everything, b.window or everything
            overlap = max(first[0], second[0]) < min(first[1], second[1])
            if overlap and a.path.exists() and b.path.exists() and a.path.samefile(b.path):
                raise DataError(
                    f"{a.path} is given twice ({b} and {a}) with windows that overlap; name it "
                    "once, or give each its own window, for example run.csv@0:40 and run.csv@40:60"
                )


@dataclass(frozen=True, slots=True)
class Request:
    """The common options, read and held against each other."""

    data: Sequence[str] = ()
    maps: Sequence[str] = ()
    settings: Sequence[str] = ()
    window: str | None = None
    hold_out: Sequence[str] = ()
    resample: float | None = None
    lowpass: float | None = None
    decimate: int = 1
    detrend: bool = False
    mapping: dict[str, Mapping] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for text in self.maps:
            new = parse_mapping(text)
            old = self.mapping.get(new.signal)
            if old is not None:
                raise DataError(
                    f"--map names {new.signal!r} twice, from {old.column!r} and from "
                    f"{new.column!r}; keep one of them"
                )
            self.mapping[new.signal] = new
        if not self.data and not self.hold_out_files:
            for option, value in (
                ("--map", self.maps),
                ("--window", self.window),
                ("--resample", self.resample),
            ):
                if value:
                    raise DataError(
                        f"{option} speaks of a file, and none is given; name the data after the "
                        f"problem, or leave {option} out to use the problem's own example"
                    )

    @property
    def hold_out_files(self) -> list[str]:
        """What --hold-out names that is no number."""
        return [text for text in self.hold_out if not _is_number(text)]

    def known(self, problem: Problem) -> dict[str, float]:
        """The values of --set, each a parameter of the problem that no load case contradicts."""
        out: dict[str, float] = {}
        names = list(problem.model.parameters)
        for text in self.settings:
            name, value = parse_setting(text)
            if name not in names:
                raise DataError(
                    f"--set {text}: problem {problem.name} has no parameter {name!r}; it has "
                    f"{', '.join(names)}{_near(name, names)}"
                )
            parameter = problem.model.parameters[name]
            if not parameter.lower <= value <= parameter.upper:
                raise DataError(
                    f"--set {text}: {value:g} lies outside the bounds of {name}, "
                    f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}; give a value "
                    "inside, in SI units, or widen the bounds in the problem file"
                )
            if out.get(name, value) != value:
                raise DataError(
                    f"--set gives {name} twice, {out[name]:g} and {value:g}; keep one of them"
                )
            out[name] = value
        return out

    def prepare(self, record: Record) -> Record:
        """Low-pass, decimation, mean: in this order, on every record alike."""
        from casid import prepare

        if self.lowpass is not None:
            record = prepare.lowpass(record, self.lowpass)
        record = prepare.decimate(record, self.decimate)
        return prepare.detrend(record) if self.detrend else record

    def experiments(self, problem: Problem) -> tuple[list[Experiment], float | list[Experiment]]:
        """What is to be fitted and what is to be held out, read and prepared.

        `problem` is the one that knows the values of --set.
        """
        from casid.reading import parse_window

        window = parse_window(self.window) if self.window else None
        sources = [_source(text, window) for text in self.data]
        aside = [_source(text) for text in self.hold_out_files]
        share = self._share()
        _refuse_overlap([*sources, *aside])
        if sources:
            fitted = [self._read(problem, s) for s in sources]
        else:
            fitted = [replace(e, record=self.prepare(e.record)) for e in problem.examples()]
        return fitted, [self._read(problem, s) for s in aside] if aside else share

    def _share(self) -> float:
        numbers = [float(text) for text in self.hold_out if _is_number(text)]
        if len(self.hold_out) > 1 and numbers:
            raise DataError(
                f"--hold-out {' and '.join(self.hold_out)} contradict each other; give one share, "
                "or files"
            )
        return numbers[0] if numbers else 0.0

    def _read(self, problem: Problem, source: Source) -> Experiment:
        problem, mapping = _with_time(problem, self.mapping)
        for text in self.settings:
            name, _ = parse_setting(text)
            if name in problem.load_cases.get(source.case or "", {}):
                raise DataError(
                    f"--set {text} contradicts load case {source.case!r}, which sets {name} too; "
                    "leave one of them out"
                )
        experiment = problem.read(
            source.path,
            mapping={
                m.signal: m.column if m.unit is None else f"{m.column}:{m.unit}"
                for m in mapping.values()
            },
            window=source.window,
            case=source.case,
            resample=self.resample,
        )
        return replace(experiment, record=self.prepare(experiment.record))


def _with_time(problem: Problem, mapping: dict[str, Mapping]) -> tuple[Problem, dict[str, Mapping]]:
    """The problem with the time column of `--map t=column`, and the mapping without it."""
    model = problem.model
    if TIME not in mapping or TIME in {*model.inputs, *model.outputs, *problem.recorded}:
        return problem, mapping
    rest = {k: v for k, v in mapping.items() if k != TIME}
    return replace(problem, time=_time_column(mapping[TIME])), rest


def _time_column(mapping: Mapping) -> Any:
    from casid.reading import ColumnSpec

    return mapping.column if mapping.unit is None else ColumnSpec(mapping.column, mapping.unit)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# ---------------------------------------------------------------------- running


def _load(path: str) -> Problem:
    from casid.problem import load_problem

    try:
        with _quiet_stdout():
            return load_problem(path)
    except SystemExit as error:
        raise ModelError(
            f"problem file {path} ends the program (exit status {error.code}) instead of defining "
            "`problem`; remove the call to exit"
        ) from error


@contextlib.contextmanager
def _quiet_stdout() -> Iterator[None]:
    """Send what a problem file or a solver prints to standard error: results alone go out."""
    with contextlib.redirect_stdout(sys.stderr):
        yield


@contextlib.contextmanager
def _reserved(out: Path | None, name: str, *, force: bool) -> Iterator[Path]:
    """The folder to write to, refused at once or kept only if the work succeeds."""
    from casid.writing import output_folder

    probe = out if out is not None else Path("reports")
    new = [p for p in (probe, *probe.parents) if not p.exists()]
    folder = output_folder(
        out, re.sub(r"[^\w.-]+", "-", name).strip("-.") or "problem", force=force
    )
    if out is None:
        new.insert(0, folder)
    try:
        if not os.access(folder, os.W_OK | os.X_OK):
            raise DataError(f"{folder} cannot be written to; name another folder with --out")
        yield folder
    except BaseException:
        for path in new:
            with contextlib.suppress(OSError):  # holds something after all: not ours to remove
                path.rmdir()
        raise


@contextlib.contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A moving line where standard error is a terminal, else a line a step."""
    if quiet:
        yield lambda line: None
    elif sys.stderr is not None and sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status("", spinner="line") as status:
            yield lambda line: status.update(_plain(line))
    else:
        yield lambda line: _say(line)


def _plain(line: str) -> Any:
    from rich.text import Text

    return Text(line)  # a record's name in brackets is no markup


def _say_where(folder: Path, names: Sequence[str], quiet: bool) -> None:
    if not quiet:
        _say("wrote " + " and ".join(str(folder / name) for name in names))


_DATA_OPTIONS = (
    click.option(
        "--map",
        "maps",
        multiple=True,
        metavar="SIGNAL=COLUMN[:UNIT]",
        help="Column of a signal, and its unit in the file, as in phi=roll:deg; t=COLUMN names the "
        "time stamps. Repeatable.",
    ),
    click.option(
        "--window",
        metavar="START:STOP",
        help="Seconds of the record's own clock, as in 27:91; run.csv@12:194 gives a file its own.",
    ),
    click.option(
        "--resample",
        type=float,
        metavar="TS",
        help="Interpolate irregular records onto this sample time [s].",
    ),
    click.option(
        "--lowpass",
        type=float,
        metavar="HZ",
        help="Low-pass every channel alike (zero phase). First of the preparations.",
    ),
    click.option(
        "--decimate",
        type=click.IntRange(min=1),
        default=1,
        metavar="N",
        help="Keep every N-th sample behind an anti-alias filter. Second.",
    ),
    click.option("--detrend", is_flag=True, help="Subtract the mean of every channel. Third."),
)
"""Where records come from, and how they are prepared."""

_FIT_OPTIONS = (
    click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help="A parameter that is known, SI units. Repeatable.",
    ),
    click.option(
        "--starts",
        type=click.IntRange(min=1),
        metavar="N",
        help="Starts of the estimation; the best optimum is kept. Default: the problem's.",
    ),
    click.option(
        "--solver",
        default="ipopt",
        show_default=True,
        metavar="NAME",
        help="A CasADi NLP solver.",
    ),
)
"""How a fit is sought."""

_OUTPUT_OPTIONS = (
    click.option("--json", "as_json", is_flag=True, help="Print the result as JSON."),
    click.option("--quiet", is_flag=True, help="No progress; errors alone."),
)
"""What is said."""


def _seed_option(help: str) -> Any:
    return click.option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help=help
    )


def _folder_options(default: str, force: str) -> tuple[Any, Any]:
    return (
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            metavar="DIR",
            help=f"Folder of the results; default {default}.",
        ),
        click.option("--force", is_flag=True, help=force),
    )


def _options(*options: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command these options, in this order."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


_RECORD_OPTIONS = _options(
    *_DATA_OPTIONS,
    *_FIT_OPTIONS,
    _seed_option("Seed of the random starts."),
    *_folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *_OUTPUT_OPTIONS,
)
"""The options of what works on records."""


def _hold_out_option(default: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(
        "--hold-out",
        "hold_out",
        multiple=True,
        default=(default,),
        metavar="FILE|SHARE",
        help="Not fitted: this share at the end of every record (0: fit everything), or a file. "
        "A file is simulated on its own and may carry a load case and a window; --window is not "
        f"for it. Default {default}.",
    )


# ---------------------------------------------------------------------- the commands


@click.group(
    cls=_Casid,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="casid", message="%(prog)s %(version)s")
@click.pass_context
def main(context: click.Context) -> None:
    """Find the physical parameters of a system, and what its model is missing.

    PROBLEM is a Python file that defines the model (it runs as you); DATA are CSV or Parquet files,
    one record each, with a load case in front where the problem has any: nominal=a.csv loaded=b.csv

    Exit status: 0 done, 2 the input is unusable (the message says how to mend it).
    """
    if context.invoked_subcommand is None:
        _print(context.get_help())


@main.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@_hold_out_option("0.3")
@click.option(
    "--false-alarm-rate",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.05,
    show_default=True,
    help="Of the whole catalogue of effects, on a record without any.",
)
@click.option(
    "--max-causes",
    type=click.IntRange(min=1),
    default=4,
    show_default=True,
    help="Stop the search there.",
)
@_RECORD_OPTIONS
def diagnose(
    problem: str,
    false_alarm_rate: float,
    max_causes: int,
    starts: int | None,
    seed: int,
    solver: str,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
    **common: Any,
) -> None:
    """Find what the model is missing in these records.

    Names the causes, extends the model, and measures the gain on data that were not fitted. Without
    DATA the problem simulates its own example. Writes diagnosis.json and report.html.

    Example: casid diagnose problems/pendulum.py run.csv --map gyro=rate:deg/s --window 27:91
    """
    request = Request(**common)
    model = _load(problem)
    model = model.with_known(request.known(model))
    with _reserved(out, model.name, force=force) as folder:
        with _quiet_stdout(), _progress(quiet) as progress:
            fitted, hold_out = request.experiments(model)
            from casid.diagnosing import diagnose as run
            from casid.nlp import Solver

            result = run(
                model,
                fitted,
                hold_out=hold_out,
                false_alarm_rate=false_alarm_rate,
                max_causes=max_causes,
                solver=Solver(solver),
                starts=starts,
                seed=seed,
                progress=progress,
            )
            progress("write the report")
            result.write(folder)
    _say_where(folder, ("report.html", "diagnosis.json"), quiet)
    if as_json:
        _print_json(result.to_json())
    else:
        _print(str(result))


@main.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@_hold_out_option("0")
@click.option(
    "--segments",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Multiple shooting with so many segments a record, for unstable models.",
)
@_RECORD_OPTIONS
def identify(
    problem: str,
    segments: int,
    starts: int | None,
    seed: int,
    solver: str,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
    **common: Any,
) -> None:
    """Estimate the unknown parameters from these records.

    Least squares of the simulation error, with standard errors that allow for coloured residuals.
    Without DATA the problem simulates its own example. Writes estimate.json and report.html.

    Example: casid identify ship.py nominal=a.csv loaded=b.csv --set M=22.04 --hold-out c.csv
    """
    request = Request(**common)
    model = _load(problem)
    model = model.with_known(request.known(model))
    with _reserved(out, model.name, force=force) as folder:
        with _quiet_stdout(), _progress(quiet) as progress:
            fitted, hold_out = request.experiments(model)
            from casid.identification import FitSettings
            from casid.identification import identify as run
            from casid.nlp import Solver
            from casid.report import estimate_page
            from casid.writing import write_text

            settings = FitSettings(
                starts=model.starts if starts is None else starts,
                segments=segments,
                solver=Solver(solver),
                seed=seed,
            )
            result = run(model, fitted, hold_out=hold_out, settings=settings, progress=progress)
            progress("write the report")
            page = estimate_page(
                result, result.records
            )  # before anything is written: both files or none
            result.write(folder)
            write_text(folder / "report.html", page)
    _say_where(folder, ("report.html", "estimate.json"), quiet)
    if as_json:
        _print_json(result.to_json())
    else:
        _print(str(result))


@main.command()
@click.argument("data", nargs=-1, required=True)
@click.option(
    "--problem",
    type=click.Path(),
    metavar="FILE",
    help="Check the channels that this problem reads, in its units.",
)
@click.option(
    "--map",
    "maps",
    multiple=True,
    metavar="SIGNAL=COLUMN[:UNIT]",
    help="Column of a signal and its unit in the file; t=COLUMN names the time stamps. Repeatable.",
)
@click.option("--window", metavar="START:STOP", help="Seconds of the record's own clock.")
@click.option(
    "--resample", type=float, metavar="TS", help="Interpolate onto this sample time [s] first."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the report as JSON; of several files, a list."
)
def check(
    data: tuple[str, ...],
    problem: str | None,
    maps: tuple[str, ...],
    window: str | None,
    resample: float | None,
    as_json: bool,
) -> None:
    """Say what records are worth before anything is estimated from them.

    Clock, gaps, noise, quantisation, plateaus, spikes, drift and bandwidth of every channel.
    Exit status 2 if a file cannot be used.

    Example: casid check run.csv --map phi=roll:deg
    """
    from casid.reading import parse_window

    request = Request(data=data, maps=maps, window=window, resample=resample)
    found = _load(problem) if problem is not None else None
    common = parse_window(window) if window else None
    sources = [_source(text, common) for text in data]
    reports = [_checked(source, request, found) for source in sources]
    if as_json:
        content = [report.to_json() for report in reports]
        _print_json(content[0] if len(content) == 1 else content)
    else:
        _print("\n\n".join(str(report) for report in reports))
    unusable = [str(s) for s, r in zip(sources, reports, strict=True) if not r.is_usable]
    if unusable:
        raise DataError(
            f"unusable as it stands: {', '.join(unusable)}; mend the errors listed under findings"
        )


def _checked(source: Source, request: Request, problem: Problem | None) -> CheckReport:
    from casid.checking import check as run
    from casid.reading import ColumnSpec, column_names

    columns: dict[str, ColumnSpec] | None = None
    mapping, time = dict(request.mapping), None
    if problem is not None:
        problem, mapping = _with_time(problem, mapping)
        time = problem.time
        texts = {
            m.signal: m.column if m.unit is None else f"{m.column}:{m.unit}"
            for m in mapping.values()
        }
        columns = problem.columns(texts)
        with contextlib.suppress(DataError):  # found and told by the check itself
            there = set(column_names(source.path))
            columns = {
                signal: spec
                for signal, spec in columns.items()
                if signal not in problem.recorded or signal in texts or spec.column in there
            }
    elif mapping:
        if TIME in mapping:
            time = _time_column(mapping.pop(TIME))
        columns = {m.signal: ColumnSpec(m.column, m.unit) for m in mapping.values()} or None
    return run(source.path, columns, time=time, window=source.window, resample=request.resample)


if __name__ == "__main__":
    main()
