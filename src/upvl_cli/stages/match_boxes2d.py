"""Which 2D box shows each label, and which names those boxes give its track."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, Boxes2dRow, MatchBoxes2dRow, OdometryRow

if TYPE_CHECKING:
    from collections.abc import Callable

    from upvl_cli.perception.labels.box_matching import Matches
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Ints


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

    from upvl_cli.perception.labels.box_votes import BoxVotes

    labels, votes = inputs.table("nms", AmodalRow), BoxVotes()
    matches_of = _matcher(inputs, config)
    for row in labels:
        matches, _ = matches_of(row)
        votes.add_frame(row.track_id, matches.name, matches.score)
    for row in labels:  # once more, so that no more than a frame is held
        matches, camera = matches_of(row)
        words = votes.words(row.track_id)
        is_shown, has_picture = matches.name != "", matches.iou >= 0
        inputs.count("labels that a 2D box shows", is_shown.sum())
        inputs.count("labels that no 2D box shows", (has_picture & ~is_shown).sum())
        inputs.count("labels without a picture", (~has_picture).sum())
        yield MatchBoxes2dRow(
            inputs.segment,
            row.frame,
            row.track_id,
            camera.astype(np.int8),
            matches.iou,
            matches.name,
            matches.score,
            words.word,
            words.share,
            words.votes,
        )


def _matcher(inputs: Inputs, config: MatchBoxes2dConfig) -> Callable[[AmodalRow], tuple[Matches, Ints]]:
    """Return the function of the labels of a frame that gives their 2D boxes, and the camera of each."""
    import numpy as np

    from upvl_cli.geometry.boxes import corners
    from upvl_cli.geometry.path import pose_at
    from upvl_cli.perception.labels.box_matching import CameraView, match_boxes
    from upvl_cli.perception.visual.views import move_to_time

    cameras, boxes2d = inputs.drive.cameras, inputs.table("boxes2d", Boxes2dRow)
    poses = list(inputs.table("odometry", OdometryRow))
    times_ns = [pose.time_ns for pose in poses]
    world_from_ego = np.array([pose.world_from_ego for pose in poses])
    step_of = {pose.frame: step for step, pose in enumerate(poses)}

    def matches(row: AmodalRow) -> tuple[Matches, Ints]:
        here, step, views = boxes2d[row.frame], step_of[row.frame], list[CameraView]()
        shown = np.flatnonzero(here.has_image)
        places_m = corners(row.boxes)
        for number in shown.tolist():
            time_ns = int(here.image_time_ns[number])
            moved_m = move_to_time(
                places_m.reshape(-1, 3),
                np.repeat(row.velocity_mps, 8, axis=0),
                (time_ns - times_ns[step]) * 1e-9,
                world_from_ego[step],
                pose_at(times_ns, world_from_ego, time_ns),
            )
            views.append(
                CameraView(cameras[number], moved_m.reshape(-1, 8, 3), here.boxes2d[here.camera == number])
            )
        found = match_boxes(views, len(row.boxes), min_iou=config.min_iou)
        # The number of a view is that of its camera among those with a picture; the last place is that of none.
        return found, np.append(shown, -1)[found.view]

    return matches


STAGE = Stage(
    name="match-boxes2d",
    run=run,
    config=MatchBoxes2dConfig,
    row=MatchBoxes2dRow,
    reads=("raw", "odometry", "boxes2d", "nms"),
)
