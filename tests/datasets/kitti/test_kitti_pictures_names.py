"""Pictures that cannot be found by their names are an error, not a drive without pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from tiny_kitti import write_drive
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.errors import BadInput


def test_pictures_of_other_names_are_an_error(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, frames=3)
    folder = drive.folder / "image_02" / "data"
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    dataset = Kitti(drive.root)
    assert not dataset.open(dataset.segments[0]).cameras
    (folder / "frame_1.x.png").write_bytes(b"")
    with pytest.raises(BadInput, match=r"1 file like frame_1\.x\.png in .*, none a picture with the number"):
        Kitti(drive.root).open(dataset.segments[0])
