"""Every format on the frames, poses and cameras of real drives, with boxes all around the car."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.test_round_trip import WITH_BOXES, in_order
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.export.drive import ExportDrive
from upvl_cli.export.format import TRACK, ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import wrap_angle

DRIVES = {"kitti_raw_b": "kitti", "lyft": "parquet"}


@pytest.fixture(scope="module", params=DRIVES)
def drive(request: pytest.FixtureRequest, shared: Path) -> ExportDrive:
    """A real drive whose boxes are known: those of the test's bend, in its first frames."""
    family = dataset_family(DRIVES[request.param])
    dataset = family.open(shared / "data" / request.param, None)
    source = dataset.open(dataset.segments[0])
    given = source.world_from_ego  # the car of the Lyft drive stands, and its file has no poses
    boxes = labelled_drive(frames=12, first_index=0).boxes
    numbers = np.array([frame.index for frame in source.frames])
    return ExportDrive(
        source.name,
        source.frames,
        np.tile(np.eye(4), (len(source.frames), 1, 1)) if given is None else given,
        source.cameras,
        replace(boxes, frame=numbers[boxes.frame // 2]),
        source,
    )


@pytest.mark.real
@pytest.mark.parametrize("name", WITH_BOXES)
def test_boxes_of_a_real_drive_come_back_equal(name: str, drive: ExportDrive, tmp_path: Path) -> None:
    fmt = export_format(name)
    export([drive], fmt, tmp_path / "to", ExportOptions(), Counter())
    (found,) = read_back(fmt, tmp_path / "to", {drive.name: drive}).values()
    before, after = in_order(drive.boxes), in_order(found)
    np.testing.assert_allclose(after.center_m, before.center_m, atol=1e-3)
    turn = np.rad2deg(wrap_angle(after.heading_rad - before.heading_rad))
    np.testing.assert_allclose(turn, 0.0, atol=0.01)
    if TRACK in fmt.carries:
        assert after.track_id.tolist() == before.track_id.tolist()
