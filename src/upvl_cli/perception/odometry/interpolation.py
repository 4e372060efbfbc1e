"""Poses of frames that odometry could not place, and how far off each pose may be."""

from __future__ import annotations

from dataclasses import replace

from upvl_cli.geometry.se3 import compose
from upvl_cli.perception.odometry.config import PlacementConfig
from upvl_cli.perception.odometry.constant_velocity import motion_over, velocity_between
from upvl_cli.perception.odometry.tracker import Placement


def interpolate(placements: list[Placement]) -> list[Placement]:
    """Return the placements; those without a pose of their own lie on the motion between the placed ones around.

    After the last placed one the predicted poses stay; before the first one its motion is taken back.
    """
    placed = [step for step, placement in enumerate(placements) if placement.is_placed]
    result = list(placements)
    for step, placement in enumerate(placements):
        if placement.is_placed or not placed:
            continue
        after = next((known for known in placed if known > step), None)
        before = next((known for known in reversed(placed) if known < step), None)
        if after is None:
            continue
        later = placements[after]
        twist = later.twist
        if before is not None:
            earlier = placements[before]
            seconds = later.time_s - earlier.time_s
            twist = velocity_between(earlier.world_from_ego, later.world_from_ego, seconds)
        motion = motion_over(twist, placement.time_s - later.time_s)
        pose = compose(later.world_from_ego, motion)
        result[step] = replace(placement, world_from_ego=pose, twist=twist)
    return result


def sigmas_of(placements: list[Placement], step: int, limits: PlacementConfig) -> tuple[float, float]:
    """Return the standard deviations of the step from the placed frame before, in m and rad.

    By the fit where the frame was placed; else by what a car's motion can be off a constant one: from rest at both
    ends a s² / 8 between two known poses, and a s² / 2 where only one is known.

    Args:
        placements: All of a drive.
        step: Which of them.
        limits: What a car's motion can be.
    """
    placement = placements[step]
    if placement.is_placed and placement.agreement is not None:
        return placement.agreement.sigmas
    before = [known.time_s for known in placements[:step] if known.is_placed]
    after = [known.time_s for known in placements[step + 1 :] if known.is_placed]
    if placement.is_placed and not before:
        return 0.0, 0.0
    if not before and not after:
        return float("inf"), float("inf")
    if before and after and not placement.is_placed:
        share = (after[0] - before[-1]) ** 2 / 8
    else:
        share = (placement.time_s - before[-1] if before else after[0] - placement.time_s) ** 2 / 2
    return share * limits.max_acceleration_mps2, share * limits.max_yaw_acceleration_radps2
