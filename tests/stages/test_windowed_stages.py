"""`track` and `amodal` on a long drive: what the whole drive tells, in the memory of a window."""

from __future__ import annotations

import tracemalloc
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_inputs import SEGMENT, MemoryDrive, MemoryInputs
from test_propose_stage import CONFIG as PROPOSE
from test_propose_stage import drive as drive_beside_a_car

from upvl_cli.config.toml import load
from upvl_cli.geometry.boxes import transform
from upvl_cli.geometry.se3 import apply, inverse, rotate, yaw_of
from upvl_cli.perception.amodal.fit import fit_amodal_boxes
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.objectness.prior import shipped_prior
from upvl_cli.stages import amodal, propose, track
from upvl_cli.stages.rows import AmodalRow, GroundRow, MaskRow, OdometryRow, ProposalRow, TrackRow
from upvl_cli.types import Boxes, Ragged, concat

STAGES = Path(__file__).parents[2] / "stages"
AMODAL = load(amodal.AmodalConfig, STAGES / "amodal.toml")
TRACK = load(track.TrackConfig, STAGES / "track.toml")
FRAME_S, EGO_MPS = 0.1, 5.0


class Lookup(dict[int, Any]):
    """Rows by frame, found at once, in any number."""

    def __iter__(self) -> Iterator[Any]:
        return iter(self.values())

    @property
    def frames(self) -> tuple[int, ...]:
        return tuple(self.keys())


class LongInputs(MemoryInputs):
    """Inputs of many frames."""

    def table(self, name: str, row: type[Any], segment: str | None = None) -> Any:
        return Lookup({item.frame: item for item in self.tables[name]})


def side(x_m: float, y_m: float, length_m: float, points: int) -> np.ndarray:
    """Points of one side and the back of an object that stands on the ground, in world axes."""
    share = np.linspace(0, 1, points)
    along = np.column_stack(
        [x_m + (share - 0.5) * length_m, np.full(points, y_m - 0.9), 0.2 + share % 0.11 * 12]
    )
    back = np.column_stack(
        [np.full(points, x_m - length_m / 2), y_m + (share - 0.5) * 1.8, 0.2 + share % 0.13 * 10]
    )
    return np.concatenate([along, back])


