"""A small server that speaks the part of S3's protocol that upvl uses: objects in memory, and an archive by arithmetic.

    python bench/archive_server.py [--segments N --stages A,B,C --files FOLDER]

Prints its port and serves until it is killed. Objects that are put are kept in memory. With `--segments` the shards of
an archive are listed too: they have names, sizes and tags by arithmetic, and no content. Files of a folder stand below
`out/`. `GET /-/requests` returns how many requests of each kind were made, and starts the count anew.
"""

from __future__ import annotations

import argparse
import bisect
import hashlib
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import takewhile
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

PAGE = 1000
TIME = "2026-11-27T00:00:00.000Z"
HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?><ListBucketResult xmlns="http://s3.amazonaws.com/doc/2006-03-01/">'
)
CONTENTS = (
    f"<Contents><Key>{{}}</Key><LastModified>{TIME}</LastModified>"
    '<ETag>"{}"</ETag><Size>{}</Size></Contents>'
)


def segment_name(number: int) -> str:
    """Return the name of a drive of the archive."""
    return f"seg-{number:07d}"


def is_there(stage: int, number: int, segments: int) -> bool:
    """Whether the archive has a shard: one drive in fifty is new, and one label in a thousand is missing."""
    return number < segments - segments // 50 and (stage % 16 != 13 or number % 1009 != 7)


def tag_of(stage: int, number: int) -> str:
    """Return the entity tag of a shard of the archive."""
    return f"{stage:016x}{number:016x}"


def size_of(stage: int, number: int) -> int:
    """Return the size of a shard of the archive, in bytes."""
    return 20_000 + 1000 * stage + number % 1000


@dataclass
class Store:
    """What is served.

    Attributes:
        segments: Number of drives of the archive.
        stages: Names of its stages.
        objects: Content and tag of each object that was put.
        keys: Their keys, sorted.
        requests: How many requests of each kind were made.
    """

    segments: int = 0
    stages: tuple[str, ...] = ()
    objects: dict[str, tuple[bytes, str]] = field(default_factory=dict)
    keys: list[str] = field(default_factory=list)
    requests: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def put(self, key: str, content: bytes) -> str:
        """Keep an object, and return its tag."""
        tag = hashlib.md5(content, usedforsecurity=False).hexdigest()
        with self.lock:
            if key not in self.objects:
                if self.keys and key < self.keys[-1]:
                    bisect.insort(self.keys, key)
                else:
                    self.keys.append(key)
            self.objects[key] = content, tag
        return tag

    def delete(self, key: str) -> None:
        """Forget an object."""
        with self.lock:
            if self.objects.pop(key, None):
                del self.keys[bisect.bisect_left(self.keys, key)]

    def page(self, prefix: str, key: str, most: int) -> tuple[list[str], str]:
        """Return a page of what is below a prefix and behind a key.

        Args:
            prefix: Of all keys.
            key: The last one before the page.
            most: Number of objects at most.

        Returns:
            The objects as XML, and the last key where there are more behind it.
        """
        stage = prefix.removeprefix("out/").rstrip("/")
        if stage in self.stages and prefix.endswith("/"):
            return self._archive_page(self.stages.index(stage), prefix, key, most)
        place = (
            bisect.bisect_right(self.keys, key) if key >= prefix else bisect.bisect_left(self.keys, prefix)
        )
        keys = list(takewhile(lambda name: name.startswith(prefix), self.keys[place : place + most + 1]))
        shown = keys[:most]
        contents = [
            CONTENTS.format(escape(name), self.objects[name][1], len(self.objects[name][0])) for name in shown
        ]
        return contents, shown[-1] if len(keys) > most else ""

    def _archive_page(self, stage: int, prefix: str, key: str, most: int) -> tuple[list[str], str]:
        first = int(key[len(prefix) + 4 :].removesuffix(".parquet")) + 1 if key > prefix else 0
        numbers = range(first, min(first + most, self.segments))
        # Written out, as a page is asked for seventeen thousand times: `tag_of`, `size_of` and `segment_name`.
        size = size_of(stage, 0)
        contents = [
            f"<Contents><Key>{prefix}seg-{number:07d}.parquet</Key><LastModified>{TIME}</LastModified><ETag>"
            f'"{stage:016x}{number:016x}"</ETag><Size>{size + number % 1000}</Size></Contents>'
            for number in numbers
            if is_there(stage, number, self.segments)
        ]
        last = numbers[-1] if numbers else self.segments
        more = last + 1 < self.segments and is_there(0, last + 1, self.segments)
        return contents, f"{prefix}{segment_name(last)}.parquet" if more else ""


