"""The types of detections, by the words of the stage `name` and the features that the detector says.

A detector that says none takes those of the pictures, as the paper's baseline without distillation does, less the
points that are background, as labels do.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.classify import WordVotes
from upvl_cli.perception.labels.point_features import foreground_points
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages import classify
from upvl_cli.stages.rows import ExtractVlRow, MaskRow, ObjectRow, PcaRow, TrainRow
from upvl_cli.types import Ints


def types_of(workspace: Workspace, segment: str, rows: Table[ObjectRow]) -> dict[int, Ints]:
    """(b,) the type of each box of each frame: points vote, all those of a track together.

    Args:
        workspace: Where.
        segment: The drive.
        rows: Its rows of `detect`.
    """
    (fitted,) = workspace.table("pca", PcaRow)
    kinds, words = workspace.settings(classify.STAGE).words
    directions = workspace.model.embed_text(words)
    votes = WordVotes(np.array(kinds), lambda feature: fitted.basis.cosines(feature, directions))
    (trained,) = workspace.table("train", TrainRow)
    pictures = (
        None
        if trained.has_distillation_head
        else (
            workspace.table("extract-vl", ExtractVlRow, segment),
            workspace.table("mask", MaskRow, segment),
        )
    )
    number: dict[int, Ints] = {}
    alone = 0
    for row in rows:
        # A box of no track is an object of its own.
        of_none = row.track_id < 0
        own = -2 - alone - np.arange(len(row.track_id))
        alone += len(row.track_id)
        number[row.frame] = np.where(of_none, own, row.track_id)
        if pictures is None:
            votes.add_point_features(number[row.frame], row.point_feature)
        else:
            of, mask = pictures[0][row.frame], pictures[1][row.frame]
            point, feature = foreground_points(of.state, of.feature, mask.background)
            xyz = workspace.drive(segment).points(row.frame).xyz_ego_m[point]
            votes.add_sweep(row.boxes, number[row.frame], xyz, feature)
    return {frame: votes.classify(of_frame).type for frame, of_frame in number.items()}
