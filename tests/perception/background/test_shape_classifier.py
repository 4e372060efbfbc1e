"""Shape of the surroundings of a point, and the classifier that is trained on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.shape_classifier import (
    ShapeClassifier,
    ShapeFeatures,
    compute_shape_features,
    training_samples,
)
from upvl_cli.stages.mask import MaskConfig

CONFIG = load(MaskConfig, Path(__file__).parents[3] / "stages" / "mask.toml").shape_classifier
HEIGHT, LINEARITY, PLANARITY, SCATTERING, VERTICALITY, HIGH, LOW, COUNT = range(8)
STEP = CONFIG.voxel_m
CENTER = STEP / 2


def features(xyz: np.ndarray) -> np.ndarray:
    """(n, 8) features of each point, whose height is its z."""
    found = compute_shape_features(xyz, xyz[:, 2], CONFIG)
    return found.feature[found.voxel_of_point]


def grid(counts: tuple[int, int, int]) -> np.ndarray:
    """One point in the middle of each voxel of a block."""
    return (
        np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3) * STEP
        + CENTER
    )


SHAPES = {
    "pole": ((1, 1, 11), (1, 0, 0)),
    "wall": ((11, 1, 11), (0, 1, 0)),
    "roof": ((11, 11, 1), (0, 1, 0)),
    "bush": ((11, 11, 11), (0, 0, 1)),
}


@pytest.mark.parametrize(("counts", "expected"), SHAPES.values(), ids=SHAPES)
def test_a_pole_is_linear_a_wall_planar_and_a_bush_neither(
    counts: tuple[int, int, int], expected: tuple[int, int, int]
) -> None:
    middle = np.prod(counts) // 2
    found = features(grid(counts))[middle]
    np.testing.assert_allclose(found[[LINEARITY, PLANARITY, SCATTERING]], expected, atol=0.01)


def test_the_normal_of_a_roof_is_vertical_and_that_of_a_wall_is_not() -> None:
    assert features(grid((11, 11, 1)))[60, VERTICALITY] == pytest.approx(1, abs=1e-6)
    assert features(grid((11, 1, 11)))[60, VERTICALITY] == pytest.approx(0, abs=1e-6)
    tilted = grid((11, 11, 1))
    tilted[:, 2] += tilted[:, 0] * 0.75  # a normal of (-0.6, 0, 0.8)
    np.testing.assert_allclose(features(tilted)[60, VERTICALITY], 0.8, atol=0.02)


def test_features_are_those_of_a_plain_computation() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0, 3, (400, 3))
    found = compute_shape_features(xyz, xyz[:, 2], CONFIG)
    voxel = found.voxel_of_point
    total = voxel.max() + 1
    center = np.array([xyz[voxel == number].mean(axis=0) for number in range(total)])
    column = np.floor(center[:, :2] / CONFIG.column_m)
    _, column = np.unique(column, axis=0, return_inverse=True)
    column_center = np.array(
        [center[column == number, :2].mean(axis=0) for number in range(column.max() + 1)]
    )
    for number in range(total):
        near = center[np.linalg.norm(center - center[number], axis=1) <= CONFIG.surface_radius_m]
        values, axes = np.linalg.eigh(np.cov(near.T, bias=True) if len(near) > 1 else np.zeros((3, 3)))
        s3, s2, s1 = np.sqrt(np.maximum(values, 1e-6))
        apart = np.linalg.norm(column_center - column_center[column[number]], axis=1)
        around = center[np.isin(column, np.flatnonzero(apart <= CONFIG.column_radius_m)), 2]
        expected = [
            center[number, 2], (s1 - s2) / s1, (s2 - s3) / s1, s3 / s1, abs(axes[2, 0]), around.max(), around.min(),
            np.log(len(near)),
        ]  # fmt: skip
        chosen = found.feature[number]
        if len(near) > 4:  # with fewer the axes are not unique
            np.testing.assert_allclose(chosen, expected, atol=1e-4)
        np.testing.assert_allclose(
            chosen[[HEIGHT, HIGH, LOW, COUNT]], np.array(expected)[[0, 5, 6, 7]], atol=1e-5
        )


def test_a_voxel_has_the_mean_height_of_its_points() -> None:
    xyz = np.full((2, 3), CENTER)
    found = compute_shape_features(xyz, np.array([1.0, 2.0]), CONFIG)
    assert found.feature[:, HEIGHT].tolist() == [1.5] and found.voxel_of_point.tolist() == [0, 0]


def sample(voxel: list[int], background: list[int]) -> tuple[list[float], list[int]]:
    """First feature and state of the training samples; voxel k has the feature k."""
    total = max(voxel) + 1
    feature = np.repeat(np.arange(total, dtype=np.float32)[:, None], 8, axis=1)
    found, state = training_samples(ShapeFeatures(np.array(voxel), feature), np.array(background), CONFIG)
    return found[:, 0].tolist(), state.tolist()


def test_a_voxel_is_a_sample_of_what_most_of_its_seen_points_are() -> None:
    assert sample([0, 0, 0, 1, 1, 1, 2, 2], [1, 1, 0, 1, 0, 0, 1, 0]) == ([0, 1, 2], [1, 0, 1])
    assert sample([0, 0, 0, 1, 1], [UNKNOWN, UNKNOWN, 0, UNKNOWN, UNKNOWN]) == ([0], [0])


def samples(count: int, low: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Voxels whose first feature tells the state; `low` of them are no background."""
    feature = np.zeros((count, 8), np.float32)
    feature[:, 0] = np.arange(count)
    return [(feature, (np.arange(count) >= low).astype(np.int8))]


def asked(values: list[float]) -> ShapeFeatures:
    feature = np.zeros((len(values), 8), np.float32)
    feature[:, 0] = values
    return ShapeFeatures(np.arange(len(values)), feature)


def test_the_classifier_finds_what_tells_background() -> None:
    trained = ShapeClassifier(samples(400, 150), CONFIG)
    assert trained.classify(asked([10, 100, 200, 390])).tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize(("low", "trained"), [(99, False), (100, True), (300, True), (301, False)])
def test_each_state_needs_a_hundred_samples(low: int, trained: bool) -> None:
    found = ShapeClassifier(samples(400, low), CONFIG).classify(asked([0, 399]))
    assert found.tolist() == ([0, 1] if trained else [UNKNOWN, UNKNOWN])


def test_samples_beyond_the_limit_are_thinned_evenly() -> None:
    """Every third of 900 or 899 is left, rounded so that the limit holds: 100 of the rarer state, then 99."""
    config = replace(CONFIG, max_samples=300)
    assert ShapeClassifier(samples(900, 300), config).classify(asked([0, 899])).tolist() == [0, 1]
    assert ShapeClassifier(samples(899, 297), config).classify(asked([0, 899])).tolist() == [UNKNOWN] * 2


def test_every_point_of_a_voxel_has_its_state() -> None:
    sweep = ShapeFeatures(np.array([1, 0, 1]), asked([10, 390]).feature)
    assert ShapeClassifier(samples(400, 150), CONFIG).classify(sweep).tolist() == [1, 0, 1]
    assert ShapeClassifier([], CONFIG).classify(sweep).tolist() == [UNKNOWN] * 3
