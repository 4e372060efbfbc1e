"""KITTI's raw drives keep the contract of all datasets."""

from __future__ import annotations

from pathlib import Path

import pytest

from datasets.contract import check_dataset, check_labels
from tiny_kitti import write_drive
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.labels import KittiLabels


@pytest.mark.parametrize("absent", ["nothing", "images", "calibration", "oxts"])
def test_the_contract_of_datasets(absent: str, tmp_path: Path) -> None:
    """Also without pictures, calibration or poses."""
    write_drive(tmp_path, **({} if absent == "nothing" else {absent: False}))
    check_dataset(Kitti(tmp_path))


def test_the_contract_of_labels(tmp_path: Path) -> None:
    drive = write_drive(tmp_path)
    check_labels(KittiLabels(tmp_path), Kitti(tmp_path).open(drive.segment))
