"""What a run came to: what was found, what of it is suspicious and why, and what to do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.commands.drive_check import kept_report
from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.stages.rows import LabelRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Array

# Beside buses and lorries half of the points above the ground move on right drives (the built-in one: 44 %); with wrong
# poses 60 to 97 % do, and the check has named most of these before.
_MANY_MOVING = 0.6
_MIN_GROUND, _MAX_GROUND = 0.02, 0.98  # of the points of a drive on a road
_MANY_BOXES = 150.0  # a frame: more than a full street has road users
_MANY_LOST = 0.1  # of the frames
_MOST_SPEED_MPS = 70.0
_MANY_OF_ANY_CLASS, _MANY_OF_ONE_CLASS = 10, {"vehicle": 30}  # tracks: a motorway has vehicles alone
_ODD_LENGTHS_M = (0.3, 10.0)  # of the median box: people are longer, and buses are the exception


@dataclass(frozen=True)
class DriveResult:
    """What was made of one drive.

    Attributes:
        segment: Name of the drive.
        frames: Number of its frames.
        tracks: Number of its tracks.
        length_m: (n,) length of each box.
        speed_mps: (n,) speed of each box.
        class_name: (n,) class of each box.
        is_moving: (n,) whether it moves.
        counts: What each stage kept and dropped, by stage and reason.
        uses_pictures: Whether the drive has cameras whose pictures were to be used.
    """

    segment: str
    frames: int
    tracks: int
    length_m: Array
    speed_mps: Array
    class_name: Array
    is_moving: Array
    counts: Mapping[str, Mapping[str, int]]
    uses_pictures: bool

    def count(self, stage: str, reason: str) -> int:
        """Return how many items a stage counted under a reason."""
        return self.counts.get(stage, {}).get(reason, 0)


def verdict(workspace: Workspace, segments: Collection[str]) -> Iterator[str]:
    """Yield one line for each suspicion, and as the last line what the run came to.

    Args:
        workspace: The workspace of the labels.
        segments: Names of drives that have been labelled.
    """
    results = [_result(workspace, segment) for segment in segments]
    suspicions = []
    for result in results:
        found = [*_from_check(workspace, result.segment), *suspicions_of(result)]
        suspicions += [f"suspicious: {result.segment}: {finding.sentence}" for finding in found]
    yield from suspicions
    boxes, tracks = sum(len(result.length_m) for result in results), sum(result.tracks for result in results)
    moving = sum(int(result.is_moving.sum()) for result in results)
    drives = f"{len(results)} drive{'' if len(results) == 1 else 's'}"
    found_text = f"{boxes} boxes in {tracks} tracks, {moving} of them moving, in {drives}"
    if not boxes:
        found_text = f"no object was found in {drives}"
    if suspicions:
        plural = "thing is" if len(suspicions) == 1 else "things are"
        advice = "read the lines above before you use the labels"
        yield f"verdict: {found_text}; {len(suspicions)} {plural} suspicious: {advice}"
    else:
        yield f"verdict: {found_text}; nothing suspicious"


def _from_check(workspace: Workspace, segment: str) -> Iterator[Finding]:
    """Yield what the quick check found before the run, where it was asked."""
    report = kept_report(workspace, segment)
    if report is not None:
        yield from (finding for finding in report.findings if finding.level in ("warning", "fault"))


def suspicions_of(result: DriveResult) -> Iterator[Finding]:
    """Yield what is absurd in the labels of one drive."""
    yield from _about_points(result)
    if not len(result.length_m):
        yield _nothing_found(result)
        return
    yield from _about_boxes(result)
    yield from _about_words(result)


def _about_points(result: DriveResult) -> Iterator[Finding]:
    on_ground = result.count("ground", "ground points")
    above = result.count("ground", "points above ground")
    if not on_ground + above:
        yield Finding("points", "fault", "the drive has no points", remedy="look at the files of its sweeps")
        return
    share = on_ground / (on_ground + above)
    if not _MIN_GROUND <= share <= _MAX_GROUND:
        yield Finding(
            "ground",
            "warning",
            f"{share:.1%} of all points are ground",
            cause="the points have another unit or other axes, or the height of the LiDAR is another one",
            remedy=f"run: upvl check {result.segment}",
        )
    moving = result.count("mask", "points moving") / max(above, 1)
    if moving > _MANY_MOVING:
        yield Finding(
            "poses",
            "warning",
            f"{moving:.0%} of the points above the ground move",
            cause="the poses do not fit the sweeps",
            remedy=f"run: upvl check {result.segment}; or " + correction('poses = "ignored"'),
        )
    lost = result.count("odometry", "frames that could not be placed, poses interpolated")
    if lost > _MANY_LOST * result.frames:
        yield Finding(
            "poses",
            "warning",
            f"{lost} of {result.frames} frames could not be placed by odometry",
            cause="sweeps too far apart, or too few points",
            remedy="give poses, or leave these frames out",
        )


def _nothing_found(result: DriveResult) -> Finding:
    """Return why there is no box, by what the stages dropped."""
    drops = Counter(
        {
            f"{stage}: {reason}": items
            for stage, counts in result.counts.items()
            for reason, items in counts.items()
            if "dropped" in reason
        }
    )
    largest = ", ".join(f"{items} {reason}" for reason, items in drops.most_common(3))
    remedy = f"run: upvl check {result.segment}"
    if "too few boxes" in largest:
        remedy += "; where the drive is short or its sweeps are seconds apart, lower min_boxes in track.toml"
    return Finding(
        "labels",
        "warning",
        f"no object was found in {result.frames} frames" + (f": dropped were {largest}" if largest else ""),
        remedy=remedy,
    )


def _about_boxes(result: DriveResult) -> Iterator[Finding]:
    boxes = len(result.length_m)
    if boxes > _MANY_BOXES * result.frames:
        yield Finding(
            "labels",
            "warning",
            f"{boxes / result.frames:.0f} boxes a frame",
            cause="without words every bush and wall is an object" if not _has_words(result) else "",
            remedy="label what moves alone (--moving-only), or give pictures",
        )
    length_m = float(np.median(result.length_m))
    if not _ODD_LENGTHS_M[0] <= length_m <= _ODD_LENGTHS_M[1]:
        yield Finding(
            "labels",
            "warning",
            f"half of the boxes are {'longer' if length_m > 1 else 'shorter'} than {length_m:.1f} m",
            cause="the points have another unit",
            remedy=f"run: upvl check {result.segment}",
        )
    fast = int((result.speed_mps > _MOST_SPEED_MPS).sum())
    if fast:
        yield Finding(
            "labels",
            "warning",
            f"{fast} of {boxes} boxes are faster than {_MOST_SPEED_MPS:.0f} m/s",
            cause="poses or time stamps are wrong",
            remedy=f"run: upvl check {result.segment}",
        )


def _about_words(result: DriveResult) -> Iterator[Finding]:
    if not _has_words(result):
        if result.uses_pictures:
            yield Finding(
                "pictures",
                "warning",
                "no point has a feature of a picture, so every label is without a word",
                cause="the pictures are missing, have other names or times, or their calibration looks elsewhere",
                remedy=f"run: upvl check {result.segment}",
            )
        return
    classes = Counter(str(name) for name in result.class_name)
    (name, items), tracks = classes.most_common(1)[0], result.tracks
    if items == len(result.class_name) and tracks >= _MANY_OF_ONE_CLASS.get(name, _MANY_OF_ANY_CLASS):
        yield Finding(
            "labels",
            "warning",
            f"all {tracks} tracks are of one class, {name}",
            cause="the pictures do not show what the LiDAR sees, or are black",
            remedy=f"run: upvl check {result.segment}",
        )


def _has_words(result: DriveResult) -> bool:
    return any(reason.startswith("seen by ") for reason in result.counts.get("extract-vl", {}))


def _wants_pictures(workspace: Workspace) -> bool:
    stage = workspace.pipeline.by_name["extract-vl"]
    return bool(getattr(workspace.settings(stage), "images", "all") == "all")


def _result(workspace: Workspace, segment: str) -> DriveResult:
    labels = workspace.table("labels", LabelRow, segment)
    rows = list(labels)
    counts = {}
    for stage in workspace.pipeline.labelling_stages:
        if not stage.is_of_dataset:
            footer = read_footer(workspace.shard(stage.name, segment))
            counts[stage.name] = dict(footer.counts) if footer else {}

    def column(name: str, kind: str) -> Array:
        return np.concatenate([np.zeros(0, kind), *(np.asarray(getattr(row, name)) for row in rows)])

    velocity = np.concatenate([np.zeros((0, 3)), *(row.velocity_mps for row in rows)])
    sizes = np.concatenate([np.zeros((0, 3)), *(row.size_lwh_m for row in rows)])
    return DriveResult(
        segment=segment,
        frames=len(labels),
        tracks=len(np.unique(column("track_id", "int64"))),
        length_m=sizes[:, 0],
        speed_mps=np.linalg.norm(velocity[:, :2], axis=1),
        class_name=column("class_name", "str"),
        is_moving=column("is_moving", "bool"),
        counts=counts,
        uses_pictures=_wants_pictures(workspace) and bool(workspace.drive(segment).cameras),
    )
