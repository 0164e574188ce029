"""The command line: arguments to one library call, its result to a folder and to standard output.

Nothing heavy is imported before a command has its arguments: `casid --help` answers at once. What
a user did wrong ends with status 2 and one message `error: ...` on standard error; an exception
that casid does not raise on purpose is a fault of casid, and keeps its traceback.
"""

from __future__ import annotations

import _thread
import contextlib
import io
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from casid import __version__
from casid.cli.diagnosis_options import DIAGNOSIS_OPTIONS
from casid.cli.identifiability_options import (
    ASSUMPTION_OPTIONS,
    QUESTION_OPTIONS,
    Inquiry,
    is_equation_file,
    read_equations_for,
)
from casid.cli.instrument_options import INSTRUMENT_OPTIONS, InstrumentRequest
from casid.cli.options import (
    DATA_OPTIONS,
    FIT_OPTIONS,
    OUTPUT_OPTIONS,
    SET_OPTION,
    TIME,
    Request,
    Source,
    folder_options,
    hold_out_option,
    near,
    options,
    parse_mapping,
    parse_setting,
    record_options,
    seed_option,
    source_of,
    time_column,
    with_time,
)
from casid.cli.terminal import (
    print_json,
    print_text,
    progress_lines,
    quiet_stdout,
    reserved,
    say,
    say_where,
    study_folder,
    workers,
)
from casid.errors import CasidError, DataError, ModelError

if TYPE_CHECKING:
    from casid.data.problem import Problem
    from casid.data.quality import CheckReport
    from casid.data.reading.columns import ColumnSpec

__all__ = ["Request", "main", "parse_mapping", "parse_setting"]

DONE, UNUSABLE, INTERRUPTED = 0, 2, 130


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
        except click.Abort as error:
            what = str(error.__cause__ or "")  # a campaign says what it keeps
            return _refuse(f"interrupted; {what or 'nothing was written'}", INTERRUPTED)
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
            ctx.fail(f"no command {name!r}; there are {', '.join(known)}{near(name, known)}")
        return super().resolve_command(ctx, args)


def _refuse(message: str, status: int = UNUSABLE) -> int:
    say(f"error: {message}")
    return status


# ---------------------------------------------------------------------- running


def _load(path: str) -> Problem:
    from casid.data.problem import load_problem

    try:
        with quiet_stdout():
            return load_problem(path)
    except SystemExit as error:
        raise ModelError(
            f"problem file {path} ends the program (exit status {error.code}) instead of defining "
            "`problem`; remove the call to exit"
        ) from error


@contextlib.contextmanager
def _ends_at_ctrl_c() -> Iterator[None]:
    """Ctrl-C ends what is done here, though compiled solvers swallow it: it is said until heard."""
    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    asked, over = threading.Event(), threading.Event()

    def insist() -> None:
        while not over.wait(0.1):
            _thread.interrupt_main()

    again = threading.Thread(target=insist, daemon=True)

    def interrupt(number: int, frame: Any) -> None:
        if over.is_set():
            return
        if not asked.is_set():
            asked.set()
            sys.stdout = sys.stderr = io.StringIO()  # CasADi prints all that it swallows
            again.start()
        before(number, frame)

    streams = sys.stdout, sys.stderr
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except Exception:
        if asked.is_set():  # what Ctrl-C broke has not failed
            raise KeyboardInterrupt from None
        raise
    finally:
        over.set()
        if again.ident is not None:
            again.join()
        signal.signal(signal.SIGINT, before)
        sys.stdout, sys.stderr = streams
    if asked.is_set():
        raise KeyboardInterrupt


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
        print_text(context.get_help())


