"""Summary of the auto labels, and of the items that each stage counted, by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator

from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import AmodalRow


def lines(workspace: Workspace, segments: Collection[str] = ()) -> Iterator[str]:
    """Yield one line a segment, then one a stage with its counts over all of them, by reason.

    Args:
        workspace: The workspace of the labels.
        segments: Names of the drives; empty takes all that have labels, and lists the others.

    Raises:
        NotMade: None of them has been labelled, or one of those that are named has not.
    """
    labelled = [name for name in workspace.segments if workspace.shard("nms", name).exists()]
    chosen = segments or labelled or workspace.segments
    for segment in chosen:
        labels = workspace.table("nms", AmodalRow, segment)
        tracks = Counter(int(track_id) for row in labels for track_id in row.track_id)
        longest = max(tracks.values(), default=0)
        yield (
            f"{segment}: {len(labels)} frames, {tracks.total()} boxes in {len(tracks)} tracks "
            f"(longest {longest} frames)"
        )
    if not segments and len(chosen) < len(workspace.segments):
        yield f"not labelled: {', '.join(name for name in workspace.segments if name not in chosen)}"
    for stage in workspace.pipeline.stages:
        drives = [WHOLE_DATASET] if stage.is_of_dataset else chosen
        footers = [read_footer(workspace.shard(stage.name, drive)) for drive in drives]
        counts = sum((Counter(footer.counts) for footer in footers if footer), Counter())
        if counts:
            yield f"  {stage.name}: " + ", ".join(
                f"{items} {reason}" for reason, items in sorted(counts.items())
            )
