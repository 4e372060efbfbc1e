"""How many frames the shards of many drives have, without reading their rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.errors import NotMade
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Ints

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace


def lengths_of(workspace: Workspace, stage: str, segments: Sequence[str]) -> Ints:
    """Return (D,) how many frames the shard of each drive has, from its footer.

    What else knows the numbers of rows of shards can answer here without opening one.

    Args:
        workspace: The workspace of the shards.
        stage: The stage that made them.
        segments: Names of the drives.

    Raises:
        NotMade: A shard is missing or damaged.
    """

    def length(segment: str) -> int:
        path = workspace.shard(stage, segment)
        footer = read_footer(path)
        if footer is None:
            raise NotMade(f"{path} is missing or damaged; run: upvl {stage}")
        return footer.rows

    return np.fromiter(in_order(length, segments), np.int64, len(segments))
