"""What adapters share: content, paths, numbers, poses, pictures, numbered files, times, road height."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from datasets.contract import assert_one_line
from upvl_cli.datasets.shared.class_types import type_of_class
from upvl_cli.datasets.shared.content import read_json, read_text
from upvl_cli.datasets.shared.motion_compensation import compensate
from upvl_cli.datasets.shared.numbered_files import describe_files, numbered_files
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.datasets.shared.paths import check_segment_name, inside, unknown_segment
from upvl_cli.datasets.shared.pictures import picture_size, read_picture
from upvl_cli.datasets.shared.poses import check_pose, quaternion_rotation
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.types import Frame


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_text(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_bytes("1 2\n".encode(encoding))
    assert read_text(path) == "1 2\n"
    path.write_bytes('{"a": [1]}'.encode(encoding))
    assert read_json(path) == {"a": [1]}


@pytest.mark.parametrize("content", [b"\xff\xff\x00", b"a\0b", b"\xc3"])
def test_what_is_no_text_is_one_line(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="is not text") as failure:
        read_text(path)
    assert_one_line(failure.value)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, '{"a": 1}}'])
def test_what_is_no_json_is_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(text)
    with pytest.raises(BadInput, match="no whole JSON") as failure:
        read_json(tmp_path / "scene.json")
    assert_one_line(failure.value)


def test_a_path_from_data_stays_inside(tmp_path: Path) -> None:
    assert inside(tmp_path, "samples/a.jpg", "table") == tmp_path / "samples/a.jpg"
    (tmp_path / "link").symlink_to("/etc")
    (tmp_path / "loop").symlink_to("loop")
    for text in ("../x", "/etc/passwd", "a/../../x", "", "link/passwd", "loop/x", "a\0", "c:\\x"):
        with pytest.raises(BadInput, match="expected the relative path of a file below") as failure:
            inside(tmp_path, text, "sample_data.json, row 3")
        assert_one_line(failure.value)


def test_an_unknown_segment_is_told_the_nearest(tmp_path: Path) -> None:
    assert "it has a, b" in str(unknown_segment(tmp_path, "c", ["a", "b"]))
    known = [f"scene-{number:04d}" for number in range(20)]
    message = str(unknown_segment(tmp_path, "scene-003", known))
    assert "of its 20 segments the nearest are " in message and "scene-0003" in message
    assert "the first is scene-0000" in str(unknown_segment(tmp_path, "?", known))


@pytest.mark.parametrize("name", ["-", "-x", ".hid", "..", ".", "", "a b", "a/b", "ä", "a\n", "x" * 201])
def test_names_that_no_drive_has(name: str) -> None:
    assert check_segment_name("_a-1.b", "here") == "_a-1.b"
    with pytest.raises(BadInput, match="rename it"):
        check_segment_name(name, "here")


@pytest.mark.parametrize("text", ["1 2", "1 2 3 4", "1 2 x", "1 2 nan", "1 2 inf", ""])
def test_a_line_has_so_many_finite_numbers(text: str) -> None:
    assert numbers(" 1\t2 3e0\n", 3, "here").tolist() == [1, 2, 3]
    with pytest.raises(BadInput, match="here holds .* expected 3 finite numbers"):
        numbers(text, 3, "here")


def test_a_quaternion_is_a_rotation() -> None:
    wxyz = np.random.default_rng(0).normal(size=(20, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    expected = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(quaternion_rotation(wxyz, "here"), expected, atol=1e-12)
    np.testing.assert_allclose(quaternion_rotation([1, 0, 0, 0], "here"), np.eye(3))
    for wrong in ([1, 1, 0, 0], [0, 0, 0, 0], [np.nan, 0, 0, 1], [1e300, 0, 0, 0]):
        with pytest.raises(BadInput, match="quaternion of length"):
            quaternion_rotation(np.array([[1.0, 0, 0, 0], wrong]), "here")


def test_a_pose_is_rigid_and_near() -> None:
    poses = from_yaw(np.array([0.1, 2.0]), np.array([[1.0, 2, 3], [4e6, 5e6, 6]]))
    np.testing.assert_array_equal(check_pose(poses, "here"), poses)
    np.testing.assert_array_equal(check_pose(poses[:, :3], "here"), poses)  # without the last row
    flawed = {
        "rotation": 1.01 * np.eye(4),
        "mirror": np.diag([1.0, 1, -1, 1]),
        "nan": np.full((4, 4), np.nan),
    }
    far, last = np.eye(4), np.eye(4)
    far[0, 3], last[3, 0] = 1e12, 0.5
    for matrix in (*flawed.values(), far, last):
        for shape in (matrix, np.stack([np.eye(4), matrix])):
            with warnings.catch_warnings(action="error"), pytest.raises(BadInput) as failure:
                check_pose(shape, "here")
            assert str(failure.value).startswith("here") and assert_one_line(failure.value) is None


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA", "P", "1", "I;16"])
def test_pictures_of_all_modes(kind: str, mode: str, tmp_path: Path) -> None:
    if kind == "JPEG" and mode in ("RGBA", "P", "1", "I;16"):
        return
    path = tmp_path / "a.PNG"  # the name says nothing
    Image.new(mode, (6, 4)).save(path, kind)
    for source in (path, path.read_bytes()):
        assert picture_size(source, path) == (6, 4)
        assert read_picture(source, 6, 4, path).shape == (4, 6, 3)
        with pytest.raises(BadInput, match="6 x 4 pixels, but its calibration says 7 x 4"):
            read_picture(source, 7, 4, path)


def test_a_cut_picture_is_one_line() -> None:
    buffer = io.BytesIO()
    Image.effect_noise((64, 64), 50).convert("RGB").save(buffer, "JPEG")
    for content in (buffer.getvalue()[:500], b"", b"GIF89a"):
        with pytest.raises(BadInput, match="row 7 cannot be read") as failure:
            read_picture(content, 64, 64, "images, row 7")
        assert_one_line(failure.value)


def test_files_by_number(tmp_path: Path) -> None:
    for name in ("000007.PNG", "12.png", "0000000003.jpg", "b.png", "7.txt", ".3.png"):
        (tmp_path / name).touch()
    found = numbered_files(tmp_path, (".png", ".jpg"))
    assert {number: path.name for number, path in found.items()} == {
        3: "0000000003.jpg",
        7: "000007.PNG",
        12: "12.png",
    }
    assert list(found) == [3, 7, 12]
    assert numbered_files(tmp_path / "absent", (".png",)) == {}
    (tmp_path / "7.jpg").touch()
    with pytest.raises(BadInput, match="two files of frame 7"):
        numbered_files(tmp_path, (".png", ".jpg"))


def test_what_a_folder_holds(tmp_path: Path) -> None:
    assert describe_files(tmp_path) == f"nothing in {tmp_path}"
    for number in range(60, 68):
        (tmp_path / f"{number:06d}.bin").touch()
    assert describe_files(tmp_path) == f"8 files like 000060.bin in {tmp_path}"
    assert describe_files(tmp_path / "x") == f"no folder {tmp_path / 'x'}"


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([(0, 0), (1, 999_999)], "only 999999 ns later"),
        ([(0, 10**9), (1, 0)], "not later"),
        ([(1, 0), (1, 10**9)], "frame 1 comes after frame 1"),
        ([(0, 0), (1, 10**17)], "hours apart"),
        ([(0, 0), (1, 2**70)], "out of range"),
    ],
)
def test_frames_that_do_not_ascend(frames: list[tuple[int, int]], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        check_frames([Frame(*pair) for pair in frames], "times.txt")


def test_frames_that_ascend() -> None:
    frames = [Frame(3, 0), Frame(5, 1_000_000)]
    assert check_frames(frames, "times.txt") == tuple(frames)
    assert check_frames([], "times.txt") == ()


@pytest.mark.parametrize("height_m", [0.0, -1.73, -3.1])
@pytest.mark.parametrize("slope", [0.0, 0.05])
def test_the_height_of_the_road(height_m: float, slope: float) -> None:
    """Beside parked cars, walls, a hole below and a slope."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(-30, 30, (20_000, 2))
    ground = np.column_stack([xy, height_m + slope * xy[:, 0] + rng.normal(0, 0.02, len(xy))])
    wall = np.column_stack(
        [rng.uniform(-30, 30, 3000), np.full(3000, 4.0), height_m + rng.uniform(0, 3, 3000)]
    )
    below = np.column_stack([rng.uniform(-10, 10, (100, 2)), height_m - rng.uniform(1, 5, 100)])
    ground = ground[ground[:, 1] < 4]
    assert abs(road_height_m(np.vstack([ground, wall, below])) - height_m) < 0.2
    assert road_height_m(np.zeros((0, 3))) < 0


