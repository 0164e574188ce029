"""`casid serve`."""

from __future__ import annotations

from pathlib import Path

import click

from casid.cli.terminal import say


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8765,
    show_default=True,
    help="Port of the page; 0 takes a free one.",
)
def serve(folder: Path, port: int) -> None:
    """List the reports in FOLDER on a local page, until it is interrupted (Ctrl-C).

    The page can be opened on this machine only (127.0.0.1), and cannot change anything.

    Example: casid serve reports
    """
    from casid.cli.report_server import report_server

    with report_server(folder, port) as server:
        say(
            f"http://127.0.0.1:{server.server_port}/ lists the reports in {folder}; end with Ctrl-C"
        )
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            say("ended")
