"""How far a calibration is off: a made-up yard of boxes before a wall, then a real drive."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.commands.drive_check import sample_drive
from upvl_cli.config.toml import load
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.geometry.camera import project, rays
from upvl_cli.perception.drive_check.cameras import camera_steps, image_sweep_pairs
from upvl_cli.perception.visual.camera_check import CalibrationOffset, ImageSweepPair, estimate_offset
from upvl_cli.perception.visual.edge_agreement import (
    EdgeAgreement,
    downsample,
    downsample_camera,
    edge_strength,
)
from upvl_cli.perception.visual.outlines import LEFT, RIGHT, TOP, Outlines, _sample_spacing, detect_outlines
from upvl_cli.types import Array, Camera, concat

CHECK = load(CheckConfig, Path(__file__).parents[3] / "stages" / "check.toml")
CONFIG = CHECK.camera.calibration
CAMERA = Camera(
    name="front",
    width_px=480,
    height_px=200,
    intrinsic=np.array([[360.0, 0.0, 239.5], [0.0, 360.0, 85.0], [0.0, 0.0, 1.0]]),
    distortion=np.array([-0.05, 0.01, 0.0, 0.0, 0.0]),
    ego_from_camera=np.array(
        [[0.0, 0.0, 1.0, 0.25], [-1.0, 0.0, 0.0, 0.05], [0.0, -1.0, 0.0, -0.1], [0.0, 0.0, 0.0, 1.0]]
    ),
)
GROUND_M, WALL_M = -1.7, 35.0
FAULTS = {
    "1 degree about x": (1, 0, 0, 0, 0, 0),
    "-1 degree about y": (0, -1, 0, 0, 0, 0),
    "1 degree about z": (0, 0, 1, 0, 0, 0),
    "5 cm along x": (0, 0, 0, 5, 0, 0),
    "-5 cm along x": (0, 0, 0, -5, 0, 0),
    "5 cm along y": (0, 0, 0, 0, 5, 0),
    "-5 cm along z": (0, 0, 0, 0, 0, -5),
    "3 degrees about y": (0, 3, 0, 0, 0, 0),
}


def cast(origin: Array, ways: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Range of what each ray meets, and its number: boxes first, then the ground, then the wall."""
    with np.errstate(divide="ignore"):
        slabs = np.stack([(bound[:, None] - origin) / ways for bound in (low, high)])  # (2, boxes, rays, 3)
        ground, wall = (GROUND_M - origin[2]) / ways[:, 2], (WALL_M - origin[0]) / ways[:, 0]
    enter, leave = slabs.min(axis=0).max(axis=-1), slabs.max(axis=0).min(axis=-1)
    hits = np.where((enter < leave) & (enter > 0), enter, np.inf)
    hits = np.concatenate(
        [hits, np.where(ground > 0, ground, np.inf)[None], np.where(wall > 0, wall, np.inf)[None]]
    )
    return hits.min(axis=0), hits.argmin(axis=0)


