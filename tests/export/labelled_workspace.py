"""A workspace of the test's street whose labels are written down, so that every number of them is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import made_labels
from command import make_workspace
from export.labelled_drives import labelled_drive
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.export.drive import ExportBoxes
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import LabelRow, OdometryRow

SEGMENT = "street-0"


def labelled_workspace(folder: Path) -> Workspace:
    """The workspace; its drive has the poses of the street, and five boxes in each of its first frames."""
    make_workspace(folder)
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    drive = workspace.drive(SEGMENT)
    boxes = labelled_drive(frames=len(drive.frames)).boxes
    numbers = np.unique(boxes.frame)
    labels, poses = [], []
    for place, frame in enumerate(drive.frames):
        labels.append(label_row(frame.index, frame.time_ns, boxes[boxes.frame == numbers[place]]))
        poses.append(_pose_row(frame.index, frame.time_ns, drive.world_from_ego[place]))
    write(workspace.shard("labels", SEGMENT), LabelRow, labels, stamp="{}", counts={})
    write(workspace.shard("odometry", SEGMENT), OdometryRow, poses, stamp="{}", counts={})
    return workspace


def label_row(frame: int, time_ns: int, boxes: ExportBoxes) -> LabelRow:
    """The labels of one frame; the word of a vehicle is car."""
    names = [(str(name), 4.0) for name in boxes.class_name]
    return made_labels.label_row(
        SEGMENT,
        frame,
        names,
        time_ns=time_ns,
        center_m=boxes.center_m,
        size_lwh_m=boxes.size_lwh_m,
        heading_rad=boxes.heading_rad,
        velocity_mps=boxes.velocity_mps,
        num_points=boxes.num_points,
        score=boxes.score,
        track_id=boxes.track_id,
        word=np.where(boxes.class_name == "vehicle", "car", ""),
    )


def _pose_row(frame: int, time_ns: int, world_from_ego: np.ndarray) -> OdometryRow:
    nothing = dict.fromkeys(
        [
            "residual_m",
            "residual_given_m",
            "inlier_share",
            "inlier_share_given",
            "position_sigma_m",
            "heading_sigma_rad",
        ],
        0.0,
    )
    return OdometryRow(SEGMENT, frame, time_ns, world_from_ego, True, **nothing)
