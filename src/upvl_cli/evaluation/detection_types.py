"""Types of detections: the words of the stage `classify`, voted on by the features that the detector predicts.

A detector that predicts no features takes those of the pictures, as the paper's baseline without distillation does,
without the points that are background, as auto labels do.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.classify import WordVotes
from upvl_cli.perception.labels.point_features import foreground_points
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import classify
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import MaskRow, ObjectRow, TrainRow
from upvl_cli.types import Ints


def detection_types(workspace: Workspace, segment: str, rows: Table[ObjectRow]) -> dict[int, Ints]:
    """Return by frame (b,) the type of each box: a majority vote of all points of its track.

    Args:
        workspace: The workspace of the detections.
        segment: Name of the drive.
        rows: Its rows of `detect`.
    """
    (fitted,) = workspace.table("pca", PcaRow)
    types, words = workspace.settings(classify.STAGE).words
    directions = workspace.model.embed_text(words)
    votes = WordVotes(np.array(types), lambda feature: fitted.basis.cosines(feature, directions))
    (trained,) = workspace.table("train", TrainRow)
    pictures = (
        None
        if trained.has_distillation_head
        else (
            workspace.table("extract-vl", ExtractVlRow, segment),
            workspace.table("mask", MaskRow, segment),
        )
    )
    object_numbers: dict[int, Ints] = {}
    num_untracked = 0
    for row in rows:
        # A box without a track is an object of its own: numbers from -2 downwards.
        untracked_number = -2 - num_untracked - np.arange(len(row.track_id))
        num_untracked += len(row.track_id)
        number = np.where(row.track_id < 0, untracked_number, row.track_id)
        object_numbers[row.frame] = number
        if pictures is None:
            votes.add_point_features(number, row.point_feature)
        else:
            features, mask = pictures[0][row.frame], pictures[1][row.frame]
            point, feature = foreground_points(features.state, features.feature, mask.background)
            xyz = workspace.drive(segment).points(row.frame).xyz_ego_m[point]
            votes.add_sweep(row.boxes, number, xyz, feature)
    return {frame: votes.classify(number).type for frame, number in object_numbers.items()}