@pytest.mark.parametrize("step", [0, 1, 2])
def test_compensation_takes_each_point_back_by_the_motion_since_it_was_measured(step: int) -> None:
    times_ns = [0, 100_000_000, 190_000_000]
    poses = from_yaw(np.array([0.0, 0.05, 0.08]), np.array([[0.0, 0, 0], [2, 0.1, 0], [3.9, 0.3, 0.1]]))
    rng = np.random.default_rng(0)
    world = rng.uniform(-50, 50, (40, 3))
    offset_ns = rng.integers(-60_000_000, 60_000_000, 40)
    measured = np.array(
        [
            apply(inverse(pose_at(times_ns, poses, times_ns[step] + offset)), place[None])[0]
            for place, offset in zip(world, offset_ns, strict=True)
        ]
    )
    found = compensate(measured, offset_ns, step, times_ns, poses)
    np.testing.assert_allclose(found, apply(inverse(poses[step]), world), atol=5e-3)
    assert np.abs(measured - found).max() > 0.5
    np.testing.assert_array_equal(compensate(measured, offset_ns, 0, times_ns[:1], poses[:1]), measured)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Car", 1), ("vehicle.truck", 1), ("OTHER_VEHICLE", 1), ("otherVehicle", 1), ("Van", 1), ("motorcycle", 1),
        ("Pedestrian", 2), ("human.pedestrian.adult", 2), ("Person_sitting", 2), ("rider", 2),
        ("Cyclist", 4), ("bicycle", 4), ("BICYCLIST", 4), ("bicycle_rack", 0), ("sign", 3), ("TRAFFIC_CONE", 0),
        ("Misc", 0), ("animal", 0), ("scarf", 0), ("", 0), ("buses", 0), ("cars", 1),
    ],
)  # fmt: skip
def test_types_by_the_names_of_classes(name: str, kind: int) -> None:
    assert type_of_class(name) == kind
