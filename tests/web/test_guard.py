"""Who may ask, and how: host, token, method, body, and the headers of every answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.testclient import TestClient

from upvl_cli.errors import BadSetting
from upvl_cli.web.guard import COOKIE, Access
from upvl_cli.web.server import ServeOptions, serve
from web.small_site import client, workspace

TOKEN = "a-token-of-more-than-16"
OPEN = Access(frozenset({"my-machine"}), any_address=True, token=TOKEN)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    return client(workspace(tmp_path_factory.mktemp("guarded")))


@pytest.fixture
def guarded(tmp_path: Path) -> TestClient:
    return client(workspace(tmp_path), OPEN, "http://192.0.2.7:8700")


@pytest.mark.parametrize("host", ["127.0.0.1:8700", "localhost", "LOCALHOST:1", "[::1]:8700", "localhost."])
def test_the_own_machine_is_known(site: TestClient, host: str) -> None:
    assert site.get("/health", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "192.0.2.7:8700", "localhost:x", "", "a b", "localhost@evil"],
)
def test_another_host_is_refused(site: TestClient, host: str) -> None:
    """A name that somebody else rebinds to this machine does not open it."""
    answer = site.get("/", headers={"Host": host})
    assert answer.status_code == 421
    assert "unknown host" in answer.text


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND"])
def test_only_reading_is_answered(site: TestClient, method: str) -> None:
    answer = site.request(method, "/")
    assert answer.status_code == 405
    assert answer.headers["Allow"] == "GET, HEAD"


def test_a_head_has_no_body(site: TestClient) -> None:
    answer = site.head("/?q=bus")
    assert (answer.status_code, answer.content) == (200, b"")


@pytest.mark.parametrize(
    "path", ["/", "/?q=bus", "/nowhere", "/static/style.css", "/hit/labels/no/0/0", "/?page=x"]
)
def test_every_answer_has_the_headers(site: TestClient, path: str) -> None:
    headers = site.get(path).headers
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'self'")
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"


def test_a_body_is_refused(site: TestClient) -> None:
    assert site.request("GET", "/", content=b"x" * 10).status_code == 413


def test_a_token_opens_and_stays_in_a_cookie(guarded: TestClient) -> None:
    assert guarded.get("/").status_code == 403
    assert guarded.get("/static/style.css").status_code == 403
    assert guarded.get("/?token=wrong").status_code == 403
    first = guarded.get(f"/?q=bus&token={TOKEN}", follow_redirects=False)
    assert first.status_code == 303
    assert first.headers["Location"] == "/?q=bus"
    cookie = first.headers["Set-Cookie"]
    assert cookie.startswith(f"{COOKIE}={TOKEN};")
    assert "httponly" in cookie.lower()
    assert "samesite=strict" in cookie.lower()
    assert guarded.get("/").status_code == 200


def test_a_wrong_cookie_does_not_open(guarded: TestClient) -> None:
    for value in ("wrong", TOKEN[:-1], f"{TOKEN}x", "\xe9"):
        headers = {"Cookie": f"{COOKIE}={value}".encode("latin-1")}
        assert guarded.get("/", headers=headers).status_code == 403


def test_a_wrong_token_counts_more_than_a_right_cookie(guarded: TestClient) -> None:
    guarded.get(f"/?token={TOKEN}")
    assert guarded.get("/?token=other").status_code == 403


def test_a_rebound_name_is_refused_on_an_open_address(guarded: TestClient) -> None:
    guarded.get(f"/?token={TOKEN}")
    assert guarded.get("/", headers={"Host": "evil.example"}).status_code == 421
    assert guarded.get("/health", headers={"Host": "my-machine:8700"}).status_code in (200, 403)


@pytest.mark.parametrize("token", ["short", "with a space and long enough", "ünïcode-token-long-enough!"])
def test_a_token_is_long_and_plain(tmp_path: Path, token: str) -> None:
    with pytest.raises(BadSetting, match="--token has to be at least 16"):
        serve(workspace(tmp_path), ServeOptions(port=0, token=token), print)
