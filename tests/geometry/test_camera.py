"""Points to pixels and back, with and without distortion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project, rays
from upvl_cli.types import Camera

# x right, y down, z along the view, for a camera that looks along the car's x axis.
FORWARD = np.array([[0.0, 0, 1, 1.5], [-1, 0, 0, 0.2], [0, -1, 0, 1.8], [0, 0, 0, 1]])
NONE = [0.0] * 5


def camera(distortion: list[float], **changes: Any) -> Camera:
    settings: dict[str, Any] = {
        "name": "front",
        "width_px": 640,
        "height_px": 480,
        "intrinsic": [[500, 0, 320], [0, 510, 240], [0, 0, 1]],
        "distortion": distortion,
        "ego_from_camera": FORWARD,
    }
    return Camera(**settings | changes)


PLACES = [
    ("straight ahead", [11.5, 0.2, 1.8], [320, 240], 10, True),
    ("a metre to the left", [11.5, 1.2, 1.8], [270, 240], 10, True),
    ("a metre up", [11.5, 0.2, 2.8], [320, 189], 10, True),
    ("left edge of the image", [11.5, 0.2 + 6.41, 1.8], [-0.5, 240], 10, True),
    ("beyond the left edge", [11.5, 0.2 + 6.42, 1.8], [-1, 240], 10, False),
    ("right edge of the image", [11.5, 0.2 - 6.39, 1.8], [639.5, 240], 10, False),
    ("behind", [-8.5, 0.2, 1.8], [math.nan, math.nan], -10, False),
    ("in the lens", [1.5, 0.2, 1.8], [math.nan, math.nan], 0, False),
    ("not a number", [math.nan, 0, 0], [math.nan, math.nan], math.nan, False),
]


@pytest.mark.parametrize(
    ("xyz", "pixel", "depth_m", "seen"), [c[1:] for c in PLACES], ids=[c[0] for c in PLACES]
)
def test_pinhole(xyz: list[float], pixel: list[float], depth_m: float, seen: bool) -> None:
    uv_px, depth, visible = project(camera(NONE), [xyz])
    np.testing.assert_allclose(uv_px[0], pixel, atol=1e-9)
    np.testing.assert_allclose(depth, [depth_m])
    assert visible.tolist() == [seen]


def test_distortion_by_hand() -> None:
    # x / z = 0.3, y / z = 0.4, so r^2 = 0.25, with each coefficient a power of ten apart.
    k1, k2, p1, p2, k3 = 0.1, 0.01, 0.001, 0.002, 0.003
    radial = 1 + 0.1 * 0.25 + 0.01 * 0.0625 + 0.003 * 0.015625
    x = 0.3 * radial + 2 * p1 * 0.12 + p2 * (0.25 + 2 * 0.09)
    y = 0.4 * radial + p1 * (0.25 + 2 * 0.16) + 2 * p2 * 0.12
    lens = camera([k1, k2, p1, p2, k3], ego_from_camera=np.eye(4), width_px=1000, height_px=1000)
    uv_px, _, visible = project(lens, [[3, 4, 10]])
    np.testing.assert_allclose(uv_px[0], [320 + 500 * x, 240 + 510 * y], atol=1e-9)
    assert visible.all()


LENSES = [
    ("none", NONE),
    ("barrel", [-0.35, 0.12, 0.0005, -0.0003, -0.01]),
    ("pincushion", [0.2, 0.05, -0.001, 0.002, 0.0]),
    ("strong barrel", [-0.2, 0.0, 0.0, 0.0, 0.0]),
]


@pytest.mark.parametrize("distortion", [lens[1] for lens in LENSES], ids=[lens[0] for lens in LENSES])
def test_a_ray_comes_back_to_its_pixel(distortion: list[float]) -> None:
    lens = camera(distortion)
    uv_px = np.stack(np.meshgrid(np.linspace(0, 639, 33), np.linspace(0, 479, 25)), axis=-1).reshape(-1, 2)
    direction = rays(lens, uv_px)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1)
    distance_m = np.random.default_rng(0).uniform(1, 80, (len(uv_px), 1))
    again, depth_m, visible = project(lens, FORWARD[:3, 3] + direction * distance_m)
    np.testing.assert_allclose(again, uv_px, atol=1e-6)
    assert visible.all()
    assert (depth_m > 0).all()


def test_points_beyond_the_turning_point_are_not_seen() -> None:
    # 1 - 3 * 0.3 r^2 = 0 at r = 1.054: farther out the lens formula comes back into the image.
    lens = camera([-0.3, 0, 0, 0, 0], ego_from_camera=np.eye(4), width_px=3000, height_px=3000)
    uv_px, _, visible = project(lens, [[1.05, 0, 1], [1.06, 0, 1], [1.8, 0, 1]])
    assert visible.tolist() == [True, False, False]
    assert np.isnan(uv_px[1:]).all()
    farthest = 1.0540925 * (1 - 0.3 * 1.0540925**2)
    inside, outside = 320 + 500 * (farthest - 1e-3), 320 + 500 * (farthest + 1e-3)
    direction = rays(lens, [[inside, 240], [outside, 240]])
    assert np.isfinite(direction[0]).all()
    assert np.isnan(direction[1]).all()


def test_empty() -> None:
    uv_px, depth_m, visible = project(camera(NONE), np.zeros((0, 3)))
    assert (uv_px.shape, depth_m.shape, visible.shape) == ((0, 2), (0,), (0,))
    assert project(camera(NONE), [])[0].shape == (0, 2)
    assert rays(camera(NONE), []).shape == (0, 3)


@pytest.mark.parametrize("depth_m", [0.0, -0.5, -2.0])
def test_a_point_beside_or_just_behind_the_lens_has_no_pixel(depth_m: float) -> None:
    """Divided by a negative depth it would land in the image, mirrored."""
    camera = Camera("c", 100, 100, np.array([[50.0, 0, 50], [0, 50, 50], [0, 0, 1]]), np.zeros(5), np.eye(4))
    uv_px, depth, inside = project(camera, np.array([[0.1, 0.1, depth_m], [0.1, 0.1, 1.0]]))
    assert np.isnan(uv_px[0]).all()
    np.testing.assert_allclose(uv_px[1], [55, 55])
    assert depth.tolist() == [depth_m, 1.0]
    assert inside.tolist() == [False, True]


FISHEYES = [
    ("equidistant", [0.0] * 4),
    ("real", [-0.03, 0.005, -0.002, 0.0003]),
    ("strong", [0.05, 0.02, 0.0, 0.0]),
]


def test_fisheye_by_hand() -> None:
    """A point 45 degrees off the axis lies a quarter of pi, times the polynomial, from the center."""
    angle = math.pi / 4
    bent = angle * (1 + 0.1 * angle**2 + 0.02 * angle**4 + 0.003 * angle**6 + 0.0004 * angle**8)
    lens = camera(
        [0.1, 0.02, 0.003, 0.0004], distortion_model="fisheye", ego_from_camera=np.eye(4), width_px=2000
    )
    uv_px, _, visible = project(lens, [[3, 0, 3], [0, 0, 5], [0.6, 0.8, 1]])
    np.testing.assert_allclose(
        uv_px, [[320 + 500 * bent, 240], [320, 240], [320 + 300 * bent, 240 + 408 * bent]]
    )
    assert visible[:2].all()


@pytest.mark.parametrize("distortion", [lens[1] for lens in FISHEYES], ids=[lens[0] for lens in FISHEYES])
def test_a_ray_of_a_fisheye_comes_back_to_its_pixel(distortion: list[float]) -> None:
    lens = camera(distortion, distortion_model="fisheye", intrinsic=[[230, 0, 320], [0, 230, 240], [0, 0, 1]])
    uv_px = np.stack(np.meshgrid(np.linspace(30, 610, 33), np.linspace(0, 479, 25)), axis=-1).reshape(-1, 2)
    uv_px = uv_px[np.linalg.norm(uv_px - [320, 240], axis=1) < 230 * 1.35]  # some 80 degrees off the axis
    again, depth_m, visible = project(lens, FORWARD[:3, 3] + rays(lens, uv_px) * 20)
    np.testing.assert_allclose(again, uv_px, atol=1e-6)
    assert visible.all() and (depth_m > 0).all()


def test_a_fisheye_that_turns_back_shows_nothing_beyond() -> None:
    # The slope 1 - 3 * 0.2 a^2 is 0 at an angle of 1.291, whose tangent is 3.484.
    lens = camera([-0.2, 0, 0, 0], distortion_model="fisheye", ego_from_camera=np.eye(4), width_px=3000)
    assert project(lens, [[3.4, 0, 1], [3.6, 0, 1]])[2].tolist() == [True, False]


@pytest.mark.parametrize(("model", "count"), [("fisheye", 5), ("brown", 4)])
def test_a_lens_has_the_coefficients_of_its_model(model: str, count: int) -> None:
    with pytest.raises(BadInput, match="distortion must be finite and of shape"):
        camera([0.0] * count, distortion_model=model)
