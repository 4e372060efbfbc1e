"""Pictures of hits as files of images: the surroundings from above, the crop of a camera, and whole cameras."""

from __future__ import annotations

import io
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.drawing.hit_sheet import HitPicture, part_with_box, picture_crop, surroundings
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.box_projection import projected_boxes
from upvl_cli.geometry.boxes import corners
from upvl_cli.runtime.bounded_cache import BoundedCache
from upvl_cli.types import Camera, TrackedBoxes
from upvl_cli.web.catalog import Catalog
from upvl_cli.web.raw_drives import NoRawData, RawDrives

if TYPE_CHECKING:
    from PIL.Image import Image

CROP_PX = (360, 308)
CAMERA_PX = (960, 720)
_FILES_BYTES = 2**26
_JPEG_QUALITY = 82
_FRAME_PX = 8  # from the box to its frame

Picture = tuple[str, bytes]  # type of the file, and its content


class Pictures:
    """Draws pictures and keeps the last ones."""

    def __init__(self, drives: RawDrives) -> None:
        """Name where sweeps and pictures come from."""
        self._drives = drives
        self._files: BoundedCache[Picture] = BoundedCache(_FILES_BYTES, lambda picture: len(picture[1]))

    def above(self, catalog: Catalog, segment: str, frame: int, box: int) -> Picture:
        """Return a box and what is around it from above; without points where the raw drive is gone."""
        catalog.row(segment, frame, box)
        hit = boxes_at(catalog, segment, frame)[box : box + 1]
        key = ("above", catalog.digest, segment, frame, box)

        def draw() -> Picture:
            try:
                points = self._drives.points(segment, frame)
            except NoRawData:
                points = np.zeros((0, 3))
            return _png(surroundings(points, hit))

        return self._files.get_or_make(key, draw)

    def crop(self, catalog: Catalog, segment: str, frame: int, box: int) -> Picture:
        """Return the part of the picture in which a box is largest; a text where no camera shows it."""
        catalog.row(segment, frame, box)
        hit = boxes_at(catalog, segment, frame)[box : box + 1]
        key = ("crop", catalog.digest, segment, frame, box)
        return self._files.get_or_make(key, lambda: self._draw_crop(segment, frame, hit))

    def _draw_crop(self, segment: str, frame: int, hit: TrackedBoxes) -> Picture:
        problem = "no camera shows it in this frame"
        try:
            cameras = self._drives.drive(segment).cameras
            seen = [(camera, part_with_box(camera, hit)) for camera in cameras]
            views = [(camera, part) for camera, part in seen if part is not None]
            for camera, part in sorted(views, key=lambda view: -_area(view[1])):
                try:
                    rgb = self._drives.picture(segment, frame, camera.name)
                except NoRawData as error:
                    problem = str(error)
                    continue
                return _jpeg(picture_crop(HitPicture(rgb, camera, part), hit, CROP_PX))
        except NoRawData:
            problem = "the raw drive cannot be read"
        return placeholder(problem, CROP_PX)

    def camera(
        self, catalog: Catalog, segment: str, frame: int, number: int, track: int | None = None
    ) -> Picture:
        """Return the whole picture of a camera with all boxes of the frame; a text where there is none.

        Args:
            catalog: The boxes.
            segment: Name of the drive.
            frame: Index of the frame.
            number: Number of the camera.
            track: Track whose box is framed; None for none.

        Raises:
            BadSetting: There is no such camera.
        """
        boxes = boxes_at(catalog, segment, frame)
        cameras = self._drives.cameras(segment)
        if not 0 <= number < len(cameras):
            raise BadSetting(f"drive {segment} has no camera number {number}")
        key = ("camera", catalog.digest, segment, frame, number, track)

        def draw() -> Picture:
            camera = cameras[number]
            try:
                rgb = self._drives.picture(segment, frame, camera.name)
            except NoRawData as error:
                return placeholder(str(error), (640, 360))
            image = camera_view(rgb, camera, boxes)
            if track is not None:
                _frame(image, camera, boxes[boxes.track_id == track])
            image.thumbnail(CAMERA_PX)
            return _jpeg(image)

        return self._files.get_or_make(key, draw)


def _frame(image: Image, camera: Camera, hit: TrackedBoxes) -> None:
    """Draw a frame around the box of a hit, which may be none."""
    from PIL import ImageDraw

    edges, _ = projected_boxes(camera, corners(hit))
    for rectangle in edges[np.isfinite(edges).all(axis=1)]:
        scale = image.width / camera.width_px
        left, top, right, bottom = (float(edge) * scale for edge in rectangle)
        outline = (left - _FRAME_PX, top - _FRAME_PX, right + _FRAME_PX, bottom + _FRAME_PX)
        ImageDraw.Draw(image).rectangle(outline, outline=colours.MOVING, width=_FRAME_PX // 2)


def boxes_at(catalog: Catalog, segment: str, frame: int) -> TrackedBoxes:
    """Return the boxes of one frame, in the order of their rows."""
    objects = catalog.objects(segment)
    low, high = np.searchsorted(objects.frame, [frame, frame + 1])
    here = objects[int(low) : int(high)]
    return TrackedBoxes(
        here.center_m, here.size_lwh_m, here.heading_rad, here.velocity_mps, here.confidence, here.track_id
    )


def placeholder(text: str, size_px: tuple[int, int]) -> Picture:
    """Return a picture that says in words why there is none."""
    width, height = size_px
    lines, line = [], ""
    for word in text.split():
        if len(line) + len(word) > 24:
            lines.append(line)
            line = ""
        line = f"{line} {word}".strip()
    lines = [*lines, line][:6]
    spans = "".join(
        f'<text x="{width / 2:g}" y="{height / 2 + 30 * (row + 0.8 - len(lines) / 2):g}" text-anchor="middle" '
        f'font-family="sans-serif" font-size="24" fill="#9aa4b2">{escape(part)}</text>'
        for row, part in enumerate(lines)
    )
    body = f'<rect width="{width}" height="{height}" fill="#12141a"/>{spans}'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">{body}</svg>'
    return "image/svg+xml", svg.encode()


def _area(part: tuple[float, float, float, float]) -> float:
    left, top, right, bottom = part
    return (right - left) * (bottom - top)


def _png(image: Image) -> Picture:
    file = io.BytesIO()
    image.save(file, format="PNG", compress_level=1)
    return "image/png", file.getvalue()


def _jpeg(image: Image) -> Picture:
    file = io.BytesIO()
    image.convert("RGB").save(file, format="JPEG", quality=_JPEG_QUALITY)
    return "image/jpeg", file.getvalue()
