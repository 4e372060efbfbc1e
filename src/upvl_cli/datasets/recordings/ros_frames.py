"""The tree of coordinate frames that a ROS recording gives in TF, and where one frame is in another."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from upvl_cli.datasets.recordings.pose_track import PoseTrack
from upvl_cli.datasets.recordings.ros_messages import pose, stamp_ns
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array

_EGO_FRAMES = ("base_link", "base_footprint", "ego", "ego_vehicle", "vehicle", "base")
_WORLD_FRAMES = ("odom", "map", "world", "earth")
_MOST_DEPTH = 100


class FrameTree:
    """Frames by their parents: fixed ones, and those that move over time."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Array]] = {}
        self._moving: dict[str, tuple[str, list[int], list[Array]]] = {}
        self._tracks: dict[str, PoseTrack] = {}

    def add(self, transforms: Iterable[Any], log_ns: int, *, is_fixed: bool) -> None:
        """Add the transforms of one TFMessage; raises `BadInput` where one is no rigid transform."""
        for message in transforms:
            parent, child = frame_name(message.header.frame_id), frame_name(message.child_frame_id)
            matrix = pose(message, f"TF from {parent} to {child}")
            if is_fixed:
                self._fixed[child] = (parent, matrix)
            else:
                _, times, poses = self._moving.setdefault(child, (parent, [], []))
                times.append(stamp_ns(message, log_ns))
                poses.append(matrix)

    @property
    def names(self) -> tuple[str, ...]:
        """All frames."""
        above = {edge[0] for edge in self._fixed.values()} | {edge[0] for edge in self._moving.values()}
        return tuple(sorted(above | self._fixed.keys() | self._moving.keys()))

    @property
    def ego_frame(self) -> str:
        """The frame that is called as the car's often is; empty where there is none."""
        return next((name for name in _EGO_FRAMES if name in self.names), "")

    def world_frame(self, ego_frame: str) -> str:
        """Return the frame above the car's in which it moves; empty where there is none."""
        above = self._above(ego_frame)
        moves = any(name in self._moving for name in above[:-1])
        named = next((name for name in _WORLD_FRAMES if name in above), above[-1])
        return named if moves and named != ego_frame else ""

    def _above(self, frame: str) -> list[str]:
        """Return a frame and all above it, up to the root."""
        path = [frame]
        while len(path) < _MOST_DEPTH:
            edge = self._fixed.get(path[-1]) or self._moving.get(path[-1])
            if edge is None or edge[0] in path:
                return path
            path.append(edge[0])
        return path

    def transform(self, target: str, source: str, time_ns: int) -> Array | None:
        """Return (4, 4) target_from_source at a time; None where the tree does not say.

        Args:
            target: Name of the frame into which points are moved.
            source: Name of the frame in which they are.
            time_ns: The time, for frames that move.
        """
        up_target, up_source = self._above(target), self._above(source)
        common = next((name for name in up_source if name in up_target), None)
        if common is None:
            return None
        common_from_target = self._chain(up_target[: up_target.index(common)], time_ns)
        common_from_source = self._chain(up_source[: up_source.index(common)], time_ns)
        if common_from_target is None or common_from_source is None:
            return None
        return compose(inverse(common_from_target), common_from_source)

    def _chain(self, frames: list[str], time_ns: int) -> Array | None:
        """Return the pose of the first of frames, each of which hangs on the next, in what the last hangs on."""
        result = np.eye(4)
        for name in frames:
            if name in self._fixed:
                step: Array | None = self._fixed[name][1]
            else:
                step = self._track(name).at(time_ns)
            if step is None:
                return None
            result = compose(step, result)
        return result

    def _track(self, name: str) -> PoseTrack:
        if name not in self._tracks:
            _, times, poses = self._moving[name]
            self._tracks[name] = PoseTrack.in_time_order(np.array(times, dtype=np.int64), np.stack(poses))
        return self._tracks[name]

    def mount(self, ego_frame: str, frame: str, what: str) -> Array:
        """Return (4, 4) ego_from_frame of a sensor, which does not move on the car.

        Raises:
            BadInput: The tree does not connect the two.
        """
        if frame == ego_frame:
            return np.eye(4)
        start_ns = min((times[0] for _, times, _ in self._moving.values()), default=0)
        found = self.transform(ego_frame, frame, start_ns)
        if found is None:
            known = ", ".join(self.names)[:300] or "no frame at all"
            raise BadInput(
                f"TF does not connect the frame {frame!r} of {what} with {ego_frame!r}: it has {known}; name another "
                "ego_frame in the topic map, or give the pose there (ego_from_lidars, ego_from_camera)"
            )
        return found


def frame_name(text: object) -> str:
    """Return the name of a frame without the slash that old recordings begin it with."""
    return str(text).lstrip("/")
