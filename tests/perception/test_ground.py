"""Ground: heights above terrain that is known, and what must not be taken for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import world
from upvl_cli.config.toml import load
from upvl_cli.perception.ground.height import _fit_planes, _Lowest, height_above_ground
from upvl_cli.stages.ground import GroundConfig

STAGE = load(GroundConfig, Path(__file__).parents[2] / "stages" / "ground.toml")
CONFIG, GROUND_M = STAGE.map, STAGE.max_height_m
RINGS = 50
STEPS = 900

Terrain = Callable[[np.ndarray, np.ndarray], np.ndarray]

TERRAINS: dict[str, Terrain] = {
    "flat": lambda x, y: 0 * x,
    "climb of 10 %": lambda x, y: 0.10 * x + 0.02 * y,
    "kerbs of 15 cm": lambda x, y: np.where(np.abs(y) > 6, 0.15, 0.0),
    "hills": lambda x, y: 1.5 * np.sin(x / 15) + 0.8 * np.sin(y / 11),
    "crest": lambda x, y: np.where(x > 0, 0.08 * x, 0.0) - np.where(x > 25, 0.12 * (x - 25), 0.0),
}


def rings(terrain: Terrain, *, fov_rad: float = 2 * np.pi) -> np.ndarray:
    """Ground as a turning LiDAR 1.7 m above flat ground meets it: rings ever further apart, 2 cm of noise."""
    rng = np.random.default_rng(0)
    range_m = 1.7 / np.tan(np.linspace(np.radians(25), np.radians(2), RINGS))
    angle = np.linspace(-fov_rad / 2, fov_rad / 2, round(STEPS * fov_rad / (2 * np.pi)), endpoint=False)
    x, y = (range_m[:, None] * np.cos(angle)).ravel(), (range_m[:, None] * np.sin(angle)).ravel()
    return np.stack([x, y, terrain(x, y) + rng.normal(0, 0.02, len(x))], axis=1)


def block(x_m: float, y_m: float, z_m: float, size_lwh_m: tuple[float, float, float]) -> np.ndarray:
    """Points on the side and the rear of a box that stands at a place, every 10 cm."""
    length, width, height = size_lwh_m
    along, up = np.meshgrid(np.arange(0, length, 0.1), np.arange(0, height, 0.1))
    across, high = np.meshgrid(np.arange(0, width, 0.1), np.arange(0, height, 0.1))
    side = np.stack([along.ravel(), 0 * along.ravel(), up.ravel()], axis=1)
    rear = np.stack([0 * across.ravel(), across.ravel(), high.ravel()], axis=1)
    return np.concatenate([side, rear]) + (x_m, y_m, z_m)


def heights(xyz_m: np.ndarray, prior_z_m: float = 0.0) -> np.ndarray:
    return height_above_ground(xyz_m, prior_z_m, CONFIG)


@pytest.mark.parametrize("name", TERRAINS)
@pytest.mark.parametrize("fov_rad", [2 * np.pi, np.pi / 2], ids=["full circle", "front view"])
def test_ground_has_height_zero(name: str, fov_rad: float) -> None:
    found = heights(rings(TERRAINS[name], fov_rad=fov_rad))
    assert found.dtype == np.float32
    assert np.mean(found > GROUND_M) < 0.001
    # The lowest of many noisy points is some 5 cm too low.
    assert np.abs(np.median(found)) < 0.06


@pytest.mark.parametrize("name", TERRAINS)
def test_a_parked_car_keeps_its_height(name: str) -> None:
    terrain = TERRAINS[name]
    at = [
        (x, y, float(terrain(np.array(x), np.array(y)))) for x, y in ((8.0, 3.0), (-12.0, -4.0), (20.0, 3.0))
    ]
    cars = np.concatenate([block(x, y, z + 0.3, (4.0, 1.8, 1.2)) for x, y, z in at])
    found = heights(np.concatenate([rings(terrain), cars]))[-len(cars) :]
    true_m = cars[:, 2] - terrain(cars[:, 0], cars[:, 1])
    assert np.mean(found[true_m > 0.45] <= GROUND_M) == 0
    assert np.abs(found - true_m).max() < 0.2


def test_the_height_of_the_sensor_does_not_matter() -> None:
    points = np.concatenate([rings(TERRAINS["kerbs of 15 cm"]), block(8, 3, 0.3, (4, 1.8, 1.2))])
    for sensor_m in (0.5, 1.73, 3.0):
        np.testing.assert_allclose(heights(points - (0, 0, sensor_m), -sensor_m), heights(points), atol=1e-4)


def test_mirror_images_below_the_road_do_not_drag_it_down() -> None:
    ground, car = rings(TERRAINS["flat"]), block(8, 3, 0.3, (4, 1.8, 1.2))
    mirrored = [(car * (1, 1, -1) + (0, 0, -0.3)), block(15, -4, -2.5, (2, 2, 0.5))]
    found = heights(np.concatenate([ground, car, *mirrored]))
    assert np.abs(found[: len(ground)]).max() < 0.15
    np.testing.assert_allclose(found[len(ground) : len(ground) + len(car)], car[:, 2], atol=0.1)
    assert found[len(ground) + len(car) :].max() < 0, "what lies below the ground is no object"


def test_a_wall_without_ground_before_it_is_not_its_own_ground() -> None:
    ground = rings(TERRAINS["flat"])
    ground = ground[ground[:, 1] < 9]  # the rest is hidden
    wall = block(-15, 22, 1.5, (30, 0.1, 4))
    found = heights(np.concatenate([ground, wall]))[-len(wall) :]
    np.testing.assert_allclose(found, wall[:, 2], atol=0.2)


def test_far_points_take_the_ground_at_the_rim() -> None:
    far = np.array([[300.0, 0, 1.0], [0.0, -500, 2.0]])
    np.testing.assert_allclose(heights(np.concatenate([rings(TERRAINS["flat"]), far]))[-2:], [1, 2], atol=0.1)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_sweep_of_next_to_nothing(count: int) -> None:
    found = heights(np.array([[5.0, 1, 1.5], [6.0, 1, 2.0]])[:count])
    np.testing.assert_allclose(found, [1.5, 2.0][:count], atol=1e-5)


def test_order_of_points_changes_nothing() -> None:
    points = rings(TERRAINS["hills"])
    order = np.random.default_rng(1).permutation(len(points))
    assert heights(points[order]).tobytes() == heights(points)[order].tobytes()


def test_planes_are_those_of_plain_least_squares() -> None:
    """Where a window holds its ground all over, the damping of the tilt is small but there: it is in both."""
    rng = np.random.default_rng(2)
    size = 20
    row, column = np.indices((size, size)) + rng.uniform(0, 1, (2, size, size))
    lowest = _Lowest(0.1 * row - 0.2 * column + rng.normal(0, 0.1, row.shape), row, column)
    is_ground = rng.uniform(size=row.shape) < 0.5
    found, _ = _fit_planes(lowest, is_ground, np.ones_like(is_ground), row, column, CONFIG)
    for i, j in ((0, 0), (3, 4), (10, 10), (19, 7)):
        for reach in (2, 4, 8):
            window = np.zeros_like(is_ground)
            window[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1] = True
            window &= is_ground
            if window.sum() >= 6:
                break
        xy = np.stack([row[window], column[window]], axis=1)
        damping = np.sqrt(0.1 * (2 * reach + 1) ** 2 / 12 * window.sum()) * np.eye(2)
        z = lowest.z_m[window]
        tilt = np.linalg.lstsq(
            np.concatenate([xy - xy.mean(axis=0), damping]), np.append(z - z.mean(), [0, 0]), rcond=None
        )[0]
        expected = z.mean() + tilt @ ((row[i, j], column[i, j]) - xy.mean(axis=0))
        assert found[i, j] == pytest.approx(expected, abs=1e-9)


def test_the_built_in_street() -> None:
    """Almost all ground is found, and hardly a point of a thing with it."""
    drive = world.drive()
    for frame in range(0, world.FRAMES, 2):
        points, truth = world.sweep(frame)
        is_ground = heights(points.xyz_ego_m, drive.ground_z_m) <= GROUND_M
        assert np.mean(is_ground[truth.object_index < 0]) > 0.99


@pytest.mark.real
def test_real_cars_and_cyclists_lose_nothing_above_their_feet(shared: Path) -> None:
    from upvl_cli.datasets.kitti.dataset import Kitti
    from upvl_cli.datasets.kitti.labels import KittiLabels
    from upvl_cli.geometry.boxes import points_inside

    root = shared / "data" / "kitti_raw_b"
    drive = Kitti(root).open(Kitti(root).segments[0])
    labels = KittiLabels(root).labels(drive.name)
    kept = total = 0
    for frame in drive.frames[::8]:
        xyz_m = drive.points(frame.index).xyz_ego_m
        found = heights(xyz_m, drive.ground_z_m)
        road = (np.abs(xyz_m[:, 1]) < 2) & (np.abs(xyz_m[:, 0] - 10) < 5)
        assert np.mean(found[road] <= GROUND_M) > 0.999
        here = labels[(labels.frame == frame.index) & (labels.class_name != "Tram")]
        for row in range(len(here)):
            box = here[row : row + 1]
            inside = points_inside(xyz_m, box, margin_m=0.0)[0]
            inside &= xyz_m[:, 2] > box.center_m[0, 2] - box.size_lwh_m[0, 2] / 2 + 0.5
            kept, total = kept + np.sum(found[inside] > GROUND_M), total + inside.sum()
    assert total > 1000
    assert kept / total > 0.99


def test_heights_fit_half_precision_wherever_a_point_is() -> None:
    xyz = np.array([[5.0, 0, -1.7], [6, 0, 9_000], [7, 0, -9_000], [1e4, 1e4, 1e4]])
    height_m = heights(xyz, -1.73)
    assert np.abs(height_m).max() == 1000 and np.isfinite(height_m.astype(np.float16)).all()
