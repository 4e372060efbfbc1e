"""One ROS recording as a drive: its first LiDAR makes the frames, everything else is looked up at their times."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.datasets.recordings import ros_messages
from upvl_cli.datasets.recordings.pose_track import NO_POSE, PoseTrack
from upvl_cli.datasets.recordings.recording import LeftOut, LidarScan, RecordedPicture, RecordedSweep
from upvl_cli.datasets.recordings.ros_frames import FrameTree, frame_name
from upvl_cli.datasets.recordings.ros_source import Decoder, RosMessage, RosSource, open_source
from upvl_cli.datasets.recordings.ros_topics import TF_TOPICS, TopicMap, proposed_map, read_topic_map
from upvl_cli.datasets.recordings.scan_drive import DAMAGED_PICTURE, NO_PICTURE
from upvl_cli.datasets.recordings.scan_folder import segment_name
from upvl_cli.datasets.shared.pictures import read_picture
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array, Camera

DAMAGED_MESSAGE = "damaged messages of a LiDAR"
NO_OTHER_LIDAR = "sweeps of a further LiDAR without one of the first at their time"
_MOST_APART_NS = 60_000_000  # half a sweep at 10 Hz, and a little
_SAMPLE_TIMES, _SAMPLE_EACH = 4, 2


@dataclass(frozen=True, eq=False)
class _Lidar:
    """One LiDAR: its number, topic and pose on the car."""

    number: int
    topic: str
    ego_from_lidar: Array


@dataclass(frozen=True, eq=False)
class RosDrive:
    """A ROS recording; see `Recording`."""

    name: str
    source: RosSource
    lidars: tuple[_Lidar, ...]
    cameras: tuple[Camera, ...]
    image_topics: Mapping[str, str]
    tree: FrameTree
    ego_frame: str
    world_frame: str
    odometry: PoseTrack | None
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    decoder: Decoder

    @property
    def total(self) -> int:
        """How many sweeps the first LiDAR made."""
        return self.source.topics[self.lidars[0].topic].count

    @property
    def has_poses(self) -> bool:
        """Whether the recording gives poses."""
        return self.odometry is not None or bool(self.world_frame)

    def sample(self) -> Sequence[LidarScan]:
        """Return some scans of each LiDAR; raises `BadInput` where none can be read."""
        found, errors = [], []
        for lidar in self.lidars:
            times = _spread(self.source, lidar.topic)
            for start_ns in times:
                messages = self.source.messages({lidar.topic}, start_ns)
                for message, _ in zip(messages, range(_SAMPLE_EACH), strict=False):
                    try:
                        found.append(self._scan(lidar, message))
                    except BadInput as error:
                        errors.append(error)
        if not found:
            raise errors[0] if errors else BadInput(f"{self.name} has no message of {self.lidars[0].topic}")
        return found

    def sweeps(self, first: int) -> Iterator[RecordedSweep | LeftOut]:
        """Yield the sweeps of the first LiDAR in order, each with the nearest of the others."""
        if len(self.lidars) == 1:
            messages = self.source.messages({self.lidars[0].topic})
            for item, message in enumerate(messages):
                if item >= first:
                    yield self._sweep(item, message, [])
            return
        yield from self._merged(first)

    def _merged(self, first: int) -> Iterator[RecordedSweep | LeftOut]:
        """Yield sweeps of several LiDARs: one waits until the others have gone by, and takes the nearest of each."""
        main = self.lidars[0].topic
        waiting: deque[tuple[int, RosMessage]] = deque()
        others: dict[str, deque[RosMessage]] = {lidar.topic: deque() for lidar in self.lidars[1:]}
        item = -1
        for message in self.source.messages({lidar.topic for lidar in self.lidars}):
            if message.topic == main:
                item += 1
                waiting.append((item, message))
            else:
                others[message.topic].append(message)
            while waiting and message.log_ns - waiting[0][1].log_ns > _MOST_APART_NS:
                place, ready = waiting.popleft()
                if place >= first:
                    yield self._sweep(place, ready, _nearest(ready, others))
                for queue in others.values():
                    while queue and queue[0].log_ns < ready.log_ns - _MOST_APART_NS:
                        queue.popleft()
        for place, ready in waiting:
            if place >= first:
                yield self._sweep(place, ready, _nearest(ready, others))

    def _sweep(self, item: int, message: RosMessage, others: Sequence[RosMessage]) -> RecordedSweep | LeftOut:
        try:
            scans = [self._scan(self.lidars[0], message)]
            by_topic = {lidar.topic: lidar for lidar in self.lidars}
            scans += [self._scan(by_topic[other.topic], other) for other in others]
        except BadInput as error:
            return LeftOut(item, DAMAGED_MESSAGE, error)
        time_ns = scans[0].time_ns
        world_from_ego = self.world_from_ego(time_ns)
        if self.has_poses and world_from_ego is None:
            return LeftOut(item, NO_POSE)
        return RecordedSweep(item, item, time_ns, world_from_ego, tuple(scans))

    def world_from_ego(self, time_ns: int) -> Array | None:
        """Return the (4, 4) pose of the car at a time; None where the recording gives none."""
        if self.odometry is not None:
            return self.odometry.at(time_ns)
        return self.tree.transform(self.world_frame, self.ego_frame, time_ns) if self.world_frame else None

    def _scan(self, lidar: _Lidar, message: RosMessage) -> LidarScan:
        decoded = self.decoder.decode(message)
        points = ros_messages.cloud(decoded, f"a message of {lidar.topic}")
        time_ns = ros_messages.stamp_ns(decoded, message.log_ns)
        return LidarScan(lidar.number, time_ns, points, lidar.ego_from_lidar)

    def pictures(self, times_ns: Mapping[int, int]) -> Iterator[RecordedPicture | LeftOut]:
        """Yield, camera by camera, the picture that is nearest to each frame."""
        for camera in self.cameras:
            yield from self._pictures(camera, times_ns)

    def _pictures(self, camera: Camera, times_ns: Mapping[int, int]) -> Iterator[RecordedPicture | LeftOut]:
        frames, frame_ns = list(times_ns), np.array(list(times_ns.values()), dtype=np.int64)
        most_ns = int(np.median(np.diff(frame_ns))) // 2 if len(frame_ns) > 1 else _MOST_APART_NS
        best: tuple[int, int, RosMessage] | None = None
        filled = 0
        for message in self.source.messages({self.image_topics[camera.name]}):
            time_ns = ros_messages.stamp_ns(self.decoder.decode(message), message.log_ns)
            step = _nearest_step(frame_ns, time_ns)
            if abs(int(frame_ns[step]) - time_ns) > most_ns or (best is not None and step < best[0]):
                continue
            apart_ns = abs(int(frame_ns[step]) - time_ns)
            if best is not None and step > best[0]:
                yield self._picture(camera, frames[best[0]], best[2])
                filled += 1
                best = None
            if best is None or apart_ns < best[1]:
                best = (step, apart_ns, message)
        if best is not None:
            yield self._picture(camera, frames[best[0]], best[2])
            filled += 1
        yield from (LeftOut(0, NO_PICTURE) for _ in range(len(frames) - filled))

    def _picture(self, camera: Camera, frame: int, message: RosMessage) -> RecordedPicture | LeftOut:
        where = f"a message of {message.topic}"
        try:
            decoded = self.decoder.decode(message)
            content = ros_messages.picture(decoded, where)
            read_picture(content, camera.width_px, camera.height_px, where)
        except BadInput as error:
            return LeftOut(0, DAMAGED_PICTURE, error)
        return RecordedPicture(frame, camera.name, ros_messages.stamp_ns(decoded, message.log_ns), content)


def _nearest_step(frame_ns: Array, time_ns: int) -> int:
    after = int(np.clip(np.searchsorted(frame_ns, time_ns), 1, max(len(frame_ns) - 1, 1)))
    if len(frame_ns) < 2:
        return 0
    return after if frame_ns[after] - time_ns < time_ns - frame_ns[after - 1] else after - 1


def _nearest(main: RosMessage, others: Mapping[str, Sequence[RosMessage]]) -> list[RosMessage]:
    """Return the message of each other LiDAR that is nearest in time, where one is near."""
    found = []
    for queue in others.values():
        near = min(queue, key=lambda message: abs(message.log_ns - main.log_ns), default=None)
        if near is not None and abs(near.log_ns - main.log_ns) <= _MOST_APART_NS:
            found.append(near)
    return found


def _spread(source: RosSource, topic: str) -> list[int | None]:
    """Return times from which samples are taken, from all over the recording where its length is known."""
    first = next(iter(source.messages({topic})), None)
    if first is None:
        return [None]
    seconds = (
        source.topics[topic].count / 10
    )  # at 10 Hz, the usual rate; too far gives no message, and no harm
    return [first.log_ns + int(part * seconds * 1e9 / _SAMPLE_TIMES) for part in range(_SAMPLE_TIMES)]


def propose(source_path: Path) -> str:
    """Return the text of a topic map for a recording."""
    source = open_source(source_path)
    tree = _read_frames(source, Decoder())
    ego = tree.ego_frame
    return proposed_map(source.topics, ego, tree.world_frame(ego) if ego else "")


def open_ros(source_path: Path, topics_path: Path) -> RosDrive:
    """Return a ROS recording.

    Args:
        source_path: The file or folder.
        topics_path: Its topic map.

    Raises:
        BadInput: It is damaged, or lacks what the map needs.
        BadSetting: The map is wrong, or packages are missing.
    """
    source, decoder = open_source(source_path), Decoder()
    topics = read_topic_map(topics_path, source.topics)
    tree = _read_frames(source, decoder)
    heads = {name: _first(source, decoder, name) for name in topics.config.lidars}
    ego_frame = topics.config.ego_frame or frame_name(heads[topics.config.lidars[0]].header.frame_id)
    world_frame = topics.config.world_frame
    if world_frame and not topics.config.odometry and world_frame not in tree.names:
        known = ", ".join(tree.names)[:300] or "no frame at all"
        raise BadInput(f"{topics_path}: world_frame {world_frame!r} is not in TF; it has {known}")
    lidars = []
    for number, topic in enumerate(topics.config.lidars):
        given = topics.config.ego_from_lidars[16 * number : 16 * number + 16]
        frame = frame_name(heads[topic].header.frame_id)
        mount = (
            _given(given, f"{topics_path}: ego_from_lidars") if given else tree.mount(ego_frame, frame, topic)
        )
        lidars.append(_Lidar(number, topic, mount))
    cameras, camera_notes = _cameras(source, decoder, topics, tree, ego_frame)
    odometry = _odometry(source, decoder, topics.config.odometry, tree, ego_frame)
    pose_note = "no poses: they will come from odometry"
    if odometry is not None:
        pose_note = f"poses from {topics.config.odometry}"
    elif topics.config.world_frame:
        pose_note = f"poses from TF: {topics.config.world_frame} to {ego_frame}"
    return RosDrive(
        name=segment_name(source_path),
        source=source,
        lidars=tuple(lidars),
        cameras=tuple(cameras),
        image_topics={known.name: known.image for known in topics.cameras},
        tree=tree,
        ego_frame=ego_frame,
        world_frame=topics.config.world_frame,
        odometry=odometry,
        files=(*source.files, topics_path),
        notes=(*(f"LiDAR {lidar.number}: {lidar.topic}" for lidar in lidars), pose_note, *camera_notes),
        decoder=decoder,
    )


def _given(numbers: Sequence[float], where: str) -> Array:
    return check_pose(np.array(numbers).reshape(4, 4), where, max_m=MAX_ON_CAR_M)


def _first(source: RosSource, decoder: Decoder, topic: str) -> Any:
    message = next(iter(source.messages({topic})), None)
    if message is None:
        raise BadInput(f"the recording has no message of {topic}")
    return decoder.decode(message)


def _read_frames(source: RosSource, decoder: Decoder) -> FrameTree:
    tree = FrameTree()
    names = [name for name in source.topics if name in TF_TOPICS]
    for message in source.messages(names) if names else ():
        transforms = decoder.decode(message).transforms
        tree.add(transforms, message.log_ns, is_fixed=message.topic == "/tf_static")
    return tree


def _odometry(
    source: RosSource, decoder: Decoder, topic: str, tree: FrameTree, ego_frame: str
) -> PoseTrack | None:
    if not topic:
        return None
    times, poses = [], []
    child = ""
    for message in source.messages({topic}):
        decoded = decoder.decode(message)
        child = frame_name(getattr(decoded, "child_frame_id", ""))
        times.append(ros_messages.stamp_ns(decoded, message.log_ns))
        poses.append(ros_messages.pose(decoded, f"a message of {topic}"))
    if not poses:
        raise BadInput(f"the recording has no message of {topic}")
    # Odometry says which frame it moves; where TF does not know that frame, it is taken for the car's.
    child_from_ego = np.eye(4)
    if child and child != ego_frame and child in tree.names:
        child_from_ego = inverse(tree.mount(ego_frame, child, topic))
    return PoseTrack.in_time_order(np.array(times, dtype=np.int64), compose(np.stack(poses), child_from_ego))


def _cameras(
    source: RosSource, decoder: Decoder, topics: TopicMap, tree: FrameTree, ego_frame: str
) -> tuple[list[Camera], list[str]]:
    cameras, notes = [], []
    for known in topics.cameras:
        info = _first(source, decoder, known.info)
        if known.ego_from_camera:
            pose = _given(known.ego_from_camera, f"camera {known.name}: ego_from_camera")
        else:
            frame = frame_name(info.header.frame_id)
            pose, is_turned = ros_messages.optical(tree.mount(ego_frame, frame, known.info))
            if is_turned:
                notes.append(
                    f"camera {known.name}: {frame} is no optical frame (its z points up), and was turned"
                )
        cameras.append(ros_messages.camera(info, known.name, pose, is_rectified=known.rectified))
    notes.append(f"cameras: {', '.join(camera.name for camera in cameras) or 'none'}")
    return cameras, notes
