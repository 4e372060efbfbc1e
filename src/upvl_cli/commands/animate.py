"""An animated picture of a labelled drive, drawn from the shards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.commands.draw import image_from_above
from upvl_cli.drawing.animation import save_gif, save_webp, side_by_side
from upvl_cli.drawing.birds_eye import BoxPaint, View
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.drawing.colours import track_colour
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.camera import rays
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.stages.rows import AmodalRow

if TYPE_CHECKING:
    from PIL.Image import Image

    from upvl_cli.types import Camera, Drive, TrackedBoxes

VIEW = View(x_min_m=-15.0, x_max_m=45.0, y_min_m=-20.0, y_max_m=20.0, pixels_per_metre=20 / 3)
MOST_FRAMES = 40  # more make the file too large for a page
CAMERA_WIDTH_PX = 900  # boxes are drawn at this width, and shrunk with the picture
SECONDS = 6.0  # of the whole animation, where the drive is no longer
FORMATS = {"gif": save_gif, "webp": save_webp}


@dataclass(frozen=True)
class Animation:
    """An animated picture on disk: its path, its size, and how many frames of the drive it shows."""

    path: Path
    size_bytes: int
    shown: int
    frames: int


def animate_drive(
    workspace: Workspace, segment: str, kind: str = "webp", tick: Callable[[], None] = lambda: None
) -> Animation:
    """Draw a labelled drive over time: from above, and by the camera that looks ahead.

    Args:
        workspace: The workspace of the labels.
        segment: Name of the drive.
        kind: A key of `FORMATS`.
        tick: Called after each frame.

    Raises:
        BadSetting: There is no such format, or the drive has no frame.
        NotMade: The drive has not been labelled.
    """
    if kind not in FORMATS:
        raise BadSetting(f"--animate-as {kind}: expected one of {', '.join(FORMATS)}")
    labels = workspace.table("nms", AmodalRow, segment)
    frames = thin(labels.frames)
    if not frames:
        raise BadSetting(f"{segment} has no frame to draw")
    images = []
    for image in _images(workspace, segment, frames):
        images.append(image)
        tick()
    path = workspace.out / "draw" / f"{segment}.{kind}"
    # GIF counts time in steps of 10 ms.
    duration_ms = 10 * max(round(SECONDS * 100 / len(images)), 2)
    with atomic_file(path) as file:
        FORMATS[kind](images, duration_ms, file)
    return Animation(path, path.stat().st_size, len(frames), len(labels.frames))


def num_drawn(workspace: Workspace, segment: str) -> int:
    """Return how many frames an animation of a drive shows.

    Raises:
        NotMade: The drive has not been labelled.
    """
    return len(thin(workspace.table("nms", AmodalRow, segment).frames))


def thin(frames: tuple[int, ...]) -> tuple[int, ...]:
    """Return every n-th frame, so that no more than `MOST_FRAMES` remain."""
    return frames[:: -(-len(frames) // MOST_FRAMES)] if frames else ()


def _images(workspace: Workspace, segment: str, frames: tuple[int, ...]) -> Iterator[Image]:
    labels = workspace.table("nms", AmodalRow, segment)
    drive = workspace.drive(segment)
    camera = forward_camera(drive)
    for frame in frames:
        boxes = labels[frame].tracked_boxes
        paints = _paints(boxes)
        above = image_from_above(workspace, segment, frame, boxes, view=VIEW, paints=paints, title="")
        picture = drive.image(frame, camera.name) if camera else None
        yield side_by_side(
            above,
            camera_view(picture.rgb, camera, boxes, paints, CAMERA_WIDTH_PX) if camera and picture else None,
        )


def _paints(boxes: TrackedBoxes) -> list[BoxPaint]:
    """Return the colours of the tracks; the pictures are too small for text."""
    return [BoxPaint(track_colour(track_id), "") for track_id in boxes.track_id.tolist()]


def forward_camera(drive: Drive) -> Camera | None:
    """Return the camera whose view is nearest to straight ahead; None where the drive has none."""

    def ahead(camera: Camera) -> float:
        middle = np.array([[camera.width_px / 2, camera.height_px / 2]])
        return float(np.nan_to_num(rays(camera, middle)[0, 0], nan=-1.0))

    return max(drive.cameras, key=ahead, default=None)
