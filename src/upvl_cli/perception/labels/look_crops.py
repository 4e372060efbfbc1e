"""The part of a picture around an object, and the feature of the object in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.camera import project
from upvl_cli.perception.labels.config import LookCropConfig
from upvl_cli.perception.visual.views import sample_bilinear
from upvl_cli.types import Array, Camera, Floats

MIN_DEPTH_M = 0.3  # a corner that is nearer to the camera's plane has no meaningful pixel


def object_rectangle(camera: Camera, corners_m: Array, uv_px: Floats) -> Floats:
    """Return (4,) left, top, right, bottom of an object in a picture, as far as they lie inside.

    Args:
        camera: The camera.
        corners_m: (8, 3) corners of its box, in ego axes at the time of the picture.
        uv_px: (n, 2) pixels of its points, at least one; they alone count where a corner lies behind the camera.
    """
    corner_px, depth_m, _ = project(camera, corners_m)
    in_front = (depth_m > MIN_DEPTH_M).all() and np.isfinite(corner_px).all()
    shown = np.concatenate([corner_px, uv_px]) if in_front else uv_px
    limit = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    return np.concatenate(
        [np.clip(shown.min(axis=0) + 0.5, 0, limit), np.clip(shown.max(axis=0) + 0.5, 0, limit)]
    )


class Crop(NamedTuple):
    """A part of a picture.

    Attributes:
        rgb: (h, w, 3) uint8 pixels, reduced or enlarged.
        origin_px: (2,) left and top of the part, in edges of pixels of the whole picture.
        size_px: (2,) width and height of the part, in pixels of the whole picture.
    """

    rgb: Array
    origin_px: Floats
    size_px: Floats

    def pixels(self, uv_px: Floats) -> Floats:
        """Return (n, 2) where pixels of the whole picture lie in this part, in its own pixels."""
        high, wide, _ = self.rgb.shape
        inside = (uv_px + 0.5 - self.origin_px) / self.size_px
        return np.asarray(inside * np.array([wide, high]) - 0.5)


def cut(rgb: Array, rectangle_px: Floats, config: LookCropConfig) -> Crop:
    """Cut an object out of a picture, with some of what is around it.

    One that is larger than wanted is reduced by a whole number, each pixel the mean of a square of pixels; one that is
    smaller is enlarged by a whole number, so that the network has more cells on it.

    Args:
        rgb: (h, w, 3) uint8 picture.
        rectangle_px: (4,) left, top, right, bottom of the object.
        config: How much around it, and how large.
    """
    high, wide, _ = rgb.shape
    low, top_end = rectangle_px[:2], rectangle_px[2:]
    size = top_end - low
    around = config.context * size.max()
    left, top = np.maximum(np.floor(low - around), 0).astype(int)
    right, bottom = np.minimum(np.ceil(top_end + around), [wide, high]).astype(int)
    longer = max(right - left, bottom - top)
    step = int(np.ceil(longer / config.max_px))
    # Whole squares: what is left over at the right and below is surroundings.
    right, bottom = left + max((right - left) // step, 1) * step, top + max((bottom - top) // step, 1) * step
    part = rgb[top:bottom, left:right]
    origin, extent = np.array([left, top], float), np.array([part.shape[1], part.shape[0]], float)
    if step > 1:
        rows, columns = part.shape[0] // step, part.shape[1] // step
        squares = part[: rows * step, : columns * step].reshape(rows, step, columns, step, 3)
        extent = np.array([columns * step, rows * step], float)
        return Crop(np.rint(squares.mean(axis=(1, 3))).astype(np.uint8), origin, extent)
    return Crop(_enlarged(part, int(config.wanted_px // longer)), origin, extent)


def _enlarged(rgb: Array, times: int) -> Array:
    """Return a picture with that many pixels for each one along both axes, interpolated between their centres."""
    if times < 2:
        return rgb
    high, wide, _ = rgb.shape
    v, u = np.mgrid[: high * times, : wide * times].reshape(2, -1)
    sampled = sample_bilinear(rgb.astype(np.float32), np.column_stack([u, v]), wide * times, high * times)
    return np.asarray(np.rint(sampled).astype(np.uint8).reshape(high * times, wide * times, 3))


def look(embed: Callable[[Array], Floats], crop: Crop, uv_px: Floats) -> Floats:
    """Return (d,) the feature of an object, of length 1: the mean of those at the pixels of its points.

    Args:
        embed: Gives (h', w', d) features of an (h, w, 3) picture.
        crop: The part of the picture that shows it.
        uv_px: (n, 2) pixels of its points in the whole picture, at least one.
    """
    high, wide, _ = crop.rgb.shape
    sampled = sample_bilinear(embed(crop.rgb), crop.pixels(uv_px), wide, high)
    sampled = sampled / np.maximum(np.linalg.norm(sampled, axis=1, keepdims=True), 1e-9)
    mean = sampled.mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-9), dtype=np.float32)
