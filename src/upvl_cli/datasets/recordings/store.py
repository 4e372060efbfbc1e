"""Sweeps of a recording on their way into a table: in parts, so that an import that is stopped goes on where it was."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.datasets.parquet.writer import points_schema, sweep_table, table_writer
from upvl_cli.datasets.recordings.conversion import Conversion
from upvl_cli.datasets.recordings.recording import LeftOut, RecordedSweep, Recording
from upvl_cli.datasets.shared.times import MIN_STEP_NS
from upvl_cli.errors import BadInput, UpvlError

MARK = "upvl_import"  # in the footer of every table that an import wrote
NOT_LATER = "sweeps that are not later than the one before"
_PART_SWEEPS = 50


@dataclass
class ImportCounts:
    """What an import has done so far.

    Attributes:
        next: The item of the recording that comes next.
        frames: Sweeps that were written.
        points: Points that were written.
        pictures: Pictures that were written.
        last_ns: Time of the last sweep; None before the first.
        skipped: What was left out, by reason.
        examples: The first message about each reason that has messages.
    """

    next: int = 0
    frames: int = 0
    points: int = 0
    pictures: int = 0
    last_ns: int | None = None
    skipped: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)

    def leave_out(self, item: LeftOut) -> None:
        """Count something that is left out."""
        self.skipped[item.reason] += 1
        if item.error is not None:
            self.examples.setdefault(item.reason, str(item.error))

    def text(self, fingerprint: str) -> str:
        """Return them as the mark of a table."""
        return json.dumps({"fingerprint": fingerprint, **vars(self)})

    @classmethod
    def read(cls, path: Path, fingerprint: str) -> ImportCounts | None:
        """Return the counts of a table that an import of this fingerprint wrote; None for any other file."""
        values = mark_of(path)
        if values is None or values.pop("fingerprint", None) != fingerprint:
            return None
        values["skipped"] = Counter(values["skipped"])
        return cls(**values)


def mark_of(path: Path) -> dict[str, Any] | None:
    """Return the mark of a table that an import wrote; None where there is no such table."""
    try:
        found = (pq.read_metadata(path).metadata or {}).get(MARK.encode())
        return dict(json.loads(found)) if found else None
    except (OSError, ValueError, pa.ArrowException):
        return None


def check_free(path: Path) -> None:
    """Raise `UpvlError` where a file lies at a path that no import wrote."""
    if path.exists() and mark_of(path) is None:
        raise UpvlError(
            f"{path} exists and was not written by upvl import; remove it, or choose another name: --segment"
        )


def write_points(
    path: Path, folder: Path, recording: Recording, conversion: Conversion, fingerprint: str,
    metadata: Mapping[str, str], on_sweep: Callable[[int], None],
) -> ImportCounts:  # fmt: skip
    """Write the sweeps of a recording, and return what was done.

    Args:
        path: The table.
        folder: Where its parts are kept until it is whole.
        recording: What is imported.
        conversion: Its units.
        fingerprint: Of the files and settings: parts of another one are not used.
        metadata: Texts for the footer.
        on_sweep: Called with how many more sweeps are done.
    """
    schema = points_schema(conversion.columns)
    counts, parts = _parts(folder, fingerprint)
    on_sweep(counts.next)
    sweeps = recording.sweeps(counts.next)
    with contextlib.closing(sweeps):  # type: ignore[type-var]
        while counts.next < recording.total:
            part = folder / f"{counts.next:08d}.parquet"
            before = counts.next
            with table_writer(part, schema, {}) as writer:
                for sweep in _some(sweeps):
                    _write(writer, sweep, conversion, counts, schema)
                    on_sweep(1)
                writer.add_key_value_metadata({MARK: counts.text(fingerprint)})
            if counts.next == before:  # fewer messages than the recording's index says
                part.unlink()
                break
            parts.append(part)
    if not counts.frames:
        shutil.rmtree(folder, ignore_errors=True)
        raise BadInput(_nothing_left(recording, counts))
    with table_writer(path, schema, metadata) as writer:
        for part in parts:
            with pq.ParquetFile(part) as file:
                for group in range(file.num_row_groups):
                    writer.write_table(file.read_row_group(group).cast(schema))
        writer.add_key_value_metadata({MARK: counts.text(fingerprint)})
    shutil.rmtree(folder, ignore_errors=True)
    return counts


def _some(sweeps: Iterator[RecordedSweep | LeftOut]) -> Iterator[RecordedSweep | LeftOut]:
    for _, sweep in zip(range(_PART_SWEEPS), sweeps, strict=False):
        yield sweep


def _write(
    writer: pq.ParquetWriter,
    sweep: RecordedSweep | LeftOut,
    conversion: Conversion,
    counts: ImportCounts,
    schema: pa.Schema,
) -> None:
    counts.next = sweep.item + 1
    if (
        isinstance(sweep, RecordedSweep)
        and counts.last_ns is not None
        and sweep.time_ns - counts.last_ns < MIN_STEP_NS
    ):
        sweep = LeftOut(sweep.item, NOT_LATER)
    if isinstance(sweep, LeftOut):
        counts.leave_out(sweep)
        return
    row = conversion.row(sweep, counts.skipped)
    writer.write_table(sweep_table(row, schema))
    counts.frames += 1
    counts.points += len(row.xyz_ego_m)
    counts.last_ns = sweep.time_ns


def _parts(folder: Path, fingerprint: str) -> tuple[ImportCounts, list[Path]]:
    """Return the parts that can be used, each of which goes on where the one before ends; others are removed."""
    counts, parts = ImportCounts(), list[Path]()
    for path in sorted(folder.glob("*.parquet")) if folder.is_dir() else ():
        found = ImportCounts.read(path, fingerprint)
        if found is None or path.stem != f"{counts.next:08d}":
            path.unlink()
            continue
        counts = found
        parts.append(path)
    return counts, parts


def _nothing_left(recording: Recording, counts: ImportCounts) -> str:
    reasons = ", ".join(f"{count} {reason}" for reason, count in counts.skipped.items()) or "it has none"
    example = next(iter(counts.examples.values()), "")
    return f"{recording.name}: no sweep can be used: {reasons}" + (
        f"; the first: {example}" if example else ""
    )
