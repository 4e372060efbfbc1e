"""Words fused over a drive: by place for what stands, by track for what moves."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.semantics.config import FusionConfig
from upvl_cli.perception.semantics.fusion import (
    NO_CLASS,
    NO_TRACK,
    FusedScores,
    SceneEvidence,
    SweepScores,
    class_scores,
    tracks_of_points,
)
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Boxes

CONFIG = FusionConfig(voxel_m=0.2, radius_m=0.4)
WALL, CAR = (0.8, 0.2), (0.1, 0.7)  # scores of two classes


def sweep(points: list[tuple[float, tuple[float, float] | None, bool, int]]) -> SweepScores:
    """Points along x: place, scores or None where no camera sees it, whether it moves, and its track."""
    x_m, score, moves, track = zip(*points, strict=True) if points else ((), (), (), ())
    xyz = np.column_stack([np.array(x_m, float), np.zeros((len(points), 2))]).reshape(-1, 3)
    seen = np.array([each is not None for each in score], bool)
    given = np.array([each for each in score if each is not None], np.float32).reshape(-1, 2)
    return SweepScores(xyz, seen, given, np.array(moves, bool), np.array(track, np.int64))


def stands(
    x_m: float, score: tuple[float, float] | None
) -> tuple[float, tuple[float, float] | None, bool, int]:
    return x_m, score, False, NO_TRACK


def fuse(sweeps: list[SweepScores], asked: SweepScores) -> FusedScores:
    evidence = SceneEvidence(2, CONFIG)
    for each in sweeps:
        evidence.add(each)
    return evidence.fit().fuse(asked)


def test_a_place_has_the_mean_of_the_frames_that_saw_it() -> None:
    sweeps = [sweep([stands(5.05, WALL)]), sweep([stands(5.1, WALL)]), sweep([stands(5.15, CAR)])]
    found = fuse(sweeps, sweeps[2])  # the third frame alone would call it a car
    np.testing.assert_allclose(found.score[0], (np.multiply(2, WALL) + CAR) / 3, rtol=1e-6)
    number, margin = found.classify()
    assert (number.tolist(), found.num_frames.tolist()) == ([0], [3])
    np.testing.assert_allclose(margin, (1.7 - 1.1) / 3, rtol=1e-5)


def test_a_hidden_point_has_the_class_of_its_place_and_a_far_one_has_none() -> None:
    seen, hidden = sweep([stands(5.05, WALL)]), sweep([stands(5.2, None), stands(5.6, None)])
    found = fuse([seen, hidden], hidden)
    assert found.classify()[0].tolist() == [0, NO_CLASS]
    assert found.num_frames.tolist() == [1, 0]
    assert found.classify()[1][1] == 0


def test_what_moves_past_a_place_leaves_nothing_there() -> None:
    passing = sweep([(5.05, CAR, True, NO_TRACK)])
    wall = sweep([stands(5.05, None), stands(5.1, WALL)])
    found = fuse([passing, passing, wall], wall)
    np.testing.assert_allclose(found.score, np.array([WALL, WALL]), rtol=1e-6)
    # The moving point itself has what its own pixel says, and not the wall's words.
    moving = fuse([passing, wall], passing)
    np.testing.assert_allclose(moving.score[0], CAR, rtol=1e-6)
    assert moving.num_frames.tolist() == [1]


def test_a_track_has_its_mean_wherever_it_goes() -> None:
    frames = [sweep([(x_m, score, True, 7)]) for x_m, score in ((0, CAR), (9, CAR), (18, WALL), (27, None))]
    found = fuse(frames, frames[3])
    np.testing.assert_allclose(found.score[0], (np.multiply(2, CAR) + WALL) / 3, rtol=1e-6)
    assert found.num_frames.tolist() == [3]
    other = sweep([(0.0, None, True, 8), (0.0, None, True, NO_TRACK)])
    assert fuse(frames, other).classify()[0].tolist() == [NO_CLASS, NO_CLASS]


def test_fused_places_are_those_of_the_plain_way() -> None:
    """The plain way keeps all points, and takes for each the mean over the voxel of the nearest centroid."""
    rng = np.random.default_rng(0)
    sweeps = [
        SweepScores(
            rng.uniform(0, 2, (300, 3)), np.ones(300, bool), rng.random((300, 2), np.float32),
            np.zeros(300, bool), np.full(300, NO_TRACK),
        )
        for _ in range(5)
    ]  # fmt: skip
    found = fuse(sweeps, sweeps[0])
    xyz, score = np.concatenate([s.xyz_world_m for s in sweeps]), np.concatenate([s.score for s in sweeps])
    cell = np.floor(xyz / 0.2).astype(int)
    per_sweep = [voxelize(s.xyz_world_m, voxel_m=0.2).centroid for s in sweeps]
    centroids: dict[tuple[int, ...], list[np.ndarray]] = {}
    for each in per_sweep:
        for centroid in each:
            centroids.setdefault(tuple(np.floor(centroid / 0.2).astype(int)), []).append(centroid)
    cells = list(centroids)
    middles = np.array([np.mean(centroids[key], axis=0) for key in cells])
    for point in range(0, 300, 30):
        nearest = cells[int(np.linalg.norm(middles - sweeps[0].xyz_world_m[point], axis=1).argmin())]
        inside = (cell == nearest).all(axis=1)
        np.testing.assert_allclose(found.score[point], score[inside].mean(axis=0), rtol=1e-5)
        assert found.num_frames[point] == len(centroids[nearest])


def test_nothing_at_all() -> None:
    nothing = sweep([])
    found = fuse([nothing], nothing)
    assert found.score.shape == (0, 2)
    assert [len(part) for part in found.classify()] == [0, 0]
    unseen = sweep([stands(1.0, None)])
    assert fuse([], unseen).classify()[0].tolist() == [NO_CLASS]


def test_one_class_leads_over_none() -> None:
    number, margin = FusedScores(np.array([[0.4]], np.float32), np.array([2])).classify()
    assert (number.tolist(), margin.tolist()) == ([0], [0])


def test_a_class_has_the_cosine_of_its_nearest_word() -> None:
    cosines = np.array([[0.1, 0.6, 0.3, 0.2], [0.5, 0.4, 0.9, -0.1]])
    np.testing.assert_array_equal(
        class_scores(cosines, np.array([0, 0, 1, 2])), [[0.6, 0.3, 0.2], [0.5, 0.9, -0.1]]
    )
    assert class_scores(np.zeros((0, 4)), np.array([0, 0, 1, 2])).shape == (0, 3)


@pytest.mark.parametrize(
    ("x_m", "moves", "track"),
    [
        (10.0, True, 4),  # inside of both: that of the first box
        (12.1, True, 4),  # beside the first by less than the margin
        (13.0, True, 9),  # in the second alone
        (10.0, False, NO_TRACK),  # it stands
        (20.0, True, NO_TRACK),  # in no box
    ],
)
def test_moving_points_belong_to_the_box_that_holds_them(x_m: float, moves: bool, track: int) -> None:
    boxes = Boxes.from_rows(np.array([[10, 0, 0, 4, 2, 2, 0], [12, 0, 0, 6, 2, 2, 0]]))
    found = tracks_of_points(
        np.array([[x_m, 0, 0]]), np.array([moves]), boxes, np.array([4, 9]), margin_m=0.2
    )
    assert found.tolist() == [track]
