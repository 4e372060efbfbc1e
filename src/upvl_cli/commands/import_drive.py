"""Make a drive of `dataset = "parquet"` from a recording of one's own sensors."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pyarrow.parquet as pq

from upvl_cli.datasets.parquet.writer import IMAGES, PictureRow, picture_table, table_writer, write_cameras
from upvl_cli.datasets.recordings.conversion import measure
from upvl_cli.datasets.recordings.recording import LeftOut, Recording
from upvl_cli.datasets.recordings.scan_folder import ScanOptions as ScanOptions
from upvl_cli.datasets.recordings.scan_folder import open_scan_folder, segment_name
from upvl_cli.datasets.recordings.store import MARK, ImportCounts, check_free, mark_of, write_points
from upvl_cli.datasets.recordings.sustech import is_sustech, open_sustech
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.paths import check_segment_name
from upvl_cli.errors import BadInput, BadSetting, UpvlError
from upvl_cli.pipeline.storage.remote_path import has_scheme
from upvl_cli.runtime.atomic import write_if_changed

_VERSION = 1  # raised by hand when the same recording gives other tables


@dataclass(frozen=True)
class ImportRequest:
    """What is imported, to where, and what its owner says about it.

    Attributes:
        source: A folder of point files, a SUSTechPOINTS scene, or a ROS recording.
        folder: The folder of drives that is written.
        segment: Name of the drive; empty for that of the source.
        scan: What the owner says about a folder.
        topics: Topic map of a ROS recording.
        intensity_max: The intensity that 1 stands for; None to see from the recording.
        is_compensated: Points are motion-compensated although they have times.
        car_m: x from and to, y from and to, of the own car, whose points are dropped; or None.
    """

    source: Path
    folder: Path
    segment: str = ""
    scan: ScanOptions = field(default_factory=ScanOptions)
    topics: Path | None = None
    intensity_max: float | None = None
    is_compensated: bool = False
    car_m: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class ImportSummary:
    """What an import did.

    Attributes:
        segment: Name of the drive.
        counts: What was written and left out.
        notes: What was recognised.
        cameras: Names of the cameras.
        was_there: The drive was there already, of the same files and settings.
    """

    segment: str
    counts: ImportCounts
    notes: tuple[str, ...]
    cameras: tuple[str, ...]
    was_there: bool


Watch = Callable[[str, int, int], None]
"""Called with what is done ("sweeps", "pictures"), how many more of it, and how many there are."""


def import_drive(request: ImportRequest, watch: Watch) -> ImportSummary:
    """Write the tables of one drive, and return what was done.

    Args:
        request: What is imported.
        watch: Told of every step.

    Raises:
        BadInput: The recording is damaged, or something does not fit together.
        BadSetting: An option is wrong.
        UpvlError: The folder cannot be written, or holds a file of that name that no import wrote.
    """
    for place in (request.source, request.folder):
        if has_scheme(str(place)):
            raise BadSetting(
                f"{place.parts[0]}//{'/'.join(place.parts[1:])} is in an object store, which import does not read or "
                "write; copy the recording to this machine, and afterwards the drive to the store"
            )
    if request.folder.exists() and not request.folder.is_dir():
        raise BadSetting(f"{request.folder} is a file; expected a folder of drives to write into")
    try:
        recording = _open(request)
    except OSError as error:  # a folder that may not be looked into
        raise unreadable(request.source, error) from None
    segment = check_segment_name(request.segment or recording.name, "--segment")
    paths = {name: request.folder / name / f"{segment}.parquet" for name in ("points", "cameras", "images")}
    for path in paths.values():
        check_free(path)
    fingerprint = _fingerprint(request, recording)
    camera_names = tuple(camera.name for camera in recording.cameras)
    done = ImportCounts.read(paths["images" if recording.cameras else "points"], fingerprint)
    points_done = ImportCounts.read(paths["points"], fingerprint)
    # A drive is listed by its table of points: that one appears last, when the pictures are there.
    staged = paths["points"].with_name(f".{segment}.staged")
    if done is not None and points_done is not None:
        return ImportSummary(segment, done, recording.notes, camera_names, was_there=True)
    conversion = measure(recording.sample(), request.intensity_max, request.car_m)
    is_compensated = request.is_compensated or not conversion.has_times
    if done is None and points_done is not None:
        os.replace(paths["points"], staged)
    points_done = ImportCounts.read(staged, fingerprint)
    if points_done is None:
        _remove_imported(paths["points"])
        metadata = {"motion_compensated": "true" if is_compensated else "false"}
        points_done = write_points(
            staged, paths["points"].with_name(f".{segment}.parts"), recording, conversion, fingerprint, metadata,
            lambda count: watch("sweeps", count, recording.total),
        )  # fmt: skip
    _write_pictures({**paths, "points": staged}, recording, fingerprint, points_done, watch)
    os.replace(staged, paths["points"])
    notes = (*recording.notes, *conversion.notes)
    if conversion.has_times and not is_compensated:
        notes = (
            *notes,
            "points are as measured while the LiDAR turned: they are moved by the poses when they are read",
        )
    return ImportSummary(segment, points_done, notes, camera_names, was_there=False)


def _open(request: ImportRequest) -> Recording:
    """Return the recording, by what the source is."""
    if not request.source.exists():
        raise BadInput(f"{request.source} is not there; expected a folder of point files, or a ROS recording")
    from upvl_cli.datasets.recordings.ros_source import is_ros

    if is_ros(request.source):
        return _open_ros(request)
    if request.topics is not None:
        raise BadSetting(f"--topics is for ROS recordings, and {request.source} is none")
    if not request.source.is_dir():
        raise BadInput(
            f"{request.source} is a file; expected a folder of point files, or an .mcap, .db3 or .bag file"
        )
    if is_sustech(request.source):
        return open_sustech(request.source, request.scan)
    return open_scan_folder(request.source, request.scan)


def _open_ros(request: ImportRequest) -> Recording:
    from upvl_cli.datasets.recordings.ros import open_ros, propose

    if request.scan != ScanOptions():
        raise BadSetting(
            "--poses, --times, --rate-hz, --axes, --mount and --cameras are for folders of point files; a ROS "
            "recording has a topic map: --topics"
        )
    if request.topics is not None:
        if not request.topics.is_file():
            raise BadSetting(f"{request.topics} is missing; without --topics a map is proposed")
        return open_ros(request.source, request.topics)
    path = request.folder / f"{request.segment or segment_name(request.source)}.topics.toml"
    if not path.exists():
        write_if_changed(path, propose(request.source))
    raise BadSetting(
        f"{request.source} needs a map of its topics: one was proposed in {path}, with all topics of the recording; "
        f"look at it, then run: upvl import {request.source} {request.folder} --topics {path}"
    )


def _fingerprint(request: ImportRequest, recording: Recording) -> str:
    """Return a digest of the files that are read, and of all that was said about them."""
    try:
        files = sorted(
            (os.path.relpath(path, request.source), stat.st_size, stat.st_mtime_ns)
            for path in set(recording.files)
            for stat in [path.stat()]
        )
    except OSError as error:
        raise BadInput(
            f"{error.filename} cannot be read ({error.strerror}); check that it is there"
        ) from None
    said = {**asdict(request), "source": "", "folder": "", "segment": ""}
    text = json.dumps([_VERSION, files, said], default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _write_pictures(
    paths: dict[str, Path], recording: Recording, fingerprint: str, counts: ImportCounts, watch: Watch
) -> None:
    """Write the cameras and their pictures; what an earlier import left of them is removed where there are none."""
    if not recording.cameras:
        _remove_imported(paths["cameras"])
        _remove_imported(paths["images"])
        return
    mark = {MARK: json.dumps({"fingerprint": fingerprint})}
    write_cameras(paths["cameras"], recording.cameras, mark)
    table = pq.read_table(paths["points"], columns=["frame", "time_ns"])
    times_ns = dict(zip(table["frame"].to_pylist(), table["time_ns"].to_pylist(), strict=True))
    total = len(times_ns) * len(recording.cameras)
    with table_writer(paths["images"], IMAGES, {}) as writer:
        for picture in recording.pictures(times_ns):
            if isinstance(picture, LeftOut):
                counts.leave_out(picture)
            else:
                row = PictureRow(picture.frame, picture.camera, picture.time_ns, picture.data)
                writer.write_table(picture_table(row))
                counts.pictures += 1
            watch("pictures", 1, total)
        writer.add_key_value_metadata({MARK: counts.text(fingerprint)})


def _remove_imported(path: Path) -> None:
    if mark_of(path) is not None:
        try:
            path.unlink()
        except OSError as error:
            raise UpvlError(
                f"{path} cannot be replaced: {error.strerror}; make the folder writable"
            ) from None
