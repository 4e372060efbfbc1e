"""Objects that a picture shows: the points behind a 2D box, however few they are.

The frustum of a 2D box holds the object and what stands before and behind it; the object is told by its depth.
Qi et al., Frustum PointNets for 3D Object Detection from RGB-D Data, CVPR 2018, lift 2D boxes in this way with a
network; here depth, and the height that the box has at that depth, choose the points.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.camera import project
from upvl_cli.perception.clustering import NOISE
from upvl_cli.perception.proposals.frustum_config import FrustumConfig
from upvl_cli.types import Array, Bools, Boxes2d, Camera, Floats, Ints


@dataclass(frozen=True)
class CameraBoxes:
    """What one picture shows of a sweep.

    Attributes:
        camera: The camera.
        xyz_m: (n, 3) the points of the sweep in ego axes at the time of the picture.
        boxes: Boxes of the kinds that are lifted.
    """

    camera: Camera
    xyz_m: Floats
    boxes: Boxes2d


def frustum_clusters(
    pictures: Sequence[CameraBoxes], given: Sequence[Ints], points: int, config: FrustumConfig
) -> tuple[Ints, Counter[str]]:
    """Return (n,) the object of each point, -1 for none, and how many boxes gave one or did not, by reason.

    Where a cluster that is known already has most of an object's points, and few others, the object is that cluster:
    so its track goes on where the clustering has lost it.

    Args:
        pictures: The pictures of one sweep, with their boxes.
        given: (n,) cluster of each point by each hypothesis of the clustering.
        points: Number n of points.
        config: Settings.
    """
    label: Ints = np.full(points, NOISE, dtype=np.int64)
    counts = Counter[str]()
    number = 0
    candidates = [
        (float(picture.boxes.score[row]), place, row)
        for place, picture in enumerate(pictures)
        for row in range(len(picture.boxes))
    ]
    projected = [project(picture.camera, picture.xyz_m)[:2] for picture in pictures]
    for _, place, row in sorted(candidates, key=lambda each: (-each[0], each[1], each[2])):
        uv_px, depth_m = projected[place]
        edges_px = pictures[place].boxes.xyxy_px[row]
        inside = np.flatnonzero(_inside(uv_px, edges_px))
        focal_px = float(pictures[place].camera.intrinsic[1, 1])
        chosen, reason = _object_in_frustum(uv_px[inside], depth_m[inside], edges_px, focal_px, config)
        counts[reason] += 1
        cluster: Ints = inside[chosen]
        if not len(cluster):
            continue
        cluster = _known_cluster(cluster, inside, given, config.min_shared)
        if (label[cluster] != NOISE).mean() > config.max_claimed:
            counts["2D boxes of an object of a better one"] += 1
            continue
        label[cluster[label[cluster] == NOISE]] = number
        number += 1
    return label, counts


def _inside(uv_px: Floats, edges_px: Array) -> Bools:
    """Return (n,) whether pixels lie in a rectangle; those that are NaN do not."""
    return np.asarray(((uv_px >= edges_px[:2]) & (uv_px <= edges_px[2:])).all(axis=1))


def _object_in_frustum(
    uv_px: Floats, depth_m: Floats, edges_px: Array, focal_px: float, config: FrustumConfig
) -> tuple[Ints, str]:
    """Return the points of the object among those of a frustum, ascending, and why there are none or some.

    It is the nearest run of depths that fills the middle of the box and at which the box is as high as its kind.

    Args:
        uv_px: (m, 2) pixels of the points in the box.
        depth_m: (m,) their depths.
        edges_px: (4,) the box.
        focal_px: Vertical focal length.
        config: Settings.
    """
    none: Ints = np.zeros(0, dtype=np.int64)
    if len(depth_m) < config.min_points:
        return none, "2D boxes without enough points"
    margin = (1 - config.middle_share) / 2 * (edges_px[2] - edges_px[0])
    is_middle = (uv_px[:, 0] >= edges_px[0] + margin) & (uv_px[:, 0] <= edges_px[2] - margin)
    order = np.argsort(depth_m, kind="stable")
    run = np.cumsum(np.diff(depth_m[order], prepend=depth_m[order[0]]) > config.max_gap_m)
    in_middle = np.bincount(run, is_middle[order])
    reason = "2D boxes whose points are not at one depth"
    for number in range(run[-1] + 1):
        members = order[run == number]
        middle = members[is_middle[members]]
        if len(middle) < config.min_points or in_middle[number] < config.min_filled * in_middle.sum():
            continue
        depth = float(np.median(depth_m[middle]))
        height_m = (edges_px[3] - edges_px[1]) * depth / focal_px
        if not config.min_height_m <= height_m <= config.max_height_m:
            reason = "2D boxes of another height than people"
            continue
        members = members[np.abs(depth_m[members] - depth) <= config.max_depth_m / 2]
        if len(members) < config.min_points:
            continue
        return np.sort(members), "2D boxes lifted"
    return none, reason


def _known_cluster(cluster: Ints, inside: Ints, given: Sequence[Ints], min_shared: float) -> Ints:
    """Return the points of the known cluster that is the same object, or those given where there is none.

    Args:
        cluster: Points of the object by its depth.
        inside: Points of the frustum.
        given: (n,) cluster of each point by each hypothesis.
        min_shared: Least share of the object's points in the known cluster, and of that cluster's in the frustum.
    """
    best, best_iou = cluster, 0.0
    for label in given:
        counts = np.bincount(label[cluster][label[cluster] != NOISE], minlength=1)
        number = int(counts.argmax())
        shared = int(counts[number])
        if shared < min_shared * len(cluster):
            continue
        members = np.flatnonzero(label == number)
        iou = shared / (len(members) + len(cluster) - shared)
        if np.isin(members, inside).mean() >= min_shared and iou > best_iou:
            best, best_iou = members, iou
    return best
