"""A real S3-compatible server in a process of its own, and a proxy before it that injects faults."""

from __future__ import annotations

import http.client
import os
import random
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from upvl_cli.pipeline.storage import connect, file_cache, folder_listings, read_ahead

SECRET = "Qf7unmistakable9secret4of1the2tests"
KEY = "AKIAUNMISTAKABLEKEY"


@dataclass(frozen=True)
class Server:
    """A running server.

    Attributes:
        port: Where it listens, on this machine alone.
        variables: The environment of a process that uses it.
    """

    port: int
    variables: dict[str, str]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def variables_of(port: int) -> dict[str, str]:
    return {
        "AWS_ACCESS_KEY_ID": KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
    }


@contextmanager
def s3_server(*buckets: str) -> Iterator[Server]:
    """Run moto's server with some buckets."""
    import boto3

    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        _wait_until_open(port, process)
        client = boto3.client(
            "s3", endpoint_url=f"http://127.0.0.1:{port}", region_name="us-east-1",
            aws_access_key_id=KEY, aws_secret_access_key=SECRET,
        )  # fmt: skip
        for bucket in buckets:
            client.create_bucket(Bucket=bucket)
        yield Server(port, variables_of(port))
    finally:
        process.kill()
        process.wait()


def _wait_until_open(port: int, process: subprocess.Popen[bytes]) -> None:
    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        assert process.poll() is None, "the server ended"
        time.sleep(0.1)
    raise AssertionError("the server does not answer")


def use_store(monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], cache: Path) -> None:
    """Make this process use a server, with an empty cache and new connections."""
    for name, value in {**variables, "UPVL_CACHE": str(cache)}.items():
        monkeypatch.setenv(name, value)
    connect.connect.cache_clear()
    file_cache.file_cache.cache_clear()
    folder_listings.listings.cache_clear()
    read_ahead.read_ahead.cache_clear()


def upload(folder: Path, address: str) -> None:
    """Copy a folder to an address of the store that this process uses."""
    import boto3

    client = boto3.client("s3", endpoint_url=os.environ["AWS_ENDPOINT_URL"])
    bucket, _, prefix = address.removeprefix("s3://").partition("/")
    with ThreadPoolExecutor(8) as pool:
        list(
            pool.map(
                lambda path: client.put_object(
                    Bucket=bucket, Key=f"{prefix}/{path.relative_to(folder)}", Body=path.read_bytes()
                ),
                (path for path in folder.rglob("*") if path.is_file()),
            )
        )


FAULTS = ("500", "503", "no answer", "cut request", "cut answer", "answer lost", "slow")


class FaultyProxy:
    """A proxy before a server that spoils some requests, in an order that a seed gives."""

    def __init__(self, server_port: int, *, seed: int, share: float, faults: Sequence[str] = FAULTS) -> None:
        self.port = free_port()
        self.injected: Counter[str] = Counter()
        self.requests: Counter[str] = Counter()  # by method; `LIST` is what lists objects
        self._server_port, self._share, self._faults = server_port, share, faults
        self._random, self._lock = random.Random(seed), threading.Lock()
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def handle_one_request(self) -> None:
                with suppress(ConnectionError, TimeoutError):
                    super().handle_one_request()

            def __getattr__(self, name: str) -> Any:
                if name.startswith("do_"):
                    return lambda: proxy.serve(self)
                raise AttributeError(name)

            def log_message(self, *_: object) -> None:
                pass

        self._listener = ThreadingHTTPServer(("127.0.0.1", self.port), Handler)
        self._listener.daemon_threads = True
        threading.Thread(target=self._listener.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._listener.shutdown()
        self._listener.server_close()

    def _choose(self) -> str:
        with self._lock:
            if self._random.random() >= self._share:
                return ""
            fault = self._random.choice(list(self._faults))
            self.injected[fault] += 1
            return fault

    def serve(self, request: BaseHTTPRequestHandler) -> None:
        """Pass a request on, or spoil it."""
        fault = self._choose()
        with self._lock:
            self.requests["LIST" if "list-type=" in request.path else request.command] += 1
        length = int(request.headers.get("Content-Length") or 0)
        request.close_connection = bool(fault)
        if fault == "cut request":
            request.rfile.read(length // 2)
            request.connection.shutdown(socket.SHUT_RDWR)
            return
        body = request.rfile.read(length)
        if fault in ("500", "503"):
            _answer(request, int(fault), [], "0")
        elif fault == "no answer":
            time.sleep(3)
        else:
            self._pass_on(request, body, fault)

    def _pass_on(self, request: BaseHTTPRequestHandler, body: bytes, fault: str) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", self._server_port, timeout=60)
        # The name of the server is part of what is signed: it stays that of the proxy.
        connection.putrequest(request.command, request.path, skip_host=True, skip_accept_encoding=True)
        for name, value in request.headers.items():
            connection.putheader(name, value)
        connection.endheaders(body)
        answer = connection.getresponse()
        content = answer.read()
        if fault == "answer lost":
            request.connection.shutdown(socket.SHUT_RDWR)
            return
        size = answer.getheader("Content-Length") if request.command == "HEAD" else str(len(content))
        _answer(request, answer.status, answer.getheaders(), size or "0")
        if fault == "cut answer":
            request.wfile.write(content[: len(content) // 2])
            request.connection.shutdown(socket.SHUT_RDWR)
            return
        step = max(len(content) // 5, 1) if fault == "slow" else max(len(content), 1)
        for begin in range(0, len(content), step):
            request.wfile.write(content[begin : begin + step])
            time.sleep(0.05 if fault == "slow" else 0)


def _answer(
    request: BaseHTTPRequestHandler, status: int, headers: Sequence[tuple[str, str]], size: str
) -> None:
    request.send_response(status)
    for name, value in headers:
        if name.lower() not in ("transfer-encoding", "connection", "content-length", "date", "server"):
            request.send_header(name, value)
    request.send_header("Content-Length", size)
    request.end_headers()
