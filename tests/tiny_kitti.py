"""A tiny drive in KITTI's raw layout: a street with a ground, an L of walls and one car, all known.

The ego drives at 5 m/s, the car before it at 8 m/s; the time between sweeps is not constant. The street's
axes are the ego axes of the first frame, and the street runs at `YAW_RAD` to the east.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from upvl_cli.types import Boxes

EGO_SPEED_MPS = 5.0
CAR_SPEED_MPS = 8.0
YAW_RAD = 0.5
GROUND_Z_M = -1.73
CAR_LWH_M = np.array([4.0, 1.8, 1.5])
CAR_START_M = np.array([12.0, 2.5, GROUND_Z_M + 0.75])
CAMERA_DELAY_NS = 2_000_000
FIRST_LATITUDE_DEG, FIRST_LONGITUDE_DEG, FIRST_ALTITUDE_M = 49.0, 8.43, 116.0
EARTH_RADIUS_M = 6378137.0
WIDTH_PX, HEIGHT_PX = 124, 37
RED = (200, 30, 30)


def turn(axis: int, angle_rad: float) -> np.ndarray:
    """(3, 3) rotation about x (0), y (1) or z (2)."""
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = np.cos(angle_rad)
    matrix[j, i], matrix[i, j] = np.sin(angle_rad), -np.sin(angle_rad)
    return matrix


# A camera looks along x: its x is ego -y, its y is ego -z. All is slightly off, as in a real car.
R_RECT = turn(1, 0.008)
VELO_TO_CAM_R = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]) @ turn(2, 0.007) @ turn(1, -0.014)
VELO_TO_CAM_T = np.array([-0.004, -0.076, -0.272])
IMU_TO_VELO_R = turn(2, 0.01)
IMU_TO_VELO_T = np.array([-0.81, 0.32, -0.80])
P_RECT = {
    f"0{number}": np.array([[72.0, 0, 61.5, 72.0 * shift], [0, 72.0, 17.0, 0.02], [0, 0, 1.0, 0.0027]])
    for number, shift in enumerate((0.0, -0.54, 0.06, -0.47))
}


@dataclass(frozen=True)
class TinyDrive:
    """Where the drive lies and what is true in it, by frame."""

    root: Path
    folder: Path
    segment: str
    time_ns: np.ndarray  # (T,)
    world_from_ego: np.ndarray  # (T, 4, 4)
    xyz_ego_m: tuple[np.ndarray, ...]  # each (n, 3), as at the frame's time
    car: Boxes  # of each of the T frames, in its ego axes
    car_points: np.ndarray  # (T,)
    car_velocity_mps: np.ndarray  # (3,) over ground, along the ego axes


def write_drive(
    root: Path,
    *,
    frames: int = 4,
    images: bool = True,
    calibration: bool = True,
    oxts: bool = True,
    tracklets: bool = True,
    drive: int = 1,
) -> TinyDrive:
    """Write `<root>/2011_09_26/2011_09_26_drive_0001_sync` and return what is true in it."""
    folder = root / f"2011_09_26/2011_09_26_drive_{drive:04d}_sync"
    steps_ns = 100_000_007 + 5_000_000 * (np.arange(frames - 1) % 3)
    start_ns = int(np.datetime64("2011-09-26T13:00:00.000000500", "ns").astype(np.int64))
    time_ns = start_ns + np.append(0, np.cumsum(steps_ns)).astype(np.int64)
    seconds = (time_ns - time_ns[0]) / 1e9
    clouds = [street_points(t) for t in seconds]
    turn_s = float(seconds[-1]) / max(frames - 1, 1)
    center_m = np.tile(CAR_START_M, (frames, 1))
    center_m[:, 0] += (CAR_SPEED_MPS - EGO_SPEED_MPS) * seconds
    car = Boxes(center_m, np.tile(CAR_LWH_M, (frames, 1)), np.zeros(frames))
    poses = ego_poses(seconds)

    write_times(folder / "velodyne_points", time_ns)
    for frame, (xyz, intensity) in enumerate(clouds):
        path = numbered(folder / "velodyne_points/data", frame, ".bin")
        np.column_stack([twisted(xyz, turn_s), intensity]).astype("<f4").tofile(path)
    if images:
        write_times(folder / "image_02", time_ns + CAMERA_DELAY_NS)
        for frame in range(frames):
            picture = draw(car.center_m[frame])
            Image.fromarray(picture).save(numbered(folder / "image_02/data", frame, ".png"))
    if calibration:
        write_calibration(folder.parent)
    if oxts:
        write_times(folder / "oxts", time_ns)
        write_oxts(folder / "oxts/data", poses)
    if tracklets:
        write_tracklets(folder / "tracklet_labels.xml", twisted(car.center_m, turn_s))
    return TinyDrive(
        root=root,
        folder=folder,
        segment=folder.name,
        time_ns=time_ns,
        world_from_ego=poses,
        xyz_ego_m=tuple(xyz for xyz, _ in clouds),
        car=car,
        car_points=np.array([(intensity == 0.8).sum() for _, intensity in clouds]),
        car_velocity_mps=np.array([CAR_SPEED_MPS, 0.0, 0.0]),
    )


def street_points(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) points in ego axes and their intensities: 0.2 ground, 0.4 walls, 0.8 car."""
    ground = grid(np.arange(-20, 45, 0.5), np.arange(-12, 8, 0.5), [GROUND_Z_M])
    walls = np.vstack(
        [
            grid(np.arange(-20, 45, 0.25), [8.0], np.arange(GROUND_Z_M + 0.25, 1.5, 0.25)),
            grid([45.0], np.arange(-12, 8, 0.25), np.arange(GROUND_Z_M + 0.25, 1.5, 0.25)),
        ]
    )
    length, width, height = CAR_LWH_M / 2 - 0.02  # so that rounding leaves no point outside
    along, across, up = (np.linspace(-half, half, 12) for half in (length, width, height))
    car = np.vstack([grid([-length], across, up), grid(along, [-width], up), grid(along, across, [height])])
    car_at = CAR_START_M + [CAR_SPEED_MPS * seconds, 0, 0]
    under_car = (np.abs(ground - car_at)[:, :2] < CAR_LWH_M[:2] / 2).all(axis=1)
    ground = ground[~under_car]

    xyz = np.vstack([ground, walls, car + car_at]) - [EGO_SPEED_MPS * seconds, 0, 0]
    intensity = np.repeat([0.2, 0.4, 0.8], [len(ground), len(walls), len(car)])
    # Not under the ego car, and not at the rear, where a turn ends and the next begins.
    behind = np.abs(np.arctan2(xyz[:, 1], xyz[:, 0])) > 3.0
    seen = (np.hypot(xyz[:, 0], xyz[:, 1]) > 3.5) & ~behind
    return xyz[seen], intensity[seen]


