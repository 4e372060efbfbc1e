"""The score of flow against the exact one of the built-in street."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scored_world import SETTINGS

from command import make_workspace
from tiny_kitti import write_drive
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.evaluation.flow_score import FlowScore, flow_score
from upvl_cli.pipeline.runner import make_shard
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from world.street import Streets

SEGMENT = "street-0"


@pytest.fixture(scope="module")
def true_mps() -> dict[int, np.ndarray]:
    """The true motion of the points of each frame."""
    drive = Streets().open(SEGMENT)
    return {frame.index: drive.truth(frame.index).velocity_mps for frame in drive.frames}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A workspace with what flow is scored beside."""
    folder = make_workspace(tmp_path_factory.mktemp("street"))
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    for stage in (PIPELINE.by_name[name] for name in ("odometry", "ground")):
        make_shard(workspace, stage, SEGMENT, workspace.settings(stage), lambda: None)
    return workspace


def scored(workspace: Workspace, flow_mps: Mapping[int, np.ndarray]) -> FlowScore:
    """The score of a flow, by frame."""
    flow = PIPELINE.by_name["flow"]
    rows = [flow.row(SEGMENT, frame, values) for frame, values in flow_mps.items()]
    stamp = workspace.shard_stamp(flow, SEGMENT)
    write(workspace.shard("flow", SEGMENT), flow.row, rows, stamp=stamp, counts={})
    score = flow_score(workspace, SETTINGS)
    assert score is not None
    return score


def test_the_true_flow_has_no_error(made: Workspace, true_mps: dict[int, np.ndarray]) -> None:
    score = scored(made, true_mps)
    # Flow is stored with 11 bits: at 12 m/s to 0.004 m/s, which is 0.4 mm in 0.1 s.
    assert score.errors.three_way_epe_m < 5e-4
    assert score.errors.relaxed == 1.0
    assert score.errors.dynamic_iou > 0.99
    assert score.mean_dynamic_error < 0.01
    assert all(points > 1000 for points in score.errors.points)
    assert score.objects is not None
    assert score.objects.moving[0].objects > 10
    assert score.objects.moving[0].right > 0.95
    assert score.objects.called_moving == 0


def test_half_the_flow_is_half_wrong(made: Workspace, true_mps: dict[int, np.ndarray]) -> None:
    score = scored(made, {frame: values / 2 for frame, values in true_mps.items()})
    assert score.mean_dynamic_error == pytest.approx(0.5, abs=0.01)
    assert score.errors.strict < 0.05  # of slow walkers: half of 0.1 m is within 5 cm
    assert [of.name for of in score.classes] == [
        "background",
        "car",
        "other vehicles",
        "pedestrian",
        "wheeled VRU",
    ]
    moving = [of.dynamic_error for of in score.classes if np.isfinite(of.dynamic_error)]
    assert moving == pytest.approx([0.5] * len(moving), abs=0.02)
    assert score.errors.static_epe_m < 0.02
    assert score.objects is not None
    assert score.objects.moving[-1].right == 0  # the fastest


def test_a_dataset_that_does_not_know_has_no_score(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives")
    folder = make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    assert flow_score(Workspace(PIPELINE, folder / "stages", folder / "out"), SETTINGS) is None
