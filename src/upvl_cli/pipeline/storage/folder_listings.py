"""What a store said of folders that do not change while a process runs; each is listed once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo

_MAX_ENTRIES = 1_000_000  # names and versions that are held: some 300 bytes each
_LISTED_AT_A_TIME = 16  # folders; a request waits for the store nearly all of its time
_LOCKS = 64

Place = tuple[str, str, str]  # scheme, bucket, and prefix, which ends with a slash or is empty


@dataclass(frozen=True, eq=False)
class FolderListing:
    """What is directly below a prefix, or a part of it.

    Attributes:
        folders: Names of the folders.
        objects: What the store says of each object, by name; None for one that is known not to be there.
        is_whole: Whether nothing else is there.
    """

    folders: Sequence[str]
    objects: dict[str, ObjectInfo | None]
    is_whole: bool

    @cached_property
    def names(self) -> list[str]:
        """Names of the objects, sorted."""
        return sorted(name for name, info in self.objects.items() if info is not None)

    @property
    def entries(self) -> int:
        """How many names it holds."""
        return len(self.folders) + len(self.objects) + 1


class Listings:
    """The listings of a process, bounded in entries; what was not asked for longest goes first."""

    def __init__(self) -> None:
        self._held: OrderedDict[Place, FolderListing] = OrderedDict()
        self._entries = 0
        self._lock = threading.Lock()
        self._place_locks = [threading.Lock() for _ in range(_LOCKS)]

    def held(self, place: Place) -> FolderListing | None:
        """Return what is known of a folder, whole or in part; None where it was not listed yet."""
        with self._lock:
            found = self._held.get(place)
            if found is not None:
                self._held.move_to_end(place)
            return found

    def complete(self, bucket: Bucket, place: Place) -> FolderListing:
        """Return all that is directly below a folder; one request for a thousand names, where it is not known yet."""
        return self._once(place, lambda _: _list_all(bucket, place[2]), lambda known: known.is_whole)

    def some(self, bucket: Bucket, place: Place, names: Collection[str]) -> FolderListing:
        """Return a listing in which some objects of a folder are known, whether they are there or not.

        Of a folder of a million objects only those between the first and the last name are listed.
        """
        return self._once(
            place,
            lambda known: _list_some(bucket, place[2], names, known),
            lambda known: known.is_whole or all(name in known.objects for name in names),
        )

    def list_at_once(self, bucket: Bucket, places: Sequence[Place]) -> None:
        """List several folders, many at a time."""
        missing = [place for place in places if not (known := self.held(place)) or not known.is_whole]
        if len(missing) > 1:
            with ThreadPoolExecutor(min(_LISTED_AT_A_TIME, len(missing))) as pool:
                list(pool.map(lambda place: self.complete(bucket, place), missing))

    def _once(
        self,
        place: Place,
        list_it: Callable[[FolderListing | None], FolderListing],
        is_enough: Callable[[FolderListing], bool],
    ) -> FolderListing:
        with self._place_locks[hash(place) % _LOCKS]:
            known = self.held(place)
            if known is not None and is_enough(known):
                return known
            found = list_it(known)
            with self._lock:
                self._entries += found.entries - (known.entries if known and place in self._held else 0)
                self._held[place] = found
                self._held.move_to_end(place)
                while self._entries > _MAX_ENTRIES and len(self._held) > 1:
                    self._entries -= self._held.popitem(last=False)[1].entries
            return found


@cache
def listings() -> Listings:
    """Return the listings of this process."""
    return Listings()


def _list_all(bucket: Bucket, prefix: str) -> FolderListing:
    folders, objects = bucket.children(prefix)
    return FolderListing(folders, dict(objects), is_whole=True)


def _list_some(
    bucket: Bucket, prefix: str, names: Collection[str], known: FolderListing | None
) -> FolderListing:
    wanted = set(names)
    # The key after which the listing begins: without its last character the first name stands just before itself.
    first, last = min(wanted, key=str.encode), max(wanted, key=str.encode)
    found: dict[str, ObjectInfo | None] = dict(known.objects) if known else {}
    for name, info in bucket.objects_after(prefix, prefix + first[:-1]):
        if name.encode() > last.encode():
            break
        if "/" not in name:
            found[name] = info
    found.update({name: None for name in wanted if name not in found})
    return FolderListing((), found, is_whole=False)
