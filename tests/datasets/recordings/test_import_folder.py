"""Folders of point files become drives: points, times, poses, pictures; stopped, resumed, refused."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest

from datasets.contract import check_dataset
from datasets.recordings.street import (
    FIRST_NS,
    HEIGHT_PX,
    INTRINSIC,
    STEP_NS,
    WIDTH_PX,
    picture,
    rows,
    times_ns,
    world_from_lidar,
    write_scans,
    write_tum,
)
from upvl_cli.commands import import_drive as command
from upvl_cli.commands.import_drive import ImportRequest, ImportSummary, ScanOptions, import_drive
from upvl_cli.datasets.parquet.dataset import ParquetDrives
from upvl_cli.datasets.recordings import store
from upvl_cli.errors import BadInput, BadSetting, UpvlError
from upvl_cli.types import Drive


def run(source: Path, folder: Path, *, segment: str = "", car_m=None, **scan: object) -> ImportSummary:  # noqa: ANN001
    request = ImportRequest(source, folder, segment, ScanOptions(**scan), car_m=car_m)
    return import_drive(request, lambda *_: None)


def opened(folder: Path, segment: str) -> Drive:
    return ParquetDrives(folder).open(segment)


def test_a_folder_with_poses_and_times_in_its_names(tmp_path: Path) -> None:
    """Poses at half frames only: those of the sweeps are between them."""
    source = write_scans(tmp_path / "scans", names="time")
    poses = write_tum(tmp_path / "poses.tum", [-0.5, 0.5, 1.5, 2.5, 3.5])
    summary = run(source, tmp_path / "drives", poses=poses)
    assert (summary.segment, summary.counts.frames, summary.counts.points) == ("scans", 4, 1600)
    assert not summary.counts.skipped
    check_dataset(ParquetDrives(tmp_path / "drives"))
    drive = opened(tmp_path / "drives", "scans")
    assert [frame.time_ns for frame in drive.frames] == times_ns(4)
    assert [frame.index for frame in drive.frames] == [0, 1, 2, 3]
    assert drive.world_from_ego is not None
    for k in range(4):
        np.testing.assert_allclose(drive.world_from_ego[k], world_from_lidar(k), atol=0.01)
        points = drive.points(k)
        np.testing.assert_allclose(points.xyz_ego_m, rows(k)[:, :3], rtol=1e-6)
        np.testing.assert_allclose(points.intensity, rows(k)[:, 3] / 255, rtol=1e-6)


def test_numbers_in_names_are_frames_and_pair_poses(tmp_path: Path) -> None:
    """KITTI poses of the whole drive, of which the folder has sweeps 60 to 63."""
    source = write_scans(tmp_path / "scans")
    poses = tmp_path / "poses.txt"
    poses.write_text("\n".join(" ".join(map(str, world_from_lidar(k - 60)[:3].ravel())) for k in range(70)))
    run(source, tmp_path / "drives", poses=poses, rate_hz=10.0)
    drive = opened(tmp_path / "drives", "scans")
    assert [frame.index for frame in drive.frames] == [60, 61, 62, 63]
    assert np.diff([frame.time_ns for frame in drive.frames]).tolist() == [STEP_NS] * 3
    np.testing.assert_allclose(drive.world_from_ego[2], world_from_lidar(2), atol=1e-9)


def test_axes_turn_points_and_poses_alike(tmp_path: Path) -> None:
    """A LiDAR whose y axis leads forward: a place stays where it is in the world."""
    source = write_scans(tmp_path / "scans", names="time")
    poses = write_tum(tmp_path / "poses.tum", [0, 1, 2, 3])
    run(source, tmp_path / "drives", poses=poses, axes="rfu")
    drive = opened(tmp_path / "drives", "scans")
    points = drive.points(1).xyz_ego_m
    np.testing.assert_allclose(points[:, 0], rows(1)[:, 1], atol=1e-5)
    world = points @ drive.world_from_ego[1][:3, :3].T + drive.world_from_ego[1][:3, 3]
    truth = rows(1)[:, :3] @ world_from_lidar(1)[:3, :3].T + world_from_lidar(1)[:3, 3]
    np.testing.assert_allclose(world, truth, atol=1e-5)


def test_a_mount_moves_poses_of_another_body(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans", names="time")
    poses = write_tum(tmp_path / "poses.tum", [0, 1, 2, 3])
    mount = tmp_path / "mount.txt"
    mount.write_text("1 0 0 0.5\n0 1 0 0\n0 0 1 1.7\n")
    run(source, tmp_path / "drives", poses=poses, mount=mount)
    drive = opened(tmp_path / "drives", "scans")
    np.testing.assert_allclose(drive.world_from_ego[0][:3, 3], [0.5, 0, 1.7], atol=1e-9)


def test_what_is_left_out_is_counted_with_its_reason(tmp_path: Path) -> None:
    """One file cut off, one sweep after the last pose."""
    source = write_scans(tmp_path / "scans", frames=6, names="time")
    poses = write_tum(tmp_path / "poses.tum", [0, 1, 2, 3])
    damaged = sorted(source.iterdir())[1]
    damaged.write_bytes(damaged.read_bytes()[:500])
    summary = run(source, tmp_path / "drives", poses=poses)
    assert summary.counts.frames == 4
    assert summary.counts.skipped == {"damaged files of points": 1, "sweeps without a pose at their time": 1}
    assert "cut off" in summary.counts.examples["damaged files of points"]
    assert [frame.index for frame in opened(tmp_path / "drives", "scans").frames] == [0, 2, 3, 4]


def test_the_own_car_is_dropped(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans")
    summary = run(source, tmp_path / "drives", rate_hz=10.0, car_m=(-100.0, 0.0, -100.0, 100.0))
    assert summary.counts.skipped["points on the car itself"] + summary.counts.points == 1600
    assert opened(tmp_path / "drives", "scans").points(60).xyz_ego_m[:, 0].min() > 0


def test_an_import_that_was_stopped_goes_on_and_ends_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_PART_SWEEPS", 2)
    source = write_scans(tmp_path / "scans", frames=7)
    request = ImportRequest(source, tmp_path / "a", scan=ScanOptions(rate_hz=10.0))
    import_drive(request, lambda *_: None)

    def stop(what: str, count: int, total: int) -> None:
        seen.append(count)
        if sum(seen) == 5:
            raise KeyboardInterrupt

    seen: list[int] = []
    stopped = ImportRequest(source, tmp_path / "b", scan=ScanOptions(rate_hz=10.0))
    with pytest.raises(KeyboardInterrupt):
        import_drive(stopped, stop)
    assert not list((tmp_path / "b").rglob("scans.parquet"))
    assert not list((tmp_path / "b").rglob("*.part"))
    steps: list[int] = []
    import_drive(stopped, lambda _, count, __: steps.append(count))
    assert steps == [4, 1, 1, 1]  # two parts of two were there
    first, second = (tmp_path / name / "points" / "scans.parquet" for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    assert [path.name for path in (tmp_path / "b" / "points").iterdir()] == ["scans.parquet"]


def test_parts_of_other_files_or_options_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_PART_SWEEPS", 2)
    source = write_scans(tmp_path / "scans", frames=7)

    def steps(rate_hz: float, most: int = 100) -> list[int]:
        def step(what: str, count: int, total: int) -> None:
            seen.append(count)
            if sum(seen) == most:
                raise KeyboardInterrupt

        seen: list[int] = []
        request = ImportRequest(source, tmp_path / "drives", scan=ScanOptions(rate_hz=rate_hz))
        with contextlib.suppress(KeyboardInterrupt):
            import_drive(request, step)
        return seen

    assert steps(10.0, most=6) == [0, 1, 1, 1, 1, 1, 1]
    assert steps(5.0, most=6)[0] == 0
    (tmp_path / "drives" / "points" / ".scans.parts" / "00000002.parquet").unlink()
    assert steps(5.0, most=7)[0] == 2  # the part behind the gap is no use
    assert steps(5.0)[0] == 6
    run(source, tmp_path / "fresh", rate_hz=5.0)
    first, second = (tmp_path / name / "points" / "scans.parquet" for name in ("drives", "fresh"))
    assert first.read_bytes() == second.read_bytes()


def test_the_same_again_does_nothing_and_changed_files_are_read_again(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans")
    assert not run(source, tmp_path / "drives", rate_hz=10.0).was_there
    path = tmp_path / "drives" / "points" / "scans.parquet"
    before = path.stat().st_mtime_ns
    again = run(source, tmp_path / "drives", rate_hz=10.0)
    assert again.was_there
    assert again.counts.points == 1600
    assert path.stat().st_mtime_ns == before
    (source / "000063.pcd").unlink()
    assert run(source, tmp_path / "drives", rate_hz=10.0).counts.frames == 3
    assert run(source, tmp_path / "drives", rate_hz=5.0).counts.frames == 3
    path.write_bytes(b"somebody else's")
    with pytest.raises(UpvlError, match="was not written by upvl import"):
        run(source, tmp_path / "drives", rate_hz=10.0)


def test_times_of_points_become_offsets(tmp_path: Path) -> None:
    """Microseconds since 1970 in a column `timestamp`, ring beside them: kept, to be compensated when read."""
    (tmp_path / "scans").mkdir()
    for k, time_ns in enumerate(times_ns(3)):
        stamps = time_ns // 1000 + np.arange(400) * 250
        arrays = {"xyz": rows(k)[:, :3], "intensity": rows(k)[:, 3].astype("u1"), "timestamp": stamps}
        np.savez(tmp_path / "scans" / f"{time_ns}.npz", **arrays)
    summary = run(tmp_path / "scans", tmp_path / "drives")
    assert (
        "npz with xyz, intensity, timestamp: intensity 0 to 255, times of points in microseconds"
        in summary.notes
    )
    drive = opened(tmp_path / "drives", "scans")
    np.testing.assert_array_equal(drive.points(1).time_offset_ns, np.arange(400) * 250_000)
    assert drive.table.is_compensated is False


def cameras(folder: Path, **changes: object) -> Path:
    values = {
        "name": "front", "pictures": "front", "width_px": WIDTH_PX, "height_px": HEIGHT_PX, "fx_px": 40.0,
        "fy_px": 40.0, "cx_px": 31.5, "cy_px": 23.5,
        "lidar_from_camera": [0.0, 0, 1, 0.2, -1, 0, 0, 0, 0, -1, 0, -0.1, 0, 0, 0, 1], **changes,
    }  # fmt: skip
    path = folder / "cameras.toml"
    path.write_text(
        "[[cameras]]\n" + "\n".join(f"{key} = {json.dumps(value)}" for key, value in values.items())
    )
    return path


def test_cameras_beside_a_folder(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans")
    (tmp_path / "front").mkdir()
    for number in (60, 61, 63):
        (tmp_path / "front" / f"{number:06d}.PNG").write_bytes(picture(number))
    summary = run(source, tmp_path / "drives", rate_hz=10.0, cameras=cameras(tmp_path))
    assert summary.counts.pictures == 3
    assert summary.counts.skipped == {"pictures missing for a sweep": 1}
    drive = opened(tmp_path / "drives", "scans")
    image = drive.image(61, "front")
    assert image is not None
    assert (image.rgb == 61).all()
    assert drive.image(62, "front") is None
    np.testing.assert_array_equal(drive.cameras[0].intrinsic, INTRINSIC)
    place = np.linalg.inv(drive.cameras[0].ego_from_camera) @ [10.2, 0, -0.1, 1]
    np.testing.assert_allclose(place, [0, 0, 10, 1], atol=1e-9)  # straight ahead


def test_a_damaged_picture_is_left_out(tmp_path: Path) -> None:
    """Its header is whole, and its data end too early."""
    source = write_scans(tmp_path / "scans")
    (tmp_path / "front").mkdir()
    for number in range(60, 64):
        content = picture(number) if number != 62 else picture(number)[:60]
        (tmp_path / "front" / f"{number:06d}.png").write_bytes(content)
    summary = run(source, tmp_path / "drives", rate_hz=10.0, cameras=cameras(tmp_path))
    assert summary.counts.skipped == {"damaged pictures, or of another size than their calibration": 1}
    assert "000062.png" in next(iter(summary.counts.examples.values()))
    assert opened(tmp_path / "drives", "scans").image(62, "front") is None


def test_a_scene_of_sustechpoints(tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    write_scans(scene / "lidar")
    for folder in ("camera/front", "calib/camera", "label"):
        (scene / folder).mkdir(parents=True)
    for number in range(60, 64):
        (scene / "camera/front" / f"{number:06d}.png").write_bytes(picture(number))
    # Its y axis leads backwards and its x axis left, as in the tool's example.
    extrinsic = [-1.0, 0, 0, 0.2, 0, 0, -1, 0, 0, -1, 0, -0.1, 0, 0, 0, 1]
    calibration = {"extrinsic": extrinsic, "intrinsic": INTRINSIC.ravel().tolist()}
    (scene / "calib/camera/front.json").write_text("\ufeff" + json.dumps(calibration))
    (scene / "label" / "000060.json").write_text("[]")
    summary = run(scene, tmp_path / "drives", rate_hz=2.0, axes="lbu")
    assert (summary.segment, summary.counts.pictures, summary.cameras) == ("scene", 4, ("front",))
    drive = opened(tmp_path / "drives", "scene")
    np.testing.assert_allclose(drive.cameras[0].ego_from_camera[:3, 2], [1, 0, 0], atol=1e-9)  # looks forward
    np.testing.assert_allclose(drive.cameras[0].ego_from_camera[:3, 3], [0.1, 0.2, 0], atol=1e-9)
    np.testing.assert_allclose(drive.cameras[0].ego_from_camera[:3, 1], [0, 0, -1], atol=1e-9)  # y leads down


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "nothing tells the times of its 4 sweeps"),
        ({"rate_hz": 10.0, "axes": "xyz"}, "--axes is 'xyz'"),
        ({"rate_hz": 10.0, "poses": "three"}, "has 3 poses for 4 sweeps"),
        ({"times": "far"}, "expected ascending times"),
        ({"times": "none"}, "cannot be read"),
        ({"rate_hz": 10.0, "cameras": "wrong"}, "unknown key 'widht_px'; did you mean 'width_px'"),
        ({"rate_hz": 10.0, "cameras": "small"}, "damaged pictures"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path: Path, options: dict[str, object], words: str) -> None:
    source = write_scans(tmp_path / "scans")
    (tmp_path / "three").write_text("\n".join(" ".join(map(str, np.eye(4)[:3].ravel())) for _ in range(3)))
    (tmp_path / "far").write_text("0.4\n0.3\n0.2\n0.1\n")
    (tmp_path / "front").mkdir()
    for number in range(60, 64):
        (tmp_path / "front" / f"{number}.png").write_bytes(picture(1))
    (tmp_path / "front" / "000060.png").write_bytes(picture(1))
    cameras(tmp_path, **({"widht_px": 3} if options.get("cameras") == "wrong" else {"width_px": 32}))
    given = {
        name: tmp_path / ("cameras.toml" if name == "cameras" else str(value))
        if name in ("poses", "times", "cameras")
        else value
        for name, value in options.items()
    }
    if options.get("cameras") == "small":
        summary = run(source, tmp_path / "drives", **given)
        assert summary.counts.skipped[f"{words}, or of another size than their calibration"] == 1
        return
    with pytest.raises((BadInput, BadSetting), match=words):
        run(source, tmp_path / "drives", **given)
    assert not list((tmp_path / "drives").rglob("*.parquet"))


def test_poses_on_another_clock_are_named(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans", names="time")
    poses = tmp_path / "poses.tum"
    poses.write_text("\n".join(f"{k / 10} 0 0 0 0 0 0 1" for k in range(9)))
    with pytest.raises(
        BadInput, match=r"poses are from 0\.000 s to 0\.800 s, and the sweeps from 1532402927\.648 s"
    ):
        run(source, tmp_path / "drives", poses=poses)


def test_a_folder_without_points_says_what_it_has(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "a.txt").write_text("")
    with pytest.raises(BadInput, match="holds no files of points"):
        run(tmp_path / "scans", tmp_path / "drives")
    write_scans(tmp_path / "more" / "velodyne")
    assert run(tmp_path / "more", tmp_path / "drives", rate_hz=10.0).segment == "more"


def test_nothing_is_imported_where_all_is_damaged(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans")
    for path in source.iterdir():
        path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(BadInput, match="cut off"):
        run(source, tmp_path / "drives", rate_hz=10.0)
    assert not list((tmp_path / "drives").rglob("*.parquet"))


def test_the_fingerprint_holds_every_option(tmp_path: Path) -> None:
    source = write_scans(tmp_path / "scans")
    plain = ImportRequest(source, tmp_path / "d", scan=ScanOptions(rate_hz=10.0))
    recording = command._open(plain)
    others = [
        ImportRequest(source, tmp_path / "d", scan=ScanOptions(rate_hz=10.0, axes="rfu")),
        ImportRequest(source, tmp_path / "d", scan=ScanOptions(rate_hz=10.0), intensity_max=1.0),
        ImportRequest(source, tmp_path / "d", scan=ScanOptions(rate_hz=10.0), is_compensated=True),
        ImportRequest(source, tmp_path / "d", scan=ScanOptions(rate_hz=10.0), car_m=(0, 1, 0, 1)),
    ]
    found = {command._fingerprint(request, recording) for request in (plain, *others)}
    assert len(found) == 5
    elsewhere = ImportRequest(source, tmp_path / "e", "name", scan=ScanOptions(rate_hz=10.0))
    assert command._fingerprint(elsewhere, recording) in found
    assert FIRST_NS > 0
