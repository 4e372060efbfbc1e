"""One Parquet file a stage with an entry for each shard: a cache, which can be deleted at any time.

An entry counts only where its version is that of the listing; any other shard is opened and entered anew.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.catalog.entries import ENTRY, NOT_LISTED, Entries, Shard, read_entries
from upvl_cli.pipeline.catalog.hashing import Bools
from upvl_cli.pipeline.catalog.listing import Listing, list_shards
from upvl_cli.runtime.atomic import atomic_file

Places = npt.NDArray[np.int64]

FOLDER = "catalog"
_SEGMENT = "segment"
_BATCH = 4096  # shards that are opened before their entries are put into the array
LEAST_NEW = 100  # shards that are opened again rather than written down


@dataclass(frozen=True)
class Reading:
    """How footers that the catalogue does not know are read, and where their entries go.

    Attributes:
        part: Name of the file of a process that works beside others, which must not overwrite each other's
            entries; empty for the file of all.
        least_new: The catalogue is written once that many footers had to be read.
        tick: Called after each footer.
        lists: Whether folders are listed. If not, the catalogue is taken for true where there is one: what was made
            or deleted since it was written is not seen.
    """

    part: str = ""
    least_new: int = LEAST_NEW
    tick: Callable[[], None] = lambda: None
    lists: bool = True


class Segments:
    """The names of all segments, and where names of a stage stand among them."""

    def __init__(self, names: Sequence[str]) -> None:
        """Take the names in the order that all arrays have."""
        self.names = pa.array(names, pa.string())
        self._last: tuple[pa.Array, Places] | None = None  # most stages have the shards of the same drives

    def places(self, names: pa.Array) -> Places:
        """Return the place of each of m names; -1 for those that are none of the segments."""
        if self._last is None or not self._last[0].equals(names):
            self._last = names, _places(names, self.names)
        return self._last[1]


def stage_entries(out: Path, stage: str, segments: Segments, reading: Reading) -> Entries:
    """Return the (n,) entries of the shards of n segments; rows are `NOT_LISTED` where there is no shard.

    Args:
        out: Folder of the results.
        stage: Name of the stage.
        segments: The segments.
        reading: What to do about shards that the catalogue does not know.
    """
    parts = _parts(out, stage)
    found = np.zeros(len(segments.names), dtype=ENTRY)
    found["rows"] = NOT_LISTED
    tables = [] if reading.lists else [table for table in map(_read, parts) if table is not None]
    for names, entries in tables or [_listed(out, stage, segments, reading, parts)]:
        place = segments.places(names)
        found[place[place >= 0]] = entries[place >= 0]
    return found


def _listed(
    out: Path, stage: str, segments: Segments, reading: Reading, parts: Sequence[Path]
) -> tuple[pa.Array, Entries]:
    """Return the names of all shards of a stage and their entries; the catalogue is written where much is new."""
    listing = list_shards(out / stage, segments.names)
    entries = np.zeros(len(listing.segment), dtype=ENTRY)
    outdated = sum(_take(path, listing, entries) for path in parts)
    entries["size_bytes"] = listing.size_bytes
    unknown = np.flatnonzero((segments.places(listing.segment) >= 0) & (entries["version"] == 0))
    for start in range(0, len(unknown), _BATCH):
        _open(out / stage, listing, unknown[start : start + _BATCH], entries, reading.tick)
    if reading.part:
        if len(unknown) >= reading.least_new:
            _save(out, stage, listing, _only(entries, unknown), reading.part)
    elif len(unknown) + outdated >= reading.least_new and _save(out, stage, listing, entries, ""):
        for merged in parts[1:]:
            with contextlib.suppress(OSError):
                merged.unlink()
    return listing.segment, entries


def _places(names: pa.Array, among: pa.Array) -> Places:
    """Return the place of each name among others; -1 where it is none of them."""
    if names.equals(among):
        return np.arange(len(names), dtype=np.int64)
    found: pa.Array = pc.index_in(names, value_set=among)
    return np.asarray(found.cast(pa.int64()).fill_null(-1).to_numpy(zero_copy_only=False))


def _parts(out: Path, stage: str) -> list[Path]:
    """Return the files of the catalogue of a stage, that of all first."""
    of_all = out / FOLDER / f"{stage}.parquet"
    with contextlib.suppress(OSError):
        return [of_all, *sorted((out / FOLDER / stage).glob("*.parquet"))]
    return [of_all]


def _read(path: Path) -> tuple[pa.Array, Entries] | None:
    """Return the names and entries of a file of the catalogue; None where there is none, or it is damaged."""
    with contextlib.suppress(OSError, pa.ArrowException, KeyError, ValueError, TypeError):
        # Opened by Arrow, and not as a data set: a path of an object is fetched whole by its name.
        table = pq.ParquetFile(os.fspath(path), page_checksum_verification=True).read()
        known = np.zeros(table.num_rows, dtype=ENTRY)
        for name in ENTRY.names or ():
            known[name] = table[name].to_numpy()
        return table[_SEGMENT].cast(pa.string()).combine_chunks(), known
    return None


def _take(path: Path, listing: Listing, entries: Entries) -> int:
    """Fill in the entries of a file that hold for the shards of the listing; return how many do not."""
    found = _read(path)
    if found is None:
        return 0
    names, known = found
    place = _places(names, listing.segment)
    holds: Bools = place >= 0
    holds[holds] = listing.version[place[holds]] == known["version"][holds]
    entries[place[holds]] = known[holds]
    return len(holds) - int(holds.sum())


def _open(folder: Path, listing: Listing, places: Places, entries: Entries, tick: Callable[[], None]) -> None:
    """Read the footers of some shards."""
    chosen = pa.array(places)
    names = listing.segment.take(chosen).to_pylist()
    tags = [""] * len(names) if listing.tag is None else listing.tag.take(chosen).to_pylist()
    sizes = listing.size_bytes[places].tolist()
    shards = [
        Shard(folder / f"{name}.parquet", size, tag or "")
        for name, size, tag in zip(names, sizes, tags, strict=True)
    ]
    for place, entry in zip(places.tolist(), read_entries(shards, tick), strict=True):
        if entry is None:  # for now: it is tried again the next time
            entries[place]["rows"] = NOT_LISTED
            continue
        entries[place] = entry
        entries[place]["version"] = listing.version[place]
        entries[place]["size_bytes"] = listing.size_bytes[place]


def _only(entries: Entries, places: Places) -> Entries:
    """Return the entries of some shards, and none of the others."""
    some = np.zeros_like(entries)
    some[places] = entries[places]
    return some


def _save(out: Path, stage: str, listing: Listing, entries: Entries, part: str) -> bool:
    """Write entries of a stage; return whether that could be done: where not, they are read again the next time."""
    keep = np.flatnonzero(entries["version"] != 0)
    try:
        write_entries(out, stage, listing.segment.take(pa.array(keep)), entries[keep], part)
    except (UpvlError, OSError):
        return False
    return True


def write_entries(out: Path, stage: str, segments: pa.Array, entries: Entries, part: str = "") -> None:
    """Write the catalogue of a stage.

    Args:
        out: Folder of the results.
        stage: Name of the stage.
        segments: n names.
        entries: (n,) entries.
        part: Name of a file beside others; empty for the file of all.
    """
    columns = {_SEGMENT: segments}
    columns |= {name: pa.array(np.ascontiguousarray(entries[name])) for name in ENTRY.names or ()}
    with atomic_file(out / FOLDER / (f"{stage}/{part}.parquet" if part else f"{stage}.parquet")) as file:
        pq.write_table(
            pa.table(columns), file, compression="zstd", use_dictionary=["settings", "files"],
            write_page_checksum=True,
        )  # fmt: skip
