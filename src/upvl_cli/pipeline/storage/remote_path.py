"""Paths of objects: what is asked of a `pathlib.Path`, answered by an object store."""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager, nullcontext
from fnmatch import fnmatchcase
from pathlib import Path, PosixPath
from typing import IO, Any, Self

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo, bucket_of
from upvl_cli.pipeline.storage.connect import SCHEMES
from upvl_cli.pipeline.storage.file_cache import file_cache
from upvl_cli.pipeline.storage.lease import Lease
from upvl_cli.pipeline.storage.ranged_file import RangedFile

# Larger objects are read by ranges when they are opened; smaller ones are fetched whole, which is one request.
WHOLE_BYTES = 4 * 2**20
_BUFFER_BYTES = 256 * 2**10

Children = tuple[list[str], dict[str, ObjectInfo]]


class RemotePath(PosixPath):
    """The path of an object, or of a folder of objects: `s3://bucket/key`.

    Its parts are the scheme with a colon, the bucket, and those of the key, so it needs no state, and a process on any
    machine can use it. As text it is the address. Where a library wants the name of a file (`os.fspath`), the object
    is fetched into a local cache bounded in bytes. Objects are written whole by `runtime.atomic`.
    """

    __slots__ = ()

    def __str__(self) -> str:
        """Return the address."""
        scheme, *key = self.parts
        return f"{scheme}//{'/'.join(key)}"

    def __fspath__(self) -> str:
        """Return the path of a local copy of the object.

        Raises:
            FileNotFoundError: There is no such object.
        """
        return str(self._fetched(self._info()))

    def __repr__(self) -> str:
        """Return the address as the class shows it."""
        return f"{type(self).__name__}({str(self)!r})"

    @property
    def bucket(self) -> Bucket:
        """The bucket of the object."""
        return bucket_of(self.parts[0].removesuffix(":"), self.parts[1])

    @property
    def key(self) -> str:
        """The key of the object in its bucket."""
        return "/".join(self.resolve().parts[2:])

    @property
    def version(self) -> str:
        """What changes whenever the content does.

        Raises:
            FileNotFoundError: There is no such object.
        """
        return self._info().version

    def look(self) -> ObjectInfo | None:
        """Return what the store says of the object now; None where there is none."""
        return self.bucket.head(self.key) if self.key else None

    def children(self) -> Children:
        """Return the names of the folders and the objects directly below, as the store has them now."""
        return self.bucket.children(f"{self.key}/" if self.key else "")

    def entries(self) -> list[tuple[str, bool]]:
        """Return the names of what is directly below, sorted, each with whether it is a folder."""
        folders, objects = self.children()
        return sorted([(name, True) for name in folders] + [(name, False) for name in objects])

    def exists(self, **_: Any) -> bool:
        """Whether there is such an object, or any below."""
        return self.is_file() or self.is_dir()

    def is_file(self, **_: Any) -> bool:
        """Whether there is such an object."""
        return self.look() is not None

    def is_dir(self, **_: Any) -> bool:
        """Whether there is any object below."""
        return self.bucket.has_below(f"{self.key}/" if self.key else "")

    def is_symlink(self) -> bool:
        """Whether it is a link: object stores have none."""
        return False

    def is_absolute(self) -> bool:
        """Whether it means the same wherever a process runs: always."""
        return True

    def absolute(self) -> Self:
        """Return the path itself."""
        return self

    def resolve(self, strict: bool = False) -> Self:
        """Return the path without `..`; none leads out of the bucket."""
        if ".." not in self.parts:
            return self
        kept: list[str] = []
        for part in self.parts[2:]:
            kept = kept[:-1] if part == ".." else [*kept, part]
        return type(self)(*self.parts[:2], *kept)

    def expanduser(self) -> Self:
        """Return the path itself."""
        return self

    def samefile(self, other_path: Any) -> bool:
        """Whether another path is the same."""
        return bool(self == other_path)

    def stat(self, **_: Any) -> os.stat_result:
        """Return size and time of the object, as a file has them.

        Raises:
            FileNotFoundError: There is no such object, nor any below.
        """
        info = self.look()
        if info is None and not self.is_dir():
            raise self._missing()
        mode = stat.S_IFREG | 0o600 if info else stat.S_IFDIR | 0o700
        size, time_s = (info.size, info.modified_s) if info else (0, 0.0)
        seconds, nanoseconds = int(time_s), int(time_s * 1e9)
        return os.stat_result((mode, 0, 0, 1, 0, 0, size, *[seconds] * 3, *[time_s] * 3, *[nanoseconds] * 3))

    def open(self, mode: str = "r", buffering: int = -1, *arguments: Any, **names: Any) -> Any:
        """Open the object for reading.

        Raises:
            FileNotFoundError: There is no such object.
        """
        if mode not in ("r", "rb", "rt"):
            raise NotImplementedError(f"{self} is written whole, by runtime.atomic")
        if "b" in mode:
            return self._opened(buffering)
        encoding: Any = arguments[0] if arguments else names.get("encoding")
        return io.TextIOWrapper(self._opened(), encoding=encoding, errors=names.get("errors"))

    def read_bytes(self) -> bytes:
        """Return the object."""
        with self._opened() as file:
            return file.read()

    def iterdir(self) -> Generator[Self, None, None]:
        """Yield what is directly below, sorted."""
        for name, _ in self.entries():
            yield self / name

    def glob(self, pattern: str, **options: Any) -> Generator[Self, None, None]:
        """Yield what is below and is like a pattern, sorted; `**` stands for any folders."""
        first, _, rest = pattern.partition("/")
        if first == "**":
            yield from self.rglob(rest or "*")
            return
        for name, is_folder in self.entries():
            if not fnmatchcase(name, first) or (name.startswith(".") and not first.startswith(".")):
                continue
            if not rest:
                yield self / name
            elif is_folder:
                yield from (self / name).glob(rest)

    def rglob(self, pattern: str, **_: Any) -> Generator[Self, None, None]:
        """Yield all objects below, at any depth, whose path from there ends like a pattern."""
        prefix = f"{self.key}/" if self.key else ""
        for key in self.bucket.keys(prefix):
            path = self / key.removeprefix(prefix)
            if path.match(pattern):
                yield path

    def unlink(self, missing_ok: bool = False) -> None:
        """Delete the object.

        Raises:
            FileNotFoundError: There is none.
        """
        if not missing_ok and not self.is_file():
            raise self._missing()
        self.bucket.delete(self.key)

    def mkdir(self, *_: Any, **__: Any) -> None:
        """Do nothing: folders are there as soon as an object is."""

    @contextmanager
    def write_whole(self, *, one_writer: bool) -> Iterator[IO[bytes]]:
        """Open a local file that becomes the object when the block ends well.

        Args:
            one_writer: Whether other processes that want to write it wait until this one is done.
        """
        lease = Lease(self.bucket, self._lease.key) if one_writer else nullcontext()
        with lease, file_cache().part(self.name) as file:
            yield file
            file.flush()
            part = Path(file.name)
            version = self.bucket.put(self.key, part)
            file_cache().adopt(part, str(self), version)

    def remove_lease(self) -> None:
        """Remove the lease of an object that needs no writer any more, which a killed one has left."""
        if self._lease.is_file():
            self._lease.unlink()

    @property
    def _lease(self) -> RemotePath:
        return self.with_name(f".{self.name}.lease")

    def _info(self) -> ObjectInfo:
        info = self.look()
        if info is None:
            raise self._missing()
        return info

    def _missing(self) -> FileNotFoundError:
        return FileNotFoundError(errno.ENOENT, "no such object", str(self))

    def _opened(self, buffering: int = -1) -> IO[bytes]:
        info = self._info()
        held = file_cache().held(str(self), info.version)
        if held is None and info.size > WHOLE_BYTES:
            file: Any = self._ranged(info)
            return file if buffering == 0 else io.BufferedReader(file, _BUFFER_BYTES)
        return open(held or self._fetched(info), "rb", buffering=buffering)

    def _ranged(self, info: ObjectInfo) -> io.RawIOBase:
        return RangedFile(self.bucket, self.key, info)

    def _fetched(self, info: ObjectInfo) -> Path:
        held = file_cache().held(str(self), info.version)
        return held or file_cache().add(str(self), lambda file: self.bucket.download(self.key, file).version)


def is_remote(path: Path) -> bool:
    """Whether a path is of an object store."""
    return isinstance(path, RemotePath)


def has_scheme(text: str) -> bool:
    """Whether a text begins like the address of an object."""
    return text.partition(":/")[0] in SCHEMES and ":/" in text
