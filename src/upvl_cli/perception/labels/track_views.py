"""Where the objects of one drive appear in its pictures, and what the model sees there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.boxes import corners, pairs_inside
from upvl_cli.geometry.camera import project
from upvl_cli.perception.labels.config import LookCropConfig
from upvl_cli.perception.labels.look_crops import cut, look, object_rectangle
from upvl_cli.perception.labels.looks import LookCandidates, sharpness
from upvl_cli.perception.visual.pixel_features import move_to_image_time
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.types import Array, Boxes, Camera, Floats, Image, Ints, concat

MAX_POINTS = 64  # of an object in a look: more of them change its mean little


class FrameObjects(NamedTuple):
    """The labels of one frame and its sweep.

    Attributes:
        boxes: b labels.
        track_id: (b,) their tracks.
        velocity_mps: (b, 3) their motion over the ground, in the axes of the boxes.
        xyz_m: (n, 3) points of the sweep, in the same axes.
        state: (n,) whether a camera sees each (`views.SEEN`).
        camera: (n,) which one sees it best.
        background: (n,) 1 background, else 0 or -1.
    """

    boxes: Boxes
    track_id: Ints
    velocity_mps: Floats
    xyz_m: Array
    state: Ints
    camera: Ints
    background: Ints

    def own_points(self) -> tuple[Ints, Ints]:
        """Return (box, point) pairs of the points of objects: those in a box that are not seen as background."""
        point = np.flatnonzero((self.background != 1) | (self.state != SEEN))
        box, inside = pairs_inside(self.xyz_m[point], self.boxes, margin_m=0.0)
        return box, point[inside]


class ObjectLook(NamedTuple):
    """One look.

    Attributes:
        candidate: Number of the candidate that it is a look at.
        vector: (d,) feature of the object, of length 1.
        sharpness: `looks.sharpness` of the part of the picture.
    """

    candidate: int
    vector: Floats
    sharpness: float


class TrackViews:
    """The cameras of one drive, and when and where its frames were taken."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        times_ns: Sequence[int],
        world_from_ego: Sequence[Array],
        config: LookCropConfig,
    ) -> None:
        """Take the cameras and the poses.

        Args:
            cameras: Calibrated cameras, numbered as in `FrameObjects.camera`.
            times_ns: (T,) times of the frames.
            world_from_ego: (T, 4, 4) poses of the frames.
            config: How objects are cut out.
        """
        self.cameras = tuple(cameras)
        self._times_ns = list(times_ns)
        self._poses = np.asarray(world_from_ego, dtype=np.float64).reshape(-1, 4, 4)
        self._config = config

    def candidates(self, step: int, objects: FrameObjects) -> LookCandidates:
        """Return which cameras see which labels of a frame; pictures are taken to be of the time of the frame.

        Args:
            step: Number of the frame in the drive, from 0.
            objects: Its labels.
        """
        box, point = objects.own_points()
        total = np.bincount(box, minlength=len(objects.boxes))
        corners_m, found = corners(objects.boxes), []
        for number, camera in enumerate(self.cameras):
            is_seen = (objects.state[point] == SEEN) & (objects.camera[point] == number)
            own, count = np.unique(box[is_seen], return_counts=True)
            if not len(own):
                continue
            uv_px = project(camera, objects.xyz_m[point[is_seen]])[0]
            ends = np.cumsum(count)
            parts = [
                object_rectangle(camera, corners_m[each], pixels)
                for each, pixels in zip(own.tolist(), np.split(uv_px, ends[:-1]), strict=True)
            ]
            rectangle = np.array(parts)
            size_px = rectangle[:, 2:] - rectangle[:, :2]
            found.append(
                LookCandidates(
                    step=np.full(len(own), step),
                    time_s=np.full(len(own), self._times_ns[step] * 1e-9),
                    camera=np.full(len(own), number),
                    box=own,
                    track_id=objects.track_id[own],
                    size_px=size_px.max(axis=1),
                    area_px=size_px.prod(axis=1),
                    seen_share=count / total[own],
                )
            )
        return concat(found, LookCandidates)

    def looks(
        self,
        objects: FrameObjects,
        candidates: LookCandidates,
        numbers: Ints,
        image: Image,
        given_px: Floats | None,
        embed: Callable[[Array], Floats],
    ) -> list[ObjectLook]:
        """Look at some objects in one picture.

        Args:
            objects: The labels of its frame.
            candidates: Those of the whole drive.
            numbers: (k,) which of them are of this frame and camera.
            image: The picture.
            given_px: (n, 2) pixels of the sweep's points in it where the data set gives them.
            embed: Gives (h', w', d) features of an (h, w, 3) picture.
        """
        box, point = objects.own_points()
        step, number = int(candidates.step[numbers[0]]), int(candidates.camera[numbers[0]])
        camera, corners_m, found = self.cameras[number], corners(objects.boxes), []
        is_seen = (objects.state[point] == SEEN) & (objects.camera[point] == number)
        for index in numbers.tolist():
            row = int(candidates.box[index])
            own = point[is_seen & (box == row)]
            own = own[:: -(-len(own) // MAX_POINTS)]
            shown_m = np.concatenate([objects.xyz_m[own], corners_m[row]])
            velocity_mps = np.broadcast_to(objects.velocity_mps[row], shown_m.shape)
            moved_m = move_to_image_time(self._times_ns, self._poses, step, shown_m, velocity_mps, image)
            uv_px = project(camera, moved_m[: len(own)])[0] if given_px is None else given_px[own]
            uv_px = uv_px[np.isfinite(uv_px).all(axis=1)]
            if not len(uv_px):
                continue
            rectangle = object_rectangle(camera, moved_m[len(own) :], uv_px)
            if (rectangle[2:] - rectangle[:2]).min() < 1:
                continue
            crop = cut(image.rgb, rectangle, self._config)
            found.append(ObjectLook(index, look(embed, crop, uv_px), sharpness(crop.rgb)))
        return found
