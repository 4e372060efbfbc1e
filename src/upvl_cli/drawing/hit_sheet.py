"""The contact sheet of a query: each object from above and in a camera's picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont, ImageOps

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import View, birds_eye
from upvl_cli.drawing.camera_view import MIN_DEPTH_M, camera_view
from upvl_cli.geometry.boxes import corners, pairs_inside
from upvl_cli.geometry.camera import project
from upvl_cli.types import Array, Camera, TrackedBoxes

REACH_M = 11.0  # of the view from above, to each side of the box
PICTURE_PX = 420  # width of the crop of the camera
MARGIN = 0.6  # of the box's size in the picture, on each side of it
MIN_CROP_PX = 60  # of the crop, in pixels of the picture: smaller ones show nothing of the surroundings
TITLE_PX = 20
COLUMNS = 2


@dataclass(frozen=True)
class HitPicture:
    """Picture that shows a box, its camera, and the part of it to show (left, top, right, bottom)."""

    rgb: Array
    camera: Camera
    part_px: tuple[float, float, float, float]


def part_with_box(camera: Camera, box: TrackedBoxes) -> tuple[float, float, float, float] | None:
    """Return the part of a picture that shows a box with some surroundings; None where it is not wholly in front.

    Args:
        camera: The camera of the picture.
        box: One box, in ego axes.
    """
    uv_px, depth_m, _ = project(camera, corners(box)[0])
    if not (depth_m > MIN_DEPTH_M).all() or not np.isfinite(uv_px).all():
        return None
    size_px = np.array([camera.width_px, camera.height_px])
    middle = uv_px.mean(axis=0)
    if not ((middle > 0) & (middle < size_px)).all():
        return None
    low, high = uv_px.min(axis=0), uv_px.max(axis=0)
    grown = np.maximum((high - low) * MARGIN, (MIN_CROP_PX - (high - low)) / 2)
    left, top = np.maximum(low - grown, 0)
    right, bottom = np.minimum(high + grown, size_px)
    return float(left), float(top), float(right), float(bottom)


def surroundings(xyz_ego_m: Array, box: TrackedBoxes) -> Image.Image:
    """Draw one object and what is around it from above, the points inside of it in another colour.

    Args:
        xyz_ego_m: (n, 3) points of the sweep.
        box: The box, in the same axes.
    """
    x_m, y_m = box.center_m[0, :2]
    view = View(x_m - REACH_M, x_m + REACH_M, y_m - REACH_M, y_m + REACH_M)
    state = np.ones(len(xyz_ego_m), dtype=np.int64)
    state[pairs_inside(xyz_ego_m, box, margin_m=0.0)[1]] = 2
    return birds_eye(view, xyz_ego_m, state, box, {}, "")


def tile(xyz_ego_m: Array, box: TrackedBoxes, shot: HitPicture | None, title: str) -> Image.Image:
    """Draw one object: from above, and beside it the crop of the picture.

    Args:
        xyz_ego_m: (n, 3) points of the sweep.
        box: The box, in the same axes.
        shot: The picture that shows it; None where no camera does.
        title: Text above.
    """
    above = surroundings(xyz_ego_m, box)
    image = Image.new("RGB", (above.width + PICTURE_PX, above.height + TITLE_PX), colours.BACKGROUND)
    image.paste(above, (0, TITLE_PX))
    if shot is not None:
        crop = picture_crop(shot, box, (PICTURE_PX, above.height))
        left = above.width + (PICTURE_PX - crop.width) // 2
        image.paste(crop, (left, TITLE_PX + (above.height - crop.height) // 2))
    ImageDraw.Draw(image).text((6, 3), title, fill=colours.TEXT, font=ImageFont.load_default(13))
    return image


def picture_crop(shot: HitPicture, box: TrackedBoxes, size_px: tuple[int, int]) -> Image.Image:
    """Return the part of a picture that shows a box, with its edges drawn.

    Args:
        shot: The picture.
        box: The box, in ego axes.
        size_px: Largest width and height of the result.
    """
    picture = camera_view(shot.rgb, shot.camera, box)
    scale = picture.width / shot.rgb.shape[1]
    left, top, right, bottom = (round(edge * scale) for edge in shot.part_px)
    crop = picture.crop((left, top, max(right, left + 1), max(bottom, top + 1)))
    return ImageOps.contain(crop, size_px)


def sheet(tiles: Sequence[Image.Image]) -> Image.Image:
    """Draw equally large tiles, at least one, in rows of two."""
    width, height = tiles[0].size
    rows = -(-len(tiles) // COLUMNS)
    image = Image.new("RGB", (width * min(len(tiles), COLUMNS), height * rows), colours.BACKGROUND)
    for place, one in enumerate(tiles):
        image.paste(one, (place % COLUMNS * width, place // COLUMNS * height))
    return image
