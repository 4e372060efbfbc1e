"""The stage `flow` with each of its methods, on a drive of three frames in memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_flow_pairs import CONFIG, INDEX, TIME_S, TinyDrive, TinyInputs, car_x_m, pose

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.flow.stored_config import StoredFlowConfig
from upvl_cli.stages import flow


def car_mps(step: int, other: int) -> np.ndarray:
    """Velocity of the moving car from a frame to another one, in the ego axes of the first."""
    mps = (car_x_m(TIME_S[other]) - car_x_m(TIME_S[step])) / (TIME_S[other] - TIME_S[step])
    return np.asarray(pose(TIME_S[step])[:3, :3].T @ (mps, 0, 0))


def with_file(root: Path, **changes: Any) -> flow.FlowConfig:
    values = {"root": str(root), "unit": "m/s", "ego_motion": "removed", "missing": "error"} | changes
    return replace(CONFIG, method="file", file=StoredFlowConfig(**values))


def write(root: Path, step: int, flow_of_points: np.ndarray) -> Path:
    path = root / "tiny" / f"{INDEX[step]:06d}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, flow_of_points.astype(np.float32))
    return path


def test_nsfp_plus_plus_moves_the_car_alone() -> None:
    rows = list(flow.run(TinyInputs(TinyDrive()), replace(CONFIG, method="nsfp++")))
    for row, step, other in zip(rows, (0, 1, 2), (1, 2, 1), strict=True):
        np.testing.assert_allclose(row.flow_mps[:450].mean(axis=0), car_mps(step, other), atol=0.6)
        assert np.abs(row.flow_mps[450:]).max() == 0


def test_nsfp_gives_a_flow_to_all_above_the_ground() -> None:
    small = replace(CONFIG.nsfp, max_points=64, optimizer=replace(CONFIG.nsfp.optimizer, max_iterations=3))
    rows = list(flow.run(TinyInputs(TinyDrive()), replace(CONFIG, method="nsfp", nsfp=small)))
    assert all(np.abs(row.flow_mps[:900]).min() > 0 for row in rows)
    assert all(np.abs(row.flow_mps[900:]).max() == 0 for row in rows)


@pytest.mark.parametrize("unit", ["m/s", "m/interval"])
@pytest.mark.parametrize("ego_motion", ["removed", "included"])
def test_flow_from_files(tmp_path: Path, unit: str, ego_motion: str) -> None:
    """Any flow comes back but that of the ground; the last frame's leads back in time."""
    drive = TinyDrive()
    for step, other in ((0, 1), (1, 2), (2, 1)):
        xyz, dt_s = drive.points(INDEX[step]).xyz_ego_m.astype(float), TIME_S[other] - TIME_S[step]
        stored = np.zeros(xyz.shape)
        stored[:450] = car_mps(step, other) * dt_s
        stored[900:] = (0, 0, 5 * dt_s)
        if ego_motion == "included":
            world = apply(pose(TIME_S[step]), xyz + stored)
            stored = apply(inverse(pose(TIME_S[other])), world) - xyz
        write(tmp_path, step, stored if unit == "m/interval" else stored / dt_s)
    rows = list(flow.run(TinyInputs(drive), with_file(tmp_path, unit=unit, ego_motion=ego_motion)))
    for row, step, other in zip(rows, (0, 1, 2), (1, 2, 1), strict=True):
        np.testing.assert_allclose(row.flow_mps[:450], np.tile(car_mps(step, other), (450, 1)), atol=0.01)
        np.testing.assert_allclose(row.flow_mps[450:900], 0, atol=0.01)
        assert np.abs(row.flow_mps[900:]).max() == 0


def test_a_frame_without_a_file(tmp_path: Path) -> None:
    drive = TinyDrive()
    for step in (0, 1):
        write(tmp_path, step, np.ones((len(drive.points(INDEX[step])), 3)))
    with pytest.raises(BadInput, match=r"000007\.npy cannot be read: No such file or directory"):
        list(flow.run(TinyInputs(drive), with_file(tmp_path)))
    inputs = TinyInputs(drive)
    rows = list(flow.run(inputs, with_file(tmp_path, missing="zero")))
    assert inputs.counts["frames without a file of flow"] == 1
    assert np.abs(rows[2].flow_mps).max() == 0


def test_a_sweep_all_alone_has_none(tmp_path: Path) -> None:
    drive = TinyDrive(count=1)
    write(tmp_path, 0, np.ones((len(drive.points(INDEX[0])), 3)))
    (row,) = flow.run(TinyInputs(drive), with_file(tmp_path))
    assert np.abs(row.flow_mps).max() == 0


def test_files_need_a_folder() -> None:
    with pytest.raises(
        BadSetting, match=r'method = "file" needs the folder of the flow; set root in \[file\]'
    ):
        list(flow.run(TinyInputs(TinyDrive()), replace(CONFIG, method="file")))


def test_a_stamp_has_the_values_of_the_method_alone(tmp_path: Path) -> None:
    for method, table in (("rigid", "rigid"), ("nsfp++", "nsfp_pp"), ("nsfp", "nsfp"), ("file", "file")):
        values = replace(CONFIG, method=method).values()  # type: ignore[arg-type]
        assert set(values) & {"rigid", "nsfp_pp", "nsfp", "file"} == {table}
        assert values["method"] == method


def test_only_the_method_file_has_files(tmp_path: Path) -> None:
    path = write(tmp_path, 0, np.zeros((1, 3)))
    config = with_file(tmp_path)
    assert config.files("tiny") == (path,)
    assert replace(config, method="rigid").files("tiny") == ()
