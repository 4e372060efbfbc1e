"""The types of detections, by the words of the stage `name` and the features that the detector says."""

from __future__ import annotations

import numpy as np

from upvl_cli.algorithms.naming import Votes
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table
from upvl_cli.types import Ints
from upvl_cli.workspace import WHOLE, Workspace


def types_of(workspace: Workspace, rows: Table) -> dict[int, Ints]:
    """(b,) the type of each box of each frame: points vote, all those of a track together.

    Args:
        workspace: Where.
        rows: Rows of `detect` of one drive.
    """
    (fitted,) = Table(workspace.shard("pca", WHOLE), BY_NAME["pca"].row)
    kinds, words = workspace.settings(BY_NAME["name"]).words
    directions = workspace.model.embed_text(words)
    votes = Votes(np.array(kinds), lambda feature: fitted.basis.cosines(feature, directions))
    number: dict[int, Ints] = {}
    alone = 0
    for row in rows:
        # A box of no track is an object of its own.
        of_none = row.track_id < 0
        own = -2 - alone - np.arange(len(row.track_id))
        alone += len(row.track_id)
        number[row.frame] = np.where(of_none, own, row.track_id)
        votes.add_features(number[row.frame], row.of_box, row.feature)
    return {frame: votes.of(of_frame)[0] for frame, of_frame in number.items()}
