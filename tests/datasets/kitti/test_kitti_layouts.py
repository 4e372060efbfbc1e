"""KITTI's object, tracking and odometry sets and View-of-Delft: what a tiny true drive of each gives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datasets.contract import check_dataset, check_labels
from datasets.kitti.kitti_writers import (
    TILTED_FROM_EGO,
    TinySequence,
    calibration_text,
    write_kitti360,
    write_object,
    write_odometry,
    write_tracking,
)
from tiny_kitti import CAMERA_DELAY_NS, RED, project
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.drive import KittiDrive
from upvl_cli.datasets.kitti.labels import KittiLabels
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project as project_camera

ASSUMED = "frame times assumed (10 a second)"
LAYOUTS: dict[str, Callable[[Path], TinySequence]] = {
    "object": write_object,
    "delft": lambda root: write_object(root, delft=True, split="lidar/training", suffix=".jpg", digits=5),
    "tracking": write_tracking,
    "odometry": write_odometry,
    "kitti360": write_kitti360,
    "semantic": lambda root: write_odometry(root, poses_inside=True),
}


@pytest.fixture(params=LAYOUTS)
def layout(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def truth(layout: str, tmp_path: Path) -> TinySequence:
    return LAYOUTS[layout](tmp_path)


def open_only(truth: TinySequence) -> KittiDrive:
    kitti = Kitti(truth.root)
    assert kitti.segments == (truth.segment,)
    return kitti.open(truth.segment)


def test_the_contract_of_datasets(truth: TinySequence) -> None:
    check_dataset(Kitti(truth.root))


def test_frames_and_times(truth: TinySequence, layout: str) -> None:
    drive = open_only(truth)
    assert [frame.index for frame in drive.frames] == truth.numbers
    start_ns = drive.frames[0].time_ns
    assert (start_ns > 0) == (layout == "kitti360")
    assert [frame.time_ns - start_ns for frame in drive.frames] == [n * 100_000_000 for n in truth.numbers]
    assert drive.skipped == ({} if layout in ("odometry", "semantic", "kitti360") else {ASSUMED: 4})


def test_points_are_where_they_were_at_the_frames_time(truth: TinySequence) -> None:
    drive = open_only(truth)
    for number, xyz in zip(truth.numbers, truth.xyz_ego_m, strict=True):
        points = drive.points(number)
        np.testing.assert_allclose(points.xyz_ego_m, xyz, atol=1e-4)
        assert set(np.unique(points.intensity).round(3)) == {np.float32(value) for value in (0.2, 0.4, 0.8)}


def test_poses_are_the_true_ones(truth: TinySequence, layout: str) -> None:
    poses = open_only(truth).world_from_ego
    if layout == "object":
        assert poses is None
        return
    assert poses is not None
    if layout in ("odometry", "semantic"):  # the world's axes are those of the first ego, not of its camera
        np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-6)
    moved = np.linalg.inv(poses[:1]) @ poses
    np.testing.assert_allclose(
        moved, np.linalg.inv(truth.world_from_ego[:1]) @ truth.world_from_ego, atol=1e-6
    )


def test_the_car_lies_on_the_pixels_of_the_car(truth: TinySequence, layout: str) -> None:
    drive = open_only(truth)
    (camera,) = drive.cameras
    assert camera.name == {"tracking": "image_02", "kitti360": "image_00"}.get(layout, "image_2")
    number = truth.numbers[2]
    image, points = drive.image(number, camera.name), drive.points(number)
    delay_ns = CAMERA_DELAY_NS if layout == "kitti360" else 0
    assert image is not None and image.time_ns == drive.frames[2].time_ns + delay_ns
    assert image.rgb.shape == (37, 124, 3)
    if layout != "delft":  # whose camera looks another way than the picture was drawn
        uv_px, _, visible = project_camera(camera, points.xyz_ego_m[points.intensity > 0.7])
        assert visible.all()
        columns, rows = uv_px.round().astype(int).T
        assert (image.rgb[rows, columns] == RED).all()
        seen = project_camera(camera, points.xyz_ego_m)
        expected = project(points.xyz_ego_m[seen[2]])
        np.testing.assert_allclose(seen[0][seen[2]], expected, atol=1e-3)


def test_the_road_is_below(truth: TinySequence, layout: str) -> None:
    drive = open_only(truth)
    assert drive.ground_z_m == pytest.approx(-1.73, abs=0.01)
    assert drive.vehicle.has_outline == (layout != "delft")


def test_labels_are_the_true_ones(truth: TinySequence, layout: str) -> None:
    drive, source = open_only(truth), KittiLabels(truth.root)
    if layout in ("odometry", "semantic", "kitti360"):
        for read in (source.labels, source.frames):
            with pytest.raises(BadInput, match="reads no boxes"):
                read(truth.segment)
        return
    check_labels(source, drive)
    labels = source.labels(truth.segment)
    assert labels.frame.tolist() == truth.numbers == source.frames(truth.segment).tolist()
    np.testing.assert_allclose(labels.to_rows(), truth.car, atol=1e-4)
    assert labels.num_points.min() > 300 and set(labels.type.tolist()) == {1}
    if layout == "tracking":
        assert set(labels.object_id) == {"7"} and set(labels.class_name) == {"Van"}
        np.testing.assert_allclose(labels.velocity_mps, np.tile([8.0, 0, 0], (4, 1)), atol=1e-3)
    else:
        assert len(set(labels.object_id)) == 4 and np.isnan(labels.velocity_mps).all()


def test_files_are_all_that_make_the_drive(truth: TinySequence, layout: str) -> None:
    files = open_only(truth).files
    kinds = sorted({path.suffix for path in files})
    expected = {"object": 12, "delft": 16, "tracking": 10, "odometry": 11, "semantic": 11, "kitti360": 14}
    assert len(files) == expected[layout], kinds
    assert not [path for path in files if "label" in str(path)]


# ---- which frames make a drive of an object set


def test_frames_with_another_calibration_are_another_drive(tmp_path: Path) -> None:
    truth = write_object(tmp_path, range(6))
    for number in (1, 4):
        text = calibration_text(np.diag([1, 1, 1, 1]) @ TILTED_FROM_EGO)
        (truth.folder / f"calib/{number:06d}.txt").write_text(text)
    kitti = Kitti(tmp_path)
    assert kitti.segments == ("training-000000", "training-000001")
    assert [[frame.index for frame in kitti.open(name).frames] for name in kitti.segments] == [
        [0, 2, 3, 5],
        [1, 4],
    ]
    source = KittiLabels(tmp_path)
    assert source.labels("training-000001").frame.tolist() == [1, 4]


def move(path: Path, metres: float) -> None:
    parts = [json.loads(line) for line in path.read_text().splitlines()]
    for part in parts:
        for values in part.values():
            values[3] += metres
    path.write_text("\n".join(json.dumps(part) for part in parts))


def test_a_recording_of_delft_ends_where_the_car_would_have_to_jump_or_frames_are_missing(
    tmp_path: Path,
) -> None:
    truth = write_object(tmp_path, [0, 1, 2, 30, 31, 32], delft=True)
    move(truth.folder / "pose/000032.json", 50)
    kitti = Kitti(tmp_path)
    assert kitti.segments == ("training-000000", "training-000030", "training-000032")
    check_dataset(kitti)


def test_a_recording_of_delft_ends_at_another_calibration(tmp_path: Path) -> None:
    truth = write_object(tmp_path, range(4), delft=True)
    for number in (1, 2):
        path = truth.folder / f"calib/{number:06d}.txt"
        path.write_text(path.read_text().replace("P2: 72.0", "P2: 73.0"))
    assert Kitti(tmp_path).segments == ("training-000000", "training-000001", "training-000003")


def test_a_frame_of_delft_without_pose_is_counted(tmp_path: Path) -> None:
    truth = write_object(tmp_path, delft=True)
    (truth.folder / "pose/000001.json").unlink()
    drive = open_only(truth)
    assert [frame.index for frame in drive.frames] == [0, 2, 3]
    assert drive.skipped == {"sweep without pose": 1, ASSUMED: 3}


def test_the_radar_beside_the_lidar_is_no_drive(tmp_path: Path) -> None:
    write_object(tmp_path, split="lidar/training", delft=True)
    for name in ("radar", "radar_3_scans", "radar_5_scans"):
        write_object(tmp_path, split=f"{name}/training", delft=True)
    assert Kitti(tmp_path).segments == ("training",)


KINDS = {
    **dict.fromkeys(("Car", "truck", "vehicle_other", "motor", "moped_scooter"), 1),
    **{"Pedestrian": 2, "Cyclist": 4},
    **dict.fromkeys(
        ("rider", "bicycle", "bicycle_rack", "human_depiction", "ride_other", "ride_uncertain"), 0
    ),
}


def test_the_classes_of_delft_become_waymos_numbers(tmp_path: Path) -> None:
    truth = write_object(tmp_path, [0], delft=True)
    path = truth.folder / "label_2/000000.txt"
    line = path.read_text().partition(" ")[2]
    path.write_text("".join(f"{kind} {line}" for kind in KINDS))
    labels = KittiLabels(tmp_path).labels(truth.segment)
    assert dict(zip(labels.class_name.tolist(), labels.type.tolist(), strict=True)) == KINDS


# ---- what is missing


def test_a_missing_sweep_of_a_tracking_sequence_is_counted(tmp_path: Path) -> None:
    truth = write_tracking(tmp_path, range(6))
    for number in (2, 3):
        (truth.folder / f"{number:06d}.bin").unlink()
    drive = open_only(truth)
    assert [frame.index for frame in drive.frames] == [0, 1, 4, 5]
    assert drive.skipped == {"no sweep": 2, ASSUMED: 4}
    assert KittiLabels(tmp_path).labels(truth.segment).frame.tolist() == [0, 1, 4, 5]
    np.testing.assert_allclose(drive.points(4).xyz_ego_m, truth.xyz_ego_m[4], atol=1e-3)


def test_a_frame_of_kitti360_without_pose_is_counted(tmp_path: Path) -> None:
    truth = write_kitti360(tmp_path)
    (path,) = tmp_path.rglob("poses.txt")
    path.write_text("".join(path.read_text().splitlines(keepends=True)[1:]))
    drive = open_only(truth)
    assert [frame.index for frame in drive.frames] == [1, 2, 3]
    assert drive.skipped == {"sweep without pose": 1}


def test_sequences_of_all_kinds_lie_side_by_side(tmp_path: Path) -> None:
    write_tracking(tmp_path / "tracking", sequence="0000")
    write_tracking(tmp_path / "tracking", sequence="0001")
    write_object(tmp_path / "object")
    write_odometry(tmp_path)
    assert Kitti(tmp_path).segments == ("00", "training", "training-0000", "training-0001")


@pytest.mark.parametrize("layout", ["object", "tracking", "odometry"], indirect=True)
def test_without_pictures_calibration_and_poses(truth: TinySequence, layout: str) -> None:
    for name in ("calib", "oxts", "image_2", "image_02"):
        for path in [*truth.root.rglob(f"{name}/**/*.*"), *truth.root.rglob(f"{name}.txt")]:
            path.unlink()
    drive = open_only(truth)
    assert not drive.cameras and drive.world_from_ego is None and len(drive.frames) == 4
    if layout != "odometry":
        with pytest.raises(BadInput, match="in camera axes; put its calibration"):
            KittiLabels(truth.root).labels(truth.segment)


def test_without_pictures_the_labelled_region_is_about_the_picture(tmp_path: Path) -> None:
    truth = write_object(tmp_path)
    for path in (truth.folder / "image_2").iterdir():
        path.unlink()
    covered = KittiLabels(tmp_path).covers(truth.segment, np.array([[20.0, 0, 0], [20, 19, 0], [-5, 0, 0]]))
    assert covered.tolist() == [True, False, False]


def test_without_times_an_odometry_sequence_has_ten_frames_a_second(tmp_path: Path) -> None:
    truth = write_odometry(tmp_path)
    (truth.folder / "times.txt").unlink()
    drive = open_only(truth)
    assert drive.skipped == {ASSUMED: 4} and drive.frames[3].time_ns == 300_000_000


def test_a_sequence_of_the_tests_has_no_poses(tmp_path: Path) -> None:
    truth = write_odometry(tmp_path)
    (tmp_path / "dataset/poses/00.txt").unlink()
    assert open_only(truth).world_from_ego is None


def change(name: str, old: str, new: str) -> Callable[[TinySequence], None]:
    def damage(truth: TinySequence) -> None:
        (path,) = truth.root.rglob(name)
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))

    return damage


BAD = {
    "calibration without numbers": ("odometry", change("calib.txt", "Tr: ", "Tr: x "), "line 5 holds"),
    "calibration without projection": ("odometry", change("calib.txt", "P2: 72.0", "P2: 0"), "P2 is not"),
    "calibration in another unit": (
        "odometry",
        change("calib.txt", "Tr: ", "Tr: 7 "),
        "13 fields; expected 12",
    ),
    "poses: too few numbers": (
        "odometry",
        change("poses/00.txt", " 0.0 ", " "),
        "poses/00.txt, line 1 holds",
    ),
    "poses: no rotation": ("odometry", change("poses/00.txt", "1.0", "2.0"), "line 1 is not a rotation"),
    "times: not ascending": ("odometry", change("times.txt", "1.000000e-01", "3.0"), "times.txt: frame 2"),
    "times: no number": ("odometry", change("times.txt", "1.000000e-01", "noon"), "times.txt, line 2 holds"),
    "times: before all": ("odometry", change("times.txt", "1.000000e-01", "-1"), "expected seconds such as"),
    "oxts: no number": ("tracking", change("oxts/0000.txt", "116.0", "high"), "oxts/0000.txt, line 1 holds"),
    "pose: no JSON": ("delft", change("00001.json", "{", ""), "00001.json is no JSON"),
    "pose: too few": ("delft", change("00001.json", "[", "[7, "), "no odomToCamera of 16 numbers"),
    "pose: text": ("delft", change("00001.json", "[", '["a", '), "no odomToCamera of 16 numbers"),
    "pose: another": ("delft", change("00001.json", "odomTo", "To"), "no odomToCamera of 16 numbers"),
    "pose: no frame": ("kitti360", change("poses.txt", "0 ", "0.5 "), "begins with 0.5, expected the number"),
    "pose: too many": ("kitti360", change("poses.txt", "0 ", "0 7 "), "14 fields; expected 13"),
    "mount: too few": ("kitti360", change("calib_cam_to_velo.txt", " ", ""), "11 fields; expected 12"),
    "pose: no rotation": ("delft", change("00001.json", "[", "[5"), "odomToCamera is not a rotation"),
}


@pytest.mark.parametrize(("layout", "damage", "message"), BAD.values(), ids=BAD, indirect=["layout"])
def test_damaged_files_are_refused(
    truth: TinySequence, damage: Callable[[TinySequence], None], message: str
) -> None:
    damage(truth)
    with pytest.raises(BadInput, match=message) as refusal:
        Kitti(truth.root).open(truth.segment)
    assert "\n" not in str(refusal.value)


BAD_LABELS = {
    "too few": (f"0 1 Car{' 1' * 13}", "13 fields; expected 14"),
    "no frame": (f"x 1 Car{' 1' * 14}", "line 1 holds"),
    "half a frame": (f"0.5 1 Car{' 1' * 14}", "begins with 0.5 1"),
    "frame without end": (f"1e300 1 Car{' 1' * 14}", "begins with 1e300 1"),
    "only a class": ("0 1 Car", "expected frame, track, class and 14 numbers"),
    "twice": (f"0 1 Car{' 1' * 14}\n0 1 Van{' 1' * 14}", "track 1 has two boxes in frame 0"),
    "missing": (None, r"no labels: nothing in .*label_02; expected"),
}


@pytest.mark.parametrize(("text", "message"), BAD_LABELS.values(), ids=BAD_LABELS)
def test_damaged_sequence_labels_are_refused(tmp_path: Path, text: str | None, message: str) -> None:
    truth = write_tracking(tmp_path)
    path = tmp_path / "training/label_02/0000.txt"
    if text is None:
        path.unlink()
    else:
        path.write_text(text)
    with pytest.raises(BadInput, match=message):
        KittiLabels(tmp_path).labels(truth.segment)


# ---- real


@pytest.mark.real
def test_the_real_frame_of_delft(shared: Path) -> None:
    root = shared / "data/vod_real"
    drive = Kitti(root).open("training")
    check_dataset(Kitti(root))
    assert [frame.index for frame in drive.frames] == [1047] and drive.is_view_of_delft
    assert drive.world_from_ego is not None
    assert (
        drive.world_from_ego[0, 2, 2] > 0.9999
    )  # upright, 1.65 m above the road, which the sweep shows within 0.1 m
    assert drive.world_from_ego[0, 2, 3] == pytest.approx(-drive.ground_z_m, abs=0.1)
    points = drive.points(1047)
    assert len(points) == 189_088 and 0.9 < points.intensity.max() <= 1
    image = drive.image(1047, "image_2")
    assert image is not None and image.rgb.shape == (1216, 1936, 3)
    source = KittiLabels(root)
    labels = source.labels("training")
    assert len(labels) == 24 and source.covers("training", labels.center_m).all()
    near = np.hypot(*labels.center_m[:, :2].T) < 25
    assert labels.num_points[near].min() >= 40  # boxes stand on their points
