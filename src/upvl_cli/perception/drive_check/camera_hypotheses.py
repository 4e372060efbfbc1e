"""Typical mistakes in the axes, mounting and lens of cameras: what else a calibration may mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from upvl_cli.geometry.se3 import inverse
from upvl_cli.types import Array, Camera, Floats

_OPTICAL_FROM_BODY = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # columns: right, down, forward
_UPSIDE_DOWN = np.diag([-1.0, -1, 1])
_SCALES = (0.5, 2 / 3, 1.5, 2.0)  # of a picture that was reduced or enlarged
_YAW_STEP_DEG = 2.0


@dataclass(frozen=True)
class CameraHypothesis:
    """What a camera may be in truth.

    Attributes:
        camera: The camera.
        text: What is wrong then, in words.
        cause: The likely cause.
        remedy: What to do.
        other: Name of the camera whose mounting it is, or empty.
    """

    camera: Camera
    text: str
    cause: str
    remedy: str = "mend its calibration"
    other: str = ""


def turns_of_points() -> list[tuple[Floats, str]]:
    """Return (3, 3) turns and mirrors about the vertical that points may need, with their names; none is last."""
    found = []
    for mirror in (False, True):
        for quarter in (1, 2, 3, 0):
            cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
            turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]) @ np.diag(
                [1, -1.0 if mirror else 1, 1]
            )
            turned = f"turned by {(360 - 90 * quarter) % 360} degrees about z" if quarter else ""
            words = " and ".join(part for part in ("mirrored" if mirror else "", turned) if part)
            found.append((turn, words))
    return [turn for turn in found if turn[1]]


def axes_setting(turn: Array) -> str:
    """Return the line of `raw.toml` that turns points: each of x, y, z as an axis of the file.

    Args:
        turn: (3, 3) signed permutation.
    """
    names = []
    for row in np.rint(turn).astype(int):
        column = int(np.abs(row).argmax())
        names.append(("-" if row[column] < 0 else "") + "xyz"[column])
    return "axes = [" + ", ".join(f'"{name}"' for name in names) + "]"


def camera_hypotheses(camera: Camera, cameras: Sequence[Camera]) -> Iterator[CameraHypothesis]:
    """Yield what a camera may be other than as given.

    Args:
        camera: As given.
        cameras: All cameras of the drive.
    """
    given = camera.ego_from_camera
    yield CameraHypothesis(
        replace(camera, ego_from_camera=inverse(given)),
        "its mounting fits when it is inverted",
        "camera_from_ego was given in place of ego_from_camera",
        "invert the matrix",
    )
    for other in cameras:
        if other.name != camera.name:
            yield CameraHypothesis(
                replace(camera, ego_from_camera=other.ego_from_camera),
                f"its pictures fit the mounting of camera {other.name}",
                f"the pictures or the calibrations of {camera.name} and {other.name} are swapped",
                "look at the names of folders and calibrations",
                other=other.name,
            )
    for rotation in _rotations():
        pose = given.copy()
        pose[:3, :3] = given[:3, :3] @ rotation
        yield CameraHypothesis(replace(camera, ego_from_camera=pose), *_axes_in_words(rotation))
    yield CameraHypothesis(
        _mirrored(camera),
        "its pictures are mirrored, left for right",
        "the pictures were flipped",
        "flip them",
    )
    for scale in _SCALES:
        intrinsic = camera.intrinsic.copy()
        intrinsic[:2] *= scale
        yield CameraHypothesis(
            replace(camera, intrinsic=intrinsic),
            f"its intrinsics fit when multiplied by {scale:.3g}",
            f"the intrinsics belong to pictures of {1 / scale:.3g} times the size",
            f"multiply fx, fy, cx and cy by {scale:.3g}",
        )


def yaw_hypotheses(camera: Camera) -> Iterator[CameraHypothesis]:
    """Yield the camera looking level in every direction, as a mounting in wrong units would have it."""
    forward = camera.ego_from_camera[:3, 2]
    given_rad = float(np.arctan2(forward[1], forward[0]))
    for degrees in np.arange(-180, 180, _YAW_STEP_DEG):
        yaw_rad = np.deg2rad(degrees)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        pose = camera.ego_from_camera.copy()
        pose[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ _OPTICAL_FROM_BODY
        yield CameraHypothesis(
            replace(camera, ego_from_camera=pose),
            f"it looks about {degrees:.0f} degrees to the left of x, level; the calibration says "
            f"{np.rad2deg(given_rad):.0f}",
            "an angle of its mounting is wrong: degrees taken for radians, another order, or another sign",
        )


def _rotations() -> Iterator[Floats]:
    """Yield the 23 rotations that permute the axes."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0 and not np.array_equal(matrix, np.eye(3)):
                yield matrix


def _axes_in_words(rotation: Floats) -> tuple[str, str, str]:
    """Return text, cause and remedy of a camera whose axes are permuted."""
    if np.array_equal(rotation, _UPSIDE_DOWN):
        return (
            "its pictures are upside down",
            "the pictures, or the mounting, are turned by 180 degrees about the view",
            "turn the pictures by 180 degrees, or the calibration",
        )
    if np.array_equal(rotation, _OPTICAL_FROM_BODY):
        cause = "its axes are x forward, y left, z up; expected x right, y down, z forward"
    else:
        cause = "the axes of the camera are permuted; expected x right, y down, z forward"
    return "its mounting fits with other camera axes", cause, "mend the rotation of its ego_from_camera"


def _mirrored(camera: Camera) -> Camera:
    """Return the camera that sees what the given one sees in a mirror."""
    intrinsic = camera.intrinsic.copy()
    intrinsic[0, 0] *= -1
    intrinsic[0, 2] = camera.width_px - 1 - intrinsic[0, 2]
    return replace(camera, intrinsic=intrinsic)