def scene(frames: int, points: int = 30) -> LongInputs:
    """The ego drives behind a car, past parked cars 20 m apart; proposals are the true boxes of what is seen."""
    tables: dict[str, list[Any]] = {name: [] for name in ("odometry", "ground", "mask", "propose")}
    sweeps = {}
    for number in range(frames):
        time_s = number * FRAME_S
        ego_x_m = EGO_MPS * time_s
        pose = np.eye(4)
        pose[0, 3] = ego_x_m
        parked = np.arange(20 * np.ceil((ego_x_m - 15) / 20), ego_x_m + 25, 20.0)
        objects = [(ego_x_m + 12, 0.0, EGO_MPS), *((x_m, 6.0, 0.0) for x_m in parked)]
        clouds = [side(x_m, y_m, 4.2, points) - [ego_x_m, 0, 0] for x_m, y_m, _ in objects]
        xyz = np.concatenate(clouds).astype(np.float32)
        low, high = (np.array([edge(cloud, axis=0) for cloud in clouds]) for edge in (np.min, np.max))
        total = len(objects)
        velocity = np.zeros((total, 3))
        velocity[:, 0] = [speed for _, _, speed in objects]
        owner = np.repeat(np.arange(total), [len(cloud) for cloud in clouds])
        measured = (True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
        tables["odometry"].append(OdometryRow(SEGMENT, number, round(time_s * 1e9), pose, *measured))
        tables["ground"].append(GroundRow(SEGMENT, number, xyz[:, 2], np.zeros(len(xyz), bool)))
        tables["mask"].append(MaskRow(SEGMENT, number, np.ones(len(xyz), bool), np.zeros(len(xyz), np.int8)))
        tables["propose"].append(
            ProposalRow(
                SEGMENT, number, round(time_s * 1e9), (low + high) / 2, high - low, np.zeros(total), velocity,
                np.full(total, 2 * points, np.int32), np.zeros(total, np.int8), np.full(total, -1),
                Ragged.grouped(owner, np.arange(len(xyz), dtype=np.int32), total), np.zeros(total, bool),
            )
        )  # fmt: skip
        sweeps[number] = xyz
    return LongInputs(tables, MemoryDrive(sweeps))


def tracked(inputs: LongInputs) -> LongInputs:
    """The same with the rows of `track`."""
    inputs.tables["track"] = list(track.run(inputs, TRACK))
    return inputs


def plain_amodal(inputs: LongInputs) -> dict[tuple[int, int], np.ndarray]:
    """The plain way: the sightings of all tracks of the drive at once; a world box by frame and track."""
    poses, sightings = inputs.tables["odometry"], dict[int, list[Any]]()
    for row, pose, proposal, ground in zip(
        *(inputs.tables[name] for name in ("track", "odometry", "propose", "ground")), strict=True
    ):
        owner = np.full(len(ground.height_m), -1)
        owner[proposal.point_index.values] = proposal.point_index.owner
        world_from_ego = pose.world_from_ego
        boxes, velocity = transform(row.boxes, world_from_ego), rotate(world_from_ego, row.velocity_mps)
        for place, track_id in enumerate(row.track_id.tolist()):
            points = np.flatnonzero((owner == row.proposal[place]) & (row.proposal[place] >= 0))
            xyz = apply(world_from_ego, inputs.drive.points(row.frame).xyz_ego_m[points])
            height = ground.height_m[points].astype(float)
            sightings.setdefault(track_id, []).append(
                (row.frame, xyz, height, boxes[[place]], velocity[place], world_from_ego, row.time_ns * 1e-9)
            )
    found = {}
    for track_id, seen in sightings.items():
        frames, xyz, height, boxes, velocity, turns, time_s = zip(*seen, strict=True)
        fitted = fit_amodal_boxes(
            Sightings(
                np.array(time_s), xyz, height, concat(boxes, Boxes), np.array(velocity),
                np.array([turn[:2, 3] for turn in turns]),
                np.array([yaw_of(turn) for turn in turns]),
            ),
            AMODAL,
        ).boxes  # fmt: skip
        for frame, box in zip(frames, fitted.to_rows(), strict=True):
            found[frame, track_id] = Boxes.from_rows(box[None])
    return {
        key: transform(box, inverse(poses[key[0]].world_from_ego)).to_rows()[0] for key, box in found.items()
    }


def rows_of(rows: list[AmodalRow]) -> dict[tuple[int, int], np.ndarray]:
    """The box of each frame and track."""
    return {
        (row.frame, track_id): box
        for row in rows
        for track_id, box in zip(row.track_id.tolist(), row.boxes.to_rows(), strict=True)
    }


def test_tracks_that_end_within_a_window_are_fitted_as_all_at_once_to_the_bit() -> None:
    inputs = tracked(scene(60))
    found, expected = rows_of(list(amodal.run(inputs, AMODAL))), plain_amodal(inputs)
    assert found.keys() == expected.keys()
    for key, box in expected.items():
        np.testing.assert_array_equal(found[key], box, err_msg=str(key))
    assert inputs.counts["tracks kept"] == len({track_id for _, track_id in expected})
    assert inputs.counts["boxes"] == len(expected)


def test_a_long_track_has_one_size_and_is_where_the_whole_drive_puts_it() -> None:
    inputs = tracked(scene(90))
    config = replace(AMODAL, window_s=2.0, max_sightings=10)
    found, expected = rows_of(list(amodal.run(inputs, config))), plain_amodal(inputs)
    assert found.keys() == expected.keys()
    sizes: dict[int, set[tuple[float, ...]]] = {}
    for (_, track_id), box in found.items():
        sizes.setdefault(track_id, set()).add(tuple(box[3:6].round(9)))
    assert {len(size) for size in sizes.values()} == {1}
    for key, box in expected.items():
        np.testing.assert_allclose(found[key], box, atol=0.2, err_msg=str(key))


def test_rows_come_once_their_tracks_have_ended_and_no_later() -> None:
    """Of a drive of 8 s, with windows of 2 s, the first rows come when 2 s and a bit were read."""
    inputs = tracked(scene(80))
    read = []
    points = inputs.drive.points
    inputs.drive.points = lambda frame: (read.append(frame), points(frame))[1]  # type: ignore[method-assign]
    config, late = replace(AMODAL, window_s=2.0, max_sightings=10), []
    for row in amodal.run(inputs, config):
        begin = len(read) - 1 - read[::-1].index(0)  # the sweep is read twice: once for the sizes
        late.append(max(read[begin:]) - row.frame)
    assert max(late) <= 2.0 / FRAME_S + 15


def peak_mib(stage: Any, inputs: Any, config: Any) -> float:
    """What the stage itself holds at most, beside its inputs."""
    tracemalloc.start()
    for _ in stage.run(inputs, config):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 2**20


SHORT_AMODAL = replace(AMODAL, window_s=1.0, max_sightings=8)
SHORT_TRACK = replace(TRACK, window_s=1.0)
PERSISTENCE = replace(PROPOSE.persistence, spans_s=(0.2,))
SHORT_PROPOSE = replace(PROPOSE, persistence=PERSISTENCE)


@pytest.mark.parametrize("stage", ["propose", "track", "amodal"])
def test_memory_does_not_grow_with_the_drive(stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UPVL_THREADS", "1")
    peaks = []
    for frames in (20, 60):
        if stage == "propose":
            source = drive_beside_a_car(6.0, 9.0, frames=frames)
            inputs: Any = LongInputs(source.tables, source.drive)
            peaks.append(peak_mib(propose, inputs, SHORT_PROPOSE))
        elif stage == "track":
            peaks.append(peak_mib(track, scene(frames), SHORT_TRACK))
        else:
            peaks.append(peak_mib(amodal, tracked(scene(frames, points=300)), SHORT_AMODAL))
    assert peaks[1] < 1.3 * peaks[0], peaks


def test_a_drive_without_a_box() -> None:
    inputs = scene(0)
    assert list(track.run(inputs, TRACK)) == []
    assert list(amodal.run(tracked(inputs), AMODAL)) == []
    empty = scene(3)
    for name in ("propose",):
        empty.tables[name] = [
            replace(
                row, center_m=row.center_m[:0], size_lwh_m=row.size_lwh_m[:0], heading_rad=row.heading_rad[:0],
                velocity_mps=row.velocity_mps[:0], num_points=row.num_points[:0],
                hypothesis=row.hypothesis[:0], duplicate_of=row.duplicate_of[:0],
                point_index=Ragged(np.zeros(0, np.int32), np.zeros(0, np.int64)), is_lifted=row.is_lifted[:0],
            )
            for row in empty.tables[name]
        ]  # fmt: skip
    rows: list[TrackRow] = tracked(empty).tables["track"]
    assert [len(row.track_id) for row in rows] == [0, 0, 0]
    assert [len(row.track_id) for row in amodal.run(empty, AMODAL)] == [0, 0, 0]


def test_each_box_is_scored_by_the_prior_on_its_own_track() -> None:
    inputs, totals = tracked(scene(20, points=300)), amodal.track_totals(tracked(scene(20, points=300)))
    rows = list(amodal.run(inputs, AMODAL))
    expected = {}
    for fitted in amodal.fitted_parts(inputs, totals, AMODAL, deque()):
        if fitted is not None:
            first = fitted.part.sightings[0]
            track_id = int(first.frame.tracks.track_id[first.row])
            expected[track_id] = shipped_prior().probability(fitted.features[None])[0]
    assert len(set(expected.values())) > 1, "tracks differ"
    for row in rows:
        np.testing.assert_allclose(row.objectness, [expected[track_id] for track_id in row.track_id.tolist()])
        support = row.num_points / (row.num_points + AMODAL.score.half_points)
        np.testing.assert_allclose(row.score, row.objectness * support * (1 - row.background_share))
