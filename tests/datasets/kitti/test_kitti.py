"""KITTI drives: what a tiny true one gives, its gaps, and what is refused."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tiny_kitti import CAMERA_DELAY_NS, P_RECT, RED, TinyDrive, project, write_drive
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project as project_camera


@pytest.fixture
def tiny(tmp_path: Path) -> TinyDrive:
    return write_drive(tmp_path)


def remove_lines(path: Path, start: int) -> None:
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:start]))


def change_line(path: Path, number: int, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


def change_fields(path: Path, texts: dict[int, str]) -> None:
    words = path.read_text().split()
    path.write_text(" ".join(texts.get(number, word) for number, word in enumerate(words)))


# ---- what a whole drive gives


def test_frames_carry_file_numbers_and_true_times(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    assert drive.name == tiny.segment
    assert [frame.index for frame in drive.frames] == [0, 1, 2, 3]
    assert [frame.time_ns for frame in drive.frames] == tiny.time_ns.tolist()
    assert drive.skipped == {}
    assert drive.ground_z_m == -1.73


def test_points_are_where_they_were_at_the_frames_time(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    for frame, xyz in enumerate(tiny.xyz_ego_m):
        points = drive.points(frame)
        np.testing.assert_allclose(points.xyz_ego_m, xyz, atol=1e-5)
        assert set(np.unique(points.intensity).round(3)) == {np.float32(value) for value in (0.2, 0.4, 0.8)}
        assert not points.elongation.any() and not points.sensor.any()


def test_the_left_is_seen_before_the_frames_time_and_the_right_after(tiny: TinyDrive) -> None:
    points = Kitti(tiny.root).open(tiny.segment).points(0)
    left = points.xyz_ego_m[:, 1] > 0.1
    assert (points.time_offset_ns[left] < 0).all()
    assert (points.time_offset_ns[points.xyz_ego_m[:, 1] < -0.1] > 0).all()
    assert np.abs(points.time_offset_ns).max() < 0.06e9  # half a turn


def test_poses_are_the_true_ones_from_the_first_frame_on(tiny: TinyDrive) -> None:
    poses = Kitti(tiny.root).open(tiny.segment).world_from_ego
    assert poses is not None
    np.testing.assert_allclose(poses, tiny.world_from_ego, atol=1e-6)
    assert not poses[0, :3, 3].any()


def test_a_camera_projects_as_kittis_own_formula_does(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    assert [camera.name for camera in drive.cameras] == ["image_02"]
    for number in P_RECT:
        camera = drive.calibration.cameras[f"image_{number}"]
        uv_px, _, visible = project_camera(camera, tiny.xyz_ego_m[0])
        assert visible.sum() > 100
        expected = project(tiny.xyz_ego_m[0][visible], number)
        np.testing.assert_allclose(uv_px[visible], expected, atol=1e-6)


def test_the_car_lies_on_the_pixels_of_the_car(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    image, points = drive.image(2, "image_02"), drive.points(2)
    assert image is not None and image.time_ns == tiny.time_ns[2] + CAMERA_DELAY_NS
    uv_px, _, visible = project_camera(drive.cameras[0], points.xyz_ego_m[points.intensity > 0.7])
    assert visible.all()
    columns, rows = uv_px.round().astype(int).T
    assert (image.rgb[rows, columns] == RED).all()
    assert 0.02 < (image.rgb == RED).all(axis=2).mean() < 0.2


def test_the_files_are_those_that_can_be_read(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    names = {str(path.relative_to(tiny.root / "2011_09_26")) for path in drive.files}
    assert len(names) == 4 + 4 + 4 + 2 + 3  # sweeps, pictures, oxts, time stamps, calibration
    assert not [name for name in names if "tracklet" in name]  # labels make no shard old
    assert all(path.is_file() for path in drive.files)


# ---- gaps


def drop(*names: str) -> Callable[[Path], None]:
    """Removes files or folders of a drive."""

    def damage(folder: Path) -> None:
        for name in names:
            path = folder / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return damage


GAPS = {
    "a missing sweep": (drop("velodyne_points/data/0000000001.bin"), [0, 2, 3], {"no sweep": 1}),
    "no sweeps at the start": (
        drop("velodyne_points/data/0000000000.bin", "velodyne_points/data/0000000001.bin"),
        [2, 3],
        {"no sweep": 2},
    ),
    "a missing record": (drop("oxts/data/0000000002.txt"), [0, 1, 3], {"sweep without oxts record": 1}),
    "a missing picture": (drop("image_02/data/0000000000.png"), [0, 1, 2, 3], {"no image_02 picture": 1}),
    "too few time stamps": (
        lambda folder: remove_lines(folder / "velodyne_points/timestamps.txt", 3),
        [0, 1, 2],
        {"sweep without time stamp": 1},
    ),
    "a blank time stamp": (
        lambda folder: change_line(folder / "velodyne_points/timestamps.txt", 2, ""),
        [0, 2, 3],
        {"sweep without time stamp": 1},
    ),
    "too few time stamps of the camera": (
        lambda folder: remove_lines(folder / "image_02/timestamps.txt", 1),
        [0, 1, 2, 3],
        {"image_02 picture without time stamp": 3},
    ),
    "no time stamps of the camera": (
        drop("image_02/timestamps.txt"),
        [0, 1, 2, 3],
        {"image_02 pictures without timestamps.txt, taken at the times of the sweeps": 4},
    ),
    "no calibration of the cameras": (
        drop("../calib_cam_to_cam.txt"),
        [0, 1, 2, 3],
        {"image_02 picture without calibration": 4},
    ),
}


@pytest.mark.parametrize(("damage", "frames", "skipped"), GAPS.values(), ids=GAPS)
def test_gaps_are_skipped_and_counted(
    tiny: TinyDrive, damage: Callable[[Path], None], frames: list[int], skipped: dict[str, int]
) -> None:
    damage(tiny.folder)
    drive = Kitti(tiny.root).open(tiny.segment)
    assert [frame.index for frame in drive.frames] == frames
    assert drive.skipped == skipped
    assert drive.world_from_ego is not None and len(drive.world_from_ego) == len(frames)
    for frame in drive.frames:
        assert frame.time_ns == tiny.time_ns[frame.index]
        # 2 cm: with fewer time stamps the turn's time is known less well.
        xyz_ego_m = drive.points(frame.index).xyz_ego_m
        np.testing.assert_allclose(xyz_ego_m, tiny.xyz_ego_m[frame.index], atol=0.02)
    pictures = [drive.image(frame, camera.name) for frame in frames for camera in drive.cameras]
    assert all(
        (drive.folder / "image_02/data" / f"{i:010d}.png").is_file()
        for i in drive.pictures.get("image_02", {})
    )
    assert sum(picture is not None for picture in pictures) == len(drive.pictures.get("image_02", {}))


def test_a_drive_that_starts_late_keeps_the_coordinates_of_the_whole_one(tiny: TinyDrive) -> None:
    drop("velodyne_points/data/0000000000.bin")(tiny.folder)
    poses = Kitti(tiny.root).open(tiny.segment).world_from_ego
    assert poses is not None
    expected = tiny.world_from_ego[1:].copy()
    expected[:, :3, 3] -= expected[0, :3, 3]
    np.testing.assert_allclose(poses, expected, atol=1e-6)


@pytest.mark.parametrize("part", ["images", "calibration", "oxts", "tracklets"])
def test_a_drive_opens_without_a_part(tmp_path: Path, part: str) -> None:
    tiny = write_drive(tmp_path, **{part: False})  # type: ignore[arg-type]
    drive = Kitti(tmp_path).open(tiny.segment)
    assert len(drive.frames) == 4
    assert len(drive.points(0)) == len(tiny.xyz_ego_m[0])
    assert bool(drive.cameras) == (part not in ("images", "calibration"))
    assert (drive.world_from_ego is None) == (part in ("oxts", "calibration"))


def test_without_poses_the_sweep_is_as_it_was_seen_but_its_times_are_known(tmp_path: Path) -> None:
    tiny = write_drive(tmp_path, oxts=False)
    points = Kitti(tmp_path).open(tiny.segment).points(1)
    shift_m = np.abs(points.xyz_ego_m - tiny.xyz_ego_m[1])
    assert 0.1 < shift_m[:, 0].max() < 0.3  # half a turn at 5 m/s
    assert points.time_offset_ns.any()


def test_a_single_frame_opens(tmp_path: Path) -> None:
    tiny = write_drive(tmp_path, frames=1)
    drive = Kitti(tmp_path).open(tiny.segment)
    np.testing.assert_allclose(drive.points(0).xyz_ego_m, tiny.xyz_ego_m[0], atol=1e-5)
    assert not drive.points(0).time_offset_ns.any()


# ---- what is refused


def write_bin(values: object) -> Callable[[Path], None]:
    return lambda path: np.asarray(values, "<f4").tofile(path)


BAD_SWEEPS = {
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "cut off": (lambda path: path.write_bytes(path.read_bytes()[:-5]), "cut off"),
    "too far": (write_bin([[1, 2, 3, 0.5], [0, -2e4, 3, 0.5]]), "1 of 2 points are more than 10 km away"),
    "absurd": (write_bin([[3e38, 1, 1, 0.5]]), "1 of 1 points are more than 10 km away"),
    "gone meanwhile": (lambda path: path.unlink(), "cannot be read"),
    "its drive gone meanwhile": (lambda path: shutil.rmtree(path.parents[2]), "cannot be read"),
}


@pytest.mark.parametrize(("damage", "message"), BAD_SWEEPS.values(), ids=BAD_SWEEPS)
def test_a_damaged_sweep_is_refused_when_it_is_read(
    tiny: TinyDrive, damage: Callable[[Path], object], message: str
) -> None:
    path = tiny.folder / "velodyne_points/data/0000000001.bin"
    drive = Kitti(tiny.root).open(tiny.segment)
    damage(path)
    with pytest.raises(BadInput, match=message) as refusal:
        drive.points(1)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)
    assert not path.parent.exists() or len(drive.points(0)) > 0


BAD_PICTURES = {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-60]),
    "cut off in the header": lambda path: path.write_bytes(path.read_bytes()[:20]),
    "not a picture": lambda path: path.write_text("hello"),
    "empty": lambda path: path.write_bytes(b""),
    "another size": lambda path: Image.new("RGB", (30, 20)).save(path),
    "so large that Pillow warns": lambda path: Image.new("1", (11000, 11000)).save(path),
    "so large that Pillow gives up": lambda path: Image.new("1", (20000, 20000)).save(path),
    "its drive gone meanwhile": lambda path: shutil.rmtree(path.parents[2]),
    "gone meanwhile": lambda path: path.unlink(),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("damage", BAD_PICTURES.values(), ids=BAD_PICTURES)
def test_a_damaged_picture_is_refused_when_it_is_read(
    tiny: TinyDrive, damage: Callable[[Path], object]
) -> None:
    path = tiny.folder / "image_02/data/0000000001.png"
    drive = Kitti(tiny.root).open(tiny.segment)
    damage(path)
    with pytest.raises(BadInput) as refusal:
        drive.image(1, "image_02")
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


BAD_DRIVES = {
    "no time stamps": (drop("velodyne_points/timestamps.txt"), "timestamps.txt is missing"),
    "no sweep": (drop("velodyne_points/data"), r"no complete frame \(4 no sweep\)"),
    "no record fits": (
        lambda f: (
            (f / "oxts/data/0000000009.txt").write_text((f / "oxts/data/0000000000.txt").read_text())
            and drop(*(f"oxts/data/{i:010d}.txt" for i in range(4)))(f)
        ),
        "4 sweep without oxts record",
    ),
    "time is no time": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 3, "yesterday"),
        r"timestamps.txt, line 3 holds 'yesterday'; expected a time",
    ),
    "month 13": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 1, "2011-13-26 13:00:00.1"),
        "timestamps.txt, line 1",
    ),
    "time goes back": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 3, "2011-09-26 12:00:00.000000000"),
        "velodyne_points/timestamps.txt: frame 2 is not later than frame 1",
    ),
    "time stamps are not text": (
        lambda f: (f / "velodyne_points/timestamps.txt").write_bytes(b"\xff\xfe\x00"),
        "is not text",
    ),
    "oxts: too few fields": (
        lambda f: (f / "oxts/data/0000000001.txt").write_text("49.0 8.4 116.0 0 0"),
        r"0000000001.txt, line 1 holds '49.0 8.4 116.0 0 0', 5 fields; expected 30",
    ),
    "oxts: empty": (lambda f: (f / "oxts/data/0000000000.txt").write_text(""), "0000000000.txt, line 1"),
    "times a nanosecond apart": (
        lambda f: (f / "velodyne_points/timestamps.txt").write_text(
            "\n".join(f"2011-09-26 13:00:00.00000000{i}" for i in range(4))
        ),
        "timestamps.txt: frame 1 is only 1 ns later than frame 0",
    ),
    "times a year apart": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 3, "2012-09-26 13:00:00.2"),
        "velodyne_points/timestamps.txt, lines 1 and 3 are 8784 hours apart",
    ),
    "times of the camera a year apart": (
        lambda f: change_line(f / "image_02/timestamps.txt", 2, "2010-09-26 13:00:00.2"),
        "image_02/timestamps.txt, lines 2 and 4 are 8760 hours apart",
    ),
    "time is before all times": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 1, "1900-01-01 00:00:00"),
        "timestamps.txt, line 1 holds '1900-01-01 00:00:00'; expected a time since 1970",
    ),
    "time is a day": (
        lambda f: change_line(f / "velodyne_points/timestamps.txt", 2, "1900-01-01"),
        "timestamps.txt, line 2 holds '1900-01-01'; expected a time",
    ),
    "oxts: altitude without end": (
        lambda f: change_fields(f / "oxts/data/0000000002.txt", {2: "1e308"}),
        r"0000000002.txt, line 1: no road has an altitude of 1e\+308 m",
    ),
    "oxts: another planet": (
        lambda f: change_fields(f / "oxts/data/0000000002.txt", {2: "1e20"}),
        r"0000000002.txt, line 1: no road has an altitude of 1e\+20 m",
    ),
    "oxts: latitude without end": (
        lambda f: change_fields(f / "oxts/data/0000000002.txt", {0: "-1e308"}),
        r"0000000002.txt, line 1: latitude -1e\+308, longitude 8.43\d* are no place on Earth",
    ),
    "oxts: degrees": (
        lambda f: change_fields(f / "oxts/data/0000000002.txt", {5: "90"}),
        "0000000002.txt, line 1: roll, pitch and yaw are .*90.0], expected radians",
    ),
    "oxts: half the world away": (
        lambda f: change_fields(f / "oxts/data/0000000002.txt", {1: "-171"}),
        r"0000000002.txt, line 1 lies 131\d\d km from .*0000000000.txt, line 1",
    ),
    "oxts: NaN": (
        lambda f: (f / "oxts/data/0000000002.txt").write_text("nan " * 30),
        "0000000002.txt, line 1",
    ),
    "oxts: not on Earth": (
        lambda f: (f / "oxts/data/0000000002.txt").write_text("95 " * 30),
        "no place on Earth",
    ),
    "calibration: no number": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 1, "R: 1 0 zero 0 1 0 0 0 1"),
        r"calib_velo_to_cam.txt, line 1",
    ),
    "calibration: too few": (
        lambda f: change_line(f / "../calib_imu_to_velo.txt", 2, "T: 1 2"),
        r"calib_imu_to_velo.txt, line 2 holds '1 2', 2 fields; expected 3",
    ),
    "calibration: no rotation": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 1, "R: 1 0 0 0 2 0 0 0 1"),
        "line 1: R is not a rotation",
    ),
    "calibration: mirrored": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 1, "R: 1 0 0 0 1 0 0 0 -1"),
        "line 1: R is not a rotation",
    ),
    "calibration: no colon": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 4, "garbage"),
        "calib_cam_to_cam.txt, line 4 holds 'garbage'",
    ),
    "calibration: key missing": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 1, ""),
        "calib_velo_to_cam.txt has no line 'R'",
    ),
    "calibration: no pinhole": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 5, "P_rect_00: " + "0 " * 12),
        "line 5: P_rect_00 is not",
    ),
    "calibration: a rotation too large to multiply": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 1, "R: " + "1e308 " * 9),
        "line 1: R is not a rotation",
    ),
    "calibration: a sensor on another car": (
        lambda f: change_line(f / "../calib_velo_to_cam.txt", 2, "T: 0 1e308 0"),
        r"calib_velo_to_cam.txt, line 2: T moves by 1e\+308 m, expected at most 100 m",
    ),
    "calibration: no focal length": (
        lambda f: change_line(
            f / "../calib_cam_to_cam.txt", 5, "P_rect_00: 1e-308 0 1 1 0 1e-308 1 1 0 0 1 1"
        ),
        "line 5: P_rect_00 is not .* focal length of 1 to 1e.06 pixels",
    ),
    "calibration: numbers without end": (
        lambda f: change_line(
            f / "../calib_cam_to_cam.txt", 5, "P_rect_00: 1e308 0 1e308 1e308 0 1e308 1e308 1e308 0 0 1 1e308"
        ),
        "line 5: P_rect_00 is not",
    ),
    "calibration: rows that say the same": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 5, "P_rect_00: 7 7 1 1 7 7 1 1 0 0 1 1"),
        "line 5: P_rect_00 is not",
    ),
    "calibration: a camera on another car": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 5, "P_rect_00: 72 0 61 1e300 0 72 17 0 0 0 1 0"),
        "line 5: P_rect_00 moves by 1.39e.298 m",
    ),
    "calibration: pictures without end": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 3, "S_rect_00: 1e300 1e300"),
        "line 3: .* no size",
    ),
    "calibration: half a pixel": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 3, "S_rect_00: 10.5 7"),
        "line 3: .* no size",
    ),
    "another size of pictures": (
        lambda f: change_line(f / "../calib_cam_to_cam.txt", 9, "S_rect_02: 1242 375"),
        "0000000000.png is 124 x 37 pixels, but its calibration says 1242 x 375",
    ),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("damage", "message"), BAD_DRIVES.values(), ids=BAD_DRIVES)
def test_a_damaged_drive_is_refused_in_one_line(
    tiny: TinyDrive, damage: Callable[[Path], object], message: str
) -> None:
    damage(tiny.folder)
    with pytest.raises(BadInput, match=message) as refusal:
        Kitti(tiny.root).open(tiny.segment)
    assert "\n" not in str(refusal.value)


def test_a_root_that_cannot_be_searched_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read"):
        Kitti(tmp_path / ("x" * 5000))


def test_a_frame_or_a_camera_that_is_not_there_is_refused(tiny: TinyDrive) -> None:
    drive = Kitti(tiny.root).open(tiny.segment)
    with pytest.raises(BadInput, match="has no frame 7; it has 4 between 0 and 3"):
        drive.points(7)
    with pytest.raises(BadInput, match="has no camera 'image_03'; it has image_02"):
        drive.image(0, "image_03")


# ---- names and folders


def test_the_root_may_be_the_day_or_the_drive(tiny: TinyDrive) -> None:
    for root in (tiny.root, tiny.folder.parent, tiny.folder):
        kitti = Kitti(root)
        assert kitti.segments == (tiny.segment,)
        assert len(kitti.open(tiny.segment).cameras) == 1


def test_the_root_may_be_the_working_folder(tiny: TinyDrive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tiny.folder)
    assert Kitti(Path(".")).segments == (tiny.segment,)


def test_segments_are_sorted_and_other_folders_are_none(tmp_path: Path) -> None:
    for drive in (3, 1, 2):
        write_drive(tmp_path, frames=1, drive=drive)
    (tmp_path / "2011_09_26/notes").mkdir()
    names = [f"2011_09_26_drive_000{number}_sync" for number in (1, 2, 3)]
    assert list(Kitti(tmp_path).segments) == names


@pytest.mark.parametrize(
    "name", ["../../etc", "..", "", ".", "a/b", "2011_09_26_drive_0001_sync/", "\x00", "a\nb"]
)
def test_a_name_that_is_no_segment_is_refused(tiny: TinyDrive, name: str) -> None:
    with pytest.raises(BadInput, match=f"it has {tiny.segment}") as refusal:
        Kitti(tiny.root).open(name)
    assert "\n" not in str(refusal.value)


def test_a_misspelt_name_gets_the_nearest_ones(tmp_path: Path) -> None:
    for number in range(12):
        write_drive(tmp_path, frames=1, images=False, drive=number * 11)
    kitti = Kitti(tmp_path)
    with pytest.raises(BadInput, match="of its 12 segments the nearest are .*2011_09_26_drive_0121_sync"):
        kitti.open("2011_09_26_drive_121_sync")
    with pytest.raises(BadInput, match="of its 12 segments the first is 2011_09_26_drive_0000_sync"):
        kitti.open("xyz")


ROOTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: None, "no folder .*kitti"),
    "empty": (lambda path: path.mkdir(), "nothing in .*kitti"),
    "a file": (lambda path: path.write_text(""), ".*Not a directory"),
    "other names": (
        lambda path: write_files(path / "training/velodyne", "scan_1.bin", "scan_2.bin"),
        "2 files like scan_1.bin in .*training/velodyne",
    ),
}


def write_files(folder: Path, *names: str) -> None:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_bytes(b"")


@pytest.mark.parametrize(("make", "found"), ROOTS.values(), ids=ROOTS)
def test_a_root_without_drives_says_what_it_found_and_expected(
    tmp_path: Path, make: Callable[[Path], object], found: str
) -> None:
    make(tmp_path / "kitti")
    with pytest.raises(BadInput, match=f"has no drive of KITTI's: {found}.*; expected <root>/2011_09_26/"):
        Kitti(tmp_path / "kitti")


def test_two_drives_of_one_name_and_a_name_with_a_blank_are_refused(tiny: TinyDrive) -> None:
    (tiny.root / "copy" / tiny.segment / "velodyne_points").mkdir(parents=True)
    with pytest.raises(BadInput, match="have one name"):
        Kitti(tiny.root)
    os.rename(tiny.root / "copy" / tiny.segment, tiny.root / "copy/my drive")
    with pytest.raises(BadInput, match="rename it"):
        Kitti(tiny.root)


def test_a_linked_drive_keeps_the_name_of_the_link(tiny: TinyDrive, tmp_path: Path) -> None:
    other = tmp_path / "links/2011_09_26"
    other.mkdir(parents=True)
    (other / "my_drive").symlink_to(tiny.folder)
    drive = Kitti(tmp_path / "links").open("my_drive")
    assert drive.name == "my_drive" and len(drive.points(0)) > 0


# ---- the real drives


@pytest.mark.real
def test_the_real_drive_with_poses(shared: Path) -> None:
    kitti = Kitti(shared / "data/kitti_raw_b")
    assert kitti.segments == ("2011_09_26_drive_0001_sync",)
    drive = kitti.open(kitti.segments[0])
    assert [frame.index for frame in drive.frames] == list(range(60, 104))
    assert drive.skipped == {"no sweep": 60}
    assert len(drive.points(60)) == 122_381
    assert 0.102 < drive.turn_s < 0.105
    assert drive.world_from_ego is not None
    path_m = np.linalg.norm(np.diff(drive.world_from_ego[:, :3, 3], axis=0), axis=1)
    seconds = np.diff([frame.time_ns for frame in drive.frames]) / 1e9
    assert (path_m / seconds).min() > 4 and (path_m / seconds).max() < 11  # it brakes from 9.6 to 5 m/s
    image = drive.image(103, "image_02")
    assert image is not None and image.rgb.shape == (375, 1242, 3)


@pytest.mark.real
def test_the_real_drive_without_poses(shared: Path) -> None:
    kitti = Kitti(shared / "data/kitti_raw_a")
    drive = kitti.open(kitti.segments[0])
    assert len(drive.frames) == 32 and drive.skipped == {} and drive.world_from_ego is None
    assert np.isfinite(drive.points(31).xyz_ego_m).all()
    image = drive.image(31, "image_02")
    assert image is not None and image.rgb.shape == (375, 1242, 3)


def test_what_the_car_sees_of_itself_is_left_out(tmp_path: Path) -> None:
    tiny = write_drive(tmp_path)
    path = tiny.folder / "velodyne_points/data/0000000001.bin"
    before = np.fromfile(path, "<f4").reshape(-1, 4)
    roof = np.array([[-0.6, 1.2, -0.6, 0.1], [2.5, -0.4, -0.9, 0.1]], "<f4")
    np.vstack([roof, before]).tofile(path)
    assert len(Kitti(tmp_path).open(tiny.segment).points(1)) == len(before)
