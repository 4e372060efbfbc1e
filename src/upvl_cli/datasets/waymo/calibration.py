"""How Waymo's cameras and lasers sit on the car, and how they see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose
from upvl_cli.datasets.waymo.names import CAMERAS, LASERS
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

# Waymo's cameras look along x, with y to the left and z up.
_WAYMO_FROM_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
_MAX_WIDTH_PX = 65535
_FOCAL_PX = (1.0, 1e6)
_MAX_DISTORTION = 1e3


@dataclass(frozen=True)
class LaserCalibration:
    """Where a laser sits, and which way its beams go.

    Attributes:
        name: Name of the laser, for example "TOP".
        ego_from_laser: (4, 4) pose on the car.
        min_inclination_rad: Lower edge of its view, for beams that are spread evenly.
        max_inclination_rad: Upper edge.
        inclinations_rad: (height,) of each beam, ascending; None where they are spread evenly.
        where: The file, for messages.
    """

    name: str
    ego_from_laser: Array
    min_inclination_rad: float
    max_inclination_rad: float
    inclinations_rad: Array | None
    where: str

    def beams_rad(self, height: int) -> Array:
        """Return (height,) the inclination of each row of a range image; row 0 is the highest beam.

        Args:
            height: Rows of the range image.

        Raises:
            BadInput: The calibration has another number of beams.
        """
        if self.inclinations_rad is None:
            share = (0.5 + np.arange(height)) / height
            spread = self.max_inclination_rad - self.min_inclination_rad
            return np.asarray(share * spread + self.min_inclination_rad)[::-1]
        if len(self.inclinations_rad) != height:
            raise BadInput(
                f"{self.where}: laser {self.name} has {len(self.inclinations_rad)} beams, but its range images "
                f"have {height} rows; use calibration and range images of one segment"
            )
        return self.inclinations_rad[::-1]


def laser_calibration(
    number: int, extrinsic: Array, edges_rad: tuple[float, float], inclinations_rad: Array | None, where: str
) -> LaserCalibration:
    """Return the calibration of a laser.

    Args:
        number: Waymo's number of the laser.
        extrinsic: (16,) pose on the car, by rows.
        edges_rad: Lowest and highest inclination of its view.
        inclinations_rad: (height,) of each beam, ascending; None where they are spread evenly.
        where: The file, for messages.

    Raises:
        BadInput: There is no such laser, or a number cannot be right.
    """
    if number not in LASERS:
        raise BadInput(f"{where}: no laser has the number {number}, expected 1 to {len(LASERS)}")
    name = LASERS[number]
    angles = np.array(edges_rad if inclinations_rad is None else inclinations_rad, dtype=np.float64)
    if not np.abs(angles).max(initial=0.0) <= np.pi:
        raise BadInput(f"{where}: laser {name} has beams at {angles.tolist()[:4]} rad; copy the file again")
    pose = check_pose(
        np.reshape(extrinsic, (4, 4)), f"{where}: the extrinsic of laser {name}", max_m=MAX_ON_CAR_M
    )
    if inclinations_rad is not None:
        return LaserCalibration(name, pose, 0.0, 0.0, angles, where)
    return LaserCalibration(name, pose, float(edges_rad[0]), float(edges_rad[1]), None, where)


def camera_calibration(
    number: int, intrinsic: Array, extrinsic: Array, size_px: tuple[float, float], where: str
) -> Camera:
    """Return a camera, in the axes and pixels of computer vision.

    Args:
        number: Waymo's number of the camera.
        intrinsic: (9,) f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3; pixel 0 is the left edge of the first pixel.
        extrinsic: (16,) pose on the car, by rows: x along the view, y left, z up.
        size_px: Width and height of its pictures.
        where: The file, for messages.

    Raises:
        BadInput: There is no such camera, or a number cannot be right.
    """
    if number not in CAMERAS:
        raise BadInput(f"{where}: no camera has the number {number}, expected 1 to {len(CAMERAS)}")
    name = CAMERAS[number]
    size = np.array(size_px, dtype=np.float64)
    if not ((size >= 1) & (size <= _MAX_WIDTH_PX)).all():
        raise BadInput(f"{where}: camera {name} has pictures of {size.tolist()} pixels; copy the file again")
    intrinsic = np.asarray(intrinsic, dtype=np.float64)
    focal_px, center_px, distortion = intrinsic[:2], intrinsic[2:4], intrinsic[4:]
    if not ((focal_px >= _FOCAL_PX[0]) & (focal_px <= _FOCAL_PX[1])).all():
        raise BadInput(
            f"{where}: camera {name} has the focal lengths {focal_px.tolist()}, expected {_FOCAL_PX[0]:g} to "
            f"{_FOCAL_PX[1]:g} pixels; copy the file again"
        )
    if not (np.abs(center_px).max() <= _FOCAL_PX[1] and np.abs(distortion).max() <= _MAX_DISTORTION):
        raise BadInput(f"{where}: camera {name} has the intrinsic {intrinsic.tolist()}; copy the file again")
    mount = check_pose(
        np.reshape(extrinsic, (4, 4)), f"{where}: the extrinsic of camera {name}", max_m=MAX_ON_CAR_M
    )
    matrix = np.array([[focal_px[0], 0, center_px[0] - 0.5], [0, focal_px[1], center_px[1] - 0.5], [0, 0, 1]])
    return Camera(name, int(size[0]), int(size[1]), matrix, distortion, mount @ _WAYMO_FROM_CAMERA)
