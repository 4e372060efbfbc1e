"""Labels of made-up blocks of points, right and with one mistake each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.evaluation.label_check import check_labels
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.types import Frame, Labels, Points

CONFIG = load(CheckConfig, Path(__file__).parents[2] / "stages" / "check.toml").labels
FRAMES = tuple(Frame(number, number * 100_000_000) for number in range(4))
SIZE_M = np.array([4.0, 1.8, 1.6])
COUNT, SPEED_MPS = 8, 5.0
START_M = np.column_stack([np.linspace(-20, 22, COUNT), np.linspace(6, 17, COUNT) * (-1) ** np.arange(COUNT)])
HEADING_RAD = np.linspace(0.3, 2.3, COUNT)


def labels() -> Labels:
    """Eight cars that go on along their headings, on a road at z = 0."""
    way = np.column_stack([np.cos(HEADING_RAD), np.sin(HEADING_RAD)])
    centers = [START_M + way * SPEED_MPS * frame.time_ns / 1e9 for frame in FRAMES]
    total = COUNT * len(FRAMES)
    velocity = np.column_stack([SPEED_MPS * way, np.zeros(COUNT)])
    return Labels(
        center_m=np.column_stack([np.concatenate(centers), np.full(total, SIZE_M[2] / 2)]),
        size_lwh_m=np.tile(SIZE_M, (total, 1)),
        heading_rad=np.tile(HEADING_RAD, len(FRAMES)),
        frame=np.repeat([frame.index for frame in FRAMES], COUNT),
        object_id=np.tile([f"car {number}" for number in range(COUNT)], len(FRAMES)),
        class_name=np.full(total, "car"),
        type=np.ones(total),
        velocity_mps=np.tile(velocity, (len(FRAMES), 1)),
        num_points=np.full(total, -1),
        difficulty=np.zeros(total),
    )


TRUE = labels()


def sweep(step: int) -> Points:
    """Points on the road and all over the cars."""
    rng = np.random.default_rng(step)
    road = np.column_stack([rng.uniform(-40, 40, (8000, 2)), np.zeros(8000)])
    parts = [road]
    for box in TRUE[TRUE.frame == step].to_rows():
        inside = rng.uniform(-0.5, 0.5, (150, 3)) * SIZE_M
        cos, sin = np.cos(box[6]), np.sin(box[6])
        turned = np.column_stack(
            [inside[:, 0] * cos - inside[:, 1] * sin, inside[:, 0] * sin + inside[:, 1] * cos, inside[:, 2]]
        )
        parts.append(turned + box[:3])
    xyz = np.concatenate(parts)
    zeros = np.zeros(len(xyz))
    return Points(xyz, zeros, zeros, zeros, zeros)


SAMPLE = DriveSample(
    frames=FRAMES,
    world_from_ego=np.tile(np.eye(4), (len(FRAMES), 1, 1)),
    ground_z_m=0.0,
    cameras=(),
    runs=((0, 1, 2, 3),),
    sweep=sweep,
    picture=lambda step, name: None,
)


def lifted(share: float) -> Labels:
    return replace(TRUE, center_m=TRUE.center_m + [0, 0, share * SIZE_M[2]])


def headings(change: Callable[[np.ndarray], np.ndarray]) -> Labels:
    return replace(TRUE, heading_rad=change(TRUE.heading_rad))


def exchanged() -> Labels:
    """Two objects that exchange their ids in each frame, and so on."""
    number = (np.arange(len(TRUE)) + TRUE.frame) % COUNT
    return replace(TRUE, object_id=np.array([f"car {name}" for name in number]))


MISTAKES = {
    "bottom": (lifted(-0.5), "the middle of its bottom"),
    "top": (lifted(0.5), "the middle of its top"),
    "length and width": (headings(lambda rad: rad + np.pi / 2), "length and width are exchanged"),
    "clockwise": (headings(lambda rad: -rad), "headings turn the other way"),
    "degrees": (headings(np.rad2deg), "in degrees"),
    "half lengths": (replace(TRUE, size_lwh_m=TRUE.size_lwh_m / 2), "half lengths"),
    "backwards": (headings(lambda rad: rad + np.pi), "180 degrees off"),
    "feet": (
        replace(TRUE, center_m=TRUE.center_m / 0.3048, size_lwh_m=TRUE.size_lwh_m / 0.3048),
        "in feet",
    ),
    "mirrored": (
        replace(TRUE, center_m=TRUE.center_m * [1, -1, 1], heading_rad=-TRUE.heading_rad),
        "y to the right",
    ),
    "turned": (
        replace(
            TRUE,
            center_m=TRUE.center_m[:, [1, 0, 2]] * [-1, 1, 1],
            heading_rad=TRUE.heading_rad + np.pi / 2,
        ),
        "turn the labels by -90 degrees",
    ),
    "velocities": (replace(TRUE, velocity_mps=-TRUE.velocity_mps), "velocities contradict"),
    "ids": (exchanged(), "ids change between objects"),
    "frames": (replace(TRUE, frame=TRUE.frame + 100), "frames that the drive does not have"),
    "millimetre": (replace(TRUE, size_lwh_m=TRUE.size_lwh_m / 100), "no size of an object"),
}


def bad(found: Labels) -> list[Finding]:
    return [each for each in check_labels(found, SAMPLE, CONFIG) if each.level in ("fault", "warning")]


def test_right_labels_are_right() -> None:
    findings = list(check_labels(TRUE, SAMPLE, CONFIG))
    assert [finding.level for finding in findings] == ["ok"]
    assert "boxes hold 100% of the points" in findings[0].text


@pytest.mark.parametrize(("found", "text"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named(found: Labels, text: str) -> None:
    findings = bad(found)
    assert findings and text in findings[0].sentence


def test_few_objects_and_no_labels_say_nothing() -> None:
    few = TRUE[np.isin(TRUE.object_id, ["car 0", "car 1"])]
    assert [finding.level for finding in check_labels(few, SAMPLE, CONFIG)] == ["cannot tell"]
    assert not list(check_labels(TRUE[:0], SAMPLE, CONFIG))
