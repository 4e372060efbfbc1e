"""Pictures of one labelled frame, drawn from the shards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from upvl_cli.drawing.birds_eye import BoxPaint, View, birds_eye
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.pipeline.stage import Row
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.stages.rows import AmodalRow, GroundRow, MaskRow, OdometryRow
from upvl_cli.types import Array, TrackedBoxes

if TYPE_CHECKING:
    from PIL.Image import Image

R = TypeVar("R", bound=Row)
# A little behind the car, and ahead as far as boxes are dense on a 64-beam LiDAR.
VIEW = View(x_min_m=-25.0, x_max_m=55.0, y_min_m=-30.0, y_max_m=30.0)
TAIL_FRAMES = 20  # 2 s of past path at 10 Hz


def draw_frame(workspace: Workspace, segment: str, frame: int | None) -> Iterator[Path]:
    """Draw one labelled frame from above and on each camera's picture, and yield the paths.

    Args:
        workspace: The workspace of the labels.
        segment: Name of the drive.
        frame: Index of the frame; None takes the middle one.

    Raises:
        BadSetting: The drive has no such frame.
        NotMade: The drive has not been labelled.
    """
    labels = workspace.table("nms", AmodalRow, segment)
    frame = chosen_frame(labels, segment, frame)
    stem = workspace.out / "draw" / f"{segment}-{frame:06d}"
    above = image_from_above(workspace, segment, frame, labels[frame].tracked_boxes)
    yield save(above, stem.with_name(f"{stem.name}-above.png"))
    drive = workspace.drive(segment)
    for camera in drive.cameras:
        image = drive.image(frame, camera.name)
        if image is not None:
            picture = camera_view(image.rgb, camera, labels[frame].tracked_boxes)
            yield save(picture, stem.with_name(f"{stem.name}-{camera.name}.png"))


def chosen_frame(table: Table[R], segment: str, frame: int | None) -> int:
    """Return the frame, or the middle one where none is given.

    Args:
        table: Table with the frames of the drive.
        segment: Name of the drive, for the message.
        frame: Index of the frame; None takes the middle one.

    Raises:
        BadSetting: The drive has no such frame.
    """
    if frame is None and len(table):
        frame = table.frames[len(table) // 2]
    if frame is None or frame not in table.frames:
        span = f"{table.frames[0]} to {table.frames[-1]}" if len(table) else "no frame at all"
        raise BadSetting(f"{segment} has no frame {frame}: it has {span}")
    return frame


def image_from_above(
    workspace: Workspace,
    segment: str,
    frame: int,
    boxes: TrackedBoxes,
    *,
    view: View = VIEW,
    paints: Sequence[BoxPaint] | None = None,
    has_tails: bool = True,
    title: str | None = None,
) -> Image:
    """Return one frame from above: points by state, boxes, and the past path of their tracks.

    Args:
        workspace: The workspace of the labels.
        segment: Name of the drive.
        frame: Index of the frame.
        boxes: The boxes to draw, in the ego axes of the frame.
        view: The part of the ground to show.
        paints: Of each box its colour and text; None takes those of the tracks.
        has_tails: Whether to draw the past path of the tracks.
        title: Text of the upper left corner; None names the drive, the frame and the number of boxes.

    Raises:
        NotMade: The ground, the mask or the poses are missing.
    """
    labels = workspace.table("nms", AmodalRow, segment)
    ground = workspace.table("ground", GroundRow, segment)[frame]
    mask = workspace.table("mask", MaskRow, segment)[frame]
    candidate = mask.is_moving & (mask.background != 1) & ~ground.is_ground
    state = np.where(candidate, 2, np.where(ground.is_ground, 0, 1))
    return birds_eye(
        view,
        workspace.drive(segment).points(frame).xyz_ego_m,
        state,
        boxes,
        _tails(labels, workspace.table("odometry", OdometryRow, segment), frame) if has_tails else {},
        f"{segment}  frame {frame}  {len(boxes)} boxes" if title is None else title,
        paints,
    )


def _tails(labels: Table[AmodalRow], poses: Table[OdometryRow], frame: int) -> dict[int, Array]:
    """Return for each track of a frame (m, 2) its past centres, in the ego axes of the frame."""
    past = [index for index in labels.frames if index <= frame][-TAIL_FRAMES:]
    ego_from_world = inverse(poses[frame].world_from_ego)
    tails: dict[int, list[Array]] = {int(track_id): [] for track_id in labels[frame].track_id}
    for index in past:
        row = labels[index]
        centers_m = apply(ego_from_world @ poses[index].world_from_ego, row.center_m)
        for track_id, center_m in zip(row.track_id, centers_m, strict=True):
            if int(track_id) in tails:
                tails[int(track_id)].append(center_m[:2])
    return {track_id: np.array(tail) for track_id, tail in tails.items()}


def save(image: Image, path: Path) -> Path:
    """Write a picture as PNG and return its path."""
    with atomic_file(path) as file:
        image.save(file, format="PNG")
    return path
