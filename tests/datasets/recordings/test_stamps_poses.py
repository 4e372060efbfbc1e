"""Times and poses as people write them."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.recordings.street import FIRST_NS, STEP_NS, quat_xyzw, world_from_lidar, write_tum
from upvl_cli.datasets.recordings.axes import ego_from_axes
from upvl_cli.datasets.recordings.pose_file import read_matrix, read_poses
from upvl_cli.datasets.recordings.pose_track import PoseTrack
from upvl_cli.datasets.recordings.stamps import parse_stamps, read_time_file, times_in_names
from upvl_cli.errors import BadInput, BadSetting

POSES = np.stack([world_from_lidar(k) for k in range(3)])
TIMES = [FIRST_NS + STEP_NS * k for k in range(3)]


@pytest.mark.parametrize(
    ("stem", "time_ns"),
    [
        ("1532402927.647951", 1532402927647951000),
        ("1532402927.647951000", 1532402927647951000),
        ("1532402927647951", 1532402927647951000),
        ("1532402927647951000", 1532402927647951000),
        ("1532402927647", 1532402927647000000),
        ("1532402927_647951000", 1532402927647951000),
        ("1532402927_47951000", 1532402927047951000),
        ("n015-2018-07-24-11-22-45+0800__LIDAR_TOP__1532402927647951", 1532402927647951000),
        ("lidar_2018-07-24-03-28-47.647951", 1532402927647951000),
        ("20180724T032847", 1532402927000000000),
        ("2018-07-24 03_28_47", 1532402927000000000),
        ("000060", None),
        ("0000000060", None),
        ("2018-13-44-03-28-47", None),
    ],
)
def test_times_in_names(stem: str, time_ns: int | None) -> None:
    assert times_in_names([stem]) == (None if time_ns is None else [time_ns])


def test_names_of_one_time_have_none() -> None:
    assert times_in_names(["a_1532402927", "b_1532402927"]) is None


@pytest.mark.parametrize(
    ("texts", "first_ns", "second_ns"),
    [
        (["1532402927.647951", "1532402927.747951"], 1532402927647951000, 1532402927747951000),
        (["1.532402927647951000e+09", "1.532402927747951e9"], 1532402927647951000, 1532402927747951000),
        (["1532402927647951000", "1532402927747951000"], 1532402927647951000, 1532402927747951000),
        (["0.000000e+00", "1.037359e-01"], 0, 103735900),
        (["0", "100000000"], 0, 100000000),
        (["0", "100000"], 0, 100000000),
        (["0", "100"], 0, 100000000),
        (["0", "1"], 0, 1000000000),
        (["2018-07-24 03:28:47.5", "2018-07-24T03:28:47,600"], 1532402927500000000, 1532402927600000000),
    ],
)
def test_units_of_times(texts: list[str], first_ns: int, second_ns: int) -> None:
    assert parse_stamps(texts, Path("t")) == [first_ns, second_ns]


def test_time_files_are_paired_and_never_shifted(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text("\ufeff" + "\n".join(f"{k / 10}" for k in range(104)))
    assert read_time_file(path, ["000060", "000061"]) == [6_000_000_000, 6_100_000_000]
    path.write_text("0.5\n\n0.7\n")
    assert read_time_file(path, ["7", "8", "9"]) == [500_000_000, None, 700_000_000]
    path.write_text("b.pcd 0.2\na.pcd 0.1\n")
    assert read_time_file(path, ["a", "b"]) == [100_000_000, 200_000_000]
    path.write_text("0.5\n0.6\n0.7\n")
    with pytest.raises(BadInput, match="3 lines for 2 sweeps"):
        read_time_file(path, ["a", "b"])
    with pytest.raises(BadInput, match="3 lines for 2 sweeps"):
        read_time_file(path, ["8", "9"])


def matrix_lines() -> str:
    return "\n".join(" ".join(f"{value:.9f}" for value in pose[:3].ravel()) for pose in POSES)


def table(header: str, separator: str, columns: list[np.ndarray]) -> str:
    lines = [separator.join(repr(cell.item()) for cell in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *lines])


SECONDS = np.array(TIMES) / 1e9
WXYZ = [3, 0, 1, 2]
XYZ, QUAT = POSES[:, :3, 3], np.stack([quat_xyzw(pose) for pose in POSES])
ODD = np.full(3, 7.5)
FILES = {
    "kitti": matrix_lines(),
    "csv": table("time,x,y,z,qx,qy,qz,qw", ",", [SECONDS, *XYZ.T, *QUAT.T]),
    "csv of nanoseconds": table(
        "timestamp_ns,tx,ty,tz,q_w,q_x,q_y,q_z", ",", [np.array(TIMES), *XYZ.T, *QUAT[:, WXYZ].T]
    ),
    "euroc": table(
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
        "v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]",
        ",", [np.array(TIMES), *XYZ.T, *QUAT[:, WXYZ].T, ODD, ODD],
    ),
    "rostopic": table(
        "%time,field.header.seq,field.header.stamp,field.pose.pose.position.x,field.pose.pose.position.y,"
        "field.pose.pose.position.z,field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
        "field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.twist.twist.linear.x",
        ",", [np.array(TIMES), ODD, np.array(TIMES), *XYZ.T, *QUAT.T, ODD],
    ),
    "angles": table(
        "stamp;pos_x;pos_y;pos_z;roll_deg;pitch_deg;yaw_deg", ";",
        [SECONDS, *XYZ.T, 0 * ODD, 0 * ODD, np.array([0.0, 2, 4])],
    ),
    "blanks": table("t x y z qx qy qz qw", " ", [SECONDS, *XYZ.T, *QUAT.T]),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_pose_files(tmp_path: Path, name: str, mark: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(mark + FILES[name] + "\n", encoding="utf-8")
    found = read_poses(path)
    np.testing.assert_allclose(found.poses, POSES, atol=1e-6)
    if name == "kitti":
        assert found.times_ns is None
    else:
        np.testing.assert_allclose(found.times_ns, TIMES, atol=300)


def test_a_tum_file_keeps_every_nanosecond(tmp_path: Path) -> None:
    found = read_poses(write_tum(tmp_path / "p.tum", [0, 1, 2]))
    assert found.times_ns.tolist() == TIMES
    np.testing.assert_allclose(found.poses, POSES, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no pose"),
        ("1 2 3\n", "has 3 columns; expected TUM"),
        ("1 0 0 0 0 0 0 2\n", "quaternion of length 2"),
        ("1 0 0 0 0 0 0 1\n2 0 0\n", "row 2 has 3 columns"),
        ("1 0 0 nan 0 0 0 1\n", "pose number 1"),
        ("time,speed,course\n1,2,3\n", "time, speed, course; expected TUM"),
        ("time,x,y,z,qx,qy,qz,qw\n1,2\n", "row 1 has 2 columns"),
    ],
)
def test_what_is_no_pose_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "p.txt"
    path.write_text(text)
    with pytest.raises(BadInput, match=words):
        read_poses(path)


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_damaged_text_gives_poses_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    text = FILES[data.draw(st.sampled_from(list(FILES)))]
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(text)))
        new = data.draw(
            st.sampled_from(["", ",", "\n", "1e400", "nan", "x", "-", '"', "\ufeff", "9" * 40, "é", " "])
        )
        text = text[:place] + new + text[place + data.draw(st.integers(0, 30)) :]
    path = tmp_path_factory.mktemp("p") / "p.txt"
    path.write_text(text, encoding="utf-8")
    with warnings.catch_warnings(action="error"):
        try:
            found = read_poses(path)
        except BadInput as error:
            assert "\n" not in str(error)
            return
    assert np.isfinite(found.poses).all()


def test_a_matrix_file(tmp_path: Path) -> None:
    path = tmp_path / "m.txt"
    path.write_text(str(POSES[1].tolist()))
    np.testing.assert_allclose(read_matrix(path), POSES[1])
    path.write_text("1 2 3")
    with pytest.raises(BadInput, match="3 words; expected 12 or 16"):
        read_matrix(path)


def test_poses_between_poses() -> None:
    track = PoseTrack.in_time_order(
        np.array(TIMES[::-1] + TIMES[:1]), np.concatenate([POSES[::-1], POSES[:1]])
    )
    between = track.at(TIMES[0] + STEP_NS // 4)
    assert between is not None
    np.testing.assert_allclose(between[:3, 3], [0.25, 0.025, 0], atol=0.01)
    assert track.at(TIMES[0] - 2 * STEP_NS) is None
    assert track.at(TIMES[2] + STEP_NS // 2) is not None
    apart = PoseTrack(np.array([0, 10**10]), POSES[:2])
    assert apart.at(5 * 10**9) is None
    np.testing.assert_allclose(apart.at(10**10), POSES[1])


@pytest.mark.parametrize(
    ("letters", "forward"),
    [("flu", (1, 0, 0)), ("rfu", (0, 1, 0)), ("lbu", (0, -1, 0)), ("frd", (1, 0, 0)), ("bru", (-1, 0, 0))],
)
def test_axes(letters: str, forward: tuple[int, int, int]) -> None:
    np.testing.assert_array_equal(ego_from_axes(letters)[:3, :3] @ forward, (1, 0, 0))


@pytest.mark.parametrize("letters", ["", "fru", "ffu", "xyz", "flul"])
def test_axes_that_are_none(letters: str) -> None:
    with pytest.raises(BadSetting, match="three letters"):
        ego_from_axes(letters)
