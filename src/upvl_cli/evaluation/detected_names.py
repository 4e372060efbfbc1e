"""The types of detections, by the words of the stage `name` and the features that the detector says.

A detector that says none takes those of the pictures, as the paper's baseline without distillation does, less the
points that are background, as labels do.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.algorithms.naming import Votes
from upvl_cli.algorithms.objects import of_objects
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table
from upvl_cli.types import Ints
from upvl_cli.workspace import WHOLE, Workspace


def types_of(workspace: Workspace, segment: str, rows: Table) -> dict[int, Ints]:
    """(b,) the type of each box of each frame: points vote, all those of a track together.

    Args:
        workspace: Where.
        segment: The drive.
        rows: Its rows of `detect`.
    """
    (fitted,) = Table(workspace.shard("pca", WHOLE), BY_NAME["pca"].row)
    kinds, words = workspace.settings(BY_NAME["name"]).words
    directions = workspace.model.embed_text(words)
    votes = Votes(np.array(kinds), lambda feature: fitted.basis.cosines(feature, directions))
    (trained,) = Table(workspace.shard("train", WHOLE), BY_NAME["train"].row)
    of_pictures = [] if trained.distils else ["extract-vl", "mask"]
    tables = [Table(workspace.shard(stage, segment), BY_NAME[stage].row) for stage in of_pictures]
    number: dict[int, Ints] = {}
    alone = 0
    for row in rows:
        # A box of no track is an object of its own.
        of_none = row.track_id < 0
        own = -2 - alone - np.arange(len(row.track_id))
        alone += len(row.track_id)
        number[row.frame] = np.where(of_none, own, row.track_id)
        if trained.distils:
            votes.add_features(number[row.frame], row.of_box, row.feature)
        else:
            of, mask = (table[row.frame] for table in tables)
            point, feature = of_objects(of.state, of.feature, mask.background)
            xyz = workspace.drive(segment).points(row.frame).xyz_ego_m[point]
            votes.add(row.seven, number[row.frame], xyz, feature)
    return {frame: votes.of(of_frame)[0] for frame, of_frame in number.items()}
