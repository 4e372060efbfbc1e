"""Flow from files as velocity over the ground, and what a file may not hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.perception.flow.stored import check_speed, check_stored_flow, velocity_over_ground
from upvl_cli.perception.flow.stored_config import StoredFlowConfig
from upvl_cli.runtime.array_files import frame_file, frame_files, read_array

XYZ_M = np.array([[10.0, 0, 0], [0, 5, 1]])
VELOCITY_MPS = np.array([[3.0, -1, 0], [0, 0, 0]])
EGO_FROM_OTHER = from_yaw(0.1, np.array([1.5, 0.2, 0.0]))


def config(**changes: Any) -> StoredFlowConfig:
    return StoredFlowConfig(
        **{"root": "", "unit": "m/s", "ego_motion": "removed", "missing": "error"} | changes
    )


@pytest.mark.parametrize("dt_s", [0.1, 0.2, -0.1])
def test_each_unit_with_and_without_ego_motion(dt_s: float) -> None:
    moved_m = XYZ_M + VELOCITY_MPS * dt_s
    seen_there_m = apply(inverse(EGO_FROM_OTHER), moved_m) - XYZ_M
    for flow, settings in (
        (VELOCITY_MPS, config()),
        (VELOCITY_MPS * dt_s, config(unit="m/interval")),
        (seen_there_m / dt_s, config(ego_motion="included")),
        (seen_there_m, config(unit="m/interval", ego_motion="included")),
    ):
        found = velocity_over_ground(flow, XYZ_M, EGO_FROM_OTHER, dt_s, settings)
        np.testing.assert_allclose(found, VELOCITY_MPS, atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int32])
def test_numbers_of_any_type_are_taken(dtype: type) -> None:
    assert check_stored_flow(np.ones((2, 3), dtype), 2, "f").dtype == np.float64


@pytest.mark.parametrize(
    ("flow", "message"),
    [
        (
            np.zeros((3, 3)),
            r"f has shape \(3, 3\) of float64, expected \(2, 3\) numbers: one flow for each point",
        ),
        (np.zeros((2, 2)), r"shape \(2, 2\)"),
        (np.zeros(6), r"shape \(6,\)"),
        (np.zeros((2, 3), complex), "of complex128"),
        (
            np.array([[0.0, 0, 0], [0, np.nan, 0]]),
            "f: the flow of 1 points is not finite, the first is point 1",
        ),
        (np.array([[np.inf, 0, 0], [0, 0, 0]]), "the first is point 0"),
    ],
    ids=["rows", "columns", "flat", "complex", "nan", "inf"],
)
def test_another_array_is_refused(flow: np.ndarray, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        check_stored_flow(flow, 2, "f")


def test_a_unit_that_cannot_be_is_refused() -> None:
    check_speed(np.full((2, 3), 80.0), "f")
    with pytest.raises(
        BadInput, match=r"f has a point at 2000 m/s, expected at most 1000; see unit and ego_motion"
    ):
        check_speed(np.full((2, 3), -2000.0), "f")


def test_a_file_is_read_from_its_place(tmp_path: Path) -> None:
    path = frame_file(tmp_path, "drive", 7)
    assert path == tmp_path / "drive" / "000007.npy"
    path.parent.mkdir()
    np.save(path, XYZ_M)
    (tmp_path / "drive" / "notes.txt").write_text("no flow")
    assert frame_files(tmp_path, "drive") == (path,)
    assert frame_files(tmp_path, "other") == ()
    np.testing.assert_array_equal(read_array(tmp_path, path), XYZ_M)


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "000000.npy"
    with pytest.raises(BadInput, match=r"000000\.npy cannot be read: No such file"):
        read_array(tmp_path, path)
    np.save(path, np.arange(100.0))
    good = path.read_bytes()
    np.save(path, np.array([{}]), allow_pickle=True)
    for content in (
        b"",
        b"text",
        good[:60],
        good[:-8],
        path.read_bytes(),
        good[:8] + b"\xff" * 40 + good[48:],
    ):
        path.write_bytes(content)
        with pytest.raises(BadInput, match=r"000000\.npy is not a \.npy file of numbers: ") as caught:
            read_array(tmp_path, path)
        assert "\n" not in str(caught.value)


def test_no_file_outside_the_folder_is_read(tmp_path: Path) -> None:
    root, outside = tmp_path / "root", tmp_path / "outside.npy"
    root.mkdir()
    np.save(outside, XYZ_M)
    (root / "000000.npy").symlink_to(outside)
    for path in (root / "000000.npy", root / ".." / "outside.npy"):
        with pytest.raises(BadInput, match="leads out of"):
            read_array(root, path)
