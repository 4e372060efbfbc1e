"""What a run came to: an absurd end is said in words, with its reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from upvl_cli.commands.verdict import DriveResult, suspicions_of

TRACKS, FRAMES = 12, 20
BOXES = TRACKS * FRAMES
UNPLACED = "frames that could not be placed, poses interpolated"
SOUND = DriveResult(
    segment="a",
    frames=FRAMES,
    tracks=TRACKS,
    length_m=np.full(BOXES, 4.2),
    speed_mps=np.full(BOXES, 8.0),
    class_name=np.array(["vehicle", "pedestrian"] * (BOXES // 2)),
    is_moving=np.ones(BOXES, dtype=bool),
    counts={
        "ground": {"ground points": 60_000, "points above ground": 40_000},
        "mask": {"points moving": 400},
        "extract-vl": {"seen by front": 30_000},
    },
    uses_pictures=True,
)


def texts(result: DriveResult) -> list[str]:
    return [finding.sentence for finding in suspicions_of(result)]


def with_counts(**changes: dict[str, int]) -> DriveResult:
    return replace(
        SOUND, counts={**SOUND.counts, **{name.replace("_", "-"): v for name, v in changes.items()}}
    )


def test_nothing_is_said_of_a_usual_drive() -> None:
    assert texts(SOUND) == []


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (with_counts(mask={"points moving": 28_000}), "70% of the points above the ground move"),
        (with_counts(ground={"points above ground": 100_000}), "0.0% of all points are ground"),
        (with_counts(ground={}), "the drive has no points"),
        (
            with_counts(odometry={"frames that could not be placed, poses interpolated": 3}),
            "3 of 20 frames could not be placed",
        ),
        (with_counts(extract_vl={"no view": 9}), "no point has a feature of a picture"),
        (replace(SOUND, class_name=np.full(BOXES, "other")), "all 12 tracks are of one class, other"),
        (replace(SOUND, length_m=SOUND.length_m * 3.28), "half of the boxes are longer than 13.8 m"),
        (replace(SOUND, speed_mps=SOUND.speed_mps * 10), "240 of 240 boxes are faster than 70 m/s"),
        (replace(SOUND, frames=1), "240 boxes a frame"),
    ],
)
def test_what_is_absurd_is_said(result: DriveResult, said: str) -> None:
    (text,) = texts(result)
    assert said in text


def test_a_drive_without_an_object_says_what_was_dropped() -> None:
    nothing = replace(
        with_counts(track={"tracks dropped: too few boxes": 24}, nms={"boxes kept": 3}),
        length_m=np.zeros(0),
        speed_mps=np.zeros(0),
        class_name=np.zeros(0, dtype=str),
        is_moving=np.zeros(0, dtype=bool),
        tracks=0,
    )
    (text,) = texts(nothing)
    assert "no object was found in 20 frames: dropped were 24 track: tracks dropped: too few boxes" in text
    assert "min_boxes in track.toml" in text


def test_vehicles_alone_are_no_surprise_on_a_motorway() -> None:
    assert texts(replace(SOUND, class_name=np.full(BOXES, "vehicle"))) == []
    assert texts(replace(SOUND, class_name=np.full(BOXES, "vehicle"), tracks=30)) != []


def test_labels_that_asked_for_no_picture_need_no_word() -> None:
    assert texts(replace(with_counts(extract_vl={"no view": 9}), uses_pictures=False)) == []
