"""Labels of made-up drives, whose truth is known exactly; for evaluation only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Bools, Frame, Ints, Labels

HARD_POINTS = 5  # Waymo's rule: a box with so few points is of difficulty 2


class FrameBoxes(NamedTuple):
    """The boxes of the same t things in one frame.

    Attributes:
        seven: (t, 7) in ego axes.
        velocity_mps: (t, 3) over the ground along the ego axes.
        points: (t,) LiDAR points inside of each.
        met: (t,) whether the LiDAR saw the thing.
    """

    seven: Array
    velocity_mps: Array
    points: Array
    met: Bools


def exact_labels(
    frames: Sequence[Frame],
    boxes: Sequence[FrameBoxes],
    things: Ints,
    kinds: Sequence[str],
    types: Sequence[int],
) -> Labels:
    """The boxes, in all frames, of the things that the LiDAR ever sees.

    Args:
        frames: The frames of the drive.
        boxes: The boxes of each frame.
        things: (t,) number of each thing.
        kinds: The name of the kind of each thing.
        types: Waymo's number of the type of each thing.
    """
    seen = np.any([frame.met for frame in boxes], axis=0)
    points = np.concatenate([frame.points[seen] for frame in boxes])
    return Labels.from_rows(
        np.concatenate([frame.seven[seen] for frame in boxes]),
        frame=np.repeat([frame.index for frame in frames], seen.sum()),
        object_id=np.tile(things[seen], len(boxes)),
        class_name=np.tile(np.array(kinds)[seen], len(boxes)),
        type=np.tile(np.array(types)[seen], len(boxes)),
        velocity_mps=np.concatenate([frame.velocity_mps[seen] for frame in boxes]),
        num_points=points,
        difficulty=np.where(points > HARD_POINTS, 1, 2),
    )
