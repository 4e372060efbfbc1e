"""What is to be made, and what need not be: asked before any work is given out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from upvl_cli.config.base import Config
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.freshness import Freshness
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace


def fresh_segments(
    workspace: Workspace,
    stages: Sequence[AnyStage],
    segments: Sequence[str],
    settings: Mapping[str, Config] | None = None,
    reading: Reading | None = None,
) -> set[str]:
    """Return the segments of which all given stages are fresh, and all that these are made from.

    Args:
        workspace: The workspace of the shards.
        stages: The stages that would be run; those of the whole dataset count for no segment.
        segments: Names of the drives.
        settings: Values of stages that run with others than those of their TOML files.
        reading: What to do about shards that the catalogue does not know.
    """
    found = Freshness(workspace, stages, segments, settings, reading)
    fresh = np.ones(len(found.segments), bool)
    for stage in stages:
        if not stage.is_of_dataset:
            fresh &= found.stages[stage.name].fresh
    return {found.segments[place] for place in np.flatnonzero(fresh[: found.asked]).tolist()}


def next_tasks(
    workspace: Workspace, stages: Sequence[AnyStage], count: int, reading: Reading | None = None
) -> list[tuple[str, str]]:
    """Return stage and segment of shards that are not fresh, and whose inputs are: each can be made now.

    Stages of the whole dataset come first, because every drive waits for them; then the drives in their order, so
    that those begun first are done first.

    Args:
        workspace: The workspace of the shards.
        stages: The stages that are wanted; what they are made from is not given unless it is among them.
        count: How many at most.
        reading: What to do about shards that the catalogue does not know.
    """
    found = Freshness(workspace, stages, reading=reading)
    of_dataset = [stage.name for stage in stages if stage.is_of_dataset]
    tasks = [(name, WHOLE_DATASET) for name in of_dataset if found.stages[name].ready[0]]
    of_segments = [stage.name for stage in stages if not stage.is_of_dataset]
    if of_segments:
        ready = np.stack([found.stages[name].ready for name in of_segments], axis=1)  # (segments, stages)
        places = np.flatnonzero(ready)[:count].tolist()
        tasks += [
            (of_segments[place % len(of_segments)], found.segments[place // len(of_segments)])
            for place in places
        ]
    return tasks[:count]
