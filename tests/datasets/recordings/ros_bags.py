"""Write ROS recordings of the street: a LiDAR or two, a camera, TF and odometry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from datasets.recordings.street import (
    HEIGHT_PX,
    INTRINSIC,
    STEP_NS,
    WIDTH_PX,
    picture,
    quat_xyzw,
    rows,
    times_ns,
    world_from_lidar,
)

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
BASE_FROM_LIDAR = np.array([[1.0, 0, 0, 0.8], [0, 1, 0, 0], [0, 0, 1, 1.7], [0, 0, 0, 1]])
BASE_FROM_CAMERA = np.array([[0.0, 0, 1, 1.0], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
CAMERA_DELAY_NS = 20_000_000
LIDAR_TURN_S = 0.08


def header(time_ns: int, frame: str) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def transform(time_ns: int, parent: str, child: str, pose: np.ndarray) -> Any:
    place = TYPES["geometry_msgs/msg/Vector3"](*map(float, pose[:3, 3]))
    turn = TYPES["geometry_msgs/msg/Quaternion"](*map(float, quat_xyzw(pose)))
    inner = TYPES["geometry_msgs/msg/Transform"](translation=place, rotation=turn)
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(time_ns, parent), child_frame_id=child, transform=inner
    )


def odometry(time_ns: int, pose: np.ndarray) -> Any:
    place = TYPES["geometry_msgs/msg/Point"](*map(float, pose[:3, 3]))
    turn = TYPES["geometry_msgs/msg/Quaternion"](*map(float, quat_xyzw(pose)))
    zero = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(time_ns, "odom"),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=TYPES["geometry_msgs/msg/Pose"](position=place, orientation=turn), covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
            twist=TYPES["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
        ),
    )


def cloud(
    time_ns: int, values: np.ndarray, *, frame: str = "lidar", big_endian: bool = False, timed: bool = False
) -> Any:
    """An organised cloud of two rows with padding at the end of each, x y z at odd places, a uint16 intensity."""
    order = ">" if big_endian else "<"
    names = ["x", "y", "z", "reflectivity", *(["t"] if timed else [])]
    formats = [f"{order}{kind}" for kind in ("f4", "f4", "f8", "u2", "u4")][: len(names)]
    offsets = [4, 8, 16, 24, 28][: len(names)]
    step, total = 32, len(values)
    points = np.zeros(
        total, np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    )
    points["x"], points["y"], points["z"] = values[:, :3].T
    points["reflectivity"] = values[:, 3]
    if timed:
        points["t"] = np.linspace(0, LIDAR_TURN_S * 1e9, total)
    data = points.view("u1").reshape(2, total // 2 * step)
    data = np.pad(data, ((0, 0), (0, 12)))
    field = TYPES["sensor_msgs/msg/PointField"]
    kinds = {"f4": 7, "f8": 8, "u2": 4, "u4": 6}
    fields = [
        field(name, place, kinds[kind[1:]], 1)
        for name, place, kind in zip(names, offsets, formats, strict=True)
    ]
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header=header(time_ns, frame), height=2, width=total // 2, fields=fields, is_bigendian=big_endian,
        point_step=step, row_step=data.shape[1], data=data.reshape(-1), is_dense=True,
    )  # fmt: skip


def camera_info(
    time_ns: int, *, model: str = "plumb_bob", numbers: tuple[float, ...] = (0.1, 0.02, 0, 0, 0)
) -> Any:
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header=header(time_ns, "camera_optical"), height=HEIGHT_PX, width=WIDTH_PX, distortion_model=model,
        d=np.array(numbers, np.float64), k=INTRINSIC.ravel(), r=np.eye(3).ravel(),
        p=np.column_stack([INTRINSIC, np.zeros(3)]).ravel(), binning_x=0, binning_y=0,
        roi=TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )  # fmt: skip


def image(time_ns: int, shade: int, *, encoding: str) -> Any:
    if encoding == "png":
        data = np.frombuffer(picture(shade), np.uint8)
        return TYPES["sensor_msgs/msg/CompressedImage"](
            header=header(time_ns, "camera_optical"), format="png", data=data
        )
    rgb = np.full((HEIGHT_PX, WIDTH_PX, 3), (shade, 0, 200), np.uint8)
    if encoding == "bgr8":
        rgb = rgb[:, :, ::-1]
    return TYPES["sensor_msgs/msg/Image"](
        header=header(time_ns, "camera_optical"), height=HEIGHT_PX, width=WIDTH_PX, encoding=encoding,
        is_bigendian=0, step=WIDTH_PX * 3, data=np.ascontiguousarray(rgb).reshape(-1),
    )  # fmt: skip


def write_bag(
    path: Path,
    frames: int = 4,
    *,
    storage: str = "mcap",
    encoding: str = "png",
    second: bool = False,
    compression: str = "",
    **options: bool,
) -> Path:
    """Write a recording of sweeps, pictures 20 ms later, TF and odometry at half frames."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:

        def topic(name: str, kind: str) -> Any:
            return writer.add_connection(name, kind, typestore=STORE)

        def put(connection: Any, time_ns: int, message: Any) -> None:
            writer.write(connection, time_ns, STORE.serialize_cdr(message, message.__msgtype__))

        tf_message = TYPES["tf2_msgs/msg/TFMessage"]
        fixed, moving = topic("/tf_static", tf_message.__msgtype__), topic("/tf", tf_message.__msgtype__)
        points, odom = (
            topic("/points", "sensor_msgs/msg/PointCloud2"),
            topic("/odom", "nav_msgs/msg/Odometry"),
        )
        infos = topic("/front/camera_info", "sensor_msgs/msg/CameraInfo")
        kind = "CompressedImage" if encoding == "png" else "Image"
        images = topic(
            "/front/image" + ("/compressed" if encoding == "png" else ""), f"sensor_msgs/msg/{kind}"
        )
        start = times_ns(1)[0]
        mounts = [
            ("lidar", BASE_FROM_LIDAR),
            ("camera_optical", BASE_FROM_CAMERA),
            ("lidar_2", BASE_FROM_LIDAR),
        ]
        put(fixed, start - STEP_NS, tf_message([transform(start, "base_link", *mount) for mount in mounts]))
        more = topic("/points_2", "sensor_msgs/msg/PointCloud2") if second else None
        for k, time_ns in enumerate([start - STEP_NS, *times_ns(frames)]):
            half_ns = time_ns + STEP_NS // 2
            pose = world_from_lidar(k - 0.5) @ np.linalg.inv(BASE_FROM_LIDAR)
            put(moving, half_ns, tf_message([transform(half_ns, "odom", "base_link", pose)]))
            put(odom, half_ns, odometry(half_ns, pose))
        for k, time_ns in enumerate(times_ns(frames)):
            put(points, time_ns + 1000, cloud(time_ns, rows(k), **options))
            if more is not None:
                put(more, time_ns + 30_000_000, cloud(time_ns + 30_000_000, rows(k)[:100], frame="lidar_2"))
            put(infos, time_ns + CAMERA_DELAY_NS, camera_info(time_ns))
            put(
                images,
                time_ns + CAMERA_DELAY_NS,
                image(time_ns + CAMERA_DELAY_NS, 10 * k % 250, encoding=encoding),
            )
    return path


def write_bag1(path: Path, frames: int = 4) -> Path:
    """Write a recording of ROS 1: a LiDAR, and its poses at half frames."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = {"/points": "sensor_msgs/msg/PointCloud2", "/pose": "geometry_msgs/msg/PoseStamped"}

    def old(message: Any) -> Any:
        stamped = message.header
        message.header = store.types["std_msgs/msg/Header"](
            seq=0, stamp=stamped.stamp, frame_id=stamped.frame_id
        )
        return message

    with BagWriter(path) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=store) for name, kind in kinds.items()}
        for k, time_ns in enumerate([times_ns(1)[0] - STEP_NS, *times_ns(frames)]):
            half_ns = time_ns + STEP_NS // 2
            pose = odometry(half_ns, world_from_lidar(k - 0.5))
            pose = old(TYPES["geometry_msgs/msg/PoseStamped"](header=pose.header, pose=pose.pose.pose))
            writer.write(topics["/pose"], half_ns, store.serialize_ros1(pose, kinds["/pose"]))
        for k, time_ns in enumerate(times_ns(frames)):
            message = store.serialize_ros1(old(cloud(time_ns, rows(k))), kinds["/points"])
            writer.write(topics["/points"], time_ns, message)
    return path
