"""The catalogue of the simulated archive of bench/archive.py: what a run over all its drives would have left behind."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa

import archive_plugin
import archive_server
import archive_shards
from archive_shards import ROOT
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.catalog.catalog import write_entries
from upvl_cli.pipeline.catalog.entries import ENTRY, Entries, settings_text
from upvl_cli.pipeline.catalog.hashing import Hashes, combine, digest_prefix, mix, text_hash
from upvl_cli.pipeline.catalog.listing import object_versions
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET
from upvl_cli.pipeline.tables import footer_digest
from upvl_cli.pipeline.workspace import Workspace

FEW = ["seg-000000[0-9]"]


def make_workspace(folder: Path, drives: int) -> Workspace:
    """Make a workspace of the archive, and its dataset as a package that upvl finds."""
    shutil.copytree(ROOT / "stages", folder / "stages")
    archive_shards.write_raw(folder, "archive", Path(str(drives)), immutable=True)
    archive_shards.set_drives(folder, FEW)
    package = folder / "upvl_archive-0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: upvl-archive\nVersion: 0\n")
    (package / "entry_points.txt").write_text(archive_plugin.ENTRY_POINTS)
    sys.path.insert(0, str(folder))
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def write_catalog(workspace: Workspace, files: Path, drives: int) -> list[str]:
    """Write the catalogue of all stages of a drive, and the shards of the whole dataset; return the stages.

    In `mask` one drive in 5003 records another input than there is.

    Args:
        workspace: Its settings.
        files: What becomes `out` of the archive.
        drives: Number of drives.
    """
    stages = [stage for stage in PIPELINE.stages if not stage.is_of_dataset]
    numbers = np.arange(drives, dtype=np.uint64)
    names = pa.array([archive_server.segment_name(number) for number in range(drives)])
    raw = mix(numbers + np.uint64(10**12))
    footers: dict[str, Hashes] = {}
    for stage in PIPELINE.stages:
        if stage.is_of_dataset:
            content = archive_shards.dataset_shard(
                workspace, stage, _hex(raw), _hexes(footers, stage.reads), files
            )
            path = files / stage.name / f"{WHOLE_DATASET}.parquet"
            path.parent.mkdir(parents=True)
            path.write_bytes(content)
            footers[stage.name] = np.array([digest_prefix(footer_digest(path))], dtype=np.uint64)
            continue
        number = stages.index(stage)
        inputs = [name for name in stage.reads if name not in NOT_MADE]
        entries: Entries = np.zeros(drives, dtype=ENTRY)
        is_there = np.array([archive_server.is_there(number, drive, drives) for drive in range(drives)])
        footers[stage.name] = np.where(is_there, mix(numbers + np.uint64(number * 10**9)), np.uint64(0))
        sizes = np.array([archive_server.size_of(number, drive) for drive in range(drives)])
        tags = pa.array([f'"{archive_server.tag_of(number, drive)}"' for drive in range(drives)])
        entries["version"] = object_versions(tags, sizes, np.zeros(drives, np.int64))
        entries["size_bytes"], entries["rows"], entries["raw"] = sizes, 200, raw
        entries["footer"] = footers[stage.name]
        entries["settings"] = text_hash(settings_text(workspace.makers(stage), inputs))
        entries["inputs"] = combine([footers[name] for name in sorted(inputs)], drives)
        if stage.name == "mask":
            entries["inputs"][5002::5003] += np.uint64(1)
        kept = np.flatnonzero(is_there)
        write_entries(files, stage.name, names.take(pa.array(kept)), entries[kept])
    return [stage.name for stage in stages]


def _hex(prefixes: Hashes) -> dict[str, str]:
    """Return digests with given first bits, for the few drives that the stages of all drives read."""
    return {
        archive_server.segment_name(number): f"{int(prefixes[number]):016x}".ljust(64, "0")
        for number in range(10)
    }


def _hexes(footers: dict[str, Hashes], names: tuple[str, ...]) -> dict[tuple[str, str], str]:
    found = {}
    for name in set(names) & set(footers):
        if PIPELINE.by_name[name].is_of_dataset:
            found[name, WHOLE_DATASET] = f"{int(footers[name][0]):016x}".ljust(64, "0")
        else:
            found |= {(name, segment): digest for segment, digest in _hex(footers[name]).items()}
    return found
