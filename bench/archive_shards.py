"""Workspaces of many drives for bench/archive.py: real shards with real footers and no frames, written quickly."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import numpy as np  # noqa: E402

from tiny_kitti import write_drive  # noqa: E402
from upvl_cli.commands.pipeline import PIPELINE  # noqa: E402
from upvl_cli.pipeline.pipeline import AnyStage  # noqa: E402
from upvl_cli.pipeline.provenance import to_json  # noqa: E402
from upvl_cli.pipeline.stage import NOT_MADE, WHOLE_DATASET  # noqa: E402
from upvl_cli.pipeline.tables import footer_digest_of, write  # noqa: E402
from upvl_cli.pipeline.workspace import Workspace  # noqa: E402

FEW = ["*_drive_000000[0-9]_sync", "*_drive_0000_sync"]  # what the stages of all drives read
Put = Callable[[str, bytes], object]


def make_drives(root: Path, drives: int, frames: int) -> int:
    """Write drives in KITTI's raw layout, all files but one links to those of the first; return the files of each."""
    first = write_drive(root, frames=frames, drive=0).folder
    files = [path for path in first.rglob("*") if path.is_file()]
    for number in range(1, drives):
        folder = first.with_name(f"2011_09_26_drive_{number:07d}_sync")
        for path in sorted({path.parent for path in files}):
            (folder / path.relative_to(first)).mkdir(parents=True, exist_ok=True)
        for path in files:
            os.link(path, folder / path.relative_to(first))
        sweep = folder / "velodyne_points" / "data" / "0000000000.bin"
        content = sweep.read_bytes()
        sweep.unlink()
        sweep.write_bytes(
            np.float32(10 + number * 1e-3).tobytes() + content[4:]
        )  # no two drives are the same
    return len(files)


def make_settings(folder: Path, root: Path) -> Workspace:
    """Copy the settings that ship; the stages of all drives read the first ten."""
    shutil.copytree(ROOT / "stages", folder / "stages")
    write_raw(folder, "kitti", root, immutable=False)
    set_drives(folder, FEW)
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def set_drives(folder: Path, drives: list[str]) -> None:
    """Name the drives that the stages of the whole dataset read."""
    for stage in ("pca", "train"):
        path = folder / "stages" / f"{stage}.toml"
        path.write_text(path.read_text().replace('drives = ["*"]', f"drives = {json.dumps(drives)}"))


def dataset_shard(
    workspace: Workspace,
    stage: AnyStage,
    raw: dict[str, str],
    digests: dict[tuple[str, str], str],
    scratch: Path,
) -> bytes:
    """Return the shard of a stage of the whole dataset.

    Args:
        workspace: Its settings.
        stage: The stage.
        raw: Digest of the content of each drive that it reads.
        digests: Digest of the footer of each shard that it reads, by stage and segment.
        scratch: Folder for one shard.
    """
    return _shard(stage, _stamp(workspace, stage, workspace.drives_of(stage), raw, digests), scratch)


def write_raw(folder: Path, dataset: str, root: Path, *, immutable: bool) -> None:
    """Write `raw.toml`."""
    (folder / "stages" / "raw.toml").write_text(
        f"dataset = {json.dumps(dataset)}\nroot = {json.dumps(str(root))}\nsegments = []\n"
        f"immutable_files = {json.dumps(immutable)}\n"
    )


def shards(workspace: Workspace, put: Put, scratch: Path) -> Iterator[tuple[str, str]]:
    """Give `put` each shard of all stages, fresh, by its place below `out`; yield stage and segment of each.

    Args:
        workspace: Its settings and drives; `pca` and `train` are written below its `out` as well, for their readers.
        put: Takes the place of a shard and its content.
        scratch: Folder for one shard at a time.
    """
    raw = {name: str(json.loads(workspace.raw_stamp(name))["content"]) for name in workspace.segments}
    digests: dict[tuple[str, str], str] = {}
    for stage in PIPELINE.stages:
        if stage.is_of_dataset:
            content = dataset_shard(workspace, stage, raw, digests, scratch)
            put(f"{stage.name}/{WHOLE_DATASET}.parquet", content)
            digests[stage.name, WHOLE_DATASET] = _digest(content)
            yield stage.name, WHOLE_DATASET
            continue
        first = workspace.segments[0]
        model = _shard(stage, _stamp(workspace, stage, (first,), raw, digests), scratch)
        inputs = [name for name in stage.reads if name not in NOT_MADE]
        for segment in workspace.segments:
            content = model.replace(raw[first].encode(), raw[segment].encode())
            for name in inputs:
                if not PIPELINE.by_name[name].is_of_dataset:
                    content = content.replace(digests[name, first].encode(), digests[name, segment].encode())
            put(f"{stage.name}/{segment}.parquet", content)
            digests[stage.name, segment] = _digest(content)
            yield stage.name, segment


def _stamp(
    workspace: Workspace,
    stage: AnyStage,
    drives: tuple[str, ...],
    raw: dict[str, str],
    digests: dict[tuple[str, str], str],
) -> str:
    makers = workspace.makers(stage)
    content = {name: raw[name] for name in drives} if stage.is_of_dataset else raw[drives[0]]
    inputs: dict[str, str] = {}
    for name in stage.reads:
        if name in NOT_MADE:
            continue
        if PIPELINE.by_name[name].is_of_dataset:
            inputs[name] = digests[name, WHOLE_DATASET]
        elif stage.is_of_dataset:
            inputs |= {f"{name}/{drive}": digests[name, drive] for drive in drives}
        else:
            inputs[name] = digests[name, drives[0]]
    return to_json(makers | {"raw": makers["raw"] | {"content": content}, "inputs": inputs})


def _shard(stage: AnyStage, stamp: str, scratch: Path) -> bytes:
    path = scratch / "shard.parquet"
    write(path, stage.row, iter(()), stamp=stamp, counts={})
    return path.read_bytes()


def _digest(content: bytes) -> str:
    return footer_digest_of(io.BytesIO(content))
