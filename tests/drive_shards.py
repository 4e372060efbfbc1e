"""Tables of the street of the tests, made by hand in the first frames: what a labelling run would write, at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from made_labels import label_row
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import FlowRow, GroundRow, LabelRow, MaskRow, OdometryRow
from world.street import StreetDrive, Streets

SEGMENT = "street-0"
CAR, PERSON = 7, 9  # tracks: the car drives ahead at 5 m/s from (10, 2), the person stands at (8, -3)
# The sensors are measured from few sweeps, for each of the street takes a quarter of a second.
FEW_SWEEPS = {"check__sample.runs": "2", "check__sample.sweeps": "2"}


def street_drive() -> StreetDrive:
    """The drive itself."""
    return Streets().open(SEGMENT)


def street_workspace(folder: Path) -> Workspace:
    """The workspace in a folder that has settings."""
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def street_labels(frame: int) -> LabelRow:
    """The two boxes of a frame; frame 0 has none."""
    if frame == 0:
        return label_row(SEGMENT, frame, [], time_ns=0)
    return label_row(
        SEGMENT,
        frame,
        [("vehicle", 4.0), ("pedestrian", 0.6)],
        center_m=np.array([[10 + 0.5 * frame, 2.0, 0.8], [8.0, -3.0, 0.9]]),
        size_lwh_m=np.array([[4.0, 2.0, 1.6], [0.6, 0.6, 1.8]]),
        heading_rad=np.array([0.1, 0.0]),
        velocity_mps=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]),
        track_id=np.array([CAR, PERSON]),
        score=np.array([0.75, 0.5]),
        word=np.array(["car", "pedestrian"]),
    )


def write_street_shards(workspace: Workspace, frames: int) -> None:
    """Write poses of all frames, and flow, ground, mask and labels of the first few."""
    drive = street_drive()
    odometry, ground, flow, mask, labels = [], [], [], [], []
    for frame, pose in zip(drive.frames, drive.world_from_ego, strict=True):
        given = {"residual_m": 0.0, "residual_given_m": 0.0, "inlier_share": 1.0, "inlier_share_given": 1.0}
        odometry.append(
            OdometryRow(
                SEGMENT, frame.index, frame.time_ns, pose, True, **given, position_sigma_m=0.0, heading_sigma_rad=0.0
            )
        )  # fmt: skip
    for frame in range(frames):
        points, truth = drive.points_with_truth(frame)
        on_ground = truth.object_index < 0
        is_moving = np.linalg.norm(truth.velocity_mps, axis=1) > 0.5
        height_m = np.where(on_ground, 0.0, points.xyz_ego_m[:, 2])
        ground.append(GroundRow(SEGMENT, frame, height_m, on_ground))
        flow.append(FlowRow(SEGMENT, frame, truth.velocity_mps))
        mask.append(MaskRow(SEGMENT, frame, is_moving, np.where(on_ground, 1, 0)))
        labels.append(street_labels(frame))
    for stage, row, rows in (
        ("odometry", OdometryRow, odometry),
        ("ground", GroundRow, ground),
        ("flow", FlowRow, flow),
        ("mask", MaskRow, mask),
        ("labels", LabelRow, labels),
    ):
        write(workspace.shard(stage, SEGMENT), row, rows, stamp="{}", counts={})
