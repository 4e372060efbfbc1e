"""Poses from KITTI's oxts records: latitude, longitude, altitude, roll, pitch, yaw of the inertial unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import compose
from upvl_cli.types import Array

_EARTH_RADIUS_M = 6378137.0  # the radius of KITTI's own projection (and of WGS 84 at the equator)
_FIELDS = 30
_ALTITUDE_M = (-1000.0, 10_000.0)  # the Dead Sea lies at -430 m, the highest road at 5800 m
_MOST_WAY_M = 1e6  # from the first frame: more than a car drives in a day


@dataclass(frozen=True)
class OxtsRecord:
    """One line of an oxts file, and which line of which file it is."""

    text: str
    where: str


def world_from_ego(first: OxtsRecord, records: Sequence[OxtsRecord], ego_from_imu: Array) -> Array:
    """Return the pose of each frame: x east, y north, z up, with the first frame's LiDAR at the origin.

    Args:
        first: The first record of the drive; it sets the scale of the projection, so that a drive of which a
            part is missing keeps the coordinates of the whole one.
        records: The record of each frame.
        ego_from_imu: (4, 4) pose of the inertial unit in ego axes.

    Returns:
        (T, 4, 4) float64; raises `BadInput` for a record that is not what it has to be.
    """
    first_latitude_deg = _read_record(first)[0]
    values = np.array([_read_record(record) for record in records]).reshape(-1, 6)
    poses = compose(
        world_from_imu(values, first_latitude_deg=first_latitude_deg), np.linalg.inv(ego_from_imu)
    )
    poses[:, :3, 3] -= poses[:1, :3, 3]
    far = np.flatnonzero(np.abs(poses[:, :3, 3]).max(axis=1) > _MOST_WAY_M)
    if len(far):
        raise BadInput(
            f"{records[far[0]].where} lies {np.abs(poses[far[0], :3, 3]).max() / 1000:.0f} km from "
            f"{records[0].where}, expected one drive; copy the files again"
        )
    return poses


def world_from_imu(records: Array, *, first_latitude_deg: float) -> Array:
    """Poses by the Mercator projection, true to scale at one latitude.

    Args:
        records: (n, 6) latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad; yaw is 0 to
            the east and counter-clockwise).
        first_latitude_deg: Latitude at which a metre of the projection is a metre.

    Returns:
        (n, 4, 4) float64. Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013, and
        the development kit of the raw data.
    """
    latitude, longitude = np.deg2rad(records[:, 0]), np.deg2rad(records[:, 1])
    scale = np.cos(np.deg2rad(first_latitude_deg))
    poses = np.tile(np.eye(4), (len(records), 1, 1))
    poses[:, 0, 3] = scale * _EARTH_RADIUS_M * longitude
    poses[:, 1, 3] = scale * _EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + latitude / 2))
    poses[:, 2, 3] = records[:, 2]
    poses[:, :3, :3] = _rotation(*records[:, 3:].T)
    return poses


def _rotation(roll: Array, pitch: Array, yaw: Array) -> Array:
    """(n, 3, 3) of Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = (f(np.array([roll, pitch, yaw])) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)  # (n, 3, 3)


def _read_record(record: OxtsRecord) -> Array:
    values = numbers(record.text, _FIELDS, record.where)[:6]
    if not abs(values[0]) < 90 or not abs(values[1]) <= 180:
        raise BadInput(
            f"{record.where}: latitude {values[0]:g}, longitude {values[1]:g} are no place on Earth"
        )
    if not _ALTITUDE_M[0] < values[2] < _ALTITUDE_M[1]:
        raise BadInput(f"{record.where}: no road has an altitude of {values[2]:g} m; copy the file again")
    if not np.abs(values[3:]).max() <= 2 * np.pi:
        raise BadInput(
            f"{record.where}: roll, pitch and yaw are {values[3:].tolist()}, expected radians in a turn; "
            "copy the file again"
        )
    return values
