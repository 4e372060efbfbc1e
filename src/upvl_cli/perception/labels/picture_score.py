"""Scores of tracks by how well their boxes fit the 2D boxes of the pictures."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.config import PictureScoreConfig
from upvl_cli.types import Floats, Ints


class PictureFits:
    """How well the boxes of each track fit 2D boxes, summed up frame by frame."""

    def __init__(self) -> None:
        """Start without a frame."""
        self._sums: dict[int, tuple[float, int]] = {}

    def add_frame(self, track_id: Ints, iou_2d: Floats) -> None:
        """Add the boxes of a frame.

        Args:
            track_id: (b,) the track of each box.
            iou_2d: (b,) IoU of its projection with the best 2D box, negative without a picture of it.
        """
        for track, iou in zip(track_id.tolist(), iou_2d.tolist(), strict=True):
            if iou >= 0:
                total, frames = self._sums.get(track, (0.0, 0))
                self._sums[track] = total + iou, frames + 1

    def weights(self, track_id: Ints, config: PictureScoreConfig) -> Floats:
        """Return (b,) factors of the scores of tracks: 1 for those that no picture shows.

        Args:
            track_id: (b,) tracks.
            config: The factors.
        """
        weights: Floats = np.ones(len(track_id))
        for row, track in enumerate(track_id.tolist()):
            if track in self._sums:
                total, frames = self._sums[track]
                fit = min(1.0, total / frames / config.full_iou)
                weights[row] = config.min_weight + (1 - config.min_weight) * fit
        return weights
