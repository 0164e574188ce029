"""`casid serve`: it lists and shows reports, to this machine alone, and nothing else."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from casid.cli.report_server import report_server
from casid.errors import DataError
from tests.cli.test_main import casid, refused


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("motor-1", "room & sun"):
        (tmp_path / "reports" / name).mkdir(parents=True)
        (tmp_path / "reports" / name / "report.html").write_text(f"<p>{name}</p>")
        (tmp_path / "reports" / name / "diagnosis.json").write_text("{}")
    (tmp_path / "secret.txt").write_text("mine")
    (tmp_path / "reports" / "away").symlink_to(tmp_path)
    return tmp_path / "reports"


@pytest.fixture
def port(folder: Path) -> Iterator[int]:
    with report_server(folder) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        assert server.server_address[0] == "127.0.0.1"
        yield server.server_port
        server.shutdown()
        thread.join()


def ask(port: int, path: str, method: str = "GET", host: str = "127.0.0.1") -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request(method, path, headers={"Host": f"{host}:{port}"})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_reports_are_listed_and_shown(port: int) -> None:
    status, page = ask(port, "/")
    assert status == 200
    assert "motor-1" in page
    assert 'href="/room%20%26%20sun/report.html">room &amp; sun</a>' in page
    assert ask(port, "/motor-1/report.html") == (200, "<p>motor-1</p>")
    assert ask(port, "/room%20%26%20sun/report.html") == (200, "<p>room & sun</p>")
    assert ask(port, "/motor-1/report.html", "HEAD") == (200, "")


@pytest.mark.parametrize(
    "path",
    [
        *("/motor-1/diagnosis.json", "/../secret.txt", "/%2e%2e/secret.txt", "/away/secret.txt"),
        *("/motor-1", "//etc/passwd", "/motor-1/../../secret.txt"),
    ],
)
def test_nothing_else_is_served(port: int, path: str) -> None:
    assert ask(port, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_is_written(port: int, method: str) -> None:
    assert ask(port, "/motor-1/report.html", method)[0] == 501


def test_a_request_under_another_name_is_refused(port: int) -> None:
    """A page elsewhere whose name was made to point here may not read the reports."""
    assert ask(port, "/", host="evil.example")[0] == 403


def test_what_cannot_be_served_is_refused(
    tmp_path: Path, port: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    refused(casid("serve", str(tmp_path / "gone")), "holds no report.html")
    with pytest.raises(DataError, match="name another with --port"):
        report_server(folder, port)
