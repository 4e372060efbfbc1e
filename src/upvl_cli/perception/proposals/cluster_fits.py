"""Boxes of the clusters of one sweep: each set of points is worked on once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.box_fit import median, rectangle_heading, tight_rectangle
from upvl_cli.perception.proposals.clusters import points_of_clusters
from upvl_cli.perception.proposals.config import ProposalBoxConfig, ProposalConfig
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints


@dataclass(frozen=True)
class Sweep:
    """The points of one sweep that stand above the ground.

    Attributes:
        xyz_m: (n, 3) points.
        velocity_mps: (n, 3) their velocity over the ground, along the axes of the points.
        is_candidate: (n,) whether the point passed the motion mask; all points do for labels in all motion states.
            The others only join a box that they lie in: flow misses points here and there.
        background: (n,) 1 background, 0 not, negative unknown.
        vl_feature: (n, d) strongest components of the features, 0 where there is none; d is 0 when unused.
        height_m: (n,) heights over the ground.
        world_from_sweep: (4, 4) pose of the axes of the points.
        step: Number of the sweep in the `OccupancyHistory`.
    """

    xyz_m: Floats
    velocity_mps: Floats
    is_candidate: Bools
    background: Ints
    vl_feature: Floats
    height_m: Floats
    world_from_sweep: Floats
    step: int


class ClusterFits:
    """The fits of one sweep: hypotheses, and the steps of one, ask for the same clusters again and again.

    Attributes:
        sweep: The points.
        config: Settings of each step.
    """

    def __init__(self, sweep: Sweep, config: ProposalConfig) -> None:
        """Start without any fit."""
        self.sweep, self.config = sweep, config
        self._boxes: dict[tuple[bytes, bytes], Array] = {}

    def boxes(self, label: Ints, velocity_mps: Floats) -> Boxes:
        """Return the k boxes of clusters.

        Args:
            label: (n,) cluster of each point, -1 for none.
            velocity_mps: (k, 3) velocity of each cluster.
        """
        rows = [
            self._box(points, velocity)
            for points, velocity in zip(points_of_clusters(label), velocity_mps, strict=True)
        ]
        return Boxes.from_rows(np.array(rows).reshape(-1, 7))

    def _box(self, points: Ints, velocity_mps: Floats) -> Array:
        key = points.tobytes(), velocity_mps.tobytes()
        if key not in self._boxes:
            xyz_m, height_m = self.sweep.xyz_m[points], self.sweep.height_m[points]
            self._boxes[key] = _fit_box(xyz_m, height_m, velocity_mps, self.config.box)
        return self._boxes[key]


def _fit_box(xyz_m: Floats, height_m: Floats, velocity_mps: Floats, config: ProposalBoxConfig) -> Array:
    """Return (7,) one box, along the motion of the object or, where it stands still, along its shape."""
    is_body = height_m >= config.ground_clearance_m
    body_xy_m = xyz_m[is_body, :2] if is_body.any() else xyz_m[:, :2]
    if np.hypot(*velocity_mps[:2]) >= config.moving_mps:
        heading_rad = float(np.arctan2(velocity_mps[1], velocity_mps[0]))
    else:
        step_rad = float(np.deg2rad(config.heading_step_deg))
        heading_rad = rectangle_heading(body_xy_m, step_rad=step_rad, floor_m=config.edge_floor_m)
    (x_m, y_m), length_m, width_m = tight_rectangle(body_xy_m, heading_rad, trim=config.trim)
    z_m = xyz_m[:, 2]
    low_m, high_m = z_m.min(), z_m.max()
    if height_m.min() < config.standing_height_m:
        low_m = median(z_m - height_m)  # the ground below the object
    return np.array([x_m, y_m, (low_m + high_m) / 2, length_m, width_m, high_m - low_m, heading_rad])
