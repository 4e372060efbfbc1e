"""Features of pixels brought to the points of a sweep: UP-VL, Algorithm 1, lines 1 and 2."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.perception.visual.open_vocabulary import KEPT, Basis
from upvl_cli.perception.visual.views import OCCLUDED, SEEN, View, at_time, best, sampled, view
from upvl_cli.types import Array, Bools, Camera, Floats, Image, Ints


@dataclass(frozen=True)
class Sight:
    """What the cameras see of one sweep, before any network has looked at the pictures.

    Attributes:
        state: (n,) of each point, as in `views`.
        camera: (n,) place of the camera that sees it best, -1 for none.
        pictures: Of each camera its picture, if there is one, and where in it the points appear.
        counts: How many points each camera sees, and how many are hidden or out of view.
    """

    state: Ints
    camera: Ints
    pictures: Sequence[tuple[Image | None, Floats]]
    counts: Mapping[str, int]

    def features(self, embed: Callable[[Array], Floats], basis: Basis) -> Ints:
        """(s, KEPT) int8 features of the seen points, in their order.

        Args:
            embed: (h', w', d) features of an (h, w, 3) picture.
            basis: Where features are kept.
        """
        codes = np.zeros((len(self.state), KEPT), dtype=np.int8)
        for number, (image, uv_px) in enumerate(self.pictures):
            of = np.flatnonzero(self.camera == number)
            if image is not None and len(of):
                height_px, width_px, _ = image.rgb.shape
                cells = basis.kept(embed(image.rgb))
                codes[of] = basis.rounded(sampled(cells, uv_px[of], width_px, height_px))
        return np.asarray(codes[self.state == SEEN])


class Look:
    """Looks at the sweeps of one drive through its cameras."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        times_ns: Sequence[int],
        world_from_ego: Sequence[Array],
        *,
        border_px: float,
        gap_deg: float,
        closer_m: float,
        closer_share: float,
        glass_m: float,
    ) -> None:
        """Take the cameras, when the frames were, and where; the rest as in `views.view`."""
        self.cameras = tuple(cameras)
        self._times_ns = list(times_ns)
        self._poses = np.asarray(world_from_ego, dtype=np.float64).reshape(-1, 4, 4)
        self._limits = {
            "border_px": border_px, "gap_deg": gap_deg, "closer_m": closer_m, "closer_share": closer_share,
            "glass_m": glass_m,
        }  # fmt: skip

    def sight(
        self,
        step: int,
        xyz_ego_m: Array,
        stands: Bools,
        velocity_mps: Array | None,
        images: Sequence[Image | None],
    ) -> Sight:
        """See one sweep.

        Args:
            step: Which frame of the drive.
            xyz_ego_m: (n, 3) its points.
            stands: (n,) whether each is above the ground.
            velocity_mps: (n, 3) their motion over the ground; None lets them stand.
            images: One picture a camera, None where it is missing.
        """
        views = [
            self._view(step, camera, xyz_ego_m, stands, velocity_mps, image)
            for camera, image in zip(self.cameras, images, strict=True)
        ]
        chosen = best(views, len(xyz_ego_m))
        counts: Counter[str] = Counter()
        for number, camera in enumerate(self.cameras):
            counts[f"seen by {camera.name}"] = int((chosen.camera == number).sum())
        counts["occluded"] = int((chosen.state == OCCLUDED).sum())
        counts["no view"] = int((chosen.state > OCCLUDED).sum())
        counts["pictures missing"] = sum(image is None for image in images)
        pictures = [(image, one.uv_px) for image, one in zip(images, views, strict=True)]
        return Sight(chosen.state, chosen.camera, pictures, counts)

    def _view(
        self,
        step: int,
        camera: Camera,
        xyz_ego_m: Array,
        stands: Bools,
        velocity_mps: Array | None,
        image: Image | None,
    ) -> View:
        if image is None:
            xyz_ego_m = np.full((len(xyz_ego_m), 3), np.nan)
        else:
            xyz_ego_m = at_picture(self._times_ns, self._poses, step, xyz_ego_m, velocity_mps, image)
        return view(camera, xyz_ego_m, stands, **self._limits)


def at_picture(
    times_ns: Sequence[int],
    world_from_ego: Array,
    step: int,
    xyz_ego_m: Array,
    velocity_mps: Array | None,
    image: Image,
) -> Floats:
    """(n, 3) where the points of a sweep are when a picture is taken, in the car's axes of that time.

    Args:
        times_ns: (T,) when the frames of the drive were.
        world_from_ego: (T, 4, 4) where the car was.
        step: Which frame the points are of.
        xyz_ego_m: (n, 3) the points.
        velocity_mps: (n, 3) their motion over the ground; None lets them stand.
        image: The picture.
    """
    late_s = (image.time_ns - times_ns[step]) * 1e-9
    then = pose_at(times_ns, world_from_ego, image.time_ns)
    return at_time(xyz_ego_m, velocity_mps, late_s, world_from_ego[step], then)
