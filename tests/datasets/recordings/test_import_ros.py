"""MCAP files and rosbag2 folders become drives, by a topic map that is proposed."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rosbags")
pytest.importorskip("mcap")

from datasets.contract import check_dataset
from datasets.recordings.ros_bags import (
    BASE_FROM_CAMERA,
    BASE_FROM_LIDAR,
    CAMERA_DELAY_NS,
    LIDAR_TURN_S,
    camera_info,
    cloud,
    transform,
    write_bag,
    write_bag1,
)
from datasets.recordings.street import FIRST_NS, INTRINSIC, STEP_NS, rows, times_ns, world_from_lidar
from upvl_cli.commands.import_drive import ImportRequest, ImportSummary, ScanOptions, import_drive
from upvl_cli.datasets.parquet.dataset import ParquetDrives
from upvl_cli.datasets.recordings import ros_messages
from upvl_cli.datasets.recordings.ros_frames import FrameTree
from upvl_cli.errors import BadInput, BadSetting, UpvlError

MAP = """
lidars = ["/points"]
ego_frame = "base_link"
world_frame = "odom"
[[cameras]]
name = "front"
image = "/front/image/compressed"
info = "/front/camera_info"
"""


def run(source: Path, folder: Path, text: str = MAP, **options: object) -> ImportSummary:
    folder.mkdir(exist_ok=True)
    topics = folder / "topics.toml"
    topics.write_text(text)
    return import_drive(ImportRequest(source, folder, "drive", topics=topics, **options), lambda *_: None)


def world_from_base(frame: float) -> np.ndarray:
    return world_from_lidar(frame) @ np.linalg.inv(BASE_FROM_LIDAR)


@pytest.mark.parametrize("kind", ["mcap folder", "mcap file", "db3 folder", "db3 file"])
def test_a_recording_becomes_a_drive(tmp_path: Path, kind: str) -> None:
    bag = write_bag(tmp_path / "bag", storage=kind.split()[0])
    source = next(bag.glob(f"*.{kind.split()[0]}")) if kind.endswith("file") else bag
    summary = run(source, tmp_path / "drives")
    assert (summary.counts.frames, summary.counts.points, summary.counts.pictures) == (4, 1600, 4)
    assert not summary.counts.skipped
    dataset = ParquetDrives(tmp_path / "drives")
    check_dataset(dataset)
    drive = dataset.open("drive")
    assert [frame.time_ns for frame in drive.frames] == times_ns(4)
    for k in range(4):
        np.testing.assert_allclose(drive.world_from_ego[k], world_from_base(k), atol=0.01)
        points = drive.points(k)
        np.testing.assert_allclose(points.xyz_ego_m, rows(k)[:, :3] + BASE_FROM_LIDAR[:3, 3], atol=1e-5)
        np.testing.assert_allclose(points.intensity, rows(k)[:, 3] / 255, atol=1e-6)
        image = drive.image(k, "front")
        assert image.time_ns == times_ns(4)[k] + CAMERA_DELAY_NS
        assert (image.rgb == 10 * k).all()
    camera = drive.cameras[0]
    np.testing.assert_array_equal(camera.intrinsic, INTRINSIC)
    np.testing.assert_allclose(camera.distortion, [0.1, 0.02, 0, 0, 0])
    np.testing.assert_allclose(camera.ego_from_camera, BASE_FROM_CAMERA, atol=1e-9)


def test_a_map_is_proposed_and_works_as_it_is(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    request = ImportRequest(bag, tmp_path / "drives")
    with pytest.raises(BadSetting, match=r"one was proposed in .*bag\.topics\.toml"):
        import_drive(request, lambda *_: None)
    proposed = tmp_path / "drives" / "bag.topics.toml"
    text = proposed.read_text()
    assert "# /odom  nav_msgs/msg/Odometry  5" in text
    summary = run(bag, tmp_path / "drives", text)
    assert summary.notes[:2] == ("LiDAR 0: /points", "poses from TF: odom to base_link")
    assert summary.counts.pictures == 4
    proposed.write_text("mine")
    with pytest.raises(BadSetting, match="one was proposed"):
        import_drive(request, lambda *_: None)
    assert proposed.read_text() == "mine"


def test_frames_along_a_chain() -> None:
    """The map holds odom, which holds the car, on which a mast holds the LiDAR: each turned and moved."""
    tree = FrameTree()
    edges = [("map", "odom"), ("odom", "base_link"), ("base_link", "mast"), ("mast", "lidar")]
    steps = [world_from_lidar(number) for number in (3, 7, 11, 20)]
    for place, ((parent, child), step) in enumerate(zip(edges, steps, strict=True)):
        messages = [
            transform(FIRST_NS, parent, child, step),
            transform(FIRST_NS + STEP_NS, parent, child, step),
        ]
        tree.add(messages, 0, is_fixed=place > 1)
    first, second, third, fourth = steps
    truth = first @ second @ third @ fourth
    np.testing.assert_allclose(tree.transform("map", "lidar", FIRST_NS), truth, atol=1e-9)
    np.testing.assert_allclose(tree.transform("lidar", "map", FIRST_NS), np.linalg.inv(truth), atol=1e-9)
    np.testing.assert_allclose(tree.mount("base_link", "lidar", "it"), third @ fourth, atol=1e-9)
    assert tree.transform("map", "lidar", FIRST_NS + 10 * STEP_NS) is None
    assert tree.transform("map", "elsewhere", FIRST_NS) is None
    assert (tree.ego_frame, tree.world_frame("base_link")) == ("base_link", "odom")


def test_frames_in_a_circle_end() -> None:
    tree = FrameTree()
    tree.add([transform(0, "a", "b", np.eye(4)), transform(0, "b", "a", np.eye(4))], 0, is_fixed=True)
    np.testing.assert_allclose(tree.transform("a", "b", 0), np.eye(4))
    assert tree.world_frame("a") == ""


def test_poses_from_an_odometry_topic(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    run(bag, tmp_path / "drives", 'lidars = ["/points"]\nego_frame = "lidar"\nodometry = "/odom"\n')
    drive = ParquetDrives(tmp_path / "drives").open("drive")
    np.testing.assert_allclose(drive.world_from_ego[1], world_from_lidar(1), atol=0.01)
    np.testing.assert_allclose(drive.points(1).xyz_ego_m, rows(1)[:, :3], rtol=1e-6)


def test_without_poses_and_without_tf(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    given = ", ".join(str(number) for number in BASE_FROM_LIDAR.ravel())
    run(bag, tmp_path / "drives", f'lidars = ["/points"]\nego_frame = "car"\nego_from_lidars = [{given}]\n')
    drive = ParquetDrives(tmp_path / "drives").open("drive")
    assert drive.world_from_ego is None
    np.testing.assert_allclose(drive.points(1).xyz_ego_m, rows(1)[:, :3] + BASE_FROM_LIDAR[:3, 3], atol=1e-5)


@pytest.mark.parametrize("is_big", [False, True])
def test_times_of_points_are_kept(tmp_path: Path, is_big: bool) -> None:
    bag = write_bag(tmp_path / "bag", timed=True, big_endian=is_big)
    summary = run(bag, tmp_path / "drives")
    assert (
        "PointCloud2 with x, y, z, reflectivity, t: intensity 0 to 255, times of points in nanoseconds"
        in summary.notes
    )
    drive = ParquetDrives(tmp_path / "drives").open("drive")
    assert not drive.table.is_compensated
    offset_ns = drive.points(2).time_offset_ns
    np.testing.assert_allclose(offset_ns, np.linspace(0, LIDAR_TURN_S * 1e9, 400), atol=1)
    moved_m = np.abs(drive.points(2).xyz_ego_m - rows(2)[:, :3] - BASE_FROM_LIDAR[:3, 3]).max(axis=1)
    assert moved_m[0] < 1e-4
    assert 0.5 < moved_m[-1] < 2  # 0.8 m on, and a turn
    again = run(bag, tmp_path / "drives", is_compensated=True)
    assert not again.was_there
    assert ParquetDrives(tmp_path / "drives").open("drive").table.is_compensated


def test_two_lidars_become_one_sweep(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", second=True)
    text = 'lidars = ["/points", "/points_2"]\nego_frame = "base_link"\nworld_frame = "odom"\n'
    summary = run(bag, tmp_path / "drives", text)
    assert summary.counts.points == 4 * 500
    drive = ParquetDrives(tmp_path / "drives").open("drive")
    assert np.bincount(drive.points(3).sensor).tolist() == [400, 100]


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_raw_pictures_are_compressed(tmp_path: Path, encoding: str) -> None:
    bag = write_bag(tmp_path / "bag", encoding=encoding)
    run(bag, tmp_path / "drives", MAP.replace("/compressed", ""))
    image = ParquetDrives(tmp_path / "drives").open("drive").image(2, "front")
    np.testing.assert_allclose(image.rgb[20, 20], (20, 0, 200), atol=6)


@pytest.mark.parametrize(("storage", "mode"), [("mcap", "MESSAGE"), ("db3", "MESSAGE"), ("db3", "FILE")])
def test_packed_recordings(tmp_path: Path, storage: str, mode: str) -> None:
    bag = write_bag(tmp_path / "bag", storage=storage, compression=mode)
    assert run(bag, tmp_path / "drives").counts.points == 1600


def test_a_recording_of_ros_1(tmp_path: Path) -> None:
    bag = write_bag1(tmp_path / "old.bag")
    summary = run(bag, tmp_path / "drives", 'lidars = ["/points"]\nodometry = "/pose"\n')
    assert summary.counts.points == 1600
    drive = ParquetDrives(tmp_path / "drives").open("drive")
    np.testing.assert_allclose(drive.points(1).xyz_ego_m, rows(1)[:, :3], rtol=1e-6)
    np.testing.assert_allclose(drive.world_from_ego[2], world_from_lidar(2), atol=0.01)


@pytest.mark.parametrize("package", ["mcap", "rosbags"])
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    bag = write_bag(tmp_path / "bag")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(BadSetting, match=rf"needs the package {package}; run: pip install 'upvl\[ros\]'"):
        run(bag, tmp_path / "drives")


@pytest.mark.parametrize("part", [0.999, 0.6])
def test_a_file_that_was_cut_off_gives_what_it_has(tmp_path: Path, part: float) -> None:
    """The recorder lost power: no index at the end, and half a chunk."""
    bag = write_bag(tmp_path / "bag", frames=40, storage="mcap")
    path = next(bag.glob("*.mcap"))
    content = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(len(content) * part)])
    try:
        summary = run(cut, tmp_path / "drives")
    except BadSetting as error:
        assert "has no topic" in str(error)  # noqa: PT017
        return
    assert 0 < summary.counts.frames <= 40


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('lidars = ["/velodyne"]', "no topic '/velodyne'; of type PointCloud2 it has /points"),
        ('lidars = ["/odom"]', "'/odom' is of type nav_msgs/msg/Odometry, expected PointCloud2"),
        ("lidars = []", "lidars names 0 topics"),
        ('lidar = ["/points"]', "unknown key 'lidar'; did you mean 'lidars'"),
        (
            'lidars = ["/points"]\nego_frame = "car"',
            "TF does not connect the frame 'lidar' of /points with 'car'",
        ),
        ('lidars = ["/points"]\ncameras = 3', r"must be tables \[\[cameras\]\]"),
        (
            'lidars = ["/points"]\nworld_frame = "map"\nego_frame = "base_link"',
            "world_frame 'map' is not in TF; it has base_link",
        ),
    ],
)
def test_a_map_that_does_not_fit_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    bag = write_bag(tmp_path / "bag")
    with pytest.raises(UpvlError, match=words):
        run(bag, tmp_path / "drives", text)
    assert not list((tmp_path / "drives").rglob("*.parquet"))


def test_options_of_folders_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    with pytest.raises(BadSetting, match="for folders of point files"):
        run(bag, tmp_path / "drives", scan=ScanOptions(rate_hz=10.0))


@pytest.mark.parametrize(
    ("model", "numbers", "is_fisheye"),
    [("plumb_bob", (0.1, 0.2, 0.3, 0.4, 0.5), False), ("rational_polynomial", (0.1, 0, 0, 0, 0, 0, 0, 0), False),
     ("equidistant", (0.1, 0.2, 0.3, 0.4), True), ("", (), False)],
)  # fmt: skip
def test_lenses(model: str, numbers: tuple[float, ...], is_fisheye: bool) -> None:
    found = ros_messages.camera(
        camera_info(0, model=model, numbers=numbers), "c", np.eye(4), is_rectified=False
    )
    assert (found.distortion_model == "fisheye") == is_fisheye
    np.testing.assert_array_equal(found.distortion[: min(len(numbers), 5)], numbers[:5])


def test_a_lens_that_cannot_be_expressed_is_refused() -> None:
    info = camera_info(0, model="rational_polynomial", numbers=(0.1, 0, 0, 0, 0, 0.3, 0, 0))
    with pytest.raises(BadInput, match="rectified = true"):
        ros_messages.camera(info, "c", np.eye(4), is_rectified=False)
    assert not ros_messages.camera(info, "c", np.eye(4), is_rectified=True).distortion.any()


def test_the_frame_of_a_camera_body_is_turned() -> None:
    body = np.eye(4)
    turned, was_turned = ros_messages.optical(body)
    assert was_turned
    np.testing.assert_array_equal(turned[:3, 2], (1, 0, 0))  # along the view: forward
    assert not ros_messages.optical(BASE_FROM_CAMERA)[1]


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_damaged_clouds_give_points_or_one_line(data: st.DataObject) -> None:
    message = cloud(FIRST_NS, rows(0, 40))
    name = data.draw(
        st.sampled_from(
            ["width", "height", "point_step", "row_step", "fields", "data", "offset", "type", "names"]
        )
    )
    number = data.draw(st.integers(0, 2**32 - 1) | st.integers(0, 40))
    if name == "data":
        message.data = message.data[:number]
    elif name == "offset":
        message.fields[1].offset = number
    elif name == "type":
        message.fields[1].datatype = number % 256
    elif name == "names":
        message.fields[1].name = data.draw(st.text(max_size=5))
    elif name == "fields":
        message.fields = message.fields[: number % 4]
    else:
        setattr(message, name, number)
    with warnings.catch_warnings(action="error"):
        try:
            points = ros_messages.cloud(message, "m")
        except BadInput as error:
            assert "\n" not in str(error)
            return
    assert np.isfinite(points.xyz_m).all()


@pytest.fixture(scope="module", params=["mcap", "db3"])
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, bytes]:
    bag = write_bag(tmp_path_factory.mktemp("bag") / "bag", storage=request.param)
    path = next(bag.glob(f"*.{request.param}"))
    return path.name, path.read_bytes()


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_damaged_recordings_give_a_drive_or_one_line(
    recorded: tuple[str, bytes], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    content = bytearray(recorded[1])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content)))
        if data.draw(st.booleans()):
            content[place : place + 4] = data.draw(st.binary(min_size=1, max_size=8))
        else:
            del content[place : place + data.draw(st.integers(1, 5000))]
    (folder / recorded[0]).write_bytes(bytes(content))
    with warnings.catch_warnings(action="error"):
        try:
            run(folder / recorded[0], folder / "drives")
        except UpvlError as error:
            assert len(str(error).splitlines()) == 1
            assert not list(folder.rglob("points/drive.parquet"))


def test_a_drive_is_listed_only_when_its_pictures_are_there(tmp_path: Path) -> None:
    """An import that is stopped among the pictures leaves no drive; the next one ends as if it had not been stopped."""
    bag = write_bag(tmp_path / "bag", storage="mcap")
    run(bag, tmp_path / "whole")

    def stop(what: str, count: int, total: int) -> None:
        if what == "pictures":
            raise KeyboardInterrupt

    folder = tmp_path / "stopped"
    folder.mkdir()
    (folder / "topics.toml").write_text(MAP)
    request = ImportRequest(bag, folder, "drive", topics=folder / "topics.toml")
    with pytest.raises(KeyboardInterrupt):
        import_drive(request, stop)
    assert not list(folder.glob("points/*.parquet"))
    run(bag, folder)
    for table in ("points", "images"):
        assert [path.name for path in (folder / table).iterdir()] == ["drive.parquet"]
    drive, undisturbed = (ParquetDrives(root).open("drive") for root in (folder, tmp_path / "whole"))
    assert len(drive.frames) == len(undisturbed.frames) == 4
    assert drive.image(2, "front") is not None


def test_a_missing_topic_map_is_one_clear_line(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", storage="mcap")
    request = ImportRequest(bag, tmp_path / "drives", "drive", topics=tmp_path / "none.toml")
    with pytest.raises(BadSetting, match="none.toml is missing; without --topics a map is proposed"):
        import_drive(request, lambda *_: None)


def test_a_target_that_is_a_file_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "drives").touch()
    with pytest.raises(BadSetting, match="drives is a file; expected a folder"):
        import_drive(ImportRequest(tmp_path, tmp_path / "drives", "drive"), lambda *_: None)
