"""What each point of a sweep takes from the pictures of its time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import from_yaw
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.pixel_features import CameraRig, move_to_image_time
from upvl_cli.perception.visual.views import NO_CAMERA, NO_VIEW, OCCLUDED, SEEN
from upvl_cli.stages.extract_vl import ExtractVlConfig
from upvl_cli.types import Array, Camera, Image

CONFIG = load(ExtractVlConfig, Path(__file__).parents[3] / "stages" / "extract-vl.toml").visibility
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
INTRINSIC = np.array([[50.0, 0, 31.5], [0, 50, 19.5], [0, 0, 1]])
FRONT = Camera("front", 64, 40, INTRINSIC, np.zeros(5), AHEAD)
BACK = Camera("back", 64, 40, INTRINSIC, np.zeros(5), from_yaw(np.pi, np.zeros(3)) @ AHEAD)
BASIS = Basis(np.zeros(3), np.vstack([np.eye(3), np.zeros((61, 3))]), np.full(COMPONENTS, 0.01), 1.0)
TIMES_NS = [0, 100_000_000, 200_000_000]
POSES = np.stack([from_yaw(0.0, np.array([10.0 * step, 0, 0])) for step in range(3)])  # 100 m/s, easy to see
XYZ = np.array([[20.0, 2, 0], [20, -2, 0], [-20, 2, 0], [0, 20, 0]])


def place_colors(rgb: Array) -> Array:
    """One feature a pixel: its column, its row, and the brightness of the picture."""
    height, width, _ = rgb.shape
    row, column = np.mgrid[:height, :width]
    return np.stack([column, row, np.full_like(row, rgb.max())], axis=2).astype(np.float32)


def rig(*cameras: Camera) -> CameraRig:
    return CameraRig(cameras, TIMES_NS, list(POSES), CONFIG)


def image(time_ns: int, brightness: int = 100) -> Image:
    return Image(np.full((40, 64, 3), brightness, np.uint8), time_ns)


def test_each_seen_point_has_the_feature_of_its_own_pixel_in_its_own_camera() -> None:
    seen = rig(FRONT, BACK).visibility(0, XYZ, np.zeros(4, bool), None, [image(0, 50), image(0, 200)])
    assert seen.camera.tolist() == [0, 0, 1, NO_CAMERA]
    assert seen.state.tolist() == [SEEN, SEEN, SEEN, NO_VIEW]
    uv = np.concatenate([project(FRONT, XYZ[:2])[0], project(BACK, XYZ[2:3])[0]])
    expected = np.column_stack([uv, [50, 50, 200]])
    found = BASIS.dequantize(seen.features(place_colors, BASIS))[:, :3]
    lengths = np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(found, expected / lengths, atol=0.012)
    assert seen.counts == {
        "seen by front": 2, "seen by back": 1, "occluded": 0, "no view": 1, "pictures missing": 0
    }  # fmt: skip


def test_a_missing_picture_sees_nothing_and_is_counted() -> None:
    seen = rig(FRONT, BACK).visibility(0, XYZ, np.zeros(4, bool), None, [None, image(0)])
    assert seen.camera.tolist() == [NO_CAMERA, NO_CAMERA, 1, NO_CAMERA]
    assert seen.counts["pictures missing"] == 1 and seen.counts["no view"] == 3
    assert seen.features(place_colors, BASIS).shape == (1, COMPONENTS)


@pytest.mark.parametrize("delay_ns", [-40_000_000, 0, 50_000_000])
def test_a_point_is_where_its_own_motion_and_that_of_the_car_have_brought_it(delay_ns: int) -> None:
    """Between frames 1 and 2 the car goes 100 m/s, the object 30 m/s ahead and 10 m/s to the left."""
    velocity = np.array([[30.0, 10, 0]])
    found = move_to_image_time(TIMES_NS, POSES, 1, XYZ[:1], velocity, image(TIMES_NS[1] + delay_ns))
    delay_s = delay_ns * 1e-9
    np.testing.assert_allclose(found, XYZ[:1] + [(30 - 100) * delay_s, 10 * delay_s, 0], atol=1e-9)
    static = move_to_image_time(TIMES_NS, POSES, 1, XYZ[:1], None, image(TIMES_NS[1] + delay_ns))
    np.testing.assert_allclose(static, XYZ[:1] - [100 * delay_s, 0, 0], atol=1e-9)


def test_the_rig_projects_points_where_they_are_at_the_time_of_the_picture() -> None:
    late = image(TIMES_NS[1] + 50_000_000)
    velocity = np.tile([0.0, -40, 0], (4, 1))
    seen = rig(FRONT).visibility(1, XYZ, np.zeros(4, bool), velocity, [late])
    ((_, uv_px),) = seen.images
    np.testing.assert_allclose(uv_px[:2], project(FRONT, XYZ[:2] + [-5, -2, 0])[0], atol=1e-9)


def test_without_cameras_no_point_is_seen() -> None:
    seen = rig().visibility(0, XYZ, np.zeros(4, bool), None, [])
    assert (seen.state == NO_VIEW).all() and (seen.camera == NO_CAMERA).all()
    assert seen.features(place_colors, BASIS).shape == (0, COMPONENTS)


def test_an_occluded_point_is_counted_as_such() -> None:
    """The second of two points on one ray is hidden; a third one is out of view."""
    xyz = np.array([[10.0, 0, 0], [30, 0, 0], [10, 0.5, 0], [10, -0.5, 0], [0, 20, 0]])
    seen = rig(FRONT).visibility(0, xyz, np.zeros(5, bool), None, [image(0)])
    assert seen.counts["occluded"] == (seen.state == OCCLUDED).sum() == 1
    assert seen.counts["no view"] == 1 and seen.counts["seen by front"] == 3


def test_pixels_that_the_data_set_gives_replace_those_of_the_calibration() -> None:
    """Also where it says that a camera does not see a point that its calibration lets it see."""
    given = np.array([[5.0, 6.0], [np.nan, np.nan], [7.0, 8.0], [np.nan, np.nan]])
    seen = rig(FRONT, BACK).visibility(0, XYZ, np.zeros(4, bool), None, [image(0), image(0)], [given, None])
    assert seen.camera.tolist() == [0, NO_CAMERA, 1, NO_CAMERA]  # the third lies behind the camera in front
    found = BASIS.dequantize(seen.features(place_colors, BASIS))[0, :3]
    np.testing.assert_allclose(found, np.array([5, 6, 100]) / np.linalg.norm([5, 6, 100]), atol=0.012)
