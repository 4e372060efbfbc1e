"""Which sweeps the flow of a frame comes from, on a drive of three frames whose car and traffic move."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.pipeline.stage import ALL_FRAMES
from upvl_cli.stages import flow, ground, odometry
from upvl_cli.stages.rows import GroundRow, OdometryRow
from upvl_cli.types import Frame, Points

STAGES = Path(__file__).parents[2] / "stages"
CONFIG = load(flow.FlowConfig, STAGES / "flow.toml")
INDEX = (4, 5, 7)  # frame 6 is missing
TIME_S = (0.4, 0.5, 0.7)
ACCELERATION_MPS2 = 8.0


def car_x_m(time_s: float) -> float:
    """A car that speeds up: from frame to frame its mean speed differs."""
    return 10.0 + 2.0 * time_s + 0.5 * ACCELERATION_MPS2 * time_s**2


def pose(time_s: float) -> np.ndarray:
    """The ego car turns and goes forward."""
    return from_yaw(0.3 * time_s, np.array([5.0 * time_s, 0.2 * time_s, 0.0]))


@dataclass
class TinyDrive:
    """A moving car, a parked one, and a road, in ego axes."""

    count: int = 3
    has_poses: bool = True
    ground_z_m: float = 0.0
    skipped: dict[str, int] = field(default_factory=dict)

    @property
    def frames(self) -> list[Frame]:
        return [
            Frame(index, round(time_s * 1e9))
            for index, time_s in list(zip(INDEX, TIME_S, strict=True))[: self.count]
        ]

    @property
    def world_from_ego(self) -> np.ndarray | None:
        return np.array([pose(time_s) for time_s in TIME_S[: self.count]]) if self.has_poses else None

    def world_xyz_m(self, step: int) -> np.ndarray:
        rng = np.random.default_rng(step)
        side = rng.uniform((-2, -0.9, 0.3), (2, -0.9, 1.5), (300, 3))
        rear = rng.uniform((-2, -0.9, 0.3), (-2, 0.9, 1.5), (150, 3))
        box = np.concatenate([side, rear])
        road = rng.uniform((0, -8, 0), (30, 8, 0), (3000, 3))
        return np.concatenate([box + (car_x_m(TIME_S[step]), 3, 0), box + (14, -5, 0), road])

    def points(self, index: int) -> Points:
        step = INDEX.index(index)
        xyz = apply(inverse(pose(TIME_S[step])), self.world_xyz_m(step))
        zero = np.zeros(len(xyz))
        return Points(
            xyz.astype(np.float32),
            *(zero.astype(dtype) for dtype in (np.float32, np.float32, np.uint8, np.int64)),
        )


class TinyInputs:
    """What a stage may open, in memory."""

    segment = "tiny"
    window = ALL_FRAMES

    def __init__(self, drive: TinyDrive) -> None:
        self.drive = drive
        self.counts: dict[str, int] = {}

    def count(self, reason: str, items: int) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + int(items)

    def table(self, name: str, row: type, segment: str | None = None):  # noqa: ANN201
        frames, stage = self.drive.frames, {"odometry": odometry, "ground": ground}[name]
        config = load(stage.STAGE.config, STAGES / f"{name}.toml")
        rows = list(stage.run(self, config))
        assert all(isinstance(made, row) for made in rows)
        return TableOf({frame.index: made for frame, made in zip(frames, rows, strict=True)})


class TableOf:
    """Rows in order, and by the number of their frame."""

    def __init__(self, rows: dict) -> None:
        self._rows = rows
        self.frames = list(rows)

    def __iter__(self):  # noqa: ANN204
        return iter(self._rows.values())

    def __getitem__(self, frame: int) -> GroundRow | OdometryRow:
        return self._rows[frame]


def flow_of(drive: TinyDrive) -> list[flow.FlowRow]:
    return list(flow.run(TinyInputs(drive), CONFIG))


def test_the_flow_of_a_frame_is_that_to_the_next_and_of_the_last_that_from_the_one_before() -> None:
    """Speeds over 0.1 and 0.2 s, against the ground, in the axes of the frame's own ego car."""
    rows = flow_of(TinyDrive())
    assert [row.frame for row in rows] == list(INDEX)
    for step, other in ((0, 1), (1, 2), (2, 1)):
        mps = (car_x_m(TIME_S[other]) - car_x_m(TIME_S[step])) / (TIME_S[other] - TIME_S[step])
        true = pose(TIME_S[step])[:3, :3].T @ (mps, 0, 0)
        found = rows[step].flow_mps
        np.testing.assert_allclose(found[:450].mean(axis=0), true, atol=0.35)
        assert np.abs(found[450:900]).max() == 0, "the parked car stands, though the ego car moves"
        assert np.abs(found[900:]).max() == 0, "the ground has no motion"


@pytest.mark.parametrize("count", [0, 1])
def test_a_sweep_all_alone_has_no_motion(count: int) -> None:
    rows = flow_of(TinyDrive(count))
    assert [np.abs(row.flow_mps).max() for row in rows] == [0.0] * count


def test_ground_is_what_lies_up_to_the_height_of_the_stage() -> None:
    inputs = TinyInputs(TinyDrive())
    config = load(ground.GroundConfig, STAGES / "ground.toml")
    rows = list(ground.run(inputs, config))
    for step, row in enumerate(rows):
        np.testing.assert_array_equal(row.is_ground, row.height_m <= 0.25)
        np.testing.assert_allclose(row.height_m, inputs.drive.world_xyz_m(step)[:, 2], atol=0.05)
    assert inputs.counts["ground points"] == sum(row.is_ground.sum() for row in rows)
    assert inputs.counts["points above ground"] == sum((~row.is_ground).sum() for row in rows)


def test_the_road_lies_at_the_drives_own_height() -> None:
    low = TinyDrive()
    low.ground_z_m = (
        30.0  # a wrong mounting height: all candidates are implausible, and the road is taken from it
    )
    rows = list(ground.run(TinyInputs(low), load(ground.GroundConfig, STAGES / "ground.toml")))
    assert np.median(rows[0].height_m[900:]) < -20


def test_given_poses_pass_through_and_others_are_estimated() -> None:
    config = load(odometry.OdometryConfig, STAGES / "odometry.toml")
    given, estimated = TinyInputs(TinyDrive()), TinyInputs(TinyDrive(has_poses=False))
    rows = list(odometry.run(given, config))
    np.testing.assert_array_equal([row.world_from_ego for row in rows], given.drive.world_from_ego)
    assert [row.time_ns for row in rows] == [400_000_000, 500_000_000, 700_000_000]
    assert given.counts == {"poses given": 3}
    rows = list(odometry.run(estimated, config))
    np.testing.assert_array_equal(rows[0].world_from_ego, np.eye(4))
    assert estimated.counts == {"poses estimated": 3, "frames placed after a gap or by a new search": 1}
