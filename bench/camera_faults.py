"""What `upvl check` says of cameras and pictures that were spoilt on purpose, without labels.

    python bench/camera_faults.py kitti=../shared/data/kitti_raw_a parquet=../shared/data/lyft synthetic=0 [--only NAME]

Each drive is checked as it is, and with each fault. A verdict is right where the finding names the fault, "cannot
tell" where no fault is claimed and the check says so or says that it would miss this one, and wrong otherwise.
"""

from __future__ import annotations

import os

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when numpy is imported

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.commands.drive_check import sample_drive
from upvl_cli.config.toml import load
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.geometry.se3 import inverse
from upvl_cli.perception.drive_check.cameras import check_cameras
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.types import Array, Camera, Drive, Image, Points

STAGES = Path(__file__).parents[1] / "stages"
CHECK = load(CheckConfig, STAGES / "check.toml")
CONFIG = CHECK.camera
OPTICAL_FROM_BODY = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])

Spoil = Callable[[DriveSample], DriveSample]


@dataclass(frozen=True)
class CameraFault:
    """A way to spoil a drive.

    Attributes:
        spoil: From a right sample.
        words: A right finding holds one of these.
        missed: What the check says that it would miss, where it cannot tell.
    """

    spoil: Spoil
    words: tuple[str, ...]
    missed: str = ""


def with_camera(change: Callable[[Camera], Camera], *, first_alone: bool = False) -> Spoil:
    """Return what changes the calibration of the first camera, or of all."""

    def spoil(sample: DriveSample) -> DriveSample:
        cameras = [
            camera if number and first_alone else change(camera)
            for number, camera in enumerate(sample.cameras)
        ]
        return replace(sample, cameras=tuple(cameras))

    return spoil


def with_picture(change: Callable[[Image], Image | None]) -> Spoil:
    """Return what changes all pictures."""

    def spoil(sample: DriveSample) -> DriveSample:
        def picture(step: int, name: str) -> Image | None:
            image = sample.picture(step, name)
            return None if image is None else change(image)

        return replace(sample, picture=picture)

    return spoil


def with_points(turn: Array) -> Spoil:
    """Return what turns all points about the origin."""

    def spoil(sample: DriveSample) -> DriveSample:
        def sweep(step: int) -> Points:
            points = sample.sweep(step)
            return replace(points, xyz_ego_m=points.xyz_ego_m @ turn.T.astype(np.float32))

        return replace(sample, sweep=sweep)

    return spoil


def frozen(sample: DriveSample) -> DriveSample:
    """Show the first picture in all frames."""
    first = sample.steps[0]

    def picture(step: int, name: str) -> Image | None:
        image, start = sample.picture(step, name), sample.picture(first, name)
        return image if image is None or start is None else replace(start, time_ns=image.time_ns)

    return replace(sample, picture=picture)


def two_cameras(sample: DriveSample) -> tuple[str, str]:
    """Return the first camera and the next one of its size."""
    first = sample.cameras[0]
    size = (first.width_px, first.height_px)
    others = [each.name for each in sample.cameras[1:] if (each.width_px, each.height_px) == size]
    if not others:
        raise ValueError("one camera")
    return first.name, others[0]


def with_names(sample: DriveSample, names: Mapping[str, str]) -> DriveSample:
    """Show the pictures of other cameras."""
    return replace(sample, picture=lambda step, name: sample.picture(step, names.get(name, name)))


def swapped(sample: DriveSample) -> DriveSample:
    """Exchange the pictures of two cameras."""
    first, second = two_cameras(sample)
    return with_names(sample, {first: second, second: first})


def copied(sample: DriveSample) -> DriveSample:
    """Show the pictures of one camera in another one too."""
    first, second = two_cameras(sample)
    return with_names(sample, {second: first})


