"""The objects of one bucket: few operations, each made again after a fault of the connection or of the store."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING, Any

from upvl_cli.errors import StorageError
from upvl_cli.pipeline.storage.connect import connect
from upvl_cli.pipeline.storage.faults import Conflict, Result, attempt

if TYPE_CHECKING:
    import pyarrow as pa

_PART_BYTES = 8 * 2**20
_STREAM_BYTES = 4 * 2**20


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """What a store says of an object.

    Attributes:
        size: Its bytes.
        version: Changes whenever its content does: the entity tag of the store.
        modified_s: Time of the last write, in seconds since 1970, by the clock of the store.
    """

    size: int
    version: str
    modified_s: float


class Bucket:
    """The objects of one bucket, by their keys."""

    def __init__(self, scheme: str, name: str) -> None:
        """Name the bucket; it is connected when the first object is asked for."""
        self._scheme, self._name = scheme, name

    def address(self, key: str) -> str:
        """Return the full address of an object."""
        return f"{self._scheme}://{self._name}/{key}"

    def _ask(self, doing: str, key: str, request: Callable[[ModuleType, Any], Result]) -> Result:
        """Return what a request gives, which is made again where that can help.

        Args:
            doing: As for `attempt`.
            key: What is asked for.
            request: Takes the library and its connection to the bucket.
        """
        store = connect(self._scheme, self._name)  # says so where the library is missing
        import obstore

        return attempt(lambda: request(obstore, store), self.address(key), doing)

    def head(self, key: str) -> ObjectInfo | None:
        """Return what the store says of an object; None where there is none."""
        try:
            return _info(self._ask("looked at", key, lambda obstore, store: obstore.head(store, key)))
        except FileNotFoundError:
            return None

    def read(self, key: str, start: int, size: int, version: str) -> bytes:
        """Return a range of an object.

        Args:
            key: The object.
            start: First byte.
            size: How many.
            version: The version that the range belongs to.

        Raises:
            FileNotFoundError: There is no such object.
            StorageError: The object has been replaced by another version meanwhile.
        """

        def once(obstore: ModuleType, store: Any) -> bytes:
            found = obstore.get(store, key, options={"range": (start, start + size), "if_match": version})
            return bytes(found.bytes())

        try:
            return self._ask("read", key, once)
        except Conflict:
            raise StorageError(f"{self.address(key)} was replaced while it was read; run again") from None

    def read_whole(self, key: str) -> tuple[bytes, str]:
        """Return a small object and its version.

        Raises:
            FileNotFoundError: There is no such object.
        """

        def once(obstore: ModuleType, store: Any) -> tuple[bytes, str]:
            found = obstore.get(store, key)
            return bytes(found.bytes()), str(found.meta["e_tag"])

        return self._ask("read", key, once)

    def download(self, key: str, file: IO[bytes]) -> ObjectInfo:
        """Write an object into a file, and return what it is.

        Raises:
            FileNotFoundError: There is no such object.
        """

        def once(obstore: ModuleType, store: Any) -> ObjectInfo:
            file.seek(0)
            file.truncate()
            found = obstore.get(store, key)
            for part in found.stream(min_chunk_size=_STREAM_BYTES):
                file.write(part)
            info = _info(found.meta)
            if file.tell() != info.size:
                raise OSError(f"{file.tell()} of {info.size} bytes arrived")
            return info

        return self._ask("read", key, once)

    def put(self, key: str, content: Path | bytes) -> str:
        """Write an object, whole or not at all, over one that is there; return its version."""
        found = self._ask(
            "written", key, lambda obstore, store: obstore.put(store, key, content, chunk_size=_PART_BYTES)
        )
        return str(found["e_tag"])

    def put_if(self, key: str, content: bytes, version: str | None) -> str:
        """Write a small object where none is there, or where the present one has that version; return the new version.

        Raises:
            Conflict: There is another one.
        """
        mode: Any = "create" if version is None else {"e_tag": version}
        try:
            found = self._ask(
                "written", key, lambda obstore, store: obstore.put(store, key, content, mode=mode)
            )
            return str(found["e_tag"])
        except FileNotFoundError:  # what was to be replaced is gone
            raise Conflict from None

    def delete(self, key: str) -> None:
        """Delete an object; none is deleted where none is there."""
        try:
            self._ask("deleted", key, lambda obstore, store: obstore.delete(store, key))
        except FileNotFoundError:
            return

    def children(self, prefix: str) -> tuple[list[str], dict[str, ObjectInfo]]:
        """Return the names of the folders and the objects directly below a prefix.

        Args:
            prefix: Ends with a slash, or is empty.
        """
        try:
            found = self._ask(
                "listed", prefix, lambda obstore, store: obstore.list_with_delimiter(store, prefix)
            )
        except FileNotFoundError:
            return [], {}
        folders = [str(path).rstrip("/").rpartition("/")[2] for path in found["common_prefixes"]]
        # An object whose key is the prefix itself marks the folder: consoles of stores write such.
        objects = {
            name: _info(item) for item in found["objects"] if (name := _name_below(prefix, str(item["path"])))
        }
        return folders, objects

    def has_below(self, prefix: str) -> bool:
        """Whether any object is below a prefix, which ends with a slash."""
        found = self._ask(
            "listed", prefix, lambda obstore, store: next(iter(obstore.list(store, prefix, chunk_size=1)), ())
        )
        return bool(found)

    def objects_after(self, prefix: str, after: str) -> Iterator[tuple[str, ObjectInfo]]:
        """Yield the objects below a prefix that come behind a key, in order, each by its key without the prefix.

        Args:
            prefix: Ends with a slash, or is empty.
            after: The key, which is left out itself.
        """
        for batch in self.batches(prefix, after, rows=1000):
            for item in batch.to_pylist():
                if name := _name_below(prefix, str(item["path"])):
                    yield name, _info(item)

    def keys(self, prefix: str) -> Iterator[str]:
        """Yield the keys of all objects below a prefix, in order."""
        for batch in self.batches(prefix):
            yield from (key for key in batch.column("path").to_pylist() if _name_below(prefix, key))

    def batches(self, prefix: str, after: str | None = None, rows: int = 5000) -> Iterator[pa.RecordBatch]:
        """Yield all objects below a prefix in order of their keys, a few thousand at a time.

        Args:
            prefix: Ends with a slash, or is empty.
            after: The key after which to begin; None begins with the first.
            rows: How many objects at a time; a request brings a thousand at most.

        Yields:
            Columns `path`, `last_modified`, `size`, `e_tag`.
        """
        import pyarrow as pa

        while True:
            # After a fault the listing goes on behind the last key that arrived.
            pages, page = self._ask("listed", prefix, partial(_first_page, prefix, after, rows))
            while page is not None:
                batch = pa.record_batch(page)
                if batch.num_rows:
                    yield batch
                    after = str(batch.column("path")[-1])
                try:
                    page = next(pages, None)
                except Exception:  # the stream is broken: a new one begins behind `after`
                    break
            else:
                return


@lru_cache(maxsize=64)
def bucket_of(scheme: str, name: str) -> Bucket:
    """Return the bucket of a scheme and a name."""
    return Bucket(scheme, name)


def _first_page(
    prefix: str, after: str | None, rows: int, obstore: ModuleType, store: Any
) -> tuple[Iterator[Any], Any]:
    """Return the pages of a listing behind a key, and the first of them; None where there is none."""
    pages = iter(obstore.list(store, prefix, offset=after, chunk_size=rows, return_arrow=True))
    return pages, next(pages, None)


def _name_below(prefix: str, key: str) -> str:
    """Return a key without a prefix; empty for the mark of the prefix itself, whose last slash the library drops."""
    return key.removeprefix(prefix) if key.startswith(prefix) else ""


def _info(found: Any) -> ObjectInfo:
    return ObjectInfo(int(found["size"]), str(found["e_tag"]), found["last_modified"].timestamp())
