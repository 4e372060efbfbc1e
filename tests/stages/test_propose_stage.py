"""From the point tables of a drive to boxes and the points that they were made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from memory_inputs import SEGMENT, MemoryDrive, MemoryInputs, boxes2d_row

from upvl_cli.config.toml import load
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS
from upvl_cli.perception.visual.views import NO_VIEW, SEEN
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.propose import ProposeConfig, run
from upvl_cli.stages.rows import FlowRow, GroundRow, MaskRow, OdometryRow, ProposalRow

SHIPPED = load(ProposeConfig, Path(__file__).parents[2] / "stages" / "propose.toml")
CONFIG = replace(SHIPPED, clustering=replace(SHIPPED.clustering, eps_m=(0.6,)))
FRAME_S, FRAMES = 0.1, 13
GRID = np.stack(
    np.meshgrid(np.linspace(-2, 2, 13), np.linspace(-1, 1, 7), [0.4, 0.8, 1.2, 1.6]), axis=-1
).reshape(-1, 3)


def drive(
    object_mps: float, ego_mps: float, feature: np.ndarray | None = None, frames: int = FRAMES, **changes: Any
) -> MemoryInputs:
    """A solid car beside a car that drives, whose flow says 6 m/s whatever it does; every other point is ground."""
    tables: dict[str, list[Any]] = {
        name: [] for name in ("odometry", "flow", "ground", "mask", "extract-vl", "boxes2d")
    }
    sweeps = {}
    for number in range(frames):
        frame, time_s = 10 + number, number * FRAME_S
        car = GRID + [15 + (object_mps - ego_mps) * time_s, 4, 0]
        total = 2 * len(car)
        xyz = np.zeros((total, 3))
        xyz[::2], xyz[1::2] = car, np.column_stack([car[:, :2], np.zeros(len(car))])
        pose = np.eye(4)
        pose[0, 3] = ego_mps * time_s
        is_ground = np.arange(total) % 2 == 1
        state = np.full(total, NO_VIEW if feature is None else SEEN, np.int8)
        codes = np.zeros((0, COMPONENTS), np.int8) if feature is None else np.repeat(feature, 2, axis=0)
        sweeps[frame] = xyz
        measured = (True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
        tables["odometry"].append(OdometryRow(SEGMENT, frame, round(time_s * 1e9), pose, *measured))
        tables["flow"].append(FlowRow(SEGMENT, frame, np.tile([6.0, 0, 0], (total, 1))))
        tables["ground"].append(GroundRow(SEGMENT, frame, xyz[:, 2], is_ground))
        values = {"is_moving": np.ones(total, bool), "background": np.zeros(total, np.int8)} | changes
        tables["mask"].append(MaskRow(SEGMENT, frame, **values))
        tables["boxes2d"].append(boxes2d_row(frame))
        tables["extract-vl"].append(ExtractVlRow(SEGMENT, frame, state, np.zeros(total, np.int8), codes))
    scale = np.full(COMPONENTS, 0.01, np.float32)
    tables["pca"] = [PcaRow("all", 0, np.zeros(COMPONENTS), np.eye(COMPONENTS).ravel(), scale, 1.0)]
    return MemoryInputs(tables, MemoryDrive(sweeps))


def boxes_of(inputs: MemoryInputs, config: ProposeConfig = CONFIG) -> list[ProposalRow]:
    return list(run(inputs, config))


def test_a_car_that_moves_as_its_flow_says_has_a_box_in_each_frame() -> None:
    inputs = drive(object_mps=6.0, ego_mps=9.0)
    rows = boxes_of(inputs)
    assert [row.frame for row in rows] == list(range(10, 10 + FRAMES))
    for number, row in enumerate(rows):
        np.testing.assert_allclose(row.center_m, [[15 - 0.3 * number, 4, 0.8]], atol=1e-6)
        np.testing.assert_allclose(row.size_lwh_m, [[4, 2, 1.6]], atol=1e-6)
        np.testing.assert_allclose(row.velocity_mps, [[6, 0, 0]])
        # The points are numbered as in the sweep, with those on the ground between them.
        assert row.point_index.values.tolist() == list(range(0, 2 * len(GRID), 2))
        assert row.num_points.tolist() == [len(GRID)]
    assert inputs.counts["boxes kept"] == FRAMES


def test_a_parked_car_whose_flow_is_wrong_has_none_though_the_sensor_moves() -> None:
    inputs = drive(object_mps=0.0, ego_mps=9.0, frames=21)  # the span is 1 s: 4.3 m at 6 m/s
    assert sum(len(row.boxes) for row in boxes_of(inputs)) == 0
    assert inputs.counts["persistent"] == 21


def test_points_that_do_not_pass_the_mask_make_no_box() -> None:
    still = drive(6.0, 0.0, is_moving=np.zeros(2 * len(GRID), bool))
    assert sum(len(row.boxes) for row in boxes_of(still)) == 0
    wall = drive(6.0, 0.0, background=np.ones(2 * len(GRID), np.int8))
    assert sum(len(row.boxes) for row in boxes_of(wall)) == 0


def test_features_part_objects_by_their_strongest_components_alone() -> None:
    front = np.where(GRID[:, 0] > 0, 100, 0)  # 1.0 in units of the features
    for component, used, boxes in ((0, True, 2), (2, True, 2), (3, True, 1), (0, False, 1)):
        feature = np.zeros((len(GRID), COMPONENTS), np.int8)
        feature[:, component] = front
        clustering = replace(CONFIG.clustering, use_vl=used, vl_eps=0.5, vl_dims=3)
        rows = boxes_of(drive(6.0, 0.0, feature), replace(CONFIG, clustering=clustering))
        # Away from the ends of the drive, where the back half takes the place of the front half.
        assert {len(row.boxes) for row in rows[5:8]} == {boxes}, (component, used)


def test_each_radius_has_its_boxes_and_those_of_the_same_points_are_named() -> None:
    inputs = drive(object_mps=6.0, ego_mps=9.0)
    alone, both = boxes_of(inputs), boxes_of(inputs, SHIPPED)
    for one, row in zip(alone, both, strict=True):
        np.testing.assert_array_equal(row.hypothesis, [0, 1])
        np.testing.assert_array_equal(row.duplicate_of, [-1, 0])
        np.testing.assert_array_equal(row.center_m, np.repeat(one.center_m, 2, axis=0))
        np.testing.assert_array_equal(row.point_index.values, np.tile(one.point_index.values, 2))
    assert inputs.counts["boxes that an earlier hypothesis has too"] == FRAMES