def moved(rotation_deg: Sequence[float] = (0, 0, 0), translation_m: Sequence[float] = (0, 0, 0)) -> Spoil:
    """Return what moves all cameras in their own axes."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.deg2rad(rotation_deg)).as_matrix()
    motion[:3, 3] = translation_m
    return with_camera(lambda camera: replace(camera, ego_from_camera=camera.ego_from_camera @ motion))


def in_body_axes(camera: Camera) -> Camera:
    """Return the camera with axes x forward, y left, z up."""
    pose = camera.ego_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ OPTICAL_FROM_BODY.T
    return replace(camera, ego_from_camera=pose)


def half_size(camera: Camera) -> Camera:
    """Return the camera with the intrinsics of pictures of half the size."""
    intrinsic = camera.intrinsic.copy()
    intrinsic[:2] /= 2
    return replace(camera, intrinsic=intrinsic)


def late(image: Image, seconds: float) -> Image:
    """Return the picture with a time that is too early."""
    return replace(image, time_ns=image.time_ns - round(seconds * 1e9))


def grey(image: Image, value: int) -> Image:
    """Return a picture of one colour."""
    return replace(image, rgb=np.full_like(image.rgb, value))


QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
CAMERA_FAULTS = {
    "missing": CameraFault(with_picture(lambda image: None), ("no picture",)),
    "black": CameraFault(with_picture(lambda image: grey(image, 0)), ("black",)),
    "white": CameraFault(with_picture(lambda image: grey(image, 255)), ("white",)),
    "constant": CameraFault(with_picture(lambda image: grey(image, 120)), ("of one colour",)),
    "frozen": CameraFault(frozen, ("the same picture",)),
    "swapped": CameraFault(swapped, ("swapped",)),
    "copied": CameraFault(copied, ("shows the pictures of",)),
    "upside down": CameraFault(
        with_picture(lambda image: replace(image, rgb=image.rgb[::-1, ::-1])), ("upside down",)
    ),
    "mirrored pictures": CameraFault(
        with_picture(lambda image: replace(image, rgb=image.rgb[:, ::-1])), ("mirrored",)
    ),
    "half size": CameraFault(with_camera(half_size), ("another size", "times the size")),
    "inverse": CameraFault(
        with_camera(lambda camera: replace(camera, ego_from_camera=inverse(camera.ego_from_camera))),
        ("inverted",),
    ),
    "body axes": CameraFault(with_camera(in_body_axes), ("x forward, y left, z up; expected x right",)),
    "points turned": CameraFault(with_points(QUARTER), ("turned by 90 degrees",)),
    "points mirrored": CameraFault(with_points(np.diag([1.0, -1, 1])), ("points are mirrored",)),
    "1 deg about x": CameraFault(moved((1, 0, 0)), ("rotated by",), "1 degree about x"),
    "1 deg about y": CameraFault(moved((0, 1, 0)), ("rotated by",), "1 degree about y"),
    "1 deg about z": CameraFault(moved((0, 0, 1)), ("rotated by",), "1 degree about z"),
    "5 cm along x": CameraFault(moved((0, 0, 0), (0.05, 0, 0)), ("moved by", "mounting"), "5 cm along x"),
    "5 cm along y": CameraFault(moved((0, 0, 0), (0, 0.05, 0)), ("moved by", "mounting"), "5 cm along y"),
    "50 ms late": CameraFault(
        with_picture(lambda image: late(image, 0.05)), ("than they say", "ms late"), "a delay of 50 ms"
    ),
}


def sample_of(drive: Drive) -> DriveSample:
    """Return the sample of a drive that the check takes."""
    return sample_drive(drive, drive.world_from_ego, CHECK.sample)


def drive_of(name: str) -> Drive:
    """Return the first drive of dataset=folder, or of the built-in city of a seed."""
    dataset, _, where = name.partition("=")
    if dataset == "synthetic":
        return City(load(CityConfig, STAGES / "synthetic.toml", {"seed": int(where), "train": 1})).open(
            "train-000"
        )
    opened = dataset_family(dataset).open(Path(where), None)
    return opened.open(opened.segments[0])


def verdict(findings: Sequence[Finding], fault: CameraFault | None) -> str:
    """Return "right", "cannot tell" or "WRONG"."""
    bad = [finding for finding in findings if finding.level in ("fault", "warning")]
    if fault is None:
        return "WRONG" if bad else "right"
    named = [any(word in finding.sentence for word in fault.words) for finding in bad]
    if any(named):
        return "right" if all(named) else f"right for {sum(named)} of {len(named)}"
    silent = all(
        finding.level == "cannot tell" or (fault.missed and fault.missed in finding.text)
        for finding in findings
    )
    return "WRONG" if bad or not silent else "cannot tell"


def main() -> None:
    """Run all faults on all drives."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", nargs="+")
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    for name in options.drives:
        run_faults(name, sample_of(drive_of(name)), options.only)


def run_faults(name: str, sample: DriveSample, only: Sequence[str]) -> None:
    """Print the verdict on each fault of one drive."""
    for key, fault in {"as it is": None, **CAMERA_FAULTS}.items():
        if only and key not in only:
            continue
        start_s = time.process_time()
        try:
            spoilt = fault.spoil(sample) if fault else sample
        except ValueError as error:
            print(f"{name:12} {key:18} left out: {error}")
            continue
        findings = list(check_cameras(spoilt, CONFIG))
        result = verdict(findings, fault)
        print(f"{name:12} {key:18} {result:16} {time.process_time() - start_s:5.1f} s", flush=True)
        if not result.startswith("right"):
            for finding in findings:
                print(f"{'':14}{finding.level}: {finding.sentence}")


if __name__ == "__main__":
    main()