def grid(x: object, y: object, z: object) -> np.ndarray:
    """(n, 3) every combination of the coordinates."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)  # type: ignore[arg-type]


def twisted(xyz_ego_m: np.ndarray, turn_s: float) -> np.ndarray:
    """Where a LiDAR that turns clockwise sees places of the world while the ego drives on."""
    seen = xyz_ego_m.copy()
    for _ in range(20):  # the place decides the time, and the time the place
        seconds = -np.arctan2(seen[:, 1], seen[:, 0]) / (2 * np.pi) * turn_s
        seen[:, 0] = xyz_ego_m[:, 0] - EGO_SPEED_MPS * seconds
    return seen


def ego_poses(seconds: np.ndarray) -> np.ndarray:
    """(T, 4, 4) world_from_ego: x east, y north, the first LiDAR at the origin."""
    poses = np.tile(np.eye(4), (len(seconds), 1, 1))
    poses[:, :3, :3] = turn(2, YAW_RAD)
    poses[:, :3, 3] = EGO_SPEED_MPS * seconds[:, None] * turn(2, YAW_RAD)[:, 0]
    return poses


def draw(center_m: np.ndarray) -> np.ndarray:
    """(h, w, 3) picture of image_02: sky, road, and a red rectangle around the car."""
    picture = np.full((HEIGHT_PX, WIDTH_PX, 3), (200, 220, 255), dtype=np.uint8)
    picture[HEIGHT_PX // 2 :] = 90
    corners = center_m + grid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]) * CAR_LWH_M
    u, v = project(corners).T
    rows, columns = (slice(int(np.floor(p.min())), int(np.ceil(p.max())) + 1) for p in (v, u))
    picture[rows, columns] = RED
    return picture


def project(xyz_ego_m: np.ndarray, camera: str = "02") -> np.ndarray:
    """(n, 2) pixels by KITTI's own formula: P_rect R_rect (R x + T)."""
    rect = (xyz_ego_m @ VELO_TO_CAM_R.T + VELO_TO_CAM_T) @ R_RECT.T
    pixels = np.column_stack([rect, np.ones(len(rect))]) @ P_RECT[camera].T
    return pixels[:, :2] / pixels[:, 2:]


