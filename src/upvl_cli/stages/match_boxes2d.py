"""Which 2D box shows each label, and which names those boxes give its track."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import Boxes2dRow, MatchBoxes2dRow
from upvl_cli.stages.rows import AmodalRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.labels.box_matching import PictureMatches
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class MatchBoxes2dConfig(Config):
    """Settings of `match-boxes2d`."""

    min_iou: float = setting(
        "IoU of a 2D box with the rectangle around a projected label from which on it shows the label, and votes for "
        "its name",
        gt=0,
        le=1,
    )


def run(inputs: Inputs, config: MatchBoxes2dConfig) -> Iterator[MatchBoxes2dRow]:
    """Compare every label with the 2D boxes of the picture that shows most of it, and let those vote for its name."""
    import numpy as np

    from upvl_cli.perception.labels.box_matching import BoxMatcher
    from upvl_cli.perception.labels.box_votes import BoxVotes

    labels, boxes2d, votes = inputs.table("nms", AmodalRow), inputs.table("boxes2d", Boxes2dRow), BoxVotes()
    poses = list(inputs.table("odometry", OdometryRow))
    step_of = {pose.frame: step for step, pose in enumerate(poses)}
    matcher = BoxMatcher(
        inputs.drive.cameras,
        [pose.time_ns for pose in poses],
        [pose.world_from_ego for pose in poses],
        config.min_iou,
    )

    def matches_of(row: AmodalRow) -> PictureMatches:
        return matcher.match(step_of[row.frame], row.boxes, row.velocity_mps, boxes2d[row.frame].pictures)

    for row in labels:
        matches = matches_of(row)
        votes.add_frame(row.track_id, matches.name, matches.score)
    for row in labels:  # once more, so that no more than a frame is held
        matches, words = matches_of(row), votes.words(row.track_id)
        is_shown, has_picture = matches.name != "", matches.iou >= 0
        inputs.count("labels that a 2D box shows", is_shown.sum())
        inputs.count("labels that no 2D box shows", (has_picture & ~is_shown).sum())
        inputs.count("labels without a picture", (~has_picture).sum())
        yield MatchBoxes2dRow(
            inputs.segment,
            row.frame,
            row.track_id,
            matches.view.astype(np.int8),
            matches.iou,
            matches.name,
            matches.score,
            words.word,
            words.share,
            words.votes,
        )


STAGE = Stage(
    name="match-boxes2d",
    run=run,
    config=MatchBoxes2dConfig,
    row=MatchBoxes2dRow,
    reads=("raw", "odometry", "boxes2d", "nms"),
)
