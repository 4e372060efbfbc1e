"""Labels of made-up drives, whose truth is known exactly; for evaluation only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Bools, Boxes, Frame, Ints, Labels, concat

MAX_HARD_POINTS = 5  # Waymo's rule: a box with so few points is of difficulty 2


class FrameBoxes(NamedTuple):
    """The boxes of the same t objects in one frame.

    Attributes:
        boxes: The t boxes, in ego axes.
        velocity_mps: (t, 3) over the ground along the ego axes.
        num_points: (t,) LiDAR points inside of each.
        is_seen: (t,) whether the LiDAR saw the object.
    """

    boxes: Boxes
    velocity_mps: Array
    num_points: Array
    is_seen: Bools


def exact_labels(
    frames: Sequence[Frame],
    boxes_by_frame: Sequence[FrameBoxes],
    object_ids: Ints,
    class_names: Sequence[str],
    types: Sequence[int],
) -> Labels:
    """Return the boxes, in all frames, of the objects that the LiDAR ever sees.

    Args:
        frames: The frames of the drive.
        boxes_by_frame: The boxes of the t objects in each frame.
        object_ids: (t,) number of each object.
        class_names: The name of the class of each object.
        types: Waymo's number of the type of each object.
    """
    seen = np.any([frame.is_seen for frame in boxes_by_frame], axis=0)
    num_points = np.concatenate([frame.num_points[seen] for frame in boxes_by_frame])
    boxes = concat([frame.boxes[seen] for frame in boxes_by_frame], Boxes)
    return Labels(
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        frame=np.repeat([frame.index for frame in frames], seen.sum()),
        object_id=np.tile(object_ids[seen], len(frames)),
        class_name=np.tile(np.array(class_names)[seen], len(frames)),
        type=np.tile(np.array(types)[seen], len(frames)),
        velocity_mps=np.concatenate([frame.velocity_mps[seen] for frame in boxes_by_frame]),
        num_points=num_points,
        difficulty=np.where(num_points > MAX_HARD_POINTS, 1, 2),
    )