def write_calibration(folder: Path) -> None:
    """The three calibration files of a day."""
    cameras: dict[str, object] = {"calib_time": "09-Jan-2012 13:57:47", "corner_dist": [0.0995]}
    for number, p_rect in P_RECT.items():
        cameras |= {f"S_rect_{number}": [WIDTH_PX, HEIGHT_PX], f"R_rect_{number}": R_RECT}
        cameras[f"P_rect_{number}"] = p_rect
    write_fields(folder / "calib_cam_to_cam.txt", cameras)
    write_fields(
        folder / "calib_velo_to_cam.txt", {"R": VELO_TO_CAM_R, "T": VELO_TO_CAM_T, "delta_f": [0, 0]}
    )
    write_fields(folder / "calib_imu_to_velo.txt", {"R": IMU_TO_VELO_R, "T": IMU_TO_VELO_T})


def write_fields(path: Path, fields: dict[str, object]) -> None:
    """`key: values` lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    texts = {key: value if isinstance(value, str) else numbers(value) for key, value in fields.items()}
    path.write_text("".join(f"{key}: {text}\n" for key, text in texts.items()))


def write_oxts(folder: Path, world_from_ego: np.ndarray) -> None:
    """One record of 30 fields a frame, by the inverse of the Mercator projection."""
    ego_from_imu = np.eye(4)
    ego_from_imu[:3, :3], ego_from_imu[:3, 3] = IMU_TO_VELO_R, IMU_TO_VELO_T
    imu = world_from_ego @ ego_from_imu
    metres = np.cos(np.deg2rad(FIRST_LATITUDE_DEG)) * EARTH_RADIUS_M
    first_north = np.log(np.tan(np.pi / 4 + np.deg2rad(FIRST_LATITUDE_DEG) / 2))
    for frame, (east_m, north_m, up_m) in enumerate(imu[:, :3, 3] - imu[0, :3, 3]):
        latitude = 2 * np.arctan(np.exp(first_north + north_m / metres)) - np.pi / 2
        longitude = np.deg2rad(FIRST_LONGITUDE_DEG) + east_m / metres
        yaw = np.arctan2(imu[frame, 1, 0], imu[frame, 0, 0])
        place = [np.rad2deg(latitude), np.rad2deg(longitude), FIRST_ALTITUDE_M + up_m]
        numbered(folder, frame, ".txt").write_text(numbers([*place, 0, 0, yaw, *[0] * 24]) + "\n")


def write_tracklets(path: Path, centre_m: np.ndarray, kind: str = "Car") -> None:
    """One object of the car's size, whose floor is below the centres."""
    length, width, height = CAR_LWH_M.tolist()
    poses = "".join(
        f"<item><tx>{x!r}</tx><ty>{y!r}</ty><tz>{z - height / 2!r}</tz><ry>0</ry><rz>0</rz></item>\n"
        for x, y, z in centre_m.tolist()
    )
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9">\n<tracklets version="0">'
        f"<count>1</count><item_version>1</item_version>\n<item><objectType>{kind}</objectType>"
        f"<h>{height}</h><w>{width}</w><l>{length}</l><first_frame>0</first_frame>\n"
        f"<poses><count>{len(centre_m)}</count><item_version>2</item_version>\n{poses}</poses>"
        "<finished>1</finished></item>\n</tracklets>\n</boost_serialization>\n"
    )


def write_times(folder: Path, time_ns: np.ndarray) -> None:
    """`timestamps.txt`: one line a frame."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [str(np.datetime64(int(ns), "ns")).replace("T", " ") for ns in time_ns]
    (folder / "timestamps.txt").write_text("\n".join(lines) + "\n")


def numbered(folder: Path, frame: int, suffix: str) -> Path:
    """The path of a frame's file; its folder exists then."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{frame:010d}{suffix}"


def numbers(values: object) -> str:
    """Numbers with all their digits, between blanks."""
    return " ".join(repr(float(value)) for value in np.ravel(values))  # type: ignore[arg-type]
