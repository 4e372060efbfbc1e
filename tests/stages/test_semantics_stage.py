"""`semantics` on a drive past a wall: what one frame hides another shows, and windows join without a seam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_inputs import SEGMENT, MemoryDrive, MemoryInputs, amodal_row

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import OCCLUDED, SEEN
from upvl_cli.stages import semantics
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow
from upvl_cli.stages.rows import FlowRow, OdometryRow
from upvl_cli.types import Boxes

CONFIG = load(semantics.SemanticsConfig, Path(__file__).parents[2] / "stages" / "semantics.toml")
CONFIG = replace(CONFIG, classes=("wall, brick", "car", "tree"))
WALL, CAR, TREE = 0, 1, 2
FRAME_S, EGO_MPS, CAR_MPS = 0.1, 4.0, 6.0


class Words:
    """A model whose words are axes: brick, the second word of wall, has one of its own."""

    def embed_text(self, words: list[str]) -> np.ndarray:
        assert words == ["wall", "brick", "car", "tree"]
        return np.eye(4, COMPONENTS)


AXIS = {WALL: 1, CAR: 2, TREE: 3}


def codes(classes: list[int]) -> np.ndarray:
    found = np.zeros((len(classes), COMPONENTS), np.int8)
    found[np.arange(len(classes)), [AXIS[number] for number in classes]] = 100
    return found


def street(frames: int) -> MemoryInputs:
    """The ego passes a wall, of which it sees half in even frames and takes one part for a tree in every fifth.

    A car drives ahead; a camera sees its front half in even frames.
    """
    tables: dict[str, list[Any]] = {name: [] for name in ("odometry", "flow", "extract-vl", "nms")}
    sweeps: dict[int, np.ndarray] = {}
    for number in range(frames):
        pose = np.eye(4)
        pose[0, 3] = EGO_MPS * number * FRAME_S
        wall = np.column_stack([np.arange(0.5, 20, 1.0), np.full(20, 5.0), np.full(20, 1.0)]) - pose[:3, 3]
        car_m = np.array([8 + CAR_MPS * number * FRAME_S, 0.0, 0.8]) - pose[:3, 3]
        car = car_m + [[-1, 0, 0], [1, 0, 0], [0, 0.8, 0]]
        shown = [TREE if number % 5 == 0 and place == 3 else WALL for place in range(20)]
        state = np.full(23, OCCLUDED)
        state[[place for place in range(20) if place % 2 == number % 2]] = SEEN
        state[20:22] = SEEN if number % 2 == 0 else OCCLUDED
        flow = np.zeros((23, 3))
        flow[20:, 0] = CAR_MPS
        measured = (True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
        tables["odometry"].append(
            OdometryRow(SEGMENT, number, round(number * FRAME_S * 1e9), pose, *measured)
        )
        tables["flow"].append(FlowRow(SEGMENT, number, flow))
        feature = codes([*shown, CAR, CAR, CAR])[state == SEEN]
        tables["extract-vl"].append(ExtractVlRow(SEGMENT, number, state, np.zeros(23, np.int8), feature))
        box = Boxes.from_rows(np.array([[*car_m, 4, 1.5, 1.6, 0]]))  # its side lies 0.05 m outside of it
        tables["nms"].append(amodal_row(number, box, [3]))
        sweeps[number] = np.concatenate([wall, car])
    zeros = np.zeros(COMPONENTS)
    pca = PcaRow("all", 0, zeros, np.eye(COMPONENTS).ravel(), np.full(COMPONENTS, 0.01), 1.0)
    return MemoryInputs({**tables, "pca": [pca]}, MemoryDrive(sweeps), Words())


def test_every_point_has_the_class_of_its_place_or_its_track() -> None:
    inputs = street(10)
    rows = list(semantics.run(inputs, CONFIG))
    assert [row.frame for row in rows] == list(range(10))
    for row in rows:
        assert row.class_name.tolist() == ["wall", "car", "tree"]
        assert row.class_index.tolist() == [WALL] * 20 + [CAR] * 3
        assert row.num_frames.tolist() == [5] * 23
    # Of the five frames that see part 3 one takes it for a tree: .8 of wall against .2.
    margin = rows[0].margin
    np.testing.assert_allclose(margin[[2, 3, 20]], [1.0, 0.6, 1.0], atol=0.01)
    assert +inputs.counts == {"points with a class": 230}


def test_windows_serve_what_their_own_seconds_saw() -> None:
    """With windows of half a second each place is seen by two or three frames of a window."""
    rows = list(semantics.run(street(20), replace(CONFIG, window_s=0.5)))
    assert [row.frame for row in rows] == list(range(20))
    found = np.array([row.class_index for row in rows])
    assert (np.delete(found[:, :20], 3, axis=1) == WALL).all()
    assert (found[:, 20:] == CAR).all()
    assert max(row.num_frames.max() for row in rows) <= 3


def test_what_no_camera_ever_saw_has_no_class() -> None:
    inputs = street(4)
    hidden = [
        replace(row, state=np.full(23, OCCLUDED), feature=codes([])) for row in inputs.tables["extract-vl"]
    ]
    inputs.tables["extract-vl"] = hidden
    for row in semantics.run(inputs, CONFIG):
        assert (row.class_index == -1).all()
        assert not row.num_frames.any()
        assert not row.margin.any()


def test_no_frame_at_all() -> None:
    assert list(semantics.run(street(0), CONFIG)) == []


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ((), "has 0 entries, expected 1 to 127"),
        (("car, ", "tree"), "has an empty word in 'car, '"),
        (("car, van", "truck, van"), "names 'van' twice; keep each once"),
        (tuple(f"word {number}" for number in range(128)), "has 128 entries"),
    ],
)
def test_classes_that_make_no_sense_are_one_line(classes: tuple[str, ...], message: str) -> None:
    with pytest.raises(BadSetting, match=message) as caught:
        next(semantics.run(street(1), replace(CONFIG, classes=classes)))
    assert "\n" not in str(caught.value)


def test_a_basis_of_axes_gives_the_cosines_that_the_test_means() -> None:
    basis = Basis(np.zeros(COMPONENTS), np.eye(COMPONENTS), np.full(COMPONENTS, 0.01), 1.0)
    cosines = basis.cosines(codes([CAR]), np.eye(4, COMPONENTS))
    np.testing.assert_allclose(cosines, [[0, 0, 1, 0]])
