"""The topic map: which topics of a ROS recording are the LiDARs, the cameras and the poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.config.base import Config, setting
from upvl_cli.config.toml import parse, read_toml
from upvl_cli.datasets.recordings.ros_source import RosTopic
from upvl_cli.errors import BadSetting

CLOUD = "sensor_msgs/msg/PointCloud2"
IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POSES = (
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)  # fmt: skip
TF_TOPICS = ("/tf", "/tf_static")


@dataclass(frozen=True)
class TopicConfig(Config):
    """What stands above the cameras in a topic map."""

    lidars: tuple[str, ...] = setting("Topics of PointCloud2; the sweeps of the first are the frames")
    ego_frame: str = setting(
        "TF frame of the car: x forward, y left, z up; empty for that of the first LiDAR"
    )
    odometry: str = setting("Topic of Odometry or PoseStamped with the poses; empty for TF")
    world_frame: str = setting(
        "TF frame that stands still; empty for none: then poses come from odometry of upvl"
    )
    ego_from_lidars: tuple[float, ...] = setting(
        "4 x 4 pose of each LiDAR on the car, row by row, instead of TF"
    )


@dataclass(frozen=True)
class CameraTopics(Config):
    """One camera of a topic map."""

    name: str = setting("Name of the camera")
    image: str = setting("Topic of CompressedImage or Image")
    info: str = setting("Topic of CameraInfo")
    rectified: bool = setting("Whether its pictures are rectified: then P of CameraInfo counts")
    ego_from_camera: tuple[float, ...] = setting("4 x 4 pose of its optical frame, row by row, instead of TF")


@dataclass(frozen=True)
class TopicMap:
    """A whole topic map."""

    config: TopicConfig
    cameras: tuple[CameraTopics, ...]


_DEFAULTS = {"ego_frame": "", "odometry": "", "world_frame": "", "ego_from_lidars": []}
_CAMERA_DEFAULTS = {"rectified": False, "ego_from_camera": []}


def read_topic_map(path: Path, topics: Mapping[str, RosTopic]) -> TopicMap:
    """Return a topic map.

    Args:
        path: The TOML file.
        topics: The topics of the recording.

    Raises:
        BadSetting: A key is unknown, or a topic is not in the recording or of another type.
    """
    values = read_toml(path)
    tables = values.pop("cameras", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise BadSetting(f"{path}: cameras must be tables [[cameras]], one a camera")
    config = parse(TopicConfig, {**_DEFAULTS, **values}, path)
    cameras = tuple(parse(CameraTopics, {**_CAMERA_DEFAULTS, **table}, path) for table in tables)
    if not config.lidars or len(set(config.lidars)) < len(config.lidars):
        raise BadSetting(f"{path}: lidars names {len(config.lidars)} topics, expected one or more, each once")
    if len(config.ego_from_lidars) not in (0, 16 * len(config.lidars)):
        raise BadSetting(
            f"{path}: ego_from_lidars has {len(config.ego_from_lidars)} numbers, expected {16 * len(config.lidars)}"
        )
    names = [known.name for known in cameras]
    if len(set(names)) < len(names):
        raise BadSetting(f"{path} has two cameras of one name: {', '.join(names)[:100]}")
    for known in cameras:
        if len(known.ego_from_camera) not in (0, 16):
            raise BadSetting(f"{path}, camera {known.name}: ego_from_camera must have 16 numbers")
    wanted: list[tuple[str, tuple[str, ...]]] = [(topic, (CLOUD,)) for topic in config.lidars]
    wanted += [(config.odometry, POSES)] if config.odometry else []
    wanted += [(known.image, IMAGES) for known in cameras] + [
        (known.info, (CAMERA_INFO,)) for known in cameras
    ]
    for topic, kinds in wanted:
        _check_topic(topic, kinds, topics, path)
    return TopicMap(config, cameras)


def _check_topic(topic: str, kinds: tuple[str, ...], topics: Mapping[str, RosTopic], path: Path) -> None:
    known = topics.get(topic)
    short = " or ".join(kind.rpartition("/")[2] for kind in kinds)
    if known is None:
        fitting = [name for name, other in topics.items() if other.type in kinds]
        raise BadSetting(
            f"{path}: the recording has no topic {topic!r}; of type {short} it has {', '.join(fitting)[:300] or 'none'}"
        )
    if known.type not in kinds:
        raise BadSetting(f"{path}: topic {topic!r} is of type {known.type or 'unknown'}, expected {short}")


def proposed_map(topics: Mapping[str, RosTopic], ego_frame: str, world_frame: str) -> str:
    """Return the text of a topic map for a recording, to be looked at and mended by its owner.

    Args:
        topics: The topics of the recording.
        ego_frame: TF frame that looks like the car's; empty where there is none.
        world_frame: TF frame above it; empty where there is none.
    """
    by_count = sorted(topics.values(), key=lambda topic: (-topic.count, topic.name))
    clouds = [topic.name for topic in by_count if topic.type == CLOUD]
    poses = [topic.name for topic in by_count if topic.type in POSES]
    images = [topic for topic in by_count if topic.type in IMAGES]
    infos = {topic.name.rpartition("/")[0]: topic.name for topic in by_count if topic.type == CAMERA_INFO}
    odometry = poses[0] if poses and not world_frame else ""
    lines = ["# Which topics are what; mend what is wrong. All topics of the recording stand below."]
    lines.append(f'lidars = ["{clouds[0] if clouds else "/points"}"]   # the first makes the frames')
    lines.append(
        f'ego_frame = "{ego_frame}"   # of TF: x forward, y left, z up; empty for that of the first LiDAR'
    )
    lines.append(f'odometry = "{odometry}"   # a topic with poses; empty for TF')
    lines.append(
        f'world_frame = "{world_frame}"   # of TF, that stands still; empty with odometry, or without poses'
    )
    taken: set[str] = set()
    for topic in images:
        folder = topic.name.removesuffix("/compressed").rpartition("/")[0]
        if folder in infos and folder not in taken:
            taken.add(folder)
            name = folder.strip("/").replace("/", "_") or "camera"
            lines += [
                "",
                "[[cameras]]",
                f'name = "{name}"',
                f'image = "{topic.name}"',
                f'info = "{infos[folder]}"',
            ]
            is_rectified = "rect" in topic.name.removesuffix("/compressed").rpartition("/")[2]
            lines.append(f"rectified = {str(is_rectified).lower()}")
    lines += ["", "# topic, type, messages"]
    lines += [
        f"# {topic.name}  {topic.type}  {topic.count}"
        for topic in sorted(by_count, key=lambda known: known.name)
    ]
    return "\n".join(lines) + "\n"
