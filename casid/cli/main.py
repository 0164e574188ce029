"""The command `casid`: its group of commands, and what the end of each means.

Nothing heavy is imported before a command has its arguments: `casid --help` answers at once. What
a user did wrong ends with status 2 and one message `error: ...` on standard error; an exception
that casid does not raise on purpose is a fault of casid, and keeps its traceback.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from typing import Any

import click

from casid import __version__
from casid.cli.check import check
from casid.cli.design import design
from casid.cli.diagnose import diagnose
from casid.cli.example import example
from casid.cli.export import export
from casid.cli.fleet import fleet
from casid.cli.gallery import gallery
from casid.cli.identifiability import identifiability
from casid.cli.identify import identify
from casid.cli.investigate import investigate
from casid.cli.montecarlo import montecarlo
from casid.cli.new import new
from casid.cli.serve import serve
from casid.cli.simulate import simulate
from casid.cli.terminal import print_text, say
from casid.errors import CasidError, nearest

DONE, UNUSABLE, INTERRUPTED = 0, 2, 130


class _Casid(click.Group):
    """A group of commands whose every refusal is one message and one exit status."""

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command and exit with its status."""
        extra.setdefault("prog_name", "casid")
        sys.exit(self._status(args, *rest, **{**extra, "standalone_mode": False}))

    def _status(self, *args: Any, **extra: Any) -> int:
        for stream in (sys.stdout, sys.stderr):
            # A character that a terminal cannot show is escaped.
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
                return _refuse(f"{what}; correct that and run the command again")
            remedy = "check the path and its permissions"
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                remedy = "free some space there, or name another place; nothing was replaced"
            return _refuse(f"{error.filename}: {what}; {remedy}")
        return status if isinstance(status, int) else DONE

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, naming the nearest where there is none."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and self.get_command(ctx, name) is None:
            ctx.fail(f"no command {name!r}{nearest(name, self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)


def _refuse(message: str, status: int = UNUSABLE) -> int:
    say(f"error: {message}")
    return status


@click.group(
    cls=_Casid,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="casid", message="%(prog)s %(version)s")
@click.pass_context
def main(context: click.Context) -> None:
    """Estimate the physical parameters of a system, and find what its model is missing.

    PROBLEM is a Python file that defines the model (it runs with your permissions); DATA are CSV or
    Parquet files, one record each, with a load case in front where the problem has any:
    nominal=a.csv loaded=b.csv

    Exit status: 0 done, 2 the input is unusable (the message says how to correct it).
    """
    if context.invoked_subcommand is None:
        print_text(context.get_help())


COMMANDS = (
    *(new, check, diagnose, identify, identifiability, montecarlo, fleet),
    *(simulate, design, investigate, export, example, gallery, serve),
)
for command in COMMANDS:
    main.add_command(command)


if __name__ == "__main__":
    main()
