"""`upvl view` whole: a recording is read back, a page is served to this machine alone, faults are one line."""

from __future__ import annotations

import contextlib
import re
import resource
import signal
import socket
import subprocess
import sys
import urllib.request
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command import ENVIRONMENT, UPVL, fails, make_workspace, upvl
from drive_shards import (
    CAR,
    FEW_SWEEPS,
    PERSON,
    SEGMENT,
    street_drive,
    street_labels,
    street_workspace,
    write_street_shards,
)

pytest.importorskip("rerun")

FRAMES = 3
MAX_POINTS = 4000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace of the street with tables of its first frames."""
    made = make_workspace(tmp_path_factory.mktemp("shown"), **FEW_SWEEPS)
    write_street_shards(street_workspace(made), FRAMES)
    return made


@pytest.fixture(scope="module")
def saved(folder: Path) -> subprocess.CompletedProcess[str]:
    """The command that saved the first frames as street.rrd."""
    return upvl(
        folder, "view", "--save", "street.rrd", "--frame-range", f"0:{FRAMES - 1}", "--max-points", str(MAX_POINTS)
    )  # fmt: skip


Rows = dict[
    str, dict[int | None, Any]
]  # of each component by its name, the value at each frame; None for static


@pytest.fixture(scope="module")
def recording(folder: Path, saved: subprocess.CompletedProcess[str]) -> dict[str, Rows]:
    """What the recording holds, by the path of its entities."""
    assert saved.returncode == 0, saved.stderr
    return read_recording(folder / "street.rrd")


def read_recording(path: Path) -> dict[str, Rows]:
    from rerun.chunk import RrdReader

    found: dict[str, Rows] = defaultdict(lambda: defaultdict(dict))
    for chunk in RrdReader(path).store().stream().to_chunks():
        batch = chunk.to_record_batch()
        assert chunk.is_static or set(chunk.timeline_names) == {"frame", "time"}
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names}
        for row in range(batch.num_rows):
            frame = None if chunk.is_static else columns["frame"][row]
            for name, values in columns.items():
                if values[row] is not None:
                    found[chunk.entity_path][name][frame] = values[row]
    return found


def test_the_command_says_what_it_shows(folder: Path, saved: subprocess.CompletedProcess[str]) -> None:
    assert saved.stdout.splitlines() == [
        "not shown: no classes of points (upvl semantics has not been run)",
        f"points thinned to {MAX_POINTS} a frame; --all-points keeps all",
        "street.rrd",
    ]
    assert saved.stderr == ""


def test_boxes_have_their_place_track_class_and_score(recording: dict[str, Rows]) -> None:
    boxes = recording["/world/ego/boxes"]
    assert boxes["label:track_id"] == {0: [], 1: [CAR, PERSON], 2: [CAR, PERSON]}
    assert boxes["label:class_name"][1] == ["vehicle", "pedestrian"]
    assert boxes["label:word"][2] == ["car", "pedestrian"]
    assert boxes["label:score"][1] == [0.75, 0.5]
    assert boxes["Boxes3D:labels"][1] == [
        f"car #{CAR}  0.75  5.0 m/s",
        f"pedestrian #{PERSON}  0.50  0.0 m/s",
    ]
    for frame in range(FRAMES):
        labels = street_labels(frame)
        centers_m = np.array(boxes["Boxes3D:centers"][frame]).reshape(-1, 3)
        np.testing.assert_allclose(centers_m, labels.center_m, atol=1e-6)
        half_m = np.array(boxes["Boxes3D:half_sizes"][frame]).reshape(-1, 3)
        np.testing.assert_allclose(half_m, labels.size_lwh_m / 2, atol=1e-6)
        quat_xyzw = np.array(boxes["Boxes3D:quaternions"][frame]).reshape(-1, 4)
        np.testing.assert_allclose(
            2 * np.arctan2(quat_xyzw[:, 2], quat_xyzw[:, 3]), labels.heading_rad, atol=1e-6
        )


def test_points_are_thinned_and_have_a_colour_in_each_layer(recording: dict[str, Rows]) -> None:
    points = recording["/world/ego/points"]
    for frame in range(FRAMES):
        xyz_m = np.array(points["Points3D:positions"][frame])
        assert MAX_POINTS / 2 < len(xyz_m) <= MAX_POINTS
        sweep_m = street_drive().points(frame).xyz_ego_m
        rounded_m = np.round(sweep_m * 256) / 256
        assert set(map(tuple, xyz_m.tolist())) <= set(map(tuple, rounded_m.astype(np.float32).tolist()))
        for layer in ("words", "flow", "height", "ground", "moving", "intensity"):
            assert len(points[f"layers:{layer}"][frame]) == len(xyz_m)
    # Those of the car's box have its word.
    names = {entry["class_id"]: entry["class_description"]["info"]["label"]
             for entry in points["AnnotationContext:context"][None][0]}  # fmt: skip
    assert set(names.values()) == {"no word", "car", "pedestrian"}
    words = {names[number] for number in points["Points3D:class_ids"][2]}
    assert "no word" in words and words <= set(names.values())


def test_the_car_and_its_tracks_move_through_the_world(recording: dict[str, Rows]) -> None:
    poses = street_drive().world_from_ego
    origin_m = poses[0, :3, 3]
    moved = recording["/world/ego"]
    for frame in range(FRAMES):
        np.testing.assert_allclose(
            moved["Transform3D:translation"][frame][0], poses[frame, :3, 3] - origin_m, atol=1e-4
        )
        turned = np.array(moved["Transform3D:mat3x3"][frame][0]).reshape(3, 3).T  # column after column
        np.testing.assert_allclose(turned, poses[frame, :3, :3], atol=1e-6)
    assert len(recording["/world/ego_path"]["LineStrips3D:strips"][None][0]) == len(poses)
    tails = recording["/world/tails"]["LineStrips3D:strips"]
    assert [len(tails[frame]) for frame in range(FRAMES)] == [0, 0, 2]  # a line takes two places
    center_m = poses[2, :3, :3] @ street_labels(2).center_m[0] + poses[2, :3, 3] - origin_m
    np.testing.assert_allclose(tails[2][0][-1], center_m, atol=1e-4)


def test_the_time_lines_count_frames_and_seconds(recording: dict[str, Rows]) -> None:
    times = recording["/world/ego"]["time"]
    assert {frame: time.total_seconds() for frame, time in times.items()} == {0: 0.0, 1: 0.1, 2: 0.2}


def test_the_camera_shows_its_picture_with_the_boxes(recording: dict[str, Rows]) -> None:
    front = "/world/ego/cameras/front"
    assert recording[front]["Pinhole:resolution"][None] == [[480, 270]]
    image = recording[f"{front}/image"]
    assert image["EncodedImage:media_type"][1] == ["image/jpeg"]
    assert bytes(image["EncodedImage:blob"][1][0])[:2] == b"\xff\xd8"
    strips = recording[f"{front}/boxes"]["LineStrips2D:strips"]
    assert len(strips[0]) == 0 and len(strips[1]) == 24
    assert recording[f"{front}/names"]["Points2D:labels"][1] == [f"car #{CAR}", f"pedestrian #{PERSON}"]


def test_texts_tell_of_colours_and_sensors(recording: dict[str, Rows]) -> None:
    assert "Colours of the points" in recording["/about/colours"]["TextDocument:text"][None][0]
    sensors = recording["/about/sensors"]["TextDocument:text"][None][0]
    assert "LiDAR 0" in sensors and "camera front" in sensors
    assert "/about/summary" not in recording  # nms has not been made, nor the check


def test_a_blueprint_is_in_the_recording(folder: Path, saved: subprocess.CompletedProcess[str]) -> None:
    from rerun.chunk import RrdReader

    assert len(RrdReader(folder / "street.rrd").blueprints()) == 1


def test_a_drive_of_which_nothing_was_made_shows_points_and_pictures(tmp_path: Path) -> None:
    make_workspace(tmp_path, **FEW_SWEEPS)
    done = upvl(tmp_path, "view", SEGMENT, "--save", "a/plain.rrd", "--frame-range", "5:5")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(
        "not shown: no poses (upvl odometry has not been run); no heights and ground"
    )
    found = read_recording(tmp_path / "a" / "plain.rrd")
    assert "/world/ego/boxes" not in found
    assert set(found["/world/ego/points"]) >= {"Points3D:positions", "layers:intensity"}
    assert "layers:flow" not in found["/world/ego/points"]
    assert list(found["/world/ego"]["Transform3D:translation"]) == [5]  # the drive's own pose


def test_labels_are_shown_without_their_drive(folder: Path, tmp_path: Path) -> None:
    make_workspace(tmp_path, raw__dataset='"kitti"', raw__root='"gone"')
    (tmp_path / "out").symlink_to(folder / "out")
    done = upvl(tmp_path, "view", "--save", "boxes.rrd", "--frame-range", "1:2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("not shown: no points and no pictures (")
    found = read_recording(tmp_path / "boxes.rrd")
    assert found["/world/ego/boxes"]["label:track_id"][1] == [CAR, PERSON]
    assert "/world/ego/points" not in found


def test_tables_of_other_sweeps_are_left_out(tmp_path: Path) -> None:
    from upvl_cli.pipeline.tables import write
    from upvl_cli.stages.rows import FlowRow
    from upvl_cli.viewer.drive_tables import DriveTables

    workspace = street_workspace(make_workspace(tmp_path))
    row = FlowRow(SEGMENT, 0, np.zeros((5, 3)))
    write(workspace.shard("flow", SEGMENT), FlowRow, [row], stamp="{}", counts={})
    points = DriveTables(workspace, SEGMENT).points(0)
    assert points is not None and points.flow_mps is None and len(points.points) > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--frame-range", "9"], "--frame-range 9: expected the first and the last frame"),
        (["--frame-range", "9:3"], "the smaller one first, such as 10:60"),
        (["--frame-range", "50:60"], "street-0 has no frame from 50 to 60: it has 0 to 19"),
        (["stret-0", "--save", "a.rrd"], "unknown segment 'stret-0'; did you mean 'street-0'"),
        (["--save", "drive.mp4"], "drive.mp4 does not end in .rrd, by which the viewer knows its files"),
        (["--save", "a.rrd", "--web"], "both --web and --save are given"),
        (["--all-points", "--max-points", "5"], "both --all-points and --max-points are given"),
    ],
)
def test_what_cannot_be_shown_is_one_line(folder: Path, arguments: list[str], message: str) -> None:
    assert message in fails(folder, "view", *arguments)
    assert not list(folder.glob(".*.part"))


def test_a_missing_package_is_named(folder: Path) -> None:
    program = (
        "import sys; sys.modules['rerun'] = None; from upvl_cli.cli import run; "
        "sys.exit(run(['view', '--save', 'none.rrd']))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "upvl: the viewer needs the package rerun; run: pip install 'upvl[view]'\n"


def test_a_full_disk_leaves_no_file(folder: Path) -> None:
    """The library writes in a thread of its own, which does not tell of a failure."""

    def limit_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    done = subprocess.run(
        [UPVL, "view", "--save", "full.rrd", "--frame-range", "1:1"], cwd=folder, capture_output=True, text=True,
        env=ENVIRONMENT, preexec_fn=limit_files,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "full.rrd could not be written to its end" in done.stderr.splitlines()[-1]
    assert not [path.name for path in folder.iterdir() if "full" in path.name]


def test_the_page_is_served_to_this_machine_alone_until_ctrl_c(folder: Path) -> None:
    command = subprocess.Popen(
        [UPVL, "view", "--frame-range", "1:1"], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, env=ENVIRONMENT,
    )  # fmt: skip
    assert command.stdout is not None and command.stderr is not None
    try:
        lines = []
        for line in command.stdout:
            lines.append(line.strip())
            if lines[-1].startswith("all frames are there"):
                break
        assert "there is no display here: the viewer opens in a browser" in lines
        (address,) = [line.removeprefix("open ") for line in lines if line.startswith("open ")]
        ports = [int(port) for port in re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", address)]
        assert len(ports) == 2
        with urllib.request.urlopen(address, timeout=10) as page:
            assert page.status == 200 and b"rerun" in page.read().lower()
        if sys.platform.startswith("linux"):
            assert {listening_address(port) for port in ports} == {"0100007F"}  # 127.0.0.1
        command.send_signal(signal.SIGINT)
        assert command.wait(timeout=30) == 130
        assert len(command.stderr.read().splitlines()) == 1
        for port in ports:
            with (
                contextlib.suppress(ConnectionError),
                socket.create_connection(("127.0.0.1", port), timeout=1),
            ):
                pytest.fail(f"something still listens to port {port}")
    finally:
        command.kill()
        command.wait()


def listening_address(port: int) -> str:
    """The address that the listener of a port is bound to, as Linux has it."""
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        address, state = line.split()[1], line.split()[3]
        if state == "0A" and int(address.split(":")[1], 16) == port:
            return address.split(":")[0]
    return "none"