@main.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0.3")
@options(*DIAGNOSIS_OPTIONS)
@record_options
def diagnose(
    problem: str,
    false_alarm_rate: float,
    calibrate: int | None,
    jobs: int | None,
    max_causes: int,
    without: tuple[str, ...],
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

    Names the causes, extends the model, and measures the gain on data that were not fitted; says
    so where nothing is missing, and where the records cannot tell. Several records are diagnosed
    jointly, each with its load case. Without DATA the problem simulates its own example. Writes
    diagnosis.json and report.html.

    Example: casid diagnose problems/pendulum.py run.csv --map gyro=rate:deg/s --window 27:91

    Several: casid diagnose ship.py nominal=a.csv loaded=b.csv --hold-out c.csv --calibrate
    """
    from casid.diagnosis.verdict.sufficiency import require_settings

    request = Request(**common)
    if jobs is not None and calibrate is None:
        raise DataError(
            "--jobs speaks of --calibrate, which alone has work for several processes; add "
            "--calibrate, or leave --jobs out"
        )
    model = _load(problem)
    model = model.with_known(request.known(model))
    require_settings(model, false_alarm_rate, max_causes, without)  # before anything is read
    with reserved(out, model.name, force=force) as folder:
        with quiet_stdout(), progress_lines(quiet) as progress:
            fitted, hold_out = request.experiments(model)
            from casid.diagnosis.diagnose import diagnose as run
            from casid.estimation.nlp.nlp import Solver

            at_work = workers(jobs, None) if calibrate else contextlib.nullcontext()
            with _ends_at_ctrl_c(), at_work:
                result = run(
                    model,
                    fitted,
                    hold_out=hold_out,
                    false_alarm_rate=false_alarm_rate,
                    max_causes=max_causes,
                    without=without,
                    calibrate=calibrate or 0,
                    solver=Solver(solver),
                    starts=starts,
                    seed=seed,
                    progress=progress,
                )
            progress("write the report")
            result.write(folder)
    say_where(folder, ("report.html", "diagnosis.json"), quiet)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(str(result))


@main.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0")
@click.option(
    "--segments",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Multiple shooting with so many segments a record, for unstable models.",
)
@options(*INSTRUMENT_OPTIONS)
@record_options
def identify(
    problem: str,
    segments: int,
    method: str,
    reference: str | None,
    lag: float | None,
    free: str | None,
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

    With instruments: casid identify ship.py nominal=a.csv b.csv --method instruments --reference
    rudder --free I_x,d,m=0.1
    """
    request = Request(**common)
    instruments = InstrumentRequest(method, reference, lag, free)
    model = _load(problem)
    model = model.with_known(request.known(model))
    if method == "instruments":
        instruments.refuse(request, starts, segments)
        instruments.freed(model)  # refused before anything is read
    with reserved(out, model.name, force=force) as folder:
        with quiet_stdout(), progress_lines(quiet) as progress:
            fitted, hold_out = request.experiments(model)
            from casid.data.files import write_text
            from casid.estimation.nlp.nlp import Solver
            from casid.estimation.simulation.fit import FitSettings
            from casid.identification.identify import identify as run
            from casid.report.pages.estimate_page import estimate_page

            result: Any
            if method == "instruments":
                progress(f"instrumental variables of {', '.join(e.name for e in fitted)}")
                with _ends_at_ctrl_c():
                    result = instruments.estimate(model, fitted, solver)
                estimate = result.estimate
            else:
                settings = FitSettings(
                    starts=model.starts if starts is None else starts,
                    segments=segments,
                    solver=Solver(solver),
                    seed=seed,
                )
                with _ends_at_ctrl_c():
                    result = estimate = run(
                        model, fitted, hold_out=hold_out, settings=settings, progress=progress
                    )
            progress("write the report")
            # Before anything is written: both files or none.
            page = estimate_page(estimate, estimate.records)
            result.write(folder)
            write_text(folder / "report.html", page)
    say_where(folder, ("report.html", "estimate.json"), quiet)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(str(result))


@main.command()
@click.argument("problem", metavar="PROBLEM|EQUATIONS", type=click.Path())
@click.argument("data", nargs=-1)
@options(*ASSUMPTION_OPTIONS, *QUESTION_OPTIONS)
@options(
    *DATA_OPTIONS,
    SET_OPTION,
    seed_option("Seed of the random points."),
    *folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *OUTPUT_OPTIONS,
)
def identifiability(
    problem: str,
    data: tuple[str, ...],
    maps: tuple[str, ...],
    window: str | None,
    resample: float | None,
    lowpass: float | None,
    decimate: int,
    detrend: bool,
    settings: tuple[str, ...],
    seed: int,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
    **asked: Any,
) -> None:
    """Say which parameters these experiments can tell, and what would mend the rest.

    PROBLEM is a problem file (.py), analysed for the load cases and inputs of DATA or of its own
    example, with the errors to expect of them; EQUATIONS is a JSON or TOML file of states,
    parameters, inputs and outputs, for which nobody needs Python. Every experiment has unknown
    inputs of its own unless --shared-input says otherwise. Writes identifiability.json and
    report.html.

    Example: casid identifiability problems/pendulum.py nominal=a.csv b.csv --known k

    Equations: casid identifiability model.toml --sensor angle=x1 --known-initial x1,x2=0
    """
    request = Request(
        data=data,
        maps=maps,
        window=window,
        settings=settings,
        resample=resample,
        lowpass=lowpass,
        decimate=decimate,
        detrend=detrend,
    )
    inquiry = Inquiry(**asked)
    assuming, candidates = inquiry.assumptions(), inquiry.candidates()
    subject: Any
    if is_equation_file(problem):
        subject = read_equations_for(problem, request)
    else:
        model = _load(problem)
        subject = model.with_known(request.known(model))
    with reserved(out, subject.name, force=force) as folder:
        with quiet_stdout(), progress_lines(quiet) as progress:
            from casid.identifiability.assess import assess_identifiability

            experiments = None
            if not is_equation_file(problem) and (data or subject.example is not None):
                experiments, _ = request.experiments(subject)

            with _ends_at_ctrl_c():
                result = assess_identifiability(
                    subject,
                    experiments,
                    assuming=assuming,
                    candidates=candidates,
                    symbolic=not inquiry.structural,
                    practical=not inquiry.structural,
                    profiles=inquiry.profiled(),
                    time_limit=inquiry.time_limit,
                    seed=seed,
                    progress=progress,
                )
            progress("write the report")
            result.write(folder)
    say_where(folder, ("report.html", "identifiability.json"), quiet)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(str(result))


@main.command()
@click.argument("problem", type=click.Path())
@click.option(
    "--runs",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="N",
    help="Runs in all; those that the folder has are not done again.",
)
@click.option(
    "--method",
    default="identify",
    show_default=True,
    metavar="NAME",
    help="What every run estimates with.",
)
@click.option(
    "--duration",
    type=float,
    metavar="S",
    help="Use the first S seconds of every simulated record; default whole records.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes that work; default one for every core.",
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Work on the cluster of this Dask scheduler instead, as in tcp://host:8786. Its workers "
    "need casid, and the problem at the same path.",
)
@options(
    *FIT_OPTIONS,
    seed_option("Seed of the study; every run has its own of it."),
    *folder_options(
        "reports/<problem>-montecarlo-<n>, the last one if it holds this very study",
        "Begin anew in a folder that is not empty.",
    ),
    *OUTPUT_OPTIONS,
)
def montecarlo(
    problem: str,
    runs: int,
    method: str,
    duration: float | None,
    jobs: int | None,
    dask: str | None,
    settings: tuple[str, ...],
    starts: int | None,
    solver: str,
    seed: int,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Simulate a problem many times and hold its estimates against the truth.

    Bias, spread and coverage of the intervals, each with its own uncertainty. The problem has to
    simulate itself: `casid.Problem(..., simulate=, truth=)`. An interrupted study continues with
    the same command. Writes results.parquet, montecarlo.json and report.html.

    Example: casid montecarlo problems/roll_decay.py --runs 1000 --out study
    """
    request = Request(settings=settings)
    model = _load(problem)
    model = model.with_known(request.known(model))
    from casid.campaigns.monte_carlo import Study
    from casid.estimation.nlp.nlp import Solver
    from casid.estimation.simulation.fit import FitSettings

    fit = FitSettings(starts=model.starts if starts is None else starts, solver=Solver(solver))
    study = Study(model, method, fit, duration)
    with study_folder(out, model.name, study.manifest(seed), force=force) as folder:
        with quiet_stdout(), workers(jobs, dask):
            result = study.run(runs, seed=seed, out=folder, resume=not force, progress=not quiet)
            result.write(folder)
    say_where(folder, ("report.html", "montecarlo.json"), quiet)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(str(result))


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
    from casid.data.reading.sources import parse_window

    request = Request(data=data, maps=maps, window=window, resample=resample)
    found = _load(problem) if problem is not None else None
    common = parse_window(window) if window else None
    sources = [source_of(text, common) for text in data]
    reports = [_checked(source, request, found) for source in sources]
    if as_json:
        content = [report.to_json() for report in reports]
        print_json(content[0] if len(content) == 1 else content)
    else:
        print_text("\n\n".join(str(report) for report in reports))
    unusable = [str(s) for s, r in zip(sources, reports, strict=True) if not r.is_usable]
    if unusable:
        raise DataError(
            f"unusable as it stands: {', '.join(unusable)}; mend the errors listed under findings"
        )


def _checked(source: Source, request: Request, problem: Problem | None) -> CheckReport:
    from casid.data.quality import check as run
    from casid.data.reading.columns import ColumnSpec
    from casid.data.reading.record_file import column_names

    columns: dict[str, ColumnSpec] | None = None
    mapping, time = dict(request.mapping), None
    if problem is not None:
        problem, mapping = with_time(problem, mapping)
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
            time = time_column(mapping.pop(TIME))
        columns = {m.signal: ColumnSpec(m.column, m.unit) for m in mapping.values()} or None
    return run(source.path, columns, time=time, window=source.window, resample=request.resample)


if __name__ == "__main__":
    main()
