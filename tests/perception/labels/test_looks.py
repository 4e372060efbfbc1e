"""Which pictures of a track are looked at, and what becomes of the looks."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.labels.config import LookChoiceConfig, LookCropConfig
from upvl_cli.perception.labels.look_crops import cut, look, object_rectangle
from upvl_cli.perception.labels.look_votes import combined_shares, look_shares
from upvl_cli.perception.labels.looks import LookCandidates, choose_looks, pool_looks, sharpness
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.types import Camera

CHOICE = LookChoiceConfig(looks_per_track=2, min_gap_s=0.4, min_px=12)
CROP = LookCropConfig(context=0.2, max_px=100, wanted_px=40)
BASIS = Basis(
    np.zeros(COMPONENTS, np.float32),
    np.eye(COMPONENTS, dtype=np.float32),
    np.full(COMPONENTS, 0.01, np.float32),
    1.0,
)
CAMERA = Camera(
    "front",
    200,
    100,
    np.array([[100.0, 0, 99.5], [0, 100, 49.5], [0, 0, 1]]),
    np.zeros(5),
    np.eye(4),
)


def candidates(*rows: tuple[float, int, int, float, float]) -> LookCandidates:
    """Time, camera, track, side and share of each; the area is the square of the side."""
    time_s, camera, track, side, share = (np.array(column) for column in zip(*rows, strict=True))
    number = np.arange(len(rows))
    return LookCandidates(number, time_s, camera, number, track, side, side**2, share)


def chosen(*rows: tuple[float, int, int, float, float]) -> list[int]:
    return choose_looks(candidates(*rows), CHOICE).tolist()


def test_a_large_object_that_nothing_hides_wins_over_a_hidden_and_a_small_one() -> None:
    assert chosen((0, 0, 7, 60, 0.2), (1, 0, 7, 50, 1), (2, 0, 7, 20, 1), (3, 0, 7, 40, 1)) == [1, 3]


def test_each_track_has_its_own_looks() -> None:
    assert chosen((0, 0, 7, 60, 1), (0, 0, 8, 20, 1), (1, 0, 7, 59, 1), (2, 0, 7, 58, 1)) == [0, 1, 2]


def test_looks_of_one_camera_lie_apart_in_time_and_those_of_two_need_not() -> None:
    assert chosen((0, 0, 7, 60, 1), (0.3, 0, 7, 59, 1), (0.4, 0, 7, 30, 1)) == [0, 2]
    assert chosen((0, 0, 7, 60, 1), (0.3, 1, 7, 59, 1), (0.4, 0, 7, 30, 1)) == [0, 1]


def test_what_is_very_small_is_not_looked_at() -> None:
    assert chosen((0, 0, 7, 12, 1), (1, 0, 7, 11.9, 1)) == [0]
    assert choose_looks(candidates((0, 0, 7, 5, 1.0)), CHOICE).tolist() == []


def test_of_equals_the_first_wins() -> None:
    assert chosen(*((time_s, 0, 7, 20, 0.5) for time_s in range(4))) == [0, 1]


def noise(side: int, blur: int = 1) -> np.ndarray:
    rough = np.random.default_rng(0).integers(0, 255, (side // blur, side // blur, 3), dtype=np.uint8)
    return rough.repeat(blur, axis=0).repeat(blur, axis=1)


def test_a_blurred_picture_is_less_sharp_and_contrast_does_not_count() -> None:
    assert sharpness(noise(24)) > 2 * sharpness(noise(24, blur=3))
    assert sharpness(noise(24)) == pytest.approx(sharpness(noise(24).astype(float) * 0.5))
    assert sharpness(np.full((9, 9, 3), 7, np.uint8)) == 0
    assert sharpness(np.zeros((2, 2, 3), np.uint8)) == 0


def test_pooled_looks_are_what_plain_arithmetic_gives() -> None:
    rng = np.random.default_rng(1)
    vector = rng.normal(size=(6, COMPONENTS))
    vector /= np.linalg.norm(vector, axis=1, keepdims=True)
    track, quality = np.array([9, 4, 9, 9, 4, 2]), np.array([4.0, 1, 9, 1, 16, 5])
    sharp = np.array([1.0, 2, 3, 2, 1, 0])
    looks = pool_looks(track, vector, quality, sharp, BASIS)
    count, feature = looks.of([4, 3, 9, 2])
    assert count.tolist() == [2, 0, 3, 1]
    # Median sharpness 2 of track 9: weights 2 / 2, 3, 1. Median 1.5 of track 4: weights 1 and 4 / 1.5.
    plain = {
        9: vector[0] * 1 + vector[2] * 3 + vector[3] * 1,
        4: vector[1] * 1 + vector[4] * 4 / 1.5,
        2: vector[5],
    }
    for row, number in ((0, 4), (2, 9), (3, 2)):
        expected = plain[number] / np.linalg.norm(plain[number]) / 0.01
        np.testing.assert_allclose(feature[row], expected, atol=0.51)
    assert not feature[1].any()


def test_no_looks_are_no_features() -> None:
    none = np.zeros(0)
    looks = pool_looks(none.astype(int), np.zeros((0, COMPONENTS)), none, none, BASIS)
    count, feature = looks.of([1, 2])
    assert count.tolist() == [0, 0]
    assert feature.shape == (2, COMPONENTS)
    assert not feature.any()


def test_a_rectangle_holds_the_box_as_far_as_the_picture_goes() -> None:
    x, y, z = np.meshgrid([-1.0, 1], [-0.5, 0.5], [4.0, 5], indexing="ij")
    corners = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    one = np.array([[100.0, 50.0]])
    np.testing.assert_allclose(object_rectangle(CAMERA, corners, one), [75, 37.5, 125, 62.5])
    np.testing.assert_allclose(object_rectangle(CAMERA, corners + [4, 0, 0], one), [100.5, 37.5, 200, 62.5])
    # A corner behind the camera has no pixel: the points alone say where the object is.
    points = np.array([[20.0, 30], [60, 40]])
    np.testing.assert_allclose(
        object_rectangle(CAMERA, corners - [0, 0, 4.5], points), [20.5, 30.5, 60.5, 40.5]
    )


def test_a_crop_has_some_of_the_surroundings_and_knows_its_place() -> None:
    picture = np.zeros((100, 200, 3), np.uint8)
    picture[..., 0], picture[..., 1] = np.arange(200)[None], np.arange(100)[:, None]
    crop = cut(picture, np.array([60.0, 40, 100, 60]), CROP)
    assert (crop.origin_px.tolist(), crop.size_px.tolist()) == ([52, 32], [56, 36])
    assert crop.rgb.shape == (36, 56, 3)
    at_border = cut(picture, np.array([180.0, 90, 200, 100]), CROP)
    assert at_border.origin_px.tolist() == [176, 86]
    assert at_border.rgb.shape == (14, 24, 3)


@pytest.mark.parametrize("rectangle", [(10, 5, 190, 95), (60, 40, 70, 48), (60, 40, 100, 60)])
def test_pixels_of_a_crop_are_those_of_the_picture_reduced_or_enlarged(rectangle: tuple[int, ...]) -> None:
    picture = np.zeros((100, 200, 3), np.uint8)
    picture[..., 0], picture[..., 1] = np.arange(200)[None], np.arange(100)[:, None]
    crop = cut(picture, np.array(rectangle, float), CROP)
    assert max(crop.rgb.shape) <= CROP.max_px
    uv = np.array([[rectangle[0] + 3, rectangle[1] + 2], [rectangle[2] - 3, rectangle[3] - 3]], float)
    sampled = look_values(crop, uv)
    np.testing.assert_allclose(sampled[:, :2], uv, atol=1.0)


def look_values(crop, uv: np.ndarray) -> np.ndarray:
    from upvl_cli.perception.visual.views import sample_bilinear

    high, wide, _ = crop.rgb.shape
    return sample_bilinear(crop.rgb.astype(np.float32), crop.pixels(uv), wide, high)


def test_small_objects_are_enlarged_and_large_ones_reduced() -> None:
    picture = np.zeros((100, 200, 3), np.uint8)
    assert cut(picture, np.array([60.0, 40, 70, 48]), CROP).rgb.shape == (24, 28, 3)  # 14 x 12, twice
    assert cut(picture, np.array([10.0, 5, 190, 95]), CROP).rgb.shape == (50, 100, 3)


def test_a_look_is_the_mean_direction_at_the_points() -> None:
    picture = np.zeros((40, 40, 3), np.uint8)
    picture[:, :20], picture[:, 20:] = [200, 0, 0], [0, 100, 0]
    crop = cut(picture, np.array([5.0, 5, 35, 35]), CROP)
    uv = np.array([[10.0, 10], [11, 20], [30, 20], [12, 12]])
    found = look(lambda rgb: rgb.astype(np.float32) + 1e-6, crop, uv)
    np.testing.assert_allclose(found, np.array([3, 1, 0]) / 10**0.5, atol=1e-4)  # each point counts the same


TYPES = np.array([1, 1, 2, 4])


def test_a_class_has_the_share_of_its_nearest_word() -> None:
    cosines = np.array([[0.5, 0.5, 0.5, 0.2], [0.1, 0.2, 0.1, 0.6]])
    share = look_shares(cosines, TYPES, 0.05)
    np.testing.assert_allclose(share.sum(axis=1), 1)
    # Two words as near as one have no more together than that one.
    assert share[0, :2].sum() == pytest.approx(share[0, 2])
    assert share[0, 0] == pytest.approx(share[0, 1])
    assert share[1].argmax() == 3
    assert share[1, 3] > 0.99
    plain = np.exp(np.array([0.5, 0.5, 0.2]) / 0.05)
    assert share[0, 3] == pytest.approx(plain[2] / plain.sum())


def test_far_words_have_nothing_and_harm_nothing() -> None:
    share = look_shares(np.array([[1.0, -1, -1, -1]]), TYPES, 0.001)
    np.testing.assert_allclose(share, [[1, 0, 0, 0]])
    assert look_shares(np.zeros((0, 4)), TYPES, 0.05).shape == (0, 4)


def test_points_and_looks_share_the_say() -> None:
    points = np.array([[3, 1.0], [0, 0], [1, 3], [0, 0]])
    looks = np.array([[0, 1.0], [0.2, 0.8], [0, 0], [0, 0]])
    share = combined_shares(points, looks, np.array([True, True, False, False]), 0.4)
    np.testing.assert_allclose(share, [[0.45, 0.55], [0.2, 0.8], [0.25, 0.75], [0, 0]])
