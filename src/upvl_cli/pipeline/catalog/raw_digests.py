"""The digests of the drives' own files, for many drives at once."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from upvl_cli.config.base import Config
from upvl_cli.errors import BadInput
from upvl_cli.pipeline.catalog.hashing import NO_DIGEST, Hashes, digest_prefix
from upvl_cli.pipeline.fingerprint import fingerprint
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.workspace import Workspace

_THREADS = 16  # most of the time goes into waiting for the disk, or for a server


def raw_digests(workspace: Workspace, segments: Sequence[str]) -> Hashes:
    """Return the (n,) digests of the files of n drives; `NO_DIGEST` for a drive that cannot be read."""
    dataset, corrections = workspace.dataset, workspace.raw.corrections

    def digest(segment: str) -> int:
        try:
            drive = workspace.pipeline.correct(dataset.open(segment), corrections)
            return digest_prefix(fingerprint(drive.files, workspace.seen_path(segment)).digest)
        except BadInput:
            return NO_DIGEST

    if len(segments) < 2:
        return np.array([digest(segment) for segment in segments], dtype=np.uint64)
    with ThreadPoolExecutor(_THREADS) as pool:
        return np.fromiter(pool.map(digest, segments), dtype=np.uint64, count=len(segments))


def settings_files_digests(
    workspace: Workspace, stage: AnyStage, segments: Sequence[str], settings: Config
) -> Hashes:
    """Return the digests of the files that a stage's settings name: (n,) of n drives, or (1,) where they name none."""
    none = np.zeros(1, dtype=np.uint64)
    if not stage.has_files:
        return none
    known: dict[tuple[Path, ...], int] = {(): NO_DIGEST}  # most often all drives have the same ones
    found = np.zeros(len(segments), dtype=np.uint64)
    for place, segment in enumerate(segments):
        files = settings.files(segment)
        if files not in known:
            known[files] = digest_prefix(workspace.files_digest(stage, segment, settings))
        found[place] = known[files]
    return found if len(known) > 1 else none
