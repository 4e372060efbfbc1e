"""What odometry gives: a pose for each frame, and how well the sweeps agree with it."""

from __future__ import annotations

from dataclasses import dataclass

from upvl_cli.types import Array, ParallelArrays, array


@dataclass(frozen=True)
class EstimatedPath(ParallelArrays):
    """Poses of a drive, one a frame, and how well each agrees with the sweeps.

    Attributes:
        world_from_ego: (T, 4, 4) poses.
        is_placed: (T,) whether the sweep itself gave the pose; others are interpolated.
        is_bridged: (T,) whether it was placed after a gap in time, or by a new search.
        residual_m: (T,) root mean square distance of upright points from the surfaces of a sweep shortly
            before.
        inlier_share: (T,) share of the upright points with a partner there.
        position_sigma_m: (T,) standard deviation of the way since that sweep, in its worst direction.
        heading_sigma_rad: (T,) standard deviation of the turn since then.
    """

    world_from_ego: Array = array("float64", 4, 4)
    is_placed: Array = array("bool")
    is_bridged: Array = array("bool")
    residual_m: Array = array("float64")
    inlier_share: Array = array("float64")
    position_sigma_m: Array = array("float64")
    heading_sigma_rad: Array = array("float64")
