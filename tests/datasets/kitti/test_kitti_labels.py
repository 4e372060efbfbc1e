"""Human boxes of KITTI against a tiny true drive, damaged files, and the real ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datasets.kitti.kitti_writers import object_line
from tiny_kitti import (
    CAR_LWH_M,
    VELO_TO_CAM_R,
    VELO_TO_CAM_T,
    TinyDrive,
    project,
    write_drive,
    write_tracklets,
)
from upvl_cli.datasets.kitti.labels import KittiLabels
from upvl_cli.errors import BadInput


@pytest.fixture
def tiny(tmp_path: Path) -> TinyDrive:
    return write_drive(tmp_path)


def replace_in(path: Path, old: str, new: str) -> None:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))


# ---- tracklets


def test_the_car_is_where_it_is_and_as_fast_as_it_is(tiny: TinyDrive) -> None:
    labels = KittiLabels(tiny.root).labels(tiny.segment)
    assert labels.frame.tolist() == [0, 1, 2, 3]
    assert labels.object_id.tolist() == ["0"] * 4 and labels.class_name.tolist() == ["Car"] * 4
    assert labels.type.tolist() == [1] * 4 and labels.difficulty.tolist() == [0] * 4
    np.testing.assert_allclose(labels.to_rows(), tiny.car.to_rows(), atol=1e-6)
    np.testing.assert_allclose(labels.velocity_mps, np.tile(tiny.car_velocity_mps, (4, 1)), atol=1e-6)
    assert labels.num_points.tolist() == tiny.car_points.tolist()


KINDS = {
    **{kind: 1 for kind in ("Car", "Van", "Truck", "Tram", "Bus")},
    **{kind: 2 for kind in ("Pedestrian", "Person (sitting)")},
    **{"Cyclist": 4, "Misc": 0, "Spaceship": 0},
}


@pytest.mark.parametrize(("kind", "number"), KINDS.items())
def test_kinds_become_waymos_numbers(tiny: TinyDrive, kind: str, number: int) -> None:
    write_tracklets(tiny.folder / "tracklet_labels.xml", tiny.car.center_m, kind)
    labels = KittiLabels(tiny.root).labels(tiny.segment)
    assert set(labels.class_name) == {kind} and set(labels.type.tolist()) == {number}


def test_only_frames_that_the_drive_has_are_labelled(tiny: TinyDrive) -> None:
    (tiny.folder / "velodyne_points/data/0000000001.bin").unlink()
    write_tracklets(tiny.folder / "tracklet_labels.xml", np.tile(tiny.car.center_m, (2, 1)))
    source = KittiLabels(tiny.root)
    labels = source.labels(tiny.segment)
    assert labels.frame.tolist() == [0, 2, 3] == source.frames(tiny.segment).tolist()


def test_speed_uses_true_times_across_a_gap(tiny: TinyDrive) -> None:
    (tiny.folder / "velodyne_points/data/0000000001.bin").unlink()
    labels = KittiLabels(tiny.root).labels(tiny.segment)
    np.testing.assert_allclose(labels.velocity_mps, np.tile(tiny.car_velocity_mps, (3, 1)), atol=0.02)


def test_two_objects_do_not_share_a_track(tiny: TinyDrive) -> None:
    path = tiny.folder / "tracklet_labels.xml"
    item = path.read_text().split("<item_version>1</item_version>\n")[1].split("\n</tracklets>")[0]
    other = item.replace("<first_frame>0", "<first_frame>2").replace("Car", "Van")
    replace_in(path, "\n</tracklets>", f"\n{other}\n</tracklets>")
    labels = KittiLabels(tiny.root).labels(tiny.segment)
    assert labels.frame.tolist() == [0, 1, 2, 2, 3, 3]
    assert labels.object_id.tolist() == ["0", "0", "0", "1", "0", "1"]
    np.testing.assert_allclose(labels.velocity_mps[labels.object_id == "0", 0], 8.0, atol=1e-6)
    # The other one repeats the car's way from its first frame on, two frames late.
    assert np.isfinite(labels.velocity_mps).all()


def test_without_a_second_frame_or_poses_the_speed_is_unknown(tmp_path: Path) -> None:
    for number, parts in enumerate(({"frames": 1}, {"oxts": False}, {"calibration": False})):
        tiny = write_drive(tmp_path / str(number), **parts)  # type: ignore[arg-type]
        labels = KittiLabels(tiny.root).labels(tiny.segment)
        assert len(labels) == len(tiny.time_ns) and np.isnan(labels.velocity_mps).all()


HEADINGS = {"-3.2": 2 * np.pi - 3.2, "3.2": 3.2 - 2 * np.pi, "0.25": 0.25, "9.5": 9.5 - 4 * np.pi + 2 * np.pi}


@pytest.mark.parametrize(("text", "heading"), HEADINGS.items())
def test_headings_are_wrapped(tiny: TinyDrive, text: str, heading: float) -> None:
    replace_in(tiny.folder / "tracklet_labels.xml", "<rz>0</rz>", f"<rz>{text}</rz>")
    found = KittiLabels(tiny.root).labels(tiny.segment).heading_rad[0]
    assert found == pytest.approx((heading + np.pi) % (2 * np.pi) - np.pi)
    assert -np.pi <= found < np.pi


def test_a_drive_may_have_no_object(tiny: TinyDrive) -> None:
    (tiny.folder / "tracklet_labels.xml").write_text("<x><tracklets><count>0</count></tracklets></x>")
    source = KittiLabels(tiny.root)
    labels = source.labels(tiny.segment)
    assert len(labels) == 0 and labels.size_lwh_m.shape == (0, 3)
    assert source.frames(tiny.segment).tolist() == [0, 1, 2, 3]  # seen, and nothing was there


BOMB = (
    """<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><x>&b;</x>"""
)
FILE = """<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><x>&a;</x>"""

BAD_TRACKLETS = {
    "entities": (lambda path: path.write_text(BOMB), "declares XML entities"),
    "entities of a file": (lambda path: path.write_text(FILE), "declares XML entities"),
    "entities in UTF-16": (lambda path: path.write_bytes(BOMB.encode("utf-16")), "declares XML entities"),
    "cut off": (lambda path: path.write_text(path.read_text()[:-100]), "is not whole XML"),
    "empty": (lambda path: path.write_text(""), "is not whole XML"),
    "a size of 0": (
        lambda path: replace_in(path, "<w>1.8", "<w>0"),
        "tracklet 0: 'Car' of 4.0 x 0.0 x 1.5 m",
    ),
    "a size of NaN": (
        lambda path: replace_in(path, "<w>1.8", "<w>nan"),
        r"tracklet 0 \(h, w, l, first_frame\)",
    ),
    "no kind": (lambda path: replace_in(path, "<objectType>Car", "<objectType>"), "tracklet 0: ''"),
    "half a frame": (lambda path: replace_in(path, "frame>0", "frame>0.5"), "first_frame is 0.5"),
    "a frame before the first": (lambda path: replace_in(path, "frame>0", "frame>-1"), "first_frame is -1"),
    "a frame without end": (lambda path: replace_in(path, "frame>0", "frame>1e300"), "first_frame is 1e"),
    "a place without end": (
        lambda path: replace_in(path, "<ty>2.5", "<ty>1e300"),
        r"tracklet 0: 1e\+300 m is too far, expected at most 10000 m",
    ),
    "a size without end": (lambda path: replace_in(path, "<w>1.8", "<w>1e300"), "tracklet 0: 1e.300 m is"),
    "a place missing": (
        lambda path: replace_in(path, "<ty>2.5</ty>", ""),
        r"tracklet 0, pose 0 \(tx, ty, tz, rz\)",
    ),
    "a place that is code": (
        lambda path: replace_in(path, "<ty>2.5", "<ty>__import__('os')"),
        "tracklet 0, pose 0",
    ),
    "huge": (lambda path: path.open("ab").truncate(40 * 2**20), "has 41943040 bytes, expected at most"),
}


@pytest.mark.parametrize(("damage", "message"), BAD_TRACKLETS.values(), ids=BAD_TRACKLETS)
def test_a_damaged_tracklet_file_is_refused_in_one_line(
    tiny: TinyDrive, damage: Callable[[Path], object], message: str
) -> None:
    path = tiny.folder / "tracklet_labels.xml"
    damage(path)
    with pytest.raises(BadInput, match=message) as refusal:
        KittiLabels(tiny.root).labels(tiny.segment)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def test_an_outside_document_type_is_not_fetched(tiny: TinyDrive) -> None:
    path = tiny.folder / "tracklet_labels.xml"
    replace_in(
        path, "<!DOCTYPE boost_serialization>", '<!DOCTYPE boost_serialization SYSTEM "file:///no/such.dtd">'
    )
    assert len(KittiLabels(tiny.root).labels(tiny.segment)) == 4


def test_a_drive_without_labels_says_what_it_expected(tmp_path: Path) -> None:
    tiny = write_drive(tmp_path, tracklets=False)
    with pytest.raises(
        BadInput, match=r"has no labels; expected tracklet_labels.xml or object_label_2/\*.txt"
    ):
        KittiLabels(tmp_path).labels(tiny.segment)
    with pytest.raises(BadInput, match="has no labels"):
        KittiLabels(tmp_path).frames(tiny.segment)


# ---- object labels of single frames


@pytest.fixture
def objects(tmp_path: Path) -> TinyDrive:
    """A drive with object labels of frames 1 and 3 (and of 9, which has no sweep); nothing in 3."""
    tiny = write_drive(tmp_path, tracklets=False, oxts=False)
    folder = tiny.folder / "object_label_2"
    folder.mkdir()
    turned = np.r_[20.0, -3.0, -0.8, CAR_LWH_M, 2.0]
    lines = [object_line("Car", tiny.car.to_rows()[1]), object_line("Pedestrian", turned)]
    (folder / "0000000001.txt").write_text(lines[0] + f"DontCare{' -1' * 14}\n" + lines[1])
    (folder / "0000000003.txt").write_text("")
    (folder / "0000000009.txt").write_text(lines[0])
    return tiny


def test_object_labels_come_to_ego_axes(objects: TinyDrive) -> None:
    labels = KittiLabels(objects.root).labels(objects.segment)
    assert labels.frame.tolist() == [1, 1]
    assert labels.class_name.tolist() == ["Car", "Pedestrian"] and labels.type.tolist() == [1, 2]
    assert len(set(labels.object_id)) == 2
    expected = [objects.car.to_rows()[1], [20.0, -3.0, -0.8, *CAR_LWH_M, 2.0]]
    np.testing.assert_allclose(labels.to_rows(), expected, atol=1e-5)
    assert np.isnan(labels.velocity_mps).all()
    assert labels.num_points[0] > 0.9 * objects.car_points[1]  # this drive has no poses to untwist its sweeps


def test_only_labelled_frames_count(objects: TinyDrive) -> None:
    assert KittiLabels(objects.root).frames(objects.segment).tolist() == [1, 3]


BAD_OBJECTS = {
    "too few": ("Car 1 2 3\n", r"0000000001.txt, line 1 holds '1 2 3', 3 fields; expected 14"),
    "NaN": (f"\nCar {'nan ' * 14}\n", "0000000001.txt, line 2"),
    "a size of 0": (f"Car {'0 ' * 14}\n", "must be above 0"),
    "a place without end": (
        f"Car {'1 ' * 10} 1e300 1 1 1\n",
        r"line 1: size, place and angle .* within 10000 m",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD_OBJECTS.values(), ids=BAD_OBJECTS)
def test_damaged_object_labels_are_refused(objects: TinyDrive, text: str, message: str) -> None:
    (objects.folder / "object_label_2/0000000001.txt").write_text(text)
    with pytest.raises(BadInput, match=message):
        KittiLabels(objects.root).labels(objects.segment)


def test_object_labels_need_the_calibration(objects: TinyDrive) -> None:
    (objects.folder.parent / "calib_velo_to_cam.txt").unlink()
    with pytest.raises(BadInput, match="put calib_cam_to_cam.txt and calib_velo_to_cam.txt beside the drive"):
        KittiLabels(objects.root).labels(objects.segment)


# ---- the labelled region


def test_the_front_view_is_what_the_left_colour_camera_sees(tiny: TinyDrive) -> None:
    source = KittiLabels(tiny.root)
    xyz = tiny.xyz_ego_m[0]
    u, v = project(xyz).T
    ahead = (xyz @ VELO_TO_CAM_R.T + VELO_TO_CAM_T)[:, 2] > 0.1
    expected = ahead & (u >= -0.5) & (u < 123.5) & (v >= -0.5) & (v < 36.5)
    found = source.covers(tiny.segment, xyz)
    assert (found == expected).all() and 0 < found.sum() < len(xyz)
    assert source.covers(tiny.segment, np.array([[500.0, 0, 0], [-10, 0, 0], [0, 0, 0]])).tolist() == [
        True,
        False,
        False,
    ]
    assert source.covers(tiny.segment, np.empty((0, 3))).shape == (0,)


def test_the_front_view_needs_the_calibration_but_no_pictures(tmp_path: Path) -> None:
    tiny = write_drive(tmp_path / "a", images=False)
    assert KittiLabels(tiny.root).covers(tiny.segment, tiny.car.center_m).all()
    tiny = write_drive(tmp_path / "b", calibration=False)
    with pytest.raises(BadInput, match="has no calibration of image_02"):
        KittiLabels(tiny.root).covers(tiny.segment, tiny.car.center_m)


# ---- the real drives


@pytest.mark.real
def test_the_real_tracklets(shared: Path) -> None:
    source = KittiLabels(shared / "data/kitti_raw_b")
    labels = source.labels("2011_09_26_drive_0001_sync")
    speed_mps = np.linalg.norm(labels.velocity_mps[:, :2], axis=1)
    assert len(labels) == 200 and np.isfinite(speed_mps).all()
    medians = {
        object_id: np.median(speed_mps[labels.object_id == object_id]) for object_id in set(labels.object_id)
    }
    moving = {object_id for object_id, median in medians.items() if median > 1.0}
    assert moving == {"3", "10", "11"}  # the tram and two cyclists
    assert speed_mps[~np.isin(labels.object_id, list(moving))].max() < 0.6  # four parked cars
    assert labels.num_points[labels.object_id == "10"].min() >= 50
    tram = labels[labels.object_id == "3"]
    assert source.covers("2011_09_26_drive_0001_sync", tram.center_m).all()


@pytest.mark.real
def test_the_real_object_labels_stand_on_the_points(shared: Path) -> None:
    source = KittiLabels(shared / "data/kitti_raw_a")
    segment = "2011_09_26_drive_0052_sync"
    labels = source.labels(segment)
    assert source.frames(segment).tolist() == [7, 14, 21, 31]
    assert len(labels) == 31 and labels.num_points.min() > 50
    assert (np.abs(labels.heading_rad) < 0.1).all()  # a queue that looks the way the ego does
    floor_m = labels.center_m[:, 2] - labels.size_lwh_m[:, 2] / 2
    assert (np.abs(floor_m + 1.65) < 0.4).all()
