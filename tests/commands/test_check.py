"""`upvl check`: what it finds on a drive without looking at a label."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.commands.drive_check import sample_drive
from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.drive_check.calibration_words import fault_in_words, offsets_in_words
from upvl_cli.perception.drive_check.cameras import camera_steps, check_cameras, image_sweep_pairs
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.visual.camera_check import CalibrationOffset
from upvl_cli.types import Array, Camera, Frame, Image, Points

CONFIG = load(CheckConfig, Path(__file__).parents[2] / "stages" / "check.toml")
CAMERA = Camera(
    name="front",
    width_px=40,
    height_px=20,
    intrinsic=np.array([[30.0, 0.0, 19.5], [0.0, 30.0, 9.5], [0.0, 0.0, 1.0]]),
    distortion=np.zeros(5),
    ego_from_camera=np.array(
        [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    ),
)
STEP_NS = 100_000_000
GREY = np.random.default_rng(0).integers(0, 255, (20, 40, 3), dtype=np.uint8)
SPEED_MPS, TURN_RADPS = 10.0, 0.3
TREES_M = np.array([[30.0, 5.0, 0.0], [40.0, -5.0, 1.0]])  # in the axes of the world


def pose(time_ns: int) -> Array:
    """Where a car is that goes along a circle."""
    angle = TURN_RADPS * time_ns / 1e9
    radius_m = SPEED_MPS / TURN_RADPS
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turned[:2, 3] = radius_m * np.sin(angle), radius_m * (1 - np.cos(angle))
    return turned


@dataclass
class TinyDrive:
    """Five frames of a car that turns, with two trees."""

    name: str = "tiny"
    frames: tuple[Frame, ...] = tuple(Frame(number, number * STEP_NS) for number in range(5))
    cameras: tuple[Camera, ...] = (CAMERA,)
    skipped: Mapping[str, int] = field(default_factory=dict)
    ground_z_m: float = -1.7
    files: tuple[Path, ...] = ()
    delay_ns: int = 0
    without: frozenset[int] = frozenset()
    size: tuple[int, int] = (20, 40)
    frozen: bool = False

    @property
    def world_from_ego(self) -> Array:
        return np.stack([pose(frame.time_ns) for frame in self.frames])

    def points(self, frame: int) -> Points:
        xyz = np.concatenate([apply(inverse(pose(frame * STEP_NS)), TREES_M), [[1.0, 0.0, 0.0]]])
        return Points(xyz, np.zeros(3), np.zeros(3), [0, 0, 1], np.zeros(3))

    def image(self, frame: int, camera: str) -> Image | None:
        if frame in self.without:
            return None
        shown = GREY if self.frozen else np.roll(GREY, frame, axis=1)
        return Image(shown[: self.size[0], : self.size[1]], frame * STEP_NS + self.delay_ns)


def findings(drive: TinyDrive) -> list[Finding]:
    return list(check_cameras(sample_drive(drive, drive.world_from_ego, CONFIG.sample), CONFIG.camera))


UNRIGID = replace(CAMERA, ego_from_camera=CAMERA.ego_from_camera * [[1, 1.01, 1, 1]])
MIRRORED = replace(CAMERA, ego_from_camera=CAMERA.ego_from_camera * [[1], [-1], [1], [1]])
WRONG = {
    "rotation": (TinyDrive(cameras=(UNRIGID,)), "ego_from_camera is none"),
    "mirror": (TinyDrive(cameras=(MIRRORED,)), "ego_from_camera is none"),
    "size": (TinyDrive(size=(10, 20)), "20 x 10 pixels, expected 40 x 20"),
    "late": (TinyDrive(delay_ns=-250_000_000), "0.25 s from its sweep"),
    "frozen": (TinyDrive(frozen=True), "the same picture again while the car goes on"),
    "blind": (TinyDrive(without=frozenset(range(5))), "no picture in 4 of 4 frames"),
}


@pytest.mark.parametrize(("drive", "text"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_said_once(drive: TinyDrive, text: str) -> None:
    faulty = [finding.sentence for finding in findings(drive) if finding.is_fault]
    assert len(faulty) == 1 and text in faulty[0]


def test_gaps_are_told_but_are_no_fault() -> None:
    drive = TinyDrive(without=frozenset({2}))
    texts = [finding.text for finding in findings(drive)]
    assert texts[:1] == ["no picture in 1 of 4 frames looked at"]
    assert not any(finding.is_fault for finding in findings(replace(drive, frozen=False)))


@pytest.mark.parametrize("delay_ns", [-30_000_000, 0, 40_000_000])
def test_a_sweep_is_moved_to_the_time_of_the_picture(delay_ns: int) -> None:
    drive = TinyDrive(delay_ns=delay_ns)
    sample = sample_drive(drive, drive.world_from_ego, CONFIG.sample)
    images = {step: sample.picture(step, "front") for step in camera_steps(sample, CONFIG.camera)}
    moved = list(image_sweep_pairs(sample, images))
    assert len(moved) == 4  # the first lies before all poses
    for frame, view in zip(drive.frames, moved, strict=False):
        there = apply(inverse(pose(frame.time_ns + delay_ns)), TREES_M)
        np.testing.assert_allclose(view.xyz_ego_m, there, atol=0.01)  # the point of the other LiDAR is gone
        np.testing.assert_allclose(view.velocity_mps[0], SPEED_MPS, atol=0.01)
        np.testing.assert_allclose(view.turn_radps, [0, 0, TURN_RADPS], atol=1e-6)
    still = list(image_sweep_pairs(replace(sample, world_from_ego=None), images))
    np.testing.assert_allclose(still[1].xyz_ego_m, drive.points(1).xyz_ego_m[:2])


def test_a_drive_without_cameras_has_nothing_to_check() -> None:
    assert findings(TinyDrive(cameras=())) == []


def test_frames_are_spread_over_the_drive() -> None:
    drive = TinyDrive(frames=tuple(Frame(number, number) for number in range(100)), cameras=(CAMERA,) * 5)
    picked = camera_steps(sample_drive(drive, None, CONFIG.sample), CONFIG.camera)
    assert len(picked) == 12 and picked[0] == 0 and picked[-1] == 99


@pytest.mark.parametrize(("cameras", "frames"), [(1, 20), (4, 15), (20, 8)])
def test_pictures_are_shared_by_the_cameras(cameras: int, frames: int) -> None:
    drive = TinyDrive(
        frames=tuple(Frame(number, number) for number in range(100)), cameras=(CAMERA,) * cameras
    )
    assert len(camera_steps(sample_drive(drive, None, CONFIG.sample), CONFIG.camera)) == frames


def offset(error: Array, sigma: Array) -> CalibrationOffset:
    return CalibrationOffset(
        vector=error,
        covariance=np.diag(sigma**2),
        gain_sigmas=9.0,
        fault_gains=np.full(7, 9.0),
        chance_sigmas=9.0,
        scenes=10,
        outlines=500,
        has_delay=True,
        config=CONFIG.camera.calibration,
    )


def test_an_error_is_named_by_the_axes_that_are_clearly_off() -> None:
    sigma = np.array([*np.deg2rad([0.1, 0.1, 0.1]), 0.01, 0.01, 0.01, 0.01])
    error = np.array([0, np.deg2rad(0.5), np.deg2rad(0.15), 0, 0.05, 0.009, 0])
    assert list(offsets_in_words(offset(error, sigma))) == [
        "rotated by 0.50 +- 0.10 degrees about its y axis (downwards)",
        "moved by 5.0 +- 1.0 cm along its y axis (downwards)",
    ]
    assert not list(offsets_in_words(offset(error, 6 * sigma))), "none within its own uncertainty"


def test_a_delay_and_a_mounting_that_look_alike_are_both_named() -> None:
    sigma = np.array([*np.deg2rad([0.1, 0.1, 0.1]), 0.01, 0.01, 0.01, 0.005])
    late = offset(np.array([0, 0, 0, 0, 0, 0, 0.05]), sigma)
    assert late.is_fault and late.explained_by_delay and not late.explained_by_mounting
    turned = offset(np.array([0.02, 0, 0, 0, 0, 0, 0]), sigma)
    assert turned.is_fault and turned.explained_by_mounting and not turned.explained_by_delay


def test_faults_that_would_be_missed_are_told_in_words() -> None:
    config = CONFIG.camera.calibration
    assert [fault_in_words(axis, config) for axis in (0, 5, 6)] == [
        "1 degree about x",
        "5 cm along z",
        "a delay of 50 ms",
    ]
    assert fault_in_words(1, replace(config, fault_deg=0.5)) == "0.5 degrees about y"
