"""Factors of scores by 2D boxes, counted by hand."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.config import PictureScoreConfig
from upvl_cli.perception.labels.picture_score import PictureFits


def test_the_factor_is_that_of_the_mean_over_the_frames_in_view() -> None:
    fits = PictureFits()
    fits.add_frame(np.array([7, 8, 9]), np.array([0.25, 0.0, -1.0]))
    fits.add_frame(np.array([9, 7]), np.array([-1.0, 0.75]))
    fits.add_frame(np.array([7, 5]), np.array([-1.0, 0.2]))
    weights = fits.weights(np.array([9, 8, 7, 5, 4]), PictureScoreConfig(min_weight=0.2, full_iou=0.4))
    np.testing.assert_allclose(weights, [1.0, 0.2, 1.0, 0.6, 1.0])


def test_without_a_picture_scores_are_kept_to_the_last_digit() -> None:
    assert PictureFits().weights(np.arange(3), PictureScoreConfig(0.2, 0.4)).tolist() == [1.0, 1.0, 1.0]
