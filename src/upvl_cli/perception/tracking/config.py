"""Settings of the tracker and of the smoothing of its boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from upvl_cli.config.base import Config, setting, table


@dataclass(frozen=True)
class TravelConfig(Config):
    """Which tracks travel: their velocities take them somewhere, and their boxes follow."""

    required: bool = setting("drop a track that does not travel, so that only moving objects are left")
    min_distance_m: float = setting(
        "a track travels when its integrated velocity leads at least this far from its first box",
        "m",
        ge=0,
        le=10_000,
    )
    min_path_slope: float = setting(
        "a track travels when the slope of its box centers over its integrated velocity, 1 for a path truly taken, "
        "is at least this",
        ge=-1,
        le=1,
    )


@dataclass(frozen=True)
class TrackerConfig(Config):
    """How boxes of different frames are associated: a Kalman filter of nearly constant velocity, and its gate."""

    acceleration_psd_m2ps3: float = setting(
        "power spectral density of an object's acceleration, the process noise of the filter",
        "m^2/s^3",
        ge=0.001,
        le=10_000,
    )
    position_noise_m: float = setting(
        "standard deviation of the center of a measured box", "m", ge=0.001, le=100
    )
    center_noise_share: float = setting(
        "further standard deviation of a center along each side of its box, as a share of that side",
        ge=0,
        le=10,
    )
    velocity_noise_mps: float = setting(
        "standard deviation of the velocity of a measured box", "m/s", ge=0.001, le=200
    )
    gate_sigma: float = setting(
        "largest Mahalanobis distance, in standard deviations, at which a box can be associated with a track",
        ge=0.1,
        le=100,
    )
    max_coast_s: float = setting("longest time for which a track goes on without a box", "s", ge=0, le=3600)
    max_gap_s: float = setting(
        "longest time between the end of a track and the start of another that are joined", "s", ge=0, le=3600
    )
    max_standing_gap_s: float = setting(
        "the same of two parts that both stand still: what hides a parked car passes by", "s", ge=0, le=3600
    )
    standing_mps: float = setting(
        "speed below which a part of a track stands still where it ends or begins", "m/s", ge=0, le=200
    )
    standing_psd_m2ps3: float = setting(
        "power spectral density of the acceleration of what stands still, for such a gap",
        "m^2/s^3",
        ge=0,
        le=10_000,
    )
    max_overlap_s: float = setting(
        "longest time for which two tracks can go on beside each other and still be parts of one: the clustering "
        "splits an object for a few frames, and the other piece goes on",
        "s",
        ge=0,
        le=3600,
    )
    min_boxes: int = setting("fewest boxes of a track; one with fewer is dropped", ge=1, le=10**6)
    window_s: float = setting(
        "length of the windows of time in which tracks are found; those of a longer drive overlap by half, and "
        "tracks of two windows that share boxes are one",
        "s",
        ge=1,
        le=3600,
    )
    min_seconds: float = setting(
        "time that a track with fewer boxes spans, where sweeps are so rare that it can have no more in that time",
        "s",
        ge=0,
        le=3600,
    )
    min_coast_frames: int = setting(
        "sweeps for which a track goes on without a box, where that is longer than `max_coast_s`",
        ge=1,
        le=100,
    )
    min_gap_frames: int = setting(
        "sweeps between the end of a track and the start of another that are joined, where that is longer than "
        "`max_gap_s`",
        ge=1,
        le=100,
    )
    travel: TravelConfig = table("which tracks are dropped because they stand still")

    def at_rate(self, step_s: float) -> TrackerConfig:
        """Return the limits that mean the same where sweeps are rarer.

        Args:
            step_s: Usual time between sweeps; 0 for a single one, which changes nothing.
        """
        if step_s <= 0:
            return self
        # Times between sweeps vary: half a step more takes in the last of the frames, a quarter less no frame more.
        return replace(
            self,
            max_coast_s=max(self.max_coast_s, (self.min_coast_frames + 0.5) * step_s),
            max_gap_s=max(self.max_gap_s, (self.min_gap_frames + 0.5) * step_s),
            max_standing_gap_s=max(self.max_standing_gap_s, (self.min_gap_frames + 0.5) * step_s),
            min_boxes=min(self.min_boxes, max(2, math.ceil(self.min_seconds / step_s - 0.25) + 1)),
        )


@dataclass(frozen=True)
class SmoothingConfig(Config):
    """How the boxes of a track correct each other."""

    enabled: bool = setting(
        "correct size, center, heading and score of each box by the boxes of its track before and after it"
    )
    window_s: float = setting(
        "standard deviation in time of the Gaussian weight that the other boxes of a track have",
        "s",
        gt=0,
        le=3600,
    )
    min_weight_score: float = setting(
        "lowest score that a box is weighted with, so that boxes of score 0 have a mean", gt=0, le=1
    )
    unconfirmed_score_factor: float = setting("factor on the score of a box that is in no track", ge=0, le=1)
