"""Typical mistakes in labels: what else their numbers may mean."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.evaluation.label_fit import Meaning
from upvl_cli.geometry.boxes import transform
from upvl_cli.geometry.se3 import from_yaw, inverse
from upvl_cli.types import Array, Boxes

_FOOT_M = 0.3048


@dataclass(frozen=True)
class LabelMeaning:
    """What labels may mean.

    Attributes:
        apply: From boxes as they are given to what they mean.
        text: What is wrong then, in words.
        cause: The likely cause.
        remedy: How to mend the labels.
        shift: Steps by which their sweep is later.
    """

    apply: Meaning
    text: str
    cause: str
    remedy: str
    shift: int = 0


def label_meanings(world_from_ego: Array | None, ground_z_m: float) -> Iterator[LabelMeaning]:
    """Yield the mistakes that are tried.

    Args:
        world_from_ego: (T, 4, 4) poses, or None.
        ground_z_m: Height of the road in ego axes.
    """
    yield from _heights(ground_z_m)
    yield from _headings()
    yield from _sizes()
    yield from _axes(world_from_ego)
    for shift, late in ((-1, "late"), (1, "early")):
        yield LabelMeaning(
            lambda boxes, step: boxes,
            f"boxes fit the sweep of the {'frame before' if shift < 0 else 'next frame'}",
            f"the labels are one frame {late}",
            "pair each label with the sweep of its time stamp",
            shift,
        )


def _heights(ground_z_m: float) -> Iterator[LabelMeaning]:
    for share, end in ((0.5, "bottom"), (-0.5, "top")):
        yield LabelMeaning(
            lambda boxes, step, share=share: _moved(boxes, share * boxes.size_lwh_m[:, 2]),  # type: ignore[misc]
            f"boxes are half a height too {'low' if share > 0 else 'high'}",
            f"the place of a box is the middle of its {end}, expected its centre",
            f"{'add' if share > 0 else 'subtract'} half the height to z",
        )
    if abs(ground_z_m) > 0.5:
        for sign in (1, -1):
            yield LabelMeaning(
                lambda boxes, step, sign=sign: _moved(boxes, np.full(len(boxes), sign * ground_z_m)),  # type: ignore[misc]
                f"boxes are {abs(ground_z_m):.2f} m too {'high' if sign * ground_z_m < 0 else 'low'}",
                "heights are measured from the road in one and from the sensor in the other",
                f"add {sign * ground_z_m:.2f} m to z",
            )


def _headings() -> Iterator[LabelMeaning]:
    quarter = np.pi / 2
    for sign, offset, text in (
        (1, quarter, "length and width are exchanged, or headings are 90 degrees off"),
        (-1, 0.0, "headings turn the other way"),
        (-1, quarter, "headings turn the other way, from y on"),
    ):
        yield LabelMeaning(
            lambda boxes, step, sign=sign, offset=offset: replace(  # type: ignore[misc]
                boxes, heading_rad=sign * boxes.heading_rad + offset
            ),
            text,
            "another convention of yaw; expected counter-clockwise from x, along the length",
            f"take heading = {'-' if sign < 0 else ''}heading{' + pi / 2' if offset else ''}",
        )
    yield LabelMeaning(
        lambda boxes, step: replace(boxes, heading_rad=np.deg2rad(boxes.heading_rad)),
        "headings are too large",
        "headings are in degrees, expected radians",
        "divide headings by 57.2958",
    )
    yield LabelMeaning(
        lambda boxes, step: replace(boxes, heading_rad=np.rad2deg(boxes.heading_rad)),
        "headings are too small",
        "headings were converted from degrees to radians twice",
        "multiply headings by 57.2958",
    )


def _sizes() -> Iterator[LabelMeaning]:
    for scale, cause in ((2.0, "sizes are half lengths"), (0.5, "sizes are twice the lengths")):
        yield LabelMeaning(
            lambda boxes, step, scale=scale: replace(boxes, size_lwh_m=scale * boxes.size_lwh_m),  # type: ignore[misc]
            f"boxes are too {'small' if scale > 1 else 'large'}",
            cause,
            f"multiply sizes by {scale:g}",
        )
    for order, name in (((2, 1, 0), "height, width, length"), ((0, 2, 1), "length, height, width")):
        yield LabelMeaning(
            lambda boxes, step, order=order: replace(boxes, size_lwh_m=boxes.size_lwh_m[:, order]),  # type: ignore[misc]
            "sizes are in another order",
            f"sizes are {name}; expected length, width, height",
            "put the columns in order",
        )
    for scale, unit in ((_FOOT_M, "feet"), (0.01, "centimetres"), (100.0, "hundreds of metres")):
        yield LabelMeaning(
            lambda boxes, step, scale=scale: replace(  # type: ignore[misc]
                boxes, center_m=scale * boxes.center_m, size_lwh_m=scale * boxes.size_lwh_m
            ),
            "boxes lie at other distances than the points",
            f"labels are in {unit}, expected metres as the points are",
            f"multiply places and sizes by {scale:g}",
        )


def _axes(world_from_ego: Array | None) -> Iterator[LabelMeaning]:
    for degrees in (90, 180, -90):
        turn = from_yaw(np.deg2rad(degrees), np.zeros(3))
        yield LabelMeaning(
            lambda boxes, step, turn=turn: transform(boxes, turn),  # type: ignore[misc]
            f"boxes fit when they are turned by {degrees} degrees about z",
            "labels and points are in different axes; expected x forward, y left, z up",
            f"turn the labels by {degrees} degrees",
        )
    yield LabelMeaning(
        lambda boxes, step: replace(
            boxes, center_m=boxes.center_m * [1, -1, 1], heading_rad=-boxes.heading_rad
        ),
        "boxes fit when they are mirrored",
        "the labels have y to the right, expected to the left",
        "change the sign of y and of the heading",
    )
    yield LabelMeaning(
        lambda boxes, step: replace(
            boxes,
            center_m=np.column_stack([boxes.center_m[:, 2], -boxes.center_m[:, 0], -boxes.center_m[:, 1]]),
            heading_rad=-np.pi / 2 - boxes.heading_rad,
        ),
        "boxes fit in the axes of a camera",
        "the labels are in the axes of a camera (x right, y down, z forward)",
        "bring the labels into ego axes",
    )
    if world_from_ego is not None:
        yield LabelMeaning(
            lambda boxes, step: transform(boxes, inverse(world_from_ego[step])),
            "boxes fit in the axes of the world",
            "the labels are in the axes of the world, expected those of the car at their frame",
            "bring the labels into ego axes by the pose of their frame",
        )


def _moved(boxes: Boxes, up_m: Array) -> Boxes:
    """Return boxes that are higher by (n,) metres."""
    return replace(boxes, center_m=boxes.center_m + np.column_stack([np.zeros((len(boxes), 2)), up_m]))
