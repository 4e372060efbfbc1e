"""Measure how well the occlusion test agrees with the truth of the built-in city: python bench/views.py.

A ray from the camera's place at the time of the picture to each point tells whether anything is in between.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from city_checks import first_on_way, pose_at
from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.ground.height import height_above_ground
from upvl_cli.perception.visual.config import VisibilityConfig
from upvl_cli.perception.visual.views import OCCLUDED, SEEN, move_to_time, visibility
from upvl_cli.stages.extract_vl import ExtractVlConfig
from upvl_cli.stages.ground import GroundConfig
from upvl_cli.synthetic.cast import Caster
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.types import Camera

STAGES = Path(__file__).parents[1] / "stages"
HIDDEN_M = 0.5  # what is this much in front of a point hides it


def main() -> None:
    """Print, over some frames, how many points are told rightly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, nargs="+", default=[5, 20, 35])
    options = parser.parse_args()
    limits = load(ExtractVlConfig, STAGES / "extract-vl.toml").visibility
    settings = load(CityConfig, STAGES / "synthetic.toml")
    drive = CityDrive(name="views", seed=(options.seed, 1, 0), without=(), settings=settings)
    table = np.zeros((2, 2), dtype=np.int64)  # truly hidden or not, called occluded or not
    for frame in options.frames:
        table += sum(_agreement(drive, frame, camera, limits) for camera in drive.cameras)
    (seen_right, seen_wrong), (hidden_wrong, hidden_right) = table
    print(f"of the points called seen {seen_right / (seen_right + hidden_wrong):.3%} are seen")
    print(f"of the seen points {seen_right / (seen_right + seen_wrong):.3%} are called seen")
    print(f"of the hidden points {hidden_right / (hidden_right + hidden_wrong):.3%} are called occluded")
    print(f"{table.sum()} points in view, {table[1].sum() / table.sum():.2%} hidden")


def _agreement(drive: CityDrive, frame: int, camera: Camera, limits: VisibilityConfig) -> np.ndarray:
    points, truth = drive.points_with_truth(frame)
    late_s = drive.trigger_s(camera.name)
    time_s = frame / drive.rate_hz + late_s
    pose = pose_at(drive, time_s)
    xyz = move_to_time(points.xyz_ego_m, truth.velocity_mps, late_s, drive.world_from_ego[frame], pose)
    ground = load(GroundConfig, STAGES / "ground.toml")
    height_m = height_above_ground(points.xyz_ego_m, drive.ground_z_m, ground.map)
    stands = height_m > ground.max_height_m
    found = visibility(camera, xyz, stands, limits)
    chosen = np.flatnonzero((found.state == SEEN) | (found.state == OCCLUDED))
    world = apply(pose, xyz[chosen])
    eye = apply(pose, camera.ego_from_camera[None, :3, 3])[0]
    met_m, _ = first_on_way(Caster(drive.scene), eye, world, time_s)
    hidden = met_m < np.linalg.norm(world - eye, axis=1) - HIDDEN_M
    called = found.state[chosen] == OCCLUDED
    return np.array(
        [
            [(~hidden & ~called).sum(), (~hidden & called).sum()],
            [(hidden & ~called).sum(), (hidden & called).sum()],
        ]
    )


if __name__ == "__main__":
    main()
