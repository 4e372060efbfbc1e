"""Paths of drives in an object store: they do not change while a process runs, and are read many times."""

from __future__ import annotations

import io
from bisect import bisect_left
from collections.abc import Collection, Generator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Self, cast

from upvl_cli.pipeline.storage.block_file import BlockFile
from upvl_cli.pipeline.storage.bucket import ObjectInfo
from upvl_cli.pipeline.storage.file_cache import file_cache
from upvl_cli.pipeline.storage.folder_listings import Place, listings
from upvl_cli.pipeline.storage.read_ahead import read_ahead
from upvl_cli.pipeline.storage.remote_path import WHOLE_BYTES, Children, RemotePath

SWEEP_BYTES = 64 * 2**20  # larger files are no sweep and no picture: of those only blocks are fetched
_FETCHED_AT_A_TIME = 8  # files of a folder that is copied


class DrivePath(RemotePath):
    """A path below the folder of a dataset.

    A folder is listed by one request for a thousand names, where each file would cost one. Files that are read in
    order are fetched before they are asked for. Of a large file blocks are fetched, which stay in the local cache.
    """

    __slots__ = ()

    def look(self) -> ObjectInfo | None:
        """Return what the listing of its folder says of the object; None where there is none."""
        if len(self.parts) < 3:
            return None
        known = listings().held(self.parent._place)
        if known is None or not (known.is_whole or self.name in known.objects):
            known = listings().complete(self.bucket, self.parent._place)
        return known.objects.get(self.name)

    def look_among(self, names: Collection[str]) -> None:
        """Ask the store for some objects of this folder at once, where it was not listed yet.

        Args:
            names: Names of objects, whether they are there or not.
        """
        if names:
            listings().some(self.bucket, self._place, names)

    def children(self) -> Children:
        """Return the names of the folders and the objects directly below, as they were when first asked for."""
        found = listings().complete(self.bucket, self._place)
        return list(found.folders), cast("dict[str, ObjectInfo]", found.objects)

    def is_dir(self, **_: Any) -> bool:
        """Whether there is any object below."""
        own = listings().held(self._place)
        if own is None and len(self.parts) > 2:
            above = listings().held(self.parent._place)
            if above is not None and above.is_whole:
                return self.name in above.folders
        folders, objects = self.children()
        return bool(folders or objects)

    def glob(self, pattern: str, **options: Any) -> Generator[Self, None, None]:
        """Yield what is below and is like a pattern, sorted; folders are listed many at a time."""
        first, _, rest = pattern.partition("/")
        if rest and "**" not in pattern:
            found = [path for path in super().glob(first) if path.is_dir()]
            listings().list_at_once(self.bucket, [path._place for path in found])
            for path in found:
                yield from path.glob(rest)
        else:
            yield from super().glob(pattern, **options)

    def list_at_once(self, names: Collection[str]) -> None:
        """List several folders of this one, many at a time."""
        listings().list_at_once(self.bucket, [(self / name)._place for name in names])

    def read_bytes(self) -> bytes:
        """Return the object."""
        info = self._info()
        if info.size > SWEEP_BYTES:
            return super().read_bytes()
        return self._fetched(info).read_bytes()

    def local_folder(self) -> Path:
        """Return a local folder of this machine that holds copies of all objects below this one.

        Raises:
            FileNotFoundError: There is none.
        """
        prefix = f"{self.key}/"
        names = [key.removeprefix(prefix) for key in self.bucket.keys(prefix)]
        places = {(self / name).parent._place for name in names}
        listings().list_at_once(self.bucket, sorted(places))
        names = [name for name in names if (self / name).is_file()]  # without the marks of folders
        if not names:
            raise self._missing()
        version = "\n".join(f"{name} {(self / name).version}" for name in names)

        def fetch(folder: Path, name: str) -> None:
            place = folder / name
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("wb") as file:
                self.bucket.download(prefix + name, file)

        def write(folder: Path) -> None:
            with ThreadPoolExecutor(_FETCHED_AT_A_TIME) as pool:
                list(pool.map(partial(fetch, folder), names))

        return file_cache().folder(str(self), version, write)

    @property
    def _place(self) -> Place:
        key = self.key
        return self.parts[0].removesuffix(":"), self.parts[1], f"{key}/" if key else ""

    def _ranged(self, info: ObjectInfo) -> io.RawIOBase:
        return BlockFile(self.bucket, self.key, info)

    def _fetched(self, info: ObjectInfo) -> Path:
        self._fetch_ahead()
        key = str(self.parent), self.name
        held = file_cache().held(str(self), info.version)
        return held or read_ahead().get(key, partial(super()._fetched, info))

    def _fetch_ahead(self) -> None:
        """Begin to fetch the files that follow in this folder, where its files are read in order."""
        listing = listings().held(self.parent._place)
        if listing is None:
            return
        names, ahead = listing.names, read_ahead()
        series, number = str(self.parent), bisect_left(names, self.name)
        for later in ahead.next_of(series, number):
            if later >= len(names):
                return
            path, info = self.with_name(names[later]), listing.objects[names[later]]
            if info is None or info.size > WHOLE_BYTES or path.suffix != self.suffix:
                return
            if file_cache().held(str(path), info.version) is None:
                ahead.begin((series, path.name), partial(super(DrivePath, path)._fetched, info))
