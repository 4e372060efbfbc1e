"""What is kept of a feature compares with words as the feature itself does."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis, background_score, fit


def directions(count: int, dim: int, rank: int, seed: int = 0) -> np.ndarray:
    """Features of any length that lie, but for their mean, in `rank` dimensions."""
    axes, rng = np.random.default_rng(99).normal(size=(rank, dim)), np.random.default_rng(seed)
    return (rng.normal(size=(count, rank)) @ axes) * rng.uniform(1, 9, (count, 1))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def basis() -> Basis:
    features = directions(2000, 96, 40)
    return fit((features[first : first + 200] for first in range(0, 2000, 200)), 96)


def test_all_variance_of_features_of_few_dimensions_is_kept(basis: Basis) -> None:
    assert basis.components.shape == (COMPONENTS, 96)
    assert basis.variance_kept == pytest.approx(1.0, abs=1e-6)


def test_cosines_are_those_of_the_full_space(basis: Basis) -> None:
    features, words = directions(300, 96, 40), unit(np.random.default_rng(1).normal(size=(7, 96)))
    exact = unit(features) @ words.T
    codes = basis.quantize(basis.project(features))
    assert codes.dtype == np.int8
    np.testing.assert_allclose(basis.cosines(codes, words), exact, atol=0.012)  # eight bits a value
    # Against the formula written out: the feature is rebuilt, and compared.
    rebuilt = basis.mean + basis.dequantize(codes) @ basis.components
    np.testing.assert_allclose(basis.cosines(codes, words), unit(rebuilt) @ words.T, atol=1e-5)


def test_the_axes_are_those_of_a_plain_decomposition() -> None:
    """Incremental fits of many pictures give the axes of one fit of all."""
    features = unit(directions(3000, 80, 80)) * np.linspace(3, 0.1, 80)
    basis = fit((features[first : first + 500] for first in range(0, 3000, 500)), 80)
    full = unit(features)
    axes = np.linalg.svd(full - full.mean(axis=0), full_matrices=False)[2]
    overlap = np.abs(axes[:10] @ basis.components[:10].T)
    assert np.diag(overlap).min() > 0.98
    np.testing.assert_allclose(basis.mean, full.mean(axis=0), atol=1e-6)


def test_a_model_of_few_dimensions_has_axes_of_zeros() -> None:
    basis = fit([directions(200, 5, 5)], 5)
    assert not basis.components[5:].any()
    words = np.eye(5)
    features = directions(20, 5, 5, seed=3)
    np.testing.assert_allclose(
        basis.cosines(basis.quantize(basis.project(features)), words), unit(features), atol=0.02
    )


def test_without_a_picture_there_is_nothing_to_keep() -> None:
    basis = fit([], 6)
    assert basis.variance_kept == 0
    assert not basis.quantize(basis.project(np.ones((2, 6)))).any()


def test_the_score_is_the_best_word_less_the_best_of_the_others() -> None:
    cosines = np.array([[0.1, 0.5], [0.3, -0.2]])
    np.testing.assert_allclose(background_score(cosines, np.zeros((2, 0))), [0.5, 0.3])
    np.testing.assert_allclose(background_score(cosines, np.array([[0.2, 0.1], [0.4, 0.0]])), [0.3, -0.1])


def test_codes_are_the_nearest_steps_and_saturate() -> None:
    scale = np.zeros(COMPONENTS, np.float32)
    scale[:2] = 0.5, 0.25
    basis = Basis(np.zeros(2), np.zeros((COMPONENTS, 2)), scale, 1.0)
    values = np.zeros((4, COMPONENTS))
    values[:, 0], values[:, 1] = (0.74, 0.76, -500, 500), (0.12, 0.13, -0.6, 0)
    codes = basis.quantize(values)
    assert codes[:, 0].tolist() == [1, 2, -127, 127] and codes[:, 1].tolist() == [0, 1, -2, 0]
    np.testing.assert_allclose(basis.dequantize(codes)[:2, :2], [[0.5, 0], [1, 0.25]])


def test_a_feature_is_projected_at_length_one_and_from_the_mean() -> None:
    """By hand: z = W (f / |f| - m) with f / |f| = (0.6, 0.8)."""
    components = np.zeros((COMPONENTS, 2))
    components[:2] = [[0.0, 1.0], [1.0, 0.0]]
    basis = Basis(np.array([0.1, 0.2]), components, np.ones(COMPONENTS), 1.0)
    found = basis.project(np.array([[3.0, 4.0], [30.0, 40.0]]))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[:, :3], [[0.6, 0.5, 0]] * 2, atol=1e-6)


def test_the_largest_value_of_any_batch_has_the_largest_code() -> None:
    """Only the last value in the middle batch is far along the first axis."""
    small = np.column_stack([np.linspace(-0.1, 0.1, 50), np.ones(50)])
    large = small.copy()
    large[7] = 0.5, 1
    basis = fit([small, large, small], 2)
    codes = basis.quantize(basis.project(large))
    assert np.abs(codes[:, 0]).max() == 127 and np.abs(codes[:, 0]).argmax() == 7
    assert np.abs(basis.quantize(basis.project(small))[:, 0]).max() < 60


def test_the_share_of_variance_is_that_of_the_components() -> None:
    features = directions(4000, 100, 100)
    basis = fit((features[first : first + 1000] for first in range(0, 4000, 1000)), 100)
    full = unit(features) - unit(features).mean(axis=0)
    variance = np.linalg.svd(full, compute_uv=False) ** 2
    assert basis.variance_kept == pytest.approx(variance[:COMPONENTS].sum() / variance.sum(), abs=0.03)


def test_a_feature_without_length_has_the_cosine_of_the_mean() -> None:
    basis = Basis(np.array([0.6, 0.0]), np.zeros((COMPONENTS, 2)), np.ones(COMPONENTS), 1.0)
    codes = np.zeros((1, COMPONENTS), np.int8)
    np.testing.assert_allclose(
        basis.cosines(codes, np.array([[1.0, 0], [0, 1], [0.6, 0.8]])), [[1, 0, 0.6]], atol=1e-6
    )


def test_features_of_few_classes_have_few_axes() -> None:
    """Five directions differ along four axes: what the decomposition gives beyond them is rounding."""
    rng = np.random.default_rng(12)
    classes = rng.normal(size=(5, 192)).astype(np.float32)
    classes /= np.linalg.norm(classes, axis=1, keepdims=True)
    basis = fit((classes[rng.integers(5, size=300)] for _ in range(3)), 192)
    np.testing.assert_array_equal(basis.components.any(axis=1), np.arange(COMPONENTS) < 4)
    np.testing.assert_array_equal(basis.scale > 0, np.arange(COMPONENTS) < 4)
    words = rng.normal(size=(7, 192)).astype(np.float32)
    words /= np.linalg.norm(words, axis=1, keepdims=True)
    codes = basis.quantize(basis.project(classes))
    np.testing.assert_allclose(basis.cosines(codes, words), classes @ words.T, atol=0.01)
