"""Detection in one frame: boxes on the ground, and the features of the points inside of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from upvl_cli.detector.config import DecodeConfig, GroundingConfig
from upvl_cli.detector.data.batch import FEATURE_DIM, TIME_DIM, Sample, collate
from upvl_cli.detector.decode import Detections, decode_output
from upvl_cli.detector.model import Detector
from upvl_cli.detector.process_group import half_precision
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.types import Array, Boxes, Floats, Ints, Ragged

_COLUMN_HEIGHT_M = 1e3  # a column this high holds the ground below a box wherever the box is


@dataclass(frozen=True)
class FramePrediction:
    """What the detector finds in a frame.

    Attributes:
        boxes: (m) boxes by falling score, in ego axes.
        num_points: (m,) points of this sweep inside of each.
        point_feature: Of each box the (., 64) float32 kept values of the features of these points; none without
            distillation.
    """

    boxes: Detections
    num_points: Ints
    point_feature: Ragged


@dataclass(frozen=True)
class FrameInput:
    """What the detector is given of a frame.

    Attributes:
        points: (n, 6) from `TwoSweeps.points`.
        ground_xyz_m: (k, 3) the ground below some points, in the axes of the points: boxes stand on it.
        ground_z_m: Height of the road in ego axes, which the points are without.
    """

    points: Array
    ground_xyz_m: Array
    ground_z_m: float


@torch.no_grad()
def predict(
    detector: Detector, frame: FrameInput, decoding: DecodeConfig, grounding: GroundingConfig
) -> FramePrediction:
    """Return the boxes in two sweeps.

    Args:
        detector: A trained network.
        frame: Points and ground.
        decoding: Which boxes are kept.
        grounding: How boxes are put on the ground.
    """
    device = next(detector.parameters()).device
    batch = collate([Sample.from_points(frame.points)], detector.grid).to(device)
    with half_precision(device, enabled=True):
        output = detector(batch)
    (decoded,) = decode_output(detector, output, decoding)
    boxes = put_on_ground(decoded, frame.ground_xyz_m, grounding)
    points = batch.points.cpu().numpy()
    current = np.flatnonzero(points[:, TIME_DIM] == 0)
    of_box, inside = pairs_inside(points[current, :3], boxes, margin_m=0.0)
    num_points = np.bincount(of_box, minlength=len(boxes))
    if detector.distillation_head is None:
        point_feature = Ragged(np.zeros((0, FEATURE_DIM), np.float32), np.zeros(len(boxes), np.int64))
    else:
        rows = torch.from_numpy(current[inside]).to(device)
        values: Floats = detector.features(output, batch, rows).float().cpu().numpy()
        point_feature = Ragged(values, num_points)  # pairs come by box
    in_ego_axes = replace(decoded, center_m=boxes.center_m + [0.0, 0.0, frame.ground_z_m])
    return FramePrediction(in_ego_axes, num_points, point_feature)


def put_on_ground(boxes: Boxes, ground_xyz_m: Array, config: GroundingConfig) -> Boxes:
    """Return the boxes with their bottom on the ground, where it is known below them.

    A slope takes the road far from the height it has at the car, by more than a network tells from a few points.

    Args:
        boxes: (m) boxes.
        ground_xyz_m: (k, 3) points on the ground, in the axes of the boxes.
        config: Which of the points are below a box, and how many are enough.
    """
    center_m, height_m = boxes.center_m.copy(), boxes.size_lwh_m[:, 2]
    column = Boxes(center_m * [1, 1, 0], boxes.size_lwh_m.copy(), boxes.heading_rad)
    column.size_lwh_m[:, 2] = _COLUMN_HEIGHT_M
    of_box, point = pairs_inside(ground_xyz_m, column, margin_m=config.margin_m)
    for box, below in enumerate(np.split(point, np.searchsorted(of_box, np.arange(1, len(boxes))))):
        if len(below) >= config.min_points:
            center_m[box, 2] = np.median(ground_xyz_m[below, 2]) + height_m[box] / 2
    return Boxes(center_m, boxes.size_lwh_m, boxes.heading_rad)
