"""A digest of the content of files, computed again only where a file has been touched."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from upvl_cli.errors import BadInput
from upvl_cli.pipeline.storage.remote_path import RemotePath
from upvl_cli.runtime.atomic import write_if_changed


@dataclass(frozen=True)
class Fingerprint:
    """A digest of the content, and, as JSON, that digest with the state of the files on this disk."""

    digest: str
    cached: str


def fingerprint(files: Sequence[Path], cache_path: Path) -> Fingerprint:
    """Digest the content of files, or find by their state on disk that it is the one digested before.

    The state has the times of change that the system itself keeps, so a file that was written and given
    its old date again is noticed; the digest has none, so a drive that was copied is the same drive.

    Args:
        files: The files of a drive.
        cache_path: File of the digest and state of the last call.

    Raises:
        BadInput: A file is gone or cannot be read.
    """
    try:
        state = hashlib.sha256(repr([_state(path) for path in files]).encode("utf-8", "replace")).hexdigest()
        digest = _cached_digest(cache_path, state) or _digest(files)
    except OSError as error:
        raise BadInput(f"{error.filename} cannot be read: {error.strerror}; was the drive moved?") from error
    return Fingerprint(digest, json.dumps({"state": state, "digest": digest}, sort_keys=True))


def kept_digest(files: Sequence[Path], cache_path: Path) -> str:
    """Return the digest of the content of files, and keep it for the next call.

    Args:
        files: The files.
        cache_path: File of the digest and state of the last call; written where they have changed.

    Raises:
        BadInput: A file is gone or cannot be read.
    """
    found = fingerprint(files, cache_path)
    write_if_changed(cache_path, found.cached)
    return found.digest


def _state(path: Path) -> tuple[str, int, int, int] | tuple[str, str]:
    return (str(path), path.version) if isinstance(path, RemotePath) else _state_on_disk(path)


def _state_on_disk(path: Path) -> tuple[str, int, int, int]:
    found = path.stat()
    return os.path.abspath(path), found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _cached_digest(cache_path: Path, state: str) -> str:
    try:
        seen = json.loads(cache_path.read_bytes())
        return str(seen["digest"]) if seen["state"] == state else ""
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


def _digest(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        # The version of an object stands for its content, which would have to be fetched to be digested.
        if isinstance(path, RemotePath):
            digest.update(path.version.encode())
        else:
            digest.update(_content_digest(*_state_on_disk(path)))
        digest.update(path.name.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


@lru_cache(maxsize=1024)
def _content_digest(path: str, size: int, modified_ns: int, changed_ns: int) -> bytes:
    """Return the digest of a file in that state; drives that share a file, such as a table of scenes, read it once."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
