"""A run on the street of the tests, made up shard by shard: what it holds is known, and it takes milliseconds."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from command import make_workspace
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import AmodalRow, GroundRow, LabelRow, MaskRow, OdometryRow
from world.street import Streets

SEGMENT = "street-0"
FRAMES = 6
STEP_NS = 10**8


@dataclass(frozen=True)
class Thing:
    """A track in world axes: where it is in the first frame, how fast it goes along x, and what it is."""

    track_id: int
    x_m: float
    y_m: float
    speed_mps: float = 0.0
    class_name: str = "vehicle"
    word: str = "car"
    length_m: float = 4.0


# Two cars drive, one stands, and somebody stands who was seen by no camera.
THINGS = (
    Thing(1, 10.0, 3.0, speed_mps=10.0),
    Thing(2, 5.0, -3.0, speed_mps=5.0),
    Thing(3, 15.0, 6.0),
    Thing(4, 8.0, 8.0, class_name="unknown", word="", length_m=0.8),
)


def box_columns(things: Sequence[Thing], frame: int, ego_x_m: float) -> dict[str, np.ndarray]:
    time_s = frame * STEP_NS * 1e-9
    centers = [[thing.x_m + thing.speed_mps * time_s - ego_x_m, thing.y_m, 0.8] for thing in things]
    n = len(things)
    return {
        "center_m": np.array(centers).reshape(n, 3),
        "size_lwh_m": np.array([[thing.length_m, 2.0, 1.6] for thing in things]).reshape(n, 3),
        "heading_rad": np.zeros(n),
        "velocity_mps": np.array([[thing.speed_mps, 0, 0] for thing in things]).reshape(n, 3),
        "num_points": np.full(n, 9),
        "score": np.full(n, 0.75),
        "track_id": np.array([thing.track_id for thing in things], dtype=np.int64),
        "background_share": np.zeros(n),
        "num_frames_seen": np.full(n, FRAMES),
        "objectness": np.full(n, 0.9),
        "sides_seen": np.full(n, 2),
        "residual_m": np.full(n, 0.05),
    }


def label_row(things: Sequence[Thing], segment: str, frame: int, ego_x_m: float) -> LabelRow:
    n = len(things)
    return LabelRow(
        segment,
        frame,
        time_ns=frame * STEP_NS,
        **box_columns(things, frame, ego_x_m),
        class_name=np.array([thing.class_name for thing in things], dtype=str),
        word=np.array([thing.word for thing in things], dtype=str),
        class_share=np.ones(n),
        is_moving=np.array([thing.speed_mps >= 1 for thing in things], bool),
        num_looks=np.zeros(n, np.int32),
        look_word=np.full((n, 3), "", dtype=str),
        look_share=np.zeros((n, 3)),
        words_agree=np.ones(n, bool),
        iou_2d=np.full(n, -1.0),
        box_word=np.array([""] * n, dtype=str),
        box_share=np.zeros(n),
    )


def pose_row(segment: str, frame: int, x_m: float) -> OdometryRow:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return OdometryRow(segment, frame, frame * STEP_NS, pose, True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)


def write_labels(
    workspace: Workspace,
    things: Sequence[Thing] = THINGS,
    *,
    segment: str = SEGMENT,
    frames: int = FRAMES,
    stamp: str = "{}",
    ego_x_m: Callable[[int], float] = float,
) -> None:
    """Write labels and poses of a drive: the car goes 1 m a frame along the x of the world."""
    rows = [label_row(things, segment, frame, ego_x_m(frame)) for frame in range(frames)]
    write(
        workspace.shard("labels", segment),
        LabelRow,
        rows,
        stamp=stamp,
        counts={"labels": frames * len(things)},
    )
    poses = [pose_row(segment, frame, ego_x_m(frame)) for frame in range(frames)]
    write(
        workspace.shard("odometry", segment), OdometryRow, poses, stamp="{}", counts={"poses given": frames}
    )


def write_points(workspace: Workspace, things: Sequence[Thing] = THINGS, frames: int = FRAMES) -> None:
    """Write what pictures of the street are drawn from, beside its labels."""
    drive = Streets().open(SEGMENT)
    boxes, ground, mask = [], [], []
    for frame in range(frames):
        n = len(drive.points(frame))
        columns = box_columns(things, frame, float(frame))
        boxes.append(AmodalRow(SEGMENT, frame, time_ns=frame * STEP_NS, **columns))
        ground.append(GroundRow(SEGMENT, frame, np.zeros(n), np.zeros(n, bool)))
        mask.append(MaskRow(SEGMENT, frame, np.ones(n, bool), np.zeros(n)))
    dropped = {"boxes kept": frames * len(things), "boxes dropped: overlap a better one": 7}
    write(workspace.shard("nms", SEGMENT), AmodalRow, boxes, stamp="{}", counts=dropped)
    write(workspace.shard("ground", SEGMENT), GroundRow, ground, stamp="{}", counts={})
    write(workspace.shard("mask", SEGMENT), MaskRow, mask, stamp="{}", counts={"points moving": 0})


def made_up_run(
    folder: Path, things: Sequence[Thing] = THINGS, out: str = "out", *, with_points: bool = False
) -> Workspace:
    """A workspace with a labelled street; pictures of it can be drawn with points alone."""
    if not (folder / "stages").exists():
        make_workspace(folder)
    workspace = Workspace(PIPELINE, folder / "stages", folder / out)
    write_labels(workspace, things)
    if with_points:
        write_points(workspace, things)
    return workspace


def log_runs(workspace: Workspace, **seconds: float) -> None:
    """Write the log of runs: seconds of a stage by its name."""
    lines = [
        {"stage": stage, "segment": SEGMENT, "rows": FRAMES, "seconds": value, "peak_mib": 100 + value}
        for stage, value in seconds.items()
    ]
    (workspace.out / "runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