class Handler(BaseHTTPRequestHandler):
    """Answers one connection."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    store: Store

    def log_message(self, format: str, *arguments: object) -> None:
        """Write no log."""

    def _parts(self) -> tuple[str, dict[str, str]]:
        split = urlsplit(self.path)
        _, _, key = unquote(split.path).lstrip("/").partition("/")
        return key, {
            name: values[0] for name, values in parse_qs(split.query, keep_blank_values=True).items()
        }

    def _answer(self, status: int, content: bytes = b"", **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        if "Content_Length" not in headers:
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def do_GET(self) -> None:
        """Return an object, a range of one, or a page of a listing."""
        key, query = self._parts()
        if self.path == "/-/requests":
            text = " ".join(f"{name} {count}" for name, count in sorted(self.store.requests.items()))
            self.store.requests.clear()
            self._answer(200, text.encode())
        elif not key or "list-type" in query:
            self.store.requests["list"] += 1
            self._answer(200, self._page(query).encode(), Content_Type="application/xml")
        elif key not in self.store.objects:
            self.store.requests["get"] += 1
            self._answer(404, b"<Error><Code>NoSuchKey</Code></Error>")
        else:
            self.store.requests["get"] += 1
            self._object(*self.store.objects[key])

    def _object(self, content: bytes, tag: str) -> None:
        wanted = self.headers.get("If-Match", f'"{tag}"').strip('"')
        if wanted != tag:
            self._answer(412)
            return
        headers = {"ETag": f'"{tag}"', "Last_Modified": "Fri, 27 Nov 2026 00:00:00 GMT"}
        asked = self.headers.get("Range")
        if asked is None:
            self._answer(200, content, **headers)
            return
        start, _, end = asked.removeprefix("bytes=").partition("-")
        first = int(start) if start else max(0, len(content) - int(end))
        last = min(int(end), len(content) - 1) if start and end else len(content) - 1
        part = content[first : last + 1]
        self._answer(206, part, Content_Range=f"bytes {first}-{last}/{len(content)}", **headers)

    def _page(self, query: dict[str, str]) -> str:
        prefix = query.get("prefix", "")
        after = query.get("continuation-token") or query.get("start-after", "")
        most = min(int(query.get("max-keys", PAGE)), PAGE)
        if query.get("delimiter"):
            return self._folders(prefix)
        contents, last = self.store.page(prefix, after, most)
        token = f"<NextContinuationToken>{escape(last)}</NextContinuationToken>" if last else ""
        return (
            f"{HEAD}<Prefix>{escape(prefix)}</Prefix><KeyCount>{len(contents)}</KeyCount>"
            f"<IsTruncated>{'true' if last else 'false'}</IsTruncated>{token}{''.join(contents)}</ListBucketResult>"
        )

    def _folders(self, prefix: str) -> str:
        """Return the page of what is directly below a prefix; folders of the archive itself are left out."""
        folders, contents = set(), []
        for key in [key for key in self.store.keys if key.startswith(prefix)]:
            name, slash, _ = key[len(prefix) :].partition("/")
            if slash:
                folders.add(f"{prefix}{name}/")
            else:
                content, tag = self.store.objects[key]
                contents.append(
                    f"<Contents><Key>{escape(key)}</Key><LastModified>{TIME}</LastModified>"
                    f'<ETag>"{tag}"</ETag><Size>{len(content)}</Size></Contents>'
                )
        below = "".join(
            f"<CommonPrefixes><Prefix>{escape(name)}</Prefix></CommonPrefixes>" for name in sorted(folders)
        )
        return f"{HEAD}<IsTruncated>false</IsTruncated>{''.join(contents)}{below}</ListBucketResult>"

    def do_HEAD(self) -> None:
        """Say what an object is."""
        self.store.requests["head"] += 1
        found = self.store.objects.get(self._parts()[0])
        if found is None:
            self._answer(404)
            return
        modified = "Fri, 27 Nov 2026 00:00:00 GMT"
        self._answer(200, ETag=f'"{found[1]}"', Content_Length=str(len(found[0])), Last_Modified=modified)

    def do_PUT(self) -> None:
        """Keep an object."""
        self.store.requests["put"] += 1
        key, _ = self._parts()
        content = self.rfile.read(int(self.headers["Content-Length"]))
        if self.headers.get("If-None-Match") == "*" and key in self.store.objects:
            self._answer(412)
            return
        self._answer(200, ETag=f'"{self.store.put(key, content)}"')

    def do_DELETE(self) -> None:
        """Forget an object."""
        self.store.requests["delete"] += 1
        self.store.delete(self._parts()[0])
        self._answer(204)


def serve(store: Store, ready: Callable[[int], object]) -> None:
    """Serve until the process ends.

    Args:
        store: What is served.
        ready: Called with the port.
    """
    handler = type("StoreHandler", (Handler,), {"store": store})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    ready(server.server_port)
    server.serve_forever()


def main() -> None:
    """Serve what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--segments", type=int, default=0)
    parser.add_argument("--stages", default="")
    parser.add_argument("--files", type=Path)
    options = parser.parse_args()
    store = Store(options.segments, tuple(filter(None, options.stages.split(","))))
    for path in sorted(options.files.rglob("*")) if options.files else ():
        if path.is_file():
            store.put(f"out/{path.relative_to(options.files).as_posix()}", path.read_bytes())
    serve(store, lambda port: print(port, flush=True))


if __name__ == "__main__":
    main()
