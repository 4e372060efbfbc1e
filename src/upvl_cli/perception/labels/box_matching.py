"""Which 2D box shows which 3D box: by the rectangle around the 3D box's projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.geometry.box_projection import iou_of_rectangles, projected_boxes
from upvl_cli.geometry.boxes import corners
from upvl_cli.geometry.path import pose_at
from upvl_cli.perception.visual.riders import merge_riders
from upvl_cli.perception.visual.views import move_to_time
from upvl_cli.types import Array, Bools, Boxes, Boxes2d, Camera, Floats, Ints

NO_CAMERA, NO_IOU = -1, -1.0


@dataclass(frozen=True)
class CameraView:
    """The 3D boxes of a frame and the 2D boxes of one of its pictures.

    Attributes:
        camera: The camera.
        corners_m: (b, 8, 3) corners of the 3D boxes in ego axes at the time of the picture.
        boxes: The 2D boxes.
    """

    camera: Camera
    corners_m: Array
    boxes: Boxes2d


@dataclass(frozen=True)
class FramePictures:
    """The pictures of a frame and all their 2D boxes.

    Attributes:
        has_image: (c,) whether each camera has one; no camera at all without a detector.
        image_time_ns: (c,) when it was taken.
        camera: (k,) number of the camera of each 2D box.
        boxes: The k boxes.
    """

    has_image: Bools
    image_time_ns: Ints
    camera: Ints
    boxes: Boxes2d


@dataclass(frozen=True)
class PictureMatches:
    """What the pictures of a frame say of its 3D boxes.

    Attributes:
        view: (b,) number of the view with the largest part of the 3D box, `NO_CAMERA` where none has any.
        iou: (b,) IoU of the rectangle around its projection with the best 2D box there; 0 where none overlaps it,
            `NO_IOU` without a view.
        name: (b,) name of the 2D box that shows it: the best one of each other; empty for none.
        score: (b,) confidence of that 2D box, 0 for none.
    """

    view: Ints
    iou: Floats
    name: Array
    score: Floats


def match_boxes(views: Sequence[CameraView], total: int, *, min_iou: float) -> PictureMatches:
    """Return which 2D box shows each 3D box.

    A 3D box is looked for in one picture: where its projection, clipped to the picture, is largest, times the share of
    it that is inside.

    Args:
        views: The pictures of a frame.
        total: Number b of 3D boxes.
        min_iou: IoU from which on a 2D box shows a 3D box.
    """
    view: Ints = np.full(total, NO_CAMERA, dtype=np.int64)
    iou, score = np.full(total, NO_IOU), np.zeros(total)
    name = [""] * total
    projected = [projected_boxes(each.camera, each.corners_m) for each in views]
    weight = [
        np.where(share > 0, share * (edges[:, 2:] - edges[:, :2]).prod(axis=1), 0.0)
        for edges, share in projected
    ]
    if views and total:
        best = np.argmax(weight, axis=0)
        view = np.where(np.max(weight, axis=0) > 0, best, NO_CAMERA)
    for number, (each, (edges, _)) in enumerate(zip(views, projected, strict=True)):
        rows = np.flatnonzero(view == number)
        boxes = merge_riders(each.boxes)
        ious = iou_of_rectangles(edges[rows], boxes.xyxy_px)
        iou[rows] = ious.max(axis=1, initial=0.0)
        if not ious.size:
            continue
        shown_by, shows = ious.argmax(axis=1), ious.argmax(axis=0)
        is_shown = (shows[shown_by] == np.arange(len(rows))) & (iou[rows] >= min_iou)
        for row in np.flatnonzero(is_shown).tolist():
            name[rows[row]] = str(boxes.name[shown_by[row]])
            score[rows[row]] = boxes.score[shown_by[row]]
    return PictureMatches(view, iou, np.array(name, dtype=np.str_), score)


class BoxMatcher:
    """The cameras and poses of a drive, to compare its 3D boxes with 2D boxes."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        times_ns: Sequence[int],
        world_from_ego: Sequence[Array],
        min_iou: float,
    ) -> None:
        """Take the cameras and the poses.

        Args:
            cameras: The cameras of the drive.
            times_ns: (T,) times of its frames.
            world_from_ego: (T, 4, 4) poses of its frames.
            min_iou: IoU from which on a 2D box shows a 3D box.
        """
        self._cameras, self._min_iou = tuple(cameras), min_iou
        self._times_ns, self._poses = list(times_ns), np.asarray(world_from_ego).reshape(-1, 4, 4)

    def match(self, step: int, boxes: Boxes, velocity_mps: Array, pictures: FramePictures) -> PictureMatches:
        """Return which 2D box shows each 3D box of a frame; views are numbered as the drive's cameras.

        Args:
            step: Number of the frame in the drive, from 0.
            boxes: b boxes in its ego axes.
            velocity_mps: (b, 3) their velocity over the ground.
            pictures: The pictures of the frame.
        """
        shown = np.flatnonzero(pictures.has_image)
        places_m = corners(boxes).reshape(-1, 3)
        views = []
        for number in shown.tolist():
            time_ns = int(pictures.image_time_ns[number])
            moved_m = move_to_time(
                places_m,
                np.repeat(velocity_mps, 8, axis=0),
                (time_ns - self._times_ns[step]) * 1e-9,
                self._poses[step],
                pose_at(self._times_ns, self._poses, time_ns),
            )
            here = pictures.boxes[pictures.camera == number]
            views.append(CameraView(self._cameras[number], moved_m.reshape(-1, 8, 3), here))
        found = match_boxes(views, len(boxes), min_iou=self._min_iou)
        # The last place is that of no view.
        return replace(found, view=np.append(shown, NO_CAMERA)[found.view])
