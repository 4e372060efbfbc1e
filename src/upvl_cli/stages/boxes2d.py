"""2D boxes in the pictures, of a detector or a table that the user names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from upvl_cli.boxes2d import NONE, box_source_family
from upvl_cli.boxes2d.config import SuppressionConfig
from upvl_cli.config.base import Config, setting, table
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import Boxes2dRow

if TYPE_CHECKING:
    from pathlib import Path

    from upvl_cli.boxes2d.base import BoxSource2d
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Boxes2d, Drive, Frame


@dataclass(frozen=True)
class Boxes2dConfig(Config):
    """Settings of `boxes2d`."""

    detector: str = setting(
        "where 2D boxes come from: none, onnx:FILE for a detector with the head of YOLOX, or table:FILE for boxes of "
        "any detector as Parquet or as JSON of COCO; see docs/boxes2d.md"
    )
    min_score: float = setting("lowest confidence of a box that is kept", ge=0, le=1)
    suppression: SuppressionConfig = table("where a detector of onnx: looks, and which of its boxes stay")

    def values(self) -> dict[str, Any]:
        """Return the values that count: the content of a file is stamped, and not its place on this disk."""
        if self.detector == NONE:
            return {"detector": NONE}
        family, _ = box_source_family(self.detector)
        values = super().values() | {"detector": self.detector.partition(":")[0], "version": family.version}
        if values["detector"] == "table":
            del values["suppression"]
        return values

    def files(self, segment: str) -> tuple[Path, ...]:
        """Return the files that give the boxes."""
        if self.detector == NONE:
            return ()
        family, path = box_source_family(self.detector)
        return family.files(path)


def run(inputs: Inputs, config: Boxes2dConfig) -> Iterator[Boxes2dRow]:
    """Find 2D boxes in the pictures of every frame."""
    from upvl_cli.runtime.parallel import in_order

    drive = inputs.drive
    frames = [frame for frame in drive.frames if frame.index in inputs.window]
    if config.detector == NONE:
        yield from (_row(inputs.segment, frame, []) for frame in frames)
        return
    family, path = box_source_family(config.detector)
    source = family.open(path, drive, config.suppression)
    if drive.frames[0].index in inputs.window:  # counted once a drive
        for reason, items in source.dropped.items():
            inputs.count(reason, items)
    for row in in_order(lambda frame: _boxes_of(drive, frame, source, config), frames):
        inputs.count("2D boxes", len(row.camera))
        inputs.count("pictures", row.has_image.sum())
        inputs.count("pictures missing", (~row.has_image).sum())
        yield row


def _boxes_of(drive: Drive, frame: Frame, source: BoxSource2d, config: Boxes2dConfig) -> Boxes2dRow:
    from upvl_cli.boxes2d.base import CameraPicture
    from upvl_cli.types import Boxes2d, empty

    found: list[tuple[int | None, Boxes2d]] = []
    for camera in drive.cameras:
        image = drive.image(frame.index, camera.name)
        if image is None:
            found.append((None, empty(Boxes2d)))
        else:
            boxes = source.boxes(CameraPicture(frame.index, camera.name, image.rgb))
            found.append((image.time_ns, boxes[boxes.score >= config.min_score]))
    return _row(drive.name, frame, found)


def _row(segment: str, frame: Frame, found: list[tuple[int | None, Boxes2d]]) -> Boxes2dRow:
    """Return the row of a frame from the time and the boxes of each camera's picture."""
    import numpy as np

    from upvl_cli.types import Boxes2d, concat

    boxes = concat([each for _, each in found], Boxes2d)
    return Boxes2dRow(
        segment,
        frame.index,
        has_image=np.array([time_ns is not None for time_ns, _ in found], dtype=np.bool_),
        image_time_ns=np.array([time_ns or 0 for time_ns, _ in found], dtype=np.int64),
        camera=np.repeat(np.arange(len(found)), [len(each) for _, each in found]).astype(np.int8),
        xyxy_px=boxes.xyxy_px,
        score=boxes.score,
        name=boxes.name,
    )


STAGE = Stage(name="boxes2d", run=run, config=Boxes2dConfig, row=Boxes2dRow, reads=("raw",), windowed=True)
