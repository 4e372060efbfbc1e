"""`upvl serve` whole: 500 hostile requests to a real server, what it prints, and how it ends."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from command import ENVIRONMENT, UPVL, fails, upvl
from web.hostile import LINES, hostile_requests
from web.small_site import workspace

SECRET = "root-of-the-machine"


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`upvl serve` in a workspace, and the line that it prints when it is ready."""
    process = subprocess.Popen(
        [UPVL, "serve", "--port", "0", *options], cwd=folder, env=ENVIRONMENT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


def ask(port: int, request: bytes) -> bytes:
    """All that a server answers until it closes the connection; what is no whole request may get nothing."""
    parts = []
    with (
        socket.create_connection(("127.0.0.1", port), timeout=1 if request in LINES else 30) as connection,
        suppress(ConnectionError, TimeoutError),
    ):
        connection.sendall(request)
        while part := connection.recv(2**16):
            parts.append(part)
    return b"".join(parts)


@pytest.mark.slow
def test_500_hostile_requests_get_clear_refusals(tmp_path: Path) -> None:
    folder = tmp_path / "workspace"
    folder.mkdir()
    workspace(folder)
    for place in (tmp_path, folder, folder / "out"):
        (place / "secret.txt").write_text(SECRET)
    requests = list(hostile_requests())
    assert len(requests) >= 500
    with serving(folder) as (process, line):
        found = re.fullmatch(r"out is shown at (http://127\.0\.0\.1:(\d+)/) \(Ctrl-C ends\)\n", line)
        assert found, line
        for request, may_be_answered in requests:
            answer = ask(int(found[2]), request)
            status = re.match(rb"HTTP/1\.1 (\d{3}) ", answer)
            shown = request[:120]
            if status is None:  # bytes that are no request at all
                assert not answer, shown
                assert request in LINES, shown
                continue
            code, (head, _, body) = int(status[1]), answer.partition(b"\r\n\r\n")
            assert 400 <= code < 500 or (may_be_answered and code == 200), (code, shown, body[:300])
            assert b"Set-Cookie" not in head, shown
            for leak in (SECRET.encode(), b"root:", b"Traceback", b"site-packages", str(tmp_path).encode()):
                assert leak not in body, shown
            is_page = b"text/html" in head
            assert not (is_page and re.search(rb"<(script>|img src=x|svg/onload|b>)", body)), shown
            assert b"49" not in body or b"7*7" not in request, shown
        assert httpx.get(f"{found[1]}?q=bus").status_code == 200
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=20)
        assert (process.returncode, out, error) == (0, "ended\n", "")


def test_another_address_needs_a_token(tmp_path: Path) -> None:
    workspace(tmp_path)
    with serving(tmp_path, "--host", "0.0.0.0") as (_, line):
        found = re.fullmatch(
            r"out is shown at http://[\w.-]+:(\d+)/\?token=([\w-]{30,}) \(Ctrl-C ends\)\n", line
        )
        assert found, line
        home = f"http://127.0.0.1:{found[1]}/"
        assert httpx.get(home).status_code == 403
        with httpx.Client(follow_redirects=True) as browser:
            assert browser.get(f"{home}?token={found[2]}").status_code == 200
            assert browser.get(f"{home}?q=bus").status_code == 200


def test_a_port_that_is_taken_is_one_line(tmp_path: Path) -> None:
    workspace(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        message = fails(tmp_path, "serve", "--port", str(taken.getsockname()[1]))
    assert "Address already in use; choose another with --host or --port" in message


def test_a_missing_package_is_one_line(tmp_path: Path) -> None:
    workspace(tmp_path)
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "uvicorn.py").write_text('raise ModuleNotFoundError("no uvicorn", name="uvicorn")\n')
    done = upvl(tmp_path, "serve", PYTHONPATH=f"{hidden}:{ENVIRONMENT['PYTHONPATH']}")
    assert done.returncode == 2
    assert done.stderr == "upvl: serve needs the package uvicorn; run: pip install 'upvl[serve]'\n"
