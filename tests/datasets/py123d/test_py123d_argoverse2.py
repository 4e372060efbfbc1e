"""A log of Argoverse 2 as the library converts it, against the adapter of upvl that reads the log itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.feather
import pytest

pytest.importorskip("py123d.api", reason="needs the extra py123d")
pytest.importorskip("geopandas", reason="the library's converter needs it")

from py123d.api.scene.arrow.arrow_log_writer import ArrowLogWriter
from py123d.api.scene.arrow.utils.log_writer_config import LogWriterConfig
from py123d.common.runtime import DatasetPaths, dataset_paths
from py123d.datatypes import LogMetadata
from py123d.parser.av2.av2_sensor_parser import Av2SensorLogParser
from scipy.spatial.transform import Rotation

from datasets.argoverse2.av2_log import (
    ATTITUDE,
    FIRST_NS,
    LOG,
    PERIOD_NS,
    Log,
    position_city_m,
    write_feather,
    write_log,
    wxyz,
    xyz,
)
from datasets.contract import check_dataset, check_labels
from upvl_cli.datasets.argoverse2.dataset import Argoverse2
from upvl_cli.datasets.argoverse2.labels import ArgoverseLabels
from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.datasets.py123d.labels import Py123dLabels
from upvl_cli.types import Camera

# The library's converter uses what pandas will drop.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def complete(log: Log) -> None:
    """Add what the library's converter needs: the mount of the second LiDAR, and a pose at each sweep and picture."""
    path = log.folder / "calibration/egovehicle_SE3_sensor.feather"
    mounts = pyarrow.feather.read_table(path).to_pydict()
    write_feather(
        path,
        {name: [*cells, cells[-1]] for name, cells in mounts.items()}
        | {"sensor_name": [*mounts["sensor_name"], "down_lidar"]},
    )
    times = np.arange(FIRST_NS - 20_000_000, FIRST_NS + 3 * PERIOD_NS, 1_000_000)
    turned = wxyz(Rotation.concatenate([ATTITUDE] * len(times)))
    write_feather(
        log.folder / "city_SE3_egovehicle.feather",
        {"timestamp_ns": times, **turned, **xyz(position_city_m(times))},
    )


@pytest.fixture
def roots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """The data set, and the folder of the library's log of it, which refers to its sweeps and pictures."""
    source, converted = tmp_path / "av2", tmp_path / "py123d"
    written = write_log(source / "sensor")
    complete(written)
    monkeypatch.setattr(dataset_paths, "_global_dataset_paths", DatasetPaths(av2_data_root=source))
    parser = Av2SensorLogParser(written.folder, "av2-sensor_val", "nearest")
    writer = ArrowLogWriter(LogWriterConfig(), converted / "logs", converted / "sensors")
    assert writer.reset(LogMetadata("av2-sensor", "av2-sensor_val", LOG, "pit"))
    for step in parser.iter_modalities_sync():
        writer.write_sync(step)
    writer.close()
    return source / "sensor", converted


def test_both_ways_give_the_same_drive(roots: tuple[Path, Path]) -> None:
    check_dataset(Py123dLogs(roots[1]))
    own, library = Argoverse2(roots[0]).open(LOG), Py123dLogs(roots[1]).open(LOG)
    assert len(own.frames) == len(library.frames) == 3
    for own_frame, frame in zip(own.frames, library.frames, strict=True):
        assert abs(own_frame.time_ns - frame.time_ns) < 1000
        ours, theirs = own.points(own_frame.index), library.points(frame.index)
        np.testing.assert_array_equal(ours.xyz_ego_m, theirs.xyz_ego_m)
        np.testing.assert_array_equal(ours.intensity, theirs.intensity)
        assert np.abs(ours.time_offset_ns - theirs.time_offset_ns).max() <= 1000
    assert own.world_from_ego is not None and library.world_from_ego is not None
    np.testing.assert_allclose(library.world_from_ego, own.world_from_ego, rtol=0, atol=1e-6)


def test_both_ways_give_the_same_camera(roots: tuple[Path, Path]) -> None:
    own, library = Argoverse2(roots[0]).open(LOG), Py123dLogs(roots[1]).open(LOG)
    (ours,) = [camera for camera in own.cameras if camera.name == "ring_side_left"]
    (theirs,) = [camera for camera in library.cameras if camera.name == "pcam_l1"]
    for name in ("intrinsic", "distortion", "ego_from_camera"):
        np.testing.assert_allclose(
            getattr(theirs, name), getattr(ours, name), rtol=0, atol=1e-9, err_msg=name
        )
    for own_frame, frame in zip(own.frames, library.frames, strict=True):
        np.testing.assert_array_equal(rgb(library, frame.index, theirs), rgb(own, own_frame.index, ours))


def rgb(drive: Any, frame: int, camera: Camera) -> np.ndarray:
    image = drive.image(frame, camera.name)
    assert image is not None
    return np.asarray(image.rgb)


def test_both_ways_give_the_same_labels(roots: tuple[Path, Path]) -> None:
    own, library = Argoverse2(roots[0]), Py123dLogs(roots[1])
    source = Py123dLabels(roots[1], library)
    check_labels(source, library.open(LOG))
    ours, theirs = ArgoverseLabels(own).labels(LOG), source.labels(LOG)
    ours, theirs = (
        labels[np.lexsort((labels.object_id, np.unique(labels.frame, return_inverse=True)[1]))]
        for labels in (ours, theirs)
    )
    assert ours.object_id.tolist() == theirs.object_id.tolist()
    assert (
        ours.class_name.tolist() == theirs.class_name.tolist() and ours.type.tolist() == theirs.type.tolist()
    )
    np.testing.assert_allclose(theirs.center_m, ours.center_m, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.cos(theirs.heading_rad - ours.heading_rad), 1, atol=1e-9)
    np.testing.assert_allclose(theirs.size_lwh_m, ours.size_lwh_m)
