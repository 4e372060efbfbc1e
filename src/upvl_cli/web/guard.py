"""What every request passes first: method, host, token, size and form of the address; and headers of every answer."""

from __future__ import annotations

import hmac
import ipaddress
import re
from collections.abc import Iterable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "upvl_token"
MAX_PATH_BYTES = 1024
MAX_QUERY_BYTES = 8192
MAX_HEADER_BYTES = 2**14
# Of the addresses of pages: names of drives and cameras, numbers, dots and dashes; none needs a percent sign.
_SAFE_PATH = re.compile(rb"/[A-Za-z0-9_./@+-]*")
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
}


@dataclass(frozen=True)
class Access:
    """Who may ask.

    Attributes:
        hosts: Names by which the server is called; a request that calls it otherwise is refused (DNS rebinding).
        any_address: Whether every numeric address is one of them: such a name cannot be rebound.
        token: Secret that the first address has to hold; "" where none is needed.
    """

    hosts: frozenset[str]
    any_address: bool = False
    token: str = ""

    def knows_host(self, header: str) -> bool:
        """Return whether a Host header names this server."""
        match = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?", header)
        if match is None:
            return False
        name = match[1].lower().rstrip(".")
        if name in self.hosts:
            return True
        return self.any_address and is_numeric(name.strip("[]"))

    def accepts(self, token: str) -> bool:
        """Return whether a token is the right one, in a time that does not depend on where it differs."""
        return hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self.token.encode())


def is_numeric(name: str) -> bool:
    """Return whether a host is an IP address and no name."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Guard:
    """An ASGI application around another one, which sees only what passes."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        """Name the application and who may ask it."""
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] != "http":
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        answer = self._refusal(scope)
        await (answer or self._app)(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        """Return the answer to what does not pass; None for what does."""
        if scope["method"] not in ("GET", "HEAD"):
            return _refuse(405, "this server is read-only: it answers GET and HEAD", {"Allow": "GET, HEAD"})
        hosts = _values(scope, b"host")
        if len(hosts) != 1 or not self._access.knows_host(hosts[0]):
            return _refuse(421, "unknown host: call the server by the address that it printed")
        if any(value not in ("", "0") for value in _values(scope, b"content-length")) or _values(
            scope, b"transfer-encoding"
        ):
            return _refuse(413, "a question has no body")
        if sum(len(name) + len(value) for name, value in scope["headers"]) > MAX_HEADER_BYTES:
            return _refuse(431, "the headers are too long")
        path: bytes = scope.get("raw_path") or scope["path"].encode()
        path = path.partition(b"?")[0]
        if len(path) > MAX_PATH_BYTES or len(scope["query_string"]) > MAX_QUERY_BYTES:
            return _refuse(414, "the address is too long")
        if not _SAFE_PATH.fullmatch(path) or b".." in path or b"//" in path:
            return _refuse(400, "the address holds characters that no page of this server has")
        return self._without_token(scope) if self._access.token else None

    def _without_token(self, scope: Scope) -> Response | None:
        """Return the answer to a request without the token, and to the first with it; None with the right cookie."""
        try:
            fields = parse_qsl(
                scope["query_string"].decode("ascii"), keep_blank_values=True, max_num_fields=80
            )
        except ValueError:
            return _refuse(400, "the address cannot be read")
        tokens = [value for name, value in fields if name == "token"]
        if tokens and self._access.accepts(tokens[0]):
            rest = urlencode([(name, value) for name, value in fields if name != "token"])
            answer = RedirectResponse(scope["path"] + (f"?{rest}" if rest else ""), 303)
            answer.set_cookie(COOKIE, self._access.token, httponly=True, samesite="strict", path="/")
            return answer
        if not tokens and any(self._access.accepts(value) for value in _cookies(scope)):
            return None
        return _refuse(403, "open the address that the server printed, with its token")


def _cookies(scope: Scope) -> Iterable[str]:
    for header in _values(scope, b"cookie"):
        try:
            morsel = SimpleCookie(header).get(COOKIE)
        except CookieError:
            continue
        if morsel is not None:
            yield morsel.value


def _values(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key.lower() == name]


def _refuse(status: int, message: str, headers: dict[str, str] | None = None) -> Response:
    return PlainTextResponse(f"{message}\n", status, headers)
