"""What users have beside KITTI's own files: read as what it is, or refused by name, and never shifted unseen."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets.contract import check_dataset
from datasets.kitti.kitti_writers import write_object
from datasets.shared.point_writers import pcd
from tiny_kitti import TinyDrive, write_drive
from upvl_cli.datasets.kitti.dataset import Kitti
from upvl_cli.datasets.kitti.labels import KittiLabels
from upvl_cli.datasets.kitti.timestamps import lines_of_frames, times_of_frames
from upvl_cli.errors import BadInput


@pytest.fixture
def tiny(tmp_path: Path) -> TinyDrive:
    return write_drive(tmp_path)


def rename(folder: Path, name: Callable[[int], str], *folders: str) -> None:
    """Give the files of these folders other names, by their numbers."""
    for part in folders or ("velodyne_points", "image_02", "oxts"):
        for path in sorted((folder / part / "data").iterdir(), reverse=True):
            path.rename(path.with_name(name(int(path.stem)) + path.suffix))


def to_jpeg(folder: Path) -> None:
    for path in (folder / "image_02/data").iterdir():
        Image.open(path).save(path.with_suffix(".jpg"), quality=95)
        path.unlink()


def upper_suffixes(folder: Path) -> None:
    for part in ("velodyne_points", "image_02", "oxts"):
        for path in (folder / part / "data").iterdir():
            path.rename(path.with_suffix(path.suffix.upper()))


def prepend(mark: bytes) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for path in [*folder.parent.rglob("*.txt"), *folder.rglob("*.xml")]:
            path.write_bytes(mark + path.read_bytes())

    return change


def as_utf16(folder: Path) -> None:
    for path in folder.rglob("timestamps.txt"):
        path.write_bytes(path.read_text().encode("utf-16"))


def with_crlf(folder: Path) -> None:
    for path in folder.parent.rglob("*.txt"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))


def without_data_folders(folder: Path) -> None:
    for part in ("velodyne_points", "image_02"):
        for path in (folder / part / "data").iterdir():
            path.rename(folder / part / path.name)
        (folder / part / "data").rmdir()


DOORS: dict[str, Callable[[Path], None]] = {
    "JPEG": to_jpeg,
    "upper case": upper_suffixes,
    "six digits": lambda folder: rename(folder, lambda number: f"{number:06d}"),
    "no leading zeros": lambda folder: rename(folder, str),
    "byte-order marks": prepend(b"\xef\xbb\xbf"),
    "UTF-16": as_utf16,
    "lines of Windows": with_crlf,
    "no data folders": without_data_folders,
    "blank lines at the end": lambda folder: (
        [path.write_text(path.read_text() + "\n \n") for path in folder.rglob("timestamps.txt")] and None
    ),
}


@pytest.mark.parametrize("change", DOORS.values(), ids=DOORS)
def test_other_names_and_encodings_give_the_same_drive(
    tmp_path: Path, change: Callable[[Path], None]
) -> None:
    plain = write_drive(tmp_path / "plain")
    tiny = write_drive(tmp_path / "changed")
    change(tiny.folder)
    check_dataset(Kitti(tiny.root))
    before, after = (Kitti(drive.root).open(drive.segment) for drive in (plain, tiny))
    assert after.frames == before.frames and after.skipped == before.skipped == {}
    assert before.world_from_ego is not None and after.world_from_ego is not None
    np.testing.assert_array_equal(after.world_from_ego, before.world_from_ego)
    for frame in after.frames:
        np.testing.assert_array_equal(
            after.points(frame.index).xyz_ego_m, before.points(frame.index).xyz_ego_m
        )
        images = [drive.image(frame.index, "image_02") for drive in (before, after)]
        assert images[0] is not None and images[1] is not None
        assert images[0].time_ns == images[1].time_ns
        assert np.abs(images[0].rgb.astype(int) - images[1].rgb).mean() < 10
    rows = [KittiLabels(drive.root).labels(drive.segment).to_rows() for drive in (plain, tiny)]
    np.testing.assert_array_equal(*rows)


# ---- numbers and time stamps


@pytest.mark.parametrize("start", [1, 20, 60])
@pytest.mark.parametrize("has_all_lines", [True, False], ids=["a line for every number", "a line a file"])
def test_a_drive_may_start_at_any_number(tiny: TinyDrive, start: int, has_all_lines: bool) -> None:
    rename(tiny.folder, lambda number: f"{number + start:010d}")
    if has_all_lines:
        for path in tiny.folder.rglob("timestamps.txt"):
            lines = path.read_text().splitlines()
            early_ns = int(tiny.time_ns[0]) - 100_000_000 * np.arange(start, 0, -1)
            early = [str(np.datetime64(int(ns), "ns")).replace("T", " ") for ns in early_ns]
            path.write_text("\n".join(early + lines))
    drive = Kitti(tiny.root).open(tiny.segment)
    assert [frame.index for frame in drive.frames] == [start + number for number in range(4)]
    assert [frame.time_ns for frame in drive.frames] == tiny.time_ns.tolist()
    assert drive.skipped == ({"no sweep": start} if has_all_lines else {})
    for step, frame in enumerate(drive.frames):
        image = drive.image(frame.index, "image_02")
        assert image is not None and image.time_ns == tiny.time_ns[step] + 2_000_000
        np.testing.assert_allclose(drive.points(frame.index).xyz_ego_m, tiny.xyz_ego_m[step], atol=0.03)


PAIRS: dict[str, tuple[int, list[int], dict[int, int] | str]] = {
    "from 0": (3, [0, 1, 2], {0: 0, 1: 1, 2: 2}),
    "from 0 with a gap": (4, [0, 2, 3], {0: 0, 1: 1, 2: 2, 3: 3}),
    "from 0, lines end early": (2, [0, 1, 2], {0: 0, 1: 1}),
    "from 1": (3, [1, 2, 3], {1: 0, 2: 1, 3: 2}),
    "from 1 with line 0": (4, [1, 2, 3], {0: 0, 1: 1, 2: 2, 3: 3}),
    "from 60": (2, [60, 61], {60: 0, 61: 1}),
    "from 2, more lines than files, one short": (4, [2, 3, 4], {0: 0, 1: 1, 2: 2, 3: 3}),
    "every fifth at an even pace": (3, [0, 5, 10], {0: 0, 5: 1, 10: 2}),
    "no file": (2, [], {0: 0, 1: 1}),
    "from 1, lines end early": (2, [1, 2, 3], "has 2 lines for 3 files numbered 1 to 3"),
    "from 1, no line": (0, [1, 2], "has 0 lines for 2 files"),
    "a gap as many lines do not show": (3, [0, 2, 3], "has 3 lines for 3 files numbered 0 to 3"),
}


@pytest.mark.parametrize(("lines", "files", "expected"), PAIRS.values(), ids=PAIRS)
def test_which_line_is_of_which_frame(lines: int, files: list[int], expected: dict[int, int] | str) -> None:
    times = [10**18 + 10**8 * line for line in range(lines)]
    if isinstance(expected, str):
        with pytest.raises(BadInput, match=expected):
            times_of_frames(times, files, Path("times"))
    else:
        found = times_of_frames(times, files, Path("times"))
        assert found == {frame: times[line] for frame, line in expected.items()}


def test_lines_without_times_follow_no_gap() -> None:
    with pytest.raises(BadInput, match="without a gap"):
        lines_of_frames(3, [0, 5, 10], Path("poses"))


def test_pictures_of_other_numbers_are_refused(tiny: TinyDrive) -> None:
    rename(tiny.folder, lambda number: f"{number + 70:010d}", "image_02")
    with pytest.raises(
        BadInput, match=r"4 files like 0000000070.png in .*, none with the number of a sweep \(0 to 3\)"
    ):
        Kitti(tiny.root).open(tiny.segment)


def test_two_files_of_one_number_are_refused(tiny: TinyDrive) -> None:
    path = tiny.folder / "image_02/data/0000000001.png"
    Image.open(path).save(path.with_name("000001.jpg"))
    with pytest.raises(BadInput, match="two files of frame 1: 0000000001.png and 000001.jpg"):
        Kitti(tiny.root).open(tiny.segment)


# ---- what a .bin holds


def sweep(tiny: TinyDrive) -> np.ndarray:
    return np.fromfile(tiny.folder / "velodyne_points/data/0000000001.bin", "<f4").reshape(-1, 4)


def rows(columns: int, dtype: str = "<f4") -> Callable[[np.ndarray], bytes]:
    """So many columns: x, y, z, reflectance, ring, time."""

    def write(values: np.ndarray) -> bytes:
        ring = np.arange(len(values)) % 64
        table = np.column_stack([values, ring, np.linspace(0, 0.1, len(values))])
        count = len(table) // 4 * 4  # a size that rows of 4 float32 would fill, too
        return table[:count, :columns].astype(dtype).tobytes()

    return write


def npy(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


NAMED = {
    "five columns": (rows(5), "holds 5 columns of float32 .*, expected 4 columns of float32"),
    "six columns": (rows(6), "holds 6 columns of float32"),
    "float64": (rows(4, "<f8"), "holds 4 columns of float64"),
    "big-endian": (rows(4, ">f4"), "holds 4 columns of big-endian float32"),
    "gzip": (lambda values: gzip.compress(values.tobytes()), "is compressed by gzip"),
    "PCD": (lambda values: pcd(values, "binary"), "is a PCD file"),
    "npy": (npy, "is a npy file"),
}


@pytest.mark.parametrize(("write", "message"), NAMED.values(), ids=NAMED)
def test_other_contents_are_named(
    tiny: TinyDrive, write: Callable[[np.ndarray], bytes], message: str
) -> None:
    path = tiny.folder / "velodyne_points/data/0000000001.bin"
    path.write_bytes(write(sweep(tiny)))
    with pytest.raises(BadInput, match=message) as refusal:
        Kitti(tiny.root).open(tiny.segment).points(1)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_sweep_may_have_no_reflectance(tiny: TinyDrive) -> None:
    path = tiny.folder / "velodyne_points/data/0000000001.bin"
    values = sweep(tiny)
    for count in (len(values), len(values) // 4 * 4):  # also of a size that rows of four would fill
        path.write_bytes(values[:count, :3].astype("<f4").tobytes())
        points = Kitti(tiny.root).open(tiny.segment).points(1)
        np.testing.assert_allclose(points.xyz_ego_m, tiny.xyz_ego_m[1][:count], atol=1e-4)
        assert not points.intensity.any()


def test_rays_without_return_are_left_out(tiny: TinyDrive) -> None:
    path = tiny.folder / "velodyne_points/data/0000000001.bin"
    values = np.repeat(sweep(tiny), 2, axis=0)
    values[::2, :3] = np.nan
    values[-1, 3] = np.inf  # a reflectance that is no number is 0
    values.tofile(path)
    points = Kitti(tiny.root).open(tiny.segment).points(1)
    np.testing.assert_allclose(points.xyz_ego_m, tiny.xyz_ego_m[1], atol=1e-4)
    assert points.intensity[-1] == 0 and (points.intensity[:-1] > 0).all()


@pytest.mark.parametrize("full", [1, 255, 65535])
def test_the_scale_of_the_reflectance_is_that_of_the_drive(tiny: TinyDrive, full: int) -> None:
    for path in (tiny.folder / "velodyne_points/data").iterdir():
        values = np.fromfile(path, "<f4").reshape(-1, 4)
        values[:, 3] *= full
        if path.stem.endswith("1"):
            values[:, 3] = np.minimum(
                values[:, 3], 0.5
            )  # a sweep of dark things keeps the scale of the others
        values.tofile(path)
    drive = Kitti(tiny.root).open(tiny.segment)
    assert drive.points(0).intensity.max() == pytest.approx(0.8)
    assert drive.points(1).intensity.max() <= 0.5 and (full == 1 or drive.points(1).intensity.max() < 0.01)


# ---- other cars


def test_another_car_is_measured_and_keeps_its_points(tmp_path: Path) -> None:
    truth = write_object(tmp_path)
    roof = np.array([[-0.6, 1.2, 0.6, 0.1]], "<f4")
    for path in (truth.folder / "velodyne").iterdir():
        values = np.fromfile(path, "<f4").reshape(-1, 4)
        values[:, 2] -= 0.6  # the LiDAR is 2.33 m above the road
        np.vstack([roof, values]).tofile(path)
    drive = Kitti(tmp_path).open(truth.segment)
    assert drive.ground_z_m == pytest.approx(-2.33, abs=0.02)
    assert len(drive.points(1)) == len(truth.xyz_ego_m[1]) + 1


def test_rays_without_return_at_the_origin_are_left_out_around_another_car(tmp_path: Path) -> None:
    truth = write_object(tmp_path, delft=True)
    path = truth.folder / "velodyne/000001.bin"
    values = np.fromfile(path, "<f4").reshape(-1, 4)
    np.vstack([values, np.zeros((7, 4), "<f4")]).tofile(path)
    assert len(Kitti(tmp_path).open(truth.segment).points(1)) == len(values)


def test_kittis_own_recordings_need_no_measurement(tiny: TinyDrive) -> None:
    for path in (tiny.folder / "velodyne_points/data").iterdir():
        values = np.fromfile(path, "<f4").reshape(-1, 4)
        values[:, 2] += 0.9  # a steep hill, or a queue of cars: what is measured is wrong
        values.tofile(path)
    drive = Kitti(tiny.root).open(tiny.segment)
    assert drive.ground_z_m == -1.73 and drive.vehicle.has_outline


def test_axes_on_the_road_are_measured_under_kittis_name_too(tiny: TinyDrive) -> None:
    for path in (tiny.folder / "velodyne_points/data").iterdir():
        values = np.fromfile(path, "<f4").reshape(-1, 4)
        values[:, 2] += 1.73
        values.tofile(path)
    drive = Kitti(tiny.root).open(tiny.segment)
    assert drive.ground_z_m == pytest.approx(0.0, abs=0.05) and drive.vehicle.has_outline
