"""What the tests of evaluation score: cars of 4 x 2 x 1.5 m on a plane, and auto labels written by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.config.toml import load
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Boxes

SIZE_M = (4.0, 2.0, 1.5)
# As they ship; a test that depends on one of them names it.
SETTINGS: EvalConfig = load(EvalConfig, Path(__file__).parents[2] / "stages" / "eval.toml")


def cars_at(places: Sequence[tuple[float, float]]) -> np.ndarray:
    """(n, 7) rows of cars that look along x at these places."""
    return np.array([(x, y, 0.0, *SIZE_M, 0.0) for x, y in places]).reshape(-1, 7)


def material(
    labels: Sequence[tuple[int, float, float, float]],
    boxes: Sequence[tuple[int, float, float, float]],
    *,
    points: Sequence[int] | None = None,
    in_view: Sequence[bool] | None = None,
) -> Material:
    """What is scored: labels (frame, x, y, speed) and boxes (frame, x, y, score); each row is its own object.

    Args:
        labels: Labels of level 1, unless points say otherwise.
        boxes: Boxes to score; they move as fast as needed.
        points: LiDAR points of each label; many when left out.
        in_view: Whether a camera sees each label; all when left out.
    """
    of_labels, of_boxes = np.array(labels).reshape(-1, 4), np.array(boxes).reshape(-1, 4)
    n, m = len(of_labels), len(of_boxes)
    truth = Truth.from_rows(
        cars_at([tuple(place) for place in of_labels[:, 1:3]]),
        sequence=np.full(n, "drive"),
        frame=of_labels[:, 0],
        type=np.ones(n),
        level=np.zeros(n),
        velocity_mps=np.column_stack([of_labels[:, 3], np.zeros(n)]),
        object_id=np.arange(n),
    )
    predictions = Predictions.from_rows(
        cars_at([tuple(place) for place in of_boxes[:, 1:3]]),
        sequence=np.full(m, "drive"),
        frame=of_boxes[:, 0],
        type=np.ones(m),
        score=of_boxes[:, 3],
        velocity_mps=np.tile([5.0, 0.0], (m, 1)),
        object_id=np.arange(m),
        unlabelled=np.zeros(m),
    )
    return Material(
        labels=truth,
        points=np.full(n, 100) if points is None else np.array(points),
        in_view=np.ones(n, dtype=bool) if in_view is None else np.array(in_view),
        predictions=predictions,
        has_class=False,
        segments=("drive",),
        frames=1,
        left_out={},
        dropped={},
    )


def write_auto_labels(
    folder: Path, segment: str, boxes_by_frame: Mapping[int, Sequence[tuple[np.ndarray, float, int]]]
) -> None:
    """Write the shard that labelling would: by frame its boxes as (row of 7, score, track id), at 8 m/s."""
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    stage = PIPELINE.by_name["nms"]
    rows = []
    for frame, here in boxes_by_frame.items():
        count = len(here)
        boxes = Boxes.from_rows(np.array([box for box, _, _ in here]).reshape(-1, 7))
        scores, ids = (np.array([item[k] for item in here]) for k in (1, 2))
        rows.append(
            stage.row(
                segment=segment,
                frame=frame,
                time_ns=frame * 100_000_000,
                center_m=boxes.center_m,
                size_lwh_m=boxes.size_lwh_m,
                heading_rad=boxes.heading_rad,
                velocity_mps=np.tile([8.0, 0.0, 0.0], (count, 1)),
                num_points=np.full(count, 50),
                score=scores,
                track_id=ids.astype(np.int64),
                background_share=np.zeros(count),
                num_frames_seen=np.full(count, 4),
                objectness=np.full(count, 0.9),
                sides_seen=np.full(count, 2),
                residual_m=np.full(count, 0.05),
            )
        )
    stamp = workspace.shard_stamp(stage, segment)
    write(workspace.shard(stage.name, segment), stage.row, rows, stamp=stamp, counts={})
