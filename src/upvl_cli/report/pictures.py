"""Pictures of a few frames as JPEG inside the page, within a budget of bytes."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.commands.draw import image_from_above
from upvl_cli.drawing.birds_eye import BoxPaint, View
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.drawing.colours import CLASSES
from upvl_cli.errors import UpvlError, one_line
from upvl_cli.geometry.camera import project
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.drive_labels import DriveLabels
from upvl_cli.report.figures import kind_of
from upvl_cli.types import Array, Camera, TrackedBoxes

if TYPE_CHECKING:
    from PIL.Image import Image

# As `upvl draw`, at a scale that a page of text has room for.
VIEW = View(x_min_m=-25.0, x_max_m=55.0, y_min_m=-30.0, y_max_m=30.0, pixels_per_metre=9)
CAMERA_WIDTH_PX = 800
QUALITY = 72
# Where in a drive pictures are taken, by order of importance: as shares of its frames.
MOMENTS = (0.5, 1 / 6, 5 / 6)
MOST_FRAMES = 10  # beyond the middle frame of every drive: reading a sweep and its pictures takes a second
ALL_CAMERAS_DRIVES = 2  # up to so many drives the middle frame is shown by every camera
MAX_TEXT_BOXES = 40  # with more boxes in a frame their numbers cover each other: those of moving ones stay


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture: its data URI, size, and what it shows in words."""

    uri: str
    width: int
    height: int
    alt: str
    caption: str


@dataclass(frozen=True)
class EmbeddedFrame:
    """The pictures of one frame, and what could not be drawn of it and why."""

    segment: str
    frame: int
    pictures: tuple[EmbeddedPicture, ...]
    fault: str = ""


class PictureBudget:
    """Bytes that pictures may still take."""

    def __init__(self, left_bytes: int) -> None:
        """Start with a number of bytes."""
        self.left_bytes = left_bytes
        self.refused = 0

    def accept(self, picture: EmbeddedPicture) -> bool:
        """Return whether there is room for a picture, and count it."""
        if len(picture.uri) > self.left_bytes:
            self.refused += 1
            return False
        self.left_bytes -= len(picture.uri)
        return True


def frame_pictures(
    workspace: Workspace, drives: Sequence[DriveLabels], budget: PictureBudget
) -> Iterator[EmbeddedFrame]:
    """Yield pictures of a few frames of each drive: first the middle of every drive, then others.

    Args:
        workspace: The workspace of the labels.
        drives: The drives.
        budget: What the pictures may take; drawing ends when it is used up.
    """
    broken: set[str] = set()
    drawn = 0
    for moment in MOMENTS:
        for labels in drives:
            if budget.refused or (moment != MOMENTS[0] and drawn >= MOST_FRAMES):
                return
            if not len(labels.frames) or labels.segment in broken:
                continue
            place = min(int(moment * len(labels.frames)), len(labels.frames) - 1)
            if moment != MOMENTS[0] and len(labels.frames) < len(MOMENTS):
                continue
            every_camera = len(drives) <= ALL_CAMERAS_DRIVES and moment == MOMENTS[0]
            found = _of_frame(workspace, labels, place, budget, every_camera=every_camera)
            drawn += 1
            if found.fault:
                broken.add(labels.segment)
            yield found


def _of_frame(
    workspace: Workspace, labels: DriveLabels, place: int, budget: PictureBudget, *, every_camera: bool
) -> EmbeddedFrame:
    frame, index = labels.frames[place], labels.at(place)
    boxes, paints = labels.boxes[index], class_paints(labels, index)
    counts = ", ".join(
        f"{int((labels.class_name[index] == name).sum())} {name}" for name in sorted(set(labels.class_name[index]))
    )  # fmt: skip
    kept: list[EmbeddedPicture] = []
    try:
        for picture in _pictures(workspace, labels.segment, frame, (boxes, paints), every_camera):
            shown = as_picture(
                picture[1],
                f"{picture[0]}, frame {frame} of {labels.segment}: {len(boxes)} boxes"
                + (f" ({counts})" if counts else ""),
                picture[0],
            )
            if not budget.accept(shown):
                break
            kept.append(shown)
    except UpvlError as error:
        return EmbeddedFrame(labels.segment, frame, tuple(kept), one_line(error))
    return EmbeddedFrame(labels.segment, frame, tuple(kept))


def _pictures(
    workspace: Workspace,
    segment: str,
    frame: int,
    drawn: tuple[TrackedBoxes, list[BoxPaint]],
    every_camera: bool,
) -> Iterator[tuple[str, Image]]:
    boxes, paints = drawn
    above = image_from_above(workspace, segment, frame, boxes, view=VIEW, paints=paints)
    yield "Bird's-eye view", above
    drive = workspace.drive(segment)
    by_boxes = sorted(drive.cameras, key=lambda camera: -_num_visible(camera, boxes.center_m))
    for camera in drive.cameras if every_camera else by_boxes[:1]:
        image = drive.image(frame, camera.name)
        if image is not None:
            width_px = min(CAMERA_WIDTH_PX, max(image.rgb.shape[1], CAMERA_WIDTH_PX // 2))
            yield f"Camera {camera.name}", camera_view(image.rgb, camera, boxes, paints, width_px)


def _num_visible(camera: Camera, xyz_ego_m: Array) -> int:
    return int(project(camera, xyz_ego_m)[2].sum())


def class_paints(labels: DriveLabels, index: Array) -> list[BoxPaint]:
    """Return for some boxes the colour of their class, and the number of their track where there is room for it."""
    is_crowded = len(index) > MAX_TEXT_BOXES
    return [
        BoxPaint(
            CLASSES[kind_of(str(labels.class_name[box]))],
            "" if is_crowded and not labels.is_moving[box] else str(labels.boxes.track_id[box]),
        )
        for box in np.asarray(index).tolist()
    ]


def as_picture(image: Image, alt: str, caption: str) -> EmbeddedPicture:
    """Return an image as JPEG in a data URI."""
    file = io.BytesIO()
    image.convert("RGB").save(file, format="JPEG", quality=QUALITY, optimize=True)
    text = base64.b64encode(file.getvalue()).decode("ascii")
    return EmbeddedPicture(f"data:image/jpeg;base64,{text}", image.width, image.height, alt, caption)
