"""Requests that nobody asks by accident: a fixed list."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import httpx

TRAVERSALS = [
    "../",
    "..%2f",
    "%2e%2e/",
    "%2e%2e%2f",
    "..%5c",
    "..\\",
    "%252e%252e%252f",
    "..%c0%af",
    "%c0%ae%c0%ae/",
    "....//",
    "..;/",
    "%00",
    "%0a",
    "//",
    "/./",
    "~/",
    "%2f",
    "\\\\",
]
TARGETS = ["etc/passwd", "secret.txt", "stages/query.toml", "out/pca/all.parquet"]
PLACES = ["/", "/static/", "/hit/labels/", "/save/"]
WORDS = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' OR 1=1 --",
    "'; DROP TABLE hits; --",
    "{{7*7}}",
    "${7*7}",
    "{% include '/etc/passwd' %}",
    "../../etc/passwd",
    "file:///etc/passwd",
    "$(id)",
    "`id`",
    "| cat /etc/passwd",
    "%s%s%s%n",
    "=cmd|' /C calc'!A0",
    "\u202etxt",
    "\ud7ff\uffff",
    "\U0001f697",
    "ʼ",
    "javascript:alert(1)",
    "a" * 79,
    "onload=alert(1)",
    '<!--#exec cmd="id"-->',
    "<svg/onload=alert(1)>",
    "&lt;script&gt;",
    "\u0000".strip("\0") + "null",
]
NUMBERS = [
    "nan",
    "inf",
    "-inf",
    "-1",
    "1e999",
    "1e-999x",
    "0x10",
    "1_000",
    "١٢",
    "--1",
    "1;2",
    "[]",
    "NULL",
    "9" * 400,
]
FIELDS = ["min_speed", "max_speed", "max_range", "from", "to", "min_score", "within", "stand", "threshold"]
METHODS = [
    "POST",
    "PUT",
    "DELETE",
    "PATCH",
    "OPTIONS",
    "TRACE",
    "CONNECT",
    "PROPFIND",
    "BREW",
    "get",
    "G\x00T",
]
PATHS = [
    "/hit/labels/street-0/0/99",
    "/hit/labels/street-0/99/0",
    "/hit/labels/no-drive/0/0",
    "/hit/lables/street-0/0/0",
    "/hit/labels/street-0/-1/0",
    "/hit/labels/street-0/0/1e3",
    "/hit/labels/street-0/99999999999999999999999/0",
    "/hit/labels/street-0/0/4294967296",
    "/hit/labels/street-0/" + "9" * 900 + "/0",
    "/above/labels/street-0/0/99",
    "/crop/labels/street-0/99/0",
    "/camera/labels/street-0/0/99",
    "/camera/labels/street-0/99/0",
    "/camera/detections/street-0/0/0",
    "/api/boxes/labels/none/0",
    "/api/boxes/labels/street-0/0?track=x",
    "/api/boxes/labels/street-0/0?track=" + "9" * 500,
    "/api/points/labels/street-0/77",
    "/api/points/labels/gone/0",
    "/api/track/labels/street-0/99999",
    "/api/track/labels/none/1",
    "/static/",
    "/static/page.py",
    "/static/none.css",
    "/save/hits.exe?q=car",
    "/save/hits.csv?q=",
    "/admin",
    "/.git/config",
    "/.env",
    "/wp-login.php",
    "/server-status",
    "/docs",
    "/openapi.json",
    "/%",
    "/%zz",
    "/%u0041",
    "/a" * 600,
    "/" + "a" * 5000,
]
HEADERS = [
    "Host: evil.example",
    "Host: 127.0.0.1.evil.example",
    "Host: ",
    "Host: 127.0.0.1:99999999",
    "Host: a@127.0.0.1",
    "Host: 127.0.0.1\r\nHost: evil.example",
    "Host: [::1",
    "Host: 0.0.0.0",
    "Host: 169.254.169.254",
    "Host: 127.0.0.1\r\nContent-Length: 5\r\n\r\nhello",
    "Host: 127.0.0.1\r\nContent-Length: 99999999999999",
    "Host: 127.0.0.1\r\nContent-Length: -1",
    "Host: 127.0.0.1\r\nContent-Length: x",
    "Host: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n",
    "Host: 127.0.0.1\r\nTransfer-Encoding: gzip",
    "Host: 127.0.0.1\r\nContent-Length: 4\r\nTransfer-Encoding: chunked",
    "Host: 127.0.0.1\r\nX: " + "a" * 70_000,
    "Host: 127.0.0.1\r\n" + "\r\n".join(f"X-{n}: {'b' * 90}" for n in range(400)),
    "Host: 127.0.0.1\r\nX\x00Y: 1",
    "Host: 127.0.0.1\r\n bad: folded",
    "Host: 127.0.0.1\r\nno-colon",
    "X: no host at all",
]
LINES = [
    b"GET\r\n\r\n",
    b"\r\n\r\n\r\n",
    b"GET / HTTP/1.1 x\r\nHost: a\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    b"\x00" * 100,
    b"SSH-2.0-x\r\n\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    b"GET \xff\xfe HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET * HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /" + b"a" * 40_000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
]
QUERIES = [
    "q=%ff%fe",
    "q=%c0%af",
    "q=%ed%a0%80",
    "q=a%00b",
    "q=%0d%0aSet-Cookie:x=1",
    "q=" + "a" * 4200,
    "q=" + ",".join(f"w{n}" for n in range(800)),
    "&".join(f"x{n}=1" for n in range(500)),
    "page=0",
    "page=99999999999",
    "page=-1",
    "candidates=1e9",
    "like=a:b:c",
    "like=street-0:0:99",
    "like=../../x:0:0",
    "like=none:0:0",
    "relation=near",
    "relation=drop",
    "class=<b>",
    "source=../../etc",
    "unknown=1",
    "q=car&q=car",
    "q=car&at=x",
    "%00=1",
    "token=x&token=y",
    "q=" + "%25" * 900,
    "q=car&other=" + "x" * 100 + "&relation=near",
    "anyway=2",
    "motion=sideways",
    "q=" + "%F0%9F%9A%97" * 120,
]


def hostile_requests() -> Iterator[tuple[bytes, bool]]:
    """Yield raw requests, and whether a page may answer them: words are only words, whatever they look like."""
    yield from (
        (_get(address), False) for address in [*_outside(), *_numbers(), *(f"/?{query}" for query in QUERIES)]
    )
    for word in WORDS:
        quoted = str(httpx.QueryParams({"q": word}))[2:]
        yield _get(f"/?q={quoted}"), True
        yield _get(f"/?q={quoted}&anyway=1"), True
        yield _get(f"/?q=car&drive={quoted}"), False
        yield _get(f"/save/hits.csv?q=car&source={quoted}"), False
    yield from ((_get(path), path == "/save/hits.csv?q=") for path in PATHS)
    for method in METHODS:
        yield f"{method} / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode(), False
    for headers in HEADERS:
        yield f"GET / HTTP/1.1\r\nConnection: close\r\n{headers}\r\n\r\n".encode(), False
    for line in LINES:
        yield line, False


def _get(address: str) -> bytes:
    return f"GET {address} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode(
        "utf-8", "replace"
    )


def _outside() -> Iterator[str]:
    for place, traversal, target in product(PLACES, TRAVERSALS, TARGETS):
        yield place + traversal * 3 + target


def _numbers() -> Iterator[str]:
    for field, number in [*product(FIELDS[:6], NUMBERS), *((field, "nan") for field in FIELDS[6:])]:
        yield f"/?q=car&{field}={str(httpx.QueryParams({'v': number}))[2:]}"
