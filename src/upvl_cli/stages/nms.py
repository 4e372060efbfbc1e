"""Which boxes are the labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.labels.config import PictureScoreConfig, SizeConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import Boxes2dRow
from upvl_cli.stages.rows import AmodalRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.labels.picture_score import PictureFits
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Floats


@dataclass(frozen=True)
class NmsConfig(Config):
    """Settings of `nms`."""

    max_iou: float = setting(
        "bird's-eye IoU of two boxes above which the one of the lower score is dropped", ge=0, le=1
    )
    min_objectness: float = setting(
        "likeness of a track to road users below which its boxes are dropped", ge=0, le=1
    )
    size: SizeConfig = table("sizes that an object can have")
    picture: PictureScoreConfig = table("scores of tracks by 2D boxes; used where boxes2d has a detector")


def run(inputs: Inputs, config: NmsConfig) -> Iterator[AmodalRow]:
    """Drop boxes that overlap better ones, and boxes too small or too large for an object."""
    from dataclasses import replace

    import numpy as np

    from upvl_cli.geometry.nms import nms_bev
    from upvl_cli.perception.labels.suppression import size_faults
    from upvl_cli.stages.rows import select

    fits = _picture_fits(inputs)
    for row in inputs.table("amodal", AmodalRow):
        weight = fits.weights(row.track_id, config.picture)
        faults = size_faults(row.boxes, config.size)
        for reason, is_faulty in faults.items():
            inputs.count(f"boxes dropped: {reason}", is_faulty.sum())
        is_sound = ~np.logical_or.reduce([*faults.values()])
        is_alike = row.objectness >= config.min_objectness
        inputs.count("boxes dropped: unlike a road user", (is_sound & ~is_alike).sum())
        sound = np.flatnonzero(is_sound & is_alike)
        best = nms_bev(row.boxes[sound], _preference(row, weight)[sound], max_iou=config.max_iou)
        kept = sound[np.sort(best)]
        inputs.count("boxes dropped: overlap a better one", len(sound) - len(kept))
        inputs.count("boxes kept", len(kept))
        yield select(replace(row, score=row.score * weight), kept)


def _picture_fits(inputs: Inputs) -> PictureFits:
    """Return how well each track fits the 2D boxes of the pictures; nothing without a detector."""
    from upvl_cli.perception.labels.box_matching import BoxMatcher
    from upvl_cli.perception.labels.picture_score import PictureFits

    fits, boxes2d = PictureFits(), inputs.table("boxes2d", Boxes2dRow)
    if not any(row.has_image.any() for row in boxes2d):
        return fits
    poses = list(inputs.table("odometry", OdometryRow))
    step_of = {pose.frame: step for step, pose in enumerate(poses)}
    times_ns, world_from_ego = [pose.time_ns for pose in poses], [pose.world_from_ego for pose in poses]
    matcher = BoxMatcher(inputs.drive.cameras, times_ns, world_from_ego, min_iou=1.0)
    for row in inputs.table("amodal", AmodalRow):
        pictures = boxes2d[row.frame].pictures
        matches = matcher.match(step_of[row.frame], row.boxes, row.velocity_mps, pictures)
        fits.add_frame(row.track_id, matches.iou)
    return fits


def _preference(row: AmodalRow, weight: Floats) -> Floats:
    """Return (n,) an order of the boxes that is the same in all frames: of two tracks of one object one stays.

    Args:
        row: The boxes.
        weight: (n,) factor of the likeness of their tracks, by 2D boxes.
    """
    import numpy as np

    order = np.lexsort(
        (-row.track_id, row.num_frames_seen, row.objectness * (1 - row.background_share) * weight)
    )
    rank = np.empty(len(order))
    rank[order] = np.arange(len(order))
    return rank


STAGE = Stage(
    name="nms",
    run=run,
    config=NmsConfig,
    row=AmodalRow,
    reads=("raw", "odometry", "boxes2d", "amodal"),
    version=2,
)
