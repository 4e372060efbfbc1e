"""Whatever is wrong with the files of a log: one clear line, or all of it is read."""

from __future__ import annotations

import shutil
import struct
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("py123d.api", reason="needs the extra py123d")

from datasets.contract import read_everything
from datasets.damages import apply_damage, file_damages
from datasets.py123d.py123d_log import LOG_FOLDER, boxes, ego_points, ego_state, photo, sweep, write_log
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.py123d.dataset import Py123dLogs

FILES = [
    f"{LOG_FOLDER}/{name}.arrow"
    for name in ("sync", "lidar.lidar_merged", "camera.pcam_f0", "ego_state_se3", "box_detections_se3")
]


@pytest.fixture(scope="module", params=["ipc", "ipc_zstd", "laz", "draco"])
def whole(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("whole"), codec=request.param)


def read(root: Path) -> str | None:
    return read_everything(lambda: Py123dLogs(root), lambda dataset: label_source("py123d", root, dataset))


def test_the_whole_log_is_read(whole: Path) -> None:
    assert read(whole) is None


@pytest.mark.parametrize("name", FILES)
def test_a_file_with_fewer_rows_than_it_says(name: str, tmp_path: Path) -> None:
    """The library maps files into memory, and reads on behind the end of one."""
    count = 9  # a number that nothing else in the files has
    steps = [[ego_state(step), sweep(step), photo(step), boxes(step)] for step in range(count)]
    root = write_log(tmp_path, steps)
    path = root / name
    path.write_bytes(path.read_bytes().replace(struct.pack("<q", count), struct.pack("<q", 2**40)))
    assert f"{path} cannot be read by py123d" in str(read(root))


def test_a_sweep_with_fewer_points_than_it_says(tmp_path: Path) -> None:
    """The library ends the process on it."""
    # Without features of a byte each, whose buffers are as long as there are points.
    root = write_log(tmp_path, [[sweep(0, ids=None, intensity=None)]], codec="ipc")
    path = root / LOG_FOLDER / "lidar.lidar_merged.arrow"
    old, new = (struct.pack("<q", count) for count in (len(ego_points()), 2**30))
    path.write_bytes(path.read_bytes().replace(old, new))
    reason = str(read(root))
    assert "lidar.lidar_merged.arrow, iteration 0 cannot be read by py123d (ArrowInvalid: " in reason
    assert "too small" in reason


@settings(max_examples=50, deadline=None)
@given(st.lists(file_damages(FILES), min_size=1, max_size=2))
def test_damaged_files(whole: Path, damages: list[tuple[Any, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(whole, Path(folder) / "data"))
        for damage in damages:
            apply_damage(root, damage)
        read(root)
