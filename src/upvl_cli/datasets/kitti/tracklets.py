"""The objects of KITTI's `tracklet_labels.xml`: one size and class an object, one pose a frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array, Boxes

# A box takes 480 bytes in the file of drive 0001, so this is 70 000 boxes: more than any drive has.
_MOST_BYTES = 32 * 2**20
_MOST_FRAMES = 10**9
_MOST_M = 1e4  # a LiDAR sees a few hundred metres
_AGAIN = "copy the file from the data set again"


@dataclass(frozen=True)
class Tracklet:
    """One object of a drive.

    Attributes:
        class_name: KITTI's name of its class, for example "Car".
        first_frame: Number of its first frame.
        boxes: Its boxes, one for each frame from the first on, in ego axes.
    """

    class_name: str
    first_frame: int
    boxes: Boxes


def read_tracklets(path: Path) -> list[Tracklet]:
    """Return the objects of a drive.

    Args:
        path: The `tracklet_labels.xml`; its boxes are in LiDAR axes and so in ego axes.

    Raises:
        BadInput: The file is not what it has to be, is huge, or declares XML entities.
    """
    items = _root(path).findall("tracklets/item")
    return [_tracklet(item, f"{path}, tracklet {number}") for number, item in enumerate(items)]


def _root(path: Path) -> ElementTree.Element:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); {_AGAIN}") from None
    if size > _MOST_BYTES:
        raise BadInput(f"{path} has {size} bytes, expected at most {_MOST_BYTES}; {_AGAIN}")
    text = read_text(path)
    # Entities can grow a small text without bound. KITTI's files declare a DOCTYPE, but none of them.
    if "<!ENTITY" in text:
        raise BadInput(f"{path} declares XML entities, which KITTI's files never do; {_AGAIN}")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise BadInput(f"{path} is not whole XML ({error}); {_AGAIN}") from None


def _tracklet(item: ElementTree.Element, where: str) -> Tracklet:
    class_name = item.findtext("objectType", "")
    height_m, width_m, length_m, first = _values(item, ("h", "w", "l", "first_frame"), where)
    if not class_name or not min(height_m, width_m, length_m) > 0:
        raise BadInput(
            f"{where}: {class_name!r} of {length_m} x {width_m} x {height_m} m is no object; {_AGAIN}"
        )
    _check_near(np.array([height_m, width_m, length_m]), where)
    if not 0 <= first < _MOST_FRAMES or first != int(first):
        raise BadInput(f"{where}: first_frame is {first}, expected the number of a frame; {_AGAIN}")
    poses = item.findall("poses/item")
    rows = [_values(pose, ("tx", "ty", "tz", "rz"), f"{where}, pose {i}") for i, pose in enumerate(poses)]
    x, y, bottom, heading = np.array(rows).reshape(-1, 4).T
    _check_near(np.array([x, y, bottom]), where)
    boxes = Boxes(
        center_m=np.column_stack([x, y, bottom + height_m / 2]),
        size_lwh_m=np.tile([length_m, width_m, height_m], (len(rows), 1)),
        heading_rad=wrap_angle(heading),
    )
    return Tracklet(class_name, int(first), boxes)


def _values(element: ElementTree.Element, tags: tuple[str, ...], where: str) -> Array:
    text = " ".join(element.findtext(tag, "") for tag in tags)
    return numbers(text, len(tags), f"{where} ({', '.join(tags)})")


def _check_near(values: Array, where: str) -> None:
    """Refuse lengths and places that no LiDAR sees."""
    if not np.abs(values).max(initial=0.0) <= _MOST_M:
        raise BadInput(
            f"{where}: {np.abs(values).max():g} m is too far, expected at most {_MOST_M:g} m; {_AGAIN}"
        )