def turned(camera: Camera, fault: tuple[float, ...]) -> Camera:
    """The camera with a wrong calibration: degrees about its axes, centimetres along them."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.deg2rad(fault[:3])).as_matrix()
    motion[:3, 3] = np.array(fault[3:]) / 100
    return replace(camera, ego_from_camera=camera.ego_from_camera @ motion)


def yard(seed: int) -> ImageSweepPair:
    """What the LiDAR, in the origin, and the true camera see of some boxes of several colours."""
    rng = np.random.default_rng(seed)
    at = np.stack([rng.uniform(3.5, 22, 14), rng.uniform(-0.55, 0.55, 14)], axis=1)
    at[:, 1] *= at[:, 0]
    half = rng.uniform([0.1, 0.1, 0.5], [0.8, 0.8, 2.2], (14, 3))
    low = np.column_stack([at - half[:, :2], np.full(14, GROUND_M)])
    high = np.column_stack([at + half[:, :2], GROUND_M + half[:, 2]])
    azimuth, elevation = np.meshgrid(np.deg2rad(np.arange(-45, 45, 0.2)), np.deg2rad(np.arange(-20, 4, 0.45)))
    level = np.cos(elevation)
    ways = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(
        -1, 3
    )
    range_m, _ = cast(np.zeros(3), ways, low, high)
    range_m += rng.normal(0, 0.02, len(range_m))
    v, u = np.mgrid[: CAMERA.height_px, : CAMERA.width_px].reshape(2, -1)
    seen = rays(CAMERA, np.stack([u, v], axis=1))
    _, what = cast(CAMERA.ego_from_camera[:3, 3], seen, low, high)
    grey = rng.uniform(30, 220, 16)[what] + rng.normal(0, 3, len(what))
    rgb = np.repeat(grey.reshape(CAMERA.height_px, CAMERA.width_px, 1), 3, axis=2)
    kept = range_m < 60
    return ImageSweepPair(np.clip(rgb, 0, 255).astype(np.uint8), ways[kept] * range_m[kept, None])


@cache
def yards() -> tuple[ImageSweepPair, ...]:
    return tuple(yard(seed) for seed in range(10))


def estimated(camera: Camera, seen: tuple[ImageSweepPair, ...] | list[ImageSweepPair]) -> CalibrationOffset:
    found = estimate_offset(camera, seen, CONFIG)
    assert found is not None
    return found


def test_outlines_lie_on_the_ends_of_a_box() -> None:
    low, high = np.array([[10.0, -1.0, -1.7]]), np.array([[11.0, 1.0, 0.3]])
    azimuth, elevation = np.meshgrid(np.deg2rad(np.arange(-30, 30, 0.2)), np.deg2rad(np.arange(-15, 8, 0.5)))
    ways = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1).reshape(-1, 3)
    range_m, what = cast(np.zeros(3), ways, low, high)
    camera = turned(CAMERA, (0, 0, 0, 0, 0, 0))
    found = detect_outlines(camera, ways * range_m[:, None], 7, CONFIG.outline)
    assert set(found.view) == {7} and (what == 0).sum() > 300
    near = found[found.xyz_m[:, 2] < 12]
    ego = near.xyz_m @ camera.ego_from_camera[:3, :3].T + camera.ego_from_camera[:3, 3]
    step_m = 10 * np.deg2rad(0.2)
    for side, axis, place_m, within_m in (
        (LEFT, 1, 1.0, 0.4 * step_m),
        (RIGHT, 1, -1.0, 0.4 * step_m),
        (TOP, 2, 0.3, 0.1),
    ):
        assert (near.side == side).sum() > 10
        np.testing.assert_allclose(ego[near.side == side, axis], place_m, atol=within_m)


def test_a_smaller_picture_has_a_smaller_camera() -> None:
    ahead = np.array([[10.0, 1.0, 0.5], [7.0, -2.0, -0.5]])
    small = downsample_camera(CAMERA, 2)
    full_px, small_px = project(CAMERA, ahead)[0], project(small, ahead)[0]
    np.testing.assert_allclose(small_px, (full_px - 0.5) / 2)
    assert downsample(np.zeros((201, 480, 3), np.uint8), 2).shape == (100, small.width_px)


def test_an_edge_is_one_pixel_wide_and_only_across_it() -> None:
    grey = np.zeros((60, 80), np.float32)
    grey[:, 40:] = 200
    across_columns, across_rows = edge_strength(grey, CONFIG.edge_noise)
    assert (across_columns.argmax(axis=1) // 2 == 39 // 2).all() or (across_columns[:, 39:41] > 1).all()
    assert not across_columns[:, :35].any() and not across_rows.any()
    assert ((across_columns > 0).sum(axis=1) <= 2).all(), "a ridge, not the slope beside it"


def test_a_right_calibration_is_not_reported() -> None:
    found = estimated(CAMERA, yards())
    assert not found.is_fault
    assert np.abs(np.rad2deg(found.rotation_rad)).max() < 0.15 and np.abs(found.translation_m).max() < 0.025


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_a_wrong_calibration_is_reported_and_measured(fault: tuple[float, ...]) -> None:
    found = estimated(turned(CAMERA, fault), yards())
    assert found.is_fault
    wrong = found.vector[:6] - np.array([*np.deg2rad(fault[:3]), *(np.array(fault[3:]) / 100)])
    assert np.abs(np.rad2deg(wrong[:3])).max() < 0.2 and np.abs(wrong[3:]).max() < 0.03


def test_nothing_is_said_of_what_is_not_seen() -> None:
    away = turned(CAMERA, (0, 180, 0, 0, 0, 0))
    assert estimate_offset(away, yards(), CONFIG) is None
    assert estimate_offset(CAMERA, [], CONFIG) is None


def agreement(blur_px: float = 3.0, pairs: int = 3) -> EdgeAgreement:
    """Edge agreement of a few yards at the right calibration."""
    seen = yards()[:pairs]
    parts = [
        detect_outlines(CAMERA, pair.xyz_ego_m, number, CONFIG.outline) for number, pair in enumerate(seen)
    ]
    strengths = np.stack([edge_strength(downsample(pair.rgb, 1), CONFIG.edge_noise) for pair in seen])
    return EdgeAgreement(
        CAMERA, concat(parts, Outlines), strengths, blur_px, scene=np.arange(pairs), config=CONFIG
    )


def test_the_gradient_of_the_loss_is_its_slope() -> None:
    fitted = agreement()
    state = np.array([0.3, -0.2, 0.4, -0.5, 0.2, 0.6, 0])
    _, gradient = fitted.loss(state)
    step = 1e-3 * np.eye(7)
    slopes = [(fitted.loss(state + move)[0] - fitted.loss(state - move)[0]) / 2e-3 for move in step]
    np.testing.assert_allclose(gradient, slopes, rtol=0.05, atol=1e-3)  # the lens is not in the gradient


def test_the_prior_pulls_by_its_weight() -> None:
    state = np.array([1.0, 0, 0, 0, 1, 0, 0])
    fitted = agreement(pairs=1)
    value, gradient = fitted.loss(state)
    mean, slope = fitted.evaluate(state)
    # 2 degrees are 10 units, 10 cm are 5.
    assert value + mean.mean() == pytest.approx(0.01 * (1 / 100 + 1 / 25) / 2)
    expected = 0.01 * np.array([1 / 100, 0, 0, 0, 1 / 25, 0, 0])
    np.testing.assert_allclose(gradient + slope.mean(axis=0), expected, atol=1e-9)


def test_only_the_first_parameters_change_where_the_others_are_fixed() -> None:
    start = np.array([0.0, 0, 0, 0.5, -0.5, 0.25, 0])
    found = agreement(pairs=1).maximize(start, 3)
    np.testing.assert_array_equal(found[3:], start[3:])
    assert np.abs(found[:3]).min() > 0


def test_a_side_is_compared_with_edges_across_it_alone() -> None:
    """A picture of upright edges gives upper outlines nothing, and one of level edges side outlines nothing."""
    fitted = agreement(pairs=1)
    for channel, sides in ((0, (LEFT, RIGHT)), (1, (TOP,))):
        strengths = np.zeros((1, 2, CAMERA.height_px, CAMERA.width_px), np.float32)
        strengths[:, channel] = 1
        value, _ = EdgeAgreement(
            CAMERA, fitted.outlines, strengths, 1.0, scene=np.zeros(1, int), config=CONFIG
        ).evaluate(np.zeros(7))
        assert (value > 0)[np.isin(fitted.outlines.side, sides)].mean() > 0.9
        assert not value[~np.isin(fitted.outlines.side, sides)].any()


def test_outlines_outside_of_the_picture_count_nothing() -> None:
    fitted = agreement(pairs=1)
    value, slope = fitted.evaluate(np.zeros(7), np.array([2000.0, 0]))
    assert not value.any() and not slope.any()


def test_a_fault_is_more_than_the_tolerance_and_its_uncertainty() -> None:
    """With sigmas of 0.1 degrees and 1 cm: 2.6 sigmas beyond 0.2 degrees and 1 cm are 0.46 degrees and 3.6 cm."""
    sigma = np.array([*np.full(3, np.deg2rad(0.1)), *np.full(3, 0.01), 0.01])
    for axis, edge in ((0, 0.46), (2, 0.46), (3, 0.36), (5, 0.36)):
        unit = np.eye(7)[axis] * (np.deg2rad(1) if axis < 3 else 0.1)
        for size, gain, faulty in (
            (edge - 0.01, 9, False),
            (edge + 0.01, 9, True),
            (edge + 0.01, 2.9, False),
        ):
            found = CalibrationOffset(
                size * unit, np.diag(sigma**2), gain, np.full(7, 9.0), 9.0, 10, 500, False, CONFIG
            )
            assert found.is_fault is faulty
            assert found.is_doubtful is (size > edge)


def outlines_of(range_m: np.ndarray) -> Outlines:
    """Outlines of a sweep of samples 0.5 degrees apart, 61 rows by 121 columns, with these ranges."""
    azimuth, elevation = np.meshgrid(
        np.deg2rad(np.linspace(30, -30, 121)), np.deg2rad(np.linspace(15, -15, 61))
    )
    ways = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1)
    camera = replace(CAMERA, distortion=np.zeros(5), height_px=400)
    return detect_outlines(camera, (ways * range_m[..., None]).reshape(-1, 3), 0, CONFIG.outline)


def test_a_pole_of_one_column_has_a_left_and_a_right_side() -> None:
    range_m = np.full((61, 121), 30.0)
    range_m[10:50, 60] = 10
    found = outlines_of(range_m)
    near = found[found.xyz_m[:, 2] < 15]
    assert len(found) == len(near), "a wall alone has no outline"
    assert (near.side == LEFT).sum() > 20 and (near.side == RIGHT).sum() > 20
    assert (near.side == TOP).sum() <= 1


def test_the_spacing_of_columns_is_that_to_the_next_sample_on_the_right() -> None:
    u_px = np.add.outer(8.0 * np.arange(20), [0.0, 2.0]).ravel()[1:]  # as many gaps of 6 pixels as of 2
    grid = np.stack(np.meshgrid(u_px, np.arange(20) * 10.0), axis=-1).reshape(-1, 2)
    assert _sample_spacing(grid)[0] == 4.0  # the median of both


def test_a_single_sample_is_no_outline() -> None:
    range_m = np.full((61, 121), 30.0)
    range_m[30, 60] = 10
    assert not len(outlines_of(range_m))


def test_a_surface_that_recedes_or_a_small_step_has_no_outline() -> None:
    assert not len(outlines_of(np.tile(np.linspace(10, 20, 121), (61, 1))))
    small = np.full((61, 121), 10.0)
    small[:, 60:] = 10.9  # less than a tenth
    assert not len(outlines_of(small))
    large = np.full((61, 121), 10.0)
    large[:, 60:] = 11.5
    assert set(outlines_of(large).side) == {RIGHT}


def test_the_covariance_is_the_sandwich_of_curvature_and_gradients_of_independent_parts() -> None:
    """Written out plainly: strips of the picture by spans of time, and shifts of all outlines of one side."""
    fitted, state = agreement(), np.append(np.full(6, 0.1), 0)
    outlines, count = fitted.outlines, len(fitted.outlines)
    rows = [
        (fitted.evaluate(state - move)[1] - fitted.evaluate(state + move)[1]).mean(axis=0) / 0.5
        for move in 0.25 * np.eye(7)
    ]
    curvature = (np.array(rows) + np.array(rows).T) / 2
    curvature[6, 6] = 1e-4  # the car stands: of a delay nothing is seen
    gradient = fitted.evaluate(state)[1] / count
    across = np.clip(fitted._project(np.zeros(7))[0][:, 0] / CAMERA.width_px, 0, 1 - 1e-9)
    spread, parts = np.zeros((7, 7)), 0
    for view in range(3):
        for strip in range(8):
            part = (outlines.view == view) & (across >= strip / 8) & (across < (strip + 1) / 8)
            spread += np.outer(gradient[part].sum(axis=0), gradient[part].sum(axis=0))
            parts += bool(part.any())
    spread *= parts / (parts - 7)  # few parts
    spread += 1e-6 * np.eye(7)
    near = outlines.xyz_m[:, 2] < np.median(outlines.xyz_m[:, 2])
    for side, shift_px in ((LEFT, [0.5, 0]), (RIGHT, [0.5, 0]), (TOP, [0, np.deg2rad(0.1) * 360])):
        change = (
            fitted.evaluate(state, -np.array(shift_px))[1] - fitted.evaluate(state, np.array(shift_px))[1]
        )
        for depth in (near, ~near):
            for half in (across < 0.5, across >= 0.5):
                pull = change[(outlines.side == side) & depth & half].sum(axis=0) / 2 / count
                spread += np.outer(pull, pull)
    expected = np.linalg.inv(curvature) @ spread @ np.linalg.inv(curvature)
    np.testing.assert_allclose(fitted.covariance(state), expected, rtol=1e-6)


@pytest.mark.real
def test_a_real_calibration_is_right_until_it_is_moved(shared: Path) -> None:
    dataset = Kitti(shared / "data/kitti_raw_a")
    drive = dataset.open(dataset.segments[0])
    sample = sample_drive(drive, None, CHECK.sample)
    camera = drive.cameras[0]
    pictures = {step: sample.picture(step, camera.name) for step in camera_steps(sample, CHECK.camera)[::2]}
    seen = list(image_sweep_pairs(sample, {step: image for step, image in pictures.items() if image}))
    assert len(seen) == 10
    assert not estimated(camera, seen).is_fault
    found = estimated(turned(camera, (0, 1, 0, 0, 0, 0)), seen)
    assert found.is_fault and 0.9 < np.degrees(abs(found.vector[1])) < 1.1
