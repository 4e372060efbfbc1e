"""Features of pixels brought to the points of a sweep: UP-VL, Algorithm 1, lines 1 and 2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.perception.visual.config import VisibilityConfig
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import (
    NO_VIEW,
    OCCLUDED,
    SEEN,
    best_camera,
    move_to_time,
    sample_bilinear,
    visibility,
)
from upvl_cli.types import Array, Bools, Camera, Floats, Image, Ints


@dataclass(frozen=True)
class SweepVisibility:
    """What the cameras see of one sweep, before any network embeds the pictures.

    Attributes:
        state: (n,) of each point, as in `views`.
        camera: (n,) number of the camera that sees it best, -1 for none.
        images: Of each camera its picture, if there is one, and (n, 2) the pixels of the points in it.
        counts: How many points each camera sees, and how many are occluded or out of view.
    """

    state: Ints
    camera: Ints
    images: Sequence[tuple[Image | None, Floats]]
    counts: Mapping[str, int]

    def features(self, embed: Callable[[Array], Floats], basis: Basis) -> Ints:
        """Return (s, COMPONENTS) int8 features of the seen points, in their order.

        Args:
            embed: Gives (h', w', d) features of an (h, w, 3) picture.
            basis: The reduced space of the features.
        """
        codes = np.zeros((len(self.state), COMPONENTS), dtype=np.int8)
        for number, (image, uv_px) in enumerate(self.images):
            seen = np.flatnonzero(self.camera == number)
            if image is not None and len(seen):
                height_px, width_px, _ = image.rgb.shape
                cells = basis.project(embed(image.rgb))
                codes[seen] = basis.quantize(sample_bilinear(cells, uv_px[seen], width_px, height_px))
        return np.asarray(codes[self.state == SEEN])


class CameraRig:
    """The cameras of one drive, and when and where its frames were taken."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        times_ns: Sequence[int],
        world_from_ego: Sequence[Array],
        config: VisibilityConfig,
    ) -> None:
        """Take the cameras and the poses.

        Args:
            cameras: Calibrated cameras.
            times_ns: (T,) times of the frames.
            world_from_ego: (T, 4, 4) poses of the frames.
            config: Limits of the visibility test.
        """
        self.cameras = tuple(cameras)
        self._times_ns = list(times_ns)
        self._poses = np.asarray(world_from_ego, dtype=np.float64).reshape(-1, 4, 4)
        self._config = config

    def visibility(
        self,
        step: int,
        xyz_ego_m: Array,
        is_above_ground: Bools,
        velocity_mps: Array | None,
        images: Sequence[Image | None],
        given_px: Sequence[Floats | None] = (),
    ) -> SweepVisibility:
        """Return which points of one sweep the cameras see.

        Args:
            step: Number of the frame in the drive, from 0.
            xyz_ego_m: (n, 3) points of its sweep.
            is_above_ground: (n,) whether each is above the ground.
            velocity_mps: (n, 3) their motion over the ground; None takes them as static.
            images: One picture a camera, None where it is missing.
            given_px: (n, 2) pixels of the points in each picture where the data set gives them; None, or none
                at all, takes the camera's calibration.
        """
        views = [
            visibility(
                camera,
                self._move_to_image_time(step, xyz_ego_m, velocity_mps, image),
                is_above_ground,
                self._config,
                pixels,
            )
            for camera, image, pixels in zip(
                self.cameras, images, given_px or [None] * len(images), strict=True
            )
        ]
        best = best_camera(views, len(xyz_ego_m))
        counts: Counter[str] = Counter()
        for number, camera in enumerate(self.cameras):
            counts[f"seen by {camera.name}"] = int((best.camera == number).sum())
        counts["occluded"] = int((best.state == OCCLUDED).sum())
        counts["no view"] = int((best.state == NO_VIEW).sum())
        counts["pictures missing"] = sum(image is None for image in images)
        pixels = [(image, view.uv_px) for image, view in zip(images, views, strict=True)]
        return SweepVisibility(best.state, best.camera, pixels, counts)

    def _move_to_image_time(
        self, step: int, xyz_ego_m: Array, velocity_mps: Array | None, image: Image | None
    ) -> Floats:
        """Return (n, 3) points when a picture is taken; NaN without a picture, which shows none of them."""
        if image is None:
            return np.full((len(xyz_ego_m), 3), np.nan)
        return move_to_image_time(self._times_ns, self._poses, step, xyz_ego_m, velocity_mps, image)


def move_to_image_time(
    times_ns: Sequence[int],
    world_from_ego: Array,
    step: int,
    xyz_ego_m: Array,
    velocity_mps: Array | None,
    image: Image,
) -> Floats:
    """Return (n, 3) points of a sweep when a picture is taken, in the ego axes of that time.

    Args:
        times_ns: (T,) times of the frames of the drive.
        world_from_ego: (T, 4, 4) poses of the frames.
        step: Number of the points' frame in the drive, from 0.
        xyz_ego_m: (n, 3) the points.
        velocity_mps: (n, 3) their motion over the ground; None takes them as static.
        image: The picture.
    """
    delay_s = (image.time_ns - times_ns[step]) * 1e-9
    world_from_image = pose_at(times_ns, world_from_ego, image.time_ns)
    return move_to_time(xyz_ego_m, velocity_mps, delay_s, world_from_ego[step], world_from_image)
