"""A local, read-only server of the reports in a folder."""

from __future__ import annotations

import html
from datetime import datetime
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from casid.errors import DataError

_PAGE = "report.html"
_LOOPBACK = "127.0.0.1"
_STYLE = (
    ":root{color-scheme:light dark}body{font:16px/1.5 system-ui,sans-serif;max-width:60em;"
    "margin:2em auto;padding:0 16px}td,th{padding:4px 24px 4px 0;text-align:left}"
)


def reports_in(folder: Path) -> dict[str, Path]:
    """Address -> report of a folder and of those below it, the newest first.

    Raises
    ------
    DataError
        If there is none.
    """
    if folder.name == _PAGE:
        folder = folder.parent
    root = folder.resolve()
    found = [p for p in root.rglob(_PAGE) if p.is_file() and p.resolve().is_relative_to(root)]
    if not found:
        raise DataError(
            f"{folder} holds no {_PAGE}; name the folder that casid diagnose, identify or another "
            "command wrote to"
        )
    found.sort(key=lambda p: -p.stat().st_mtime)
    return {f"/{p.relative_to(root).as_posix()}": p for p in found}


def index_page(folder: Path) -> str:
    """The reports of a folder as a page of links."""
    rows = []
    for address, path in reports_in(folder).items():
        name = html.escape(address.strip("/").removesuffix(_PAGE).strip("/") or folder.name)
        when = datetime.fromtimestamp(path.stat().st_mtime).strftime("%Y-%m-%d %H:%M")
        rows.append(f'<tr><td><a href="{quote(address)}">{name}</a></td><td>{when}</td></tr>')
    title = f"Reports in {html.escape(folder.resolve().name)}"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body><main><h1>{title}</h1>"
        '<table><thead><tr><th scope="col">report</th><th scope="col">written</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></main></body></html>\n"
    )


def report_server(folder: Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of the reports of a folder, bound to 127.0.0.1; it answers GET and HEAD alone.

    Nothing but the list and the reports that it names is served, and only to requests that name
    this machine: a page elsewhere cannot read them by a name of its own for it.

    Raises
    ------
    DataError
        If the folder holds no report, or the port is taken.
    """
    reports_in(folder)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Send the list or a report."""
            self._answer(with_content=True)

        def do_HEAD(self) -> None:
            """Send its headers."""
            self._answer(with_content=False)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

        def _answer(self, *, with_content: bool) -> None:
            """Send the page at the address requested, to a browser on this machine alone."""
            host = (self.headers.get("Host") or "").rpartition(":")[0]
            if host not in (_LOOPBACK, "localhost"):
                self.send_error(HTTPStatus.FORBIDDEN)
                return
            content = _page_at(unquote(urlsplit(self.path).path), folder)
            if content is None:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            if with_content:
                self.wfile.write(content)

    try:
        return ThreadingHTTPServer((_LOOPBACK, port), Handler)
    except OSError as error:
        raise DataError(
            f"port {port} cannot be used ({error.strerror}); name another with --port, or 0 for a "
            "free one"
        ) from error


def _page_at(address: str, folder: Path) -> bytes | None:
    """The list of reports of a folder, or the report at an address; None where there is none."""
    try:
        if address == "/":
            return index_page(folder).encode("utf-8")
        path = reports_in(folder).get(address)
        return None if path is None else path.read_bytes()
    except (DataError, OSError):
        return None
