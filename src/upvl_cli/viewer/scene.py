"""The frames of a drive, ready to be logged: points thinned, boxes and tails in place, pictures reduced."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from upvl_cli.geometry.se3 import apply
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import LabelRow
from upvl_cli.types import Array, Camera, Floats, Ints
from upvl_cli.viewer.drive_tables import DriveTables, chosen_frames
from upvl_cli.viewer.layers import layer_colours
from upvl_cli.viewer.pictures import BoxEdges, box_edges, jpeg, reduction, size_of
from upvl_cli.viewer.thinning import evenly_thinned

MAX_POINTS = 20_000  # a frame, by default: see bench/view.py for the bytes
PICTURE_PX = 640  # along the longer side, by default
TAIL_FRAMES = 20  # 2 s of past path at 10 Hz
_STEPS_OF_A_METRE = 256  # positions are rounded to 4 mm: the bits below are noise, which does not compress


@dataclass(frozen=True)
class ViewOptions:
    """What of a drive is shown.

    Attributes:
        frame_range: First and last frame; None takes all.
        max_points: The most points of a frame; None keeps all.
        picture_px: The most pixels along the longer side of a picture; None keeps all.
    """

    frame_range: tuple[int, int] | None = None
    max_points: int | None = MAX_POINTS
    picture_px: int | None = PICTURE_PX


@dataclass(frozen=True)
class SweepView:
    """The points of one frame that are shown.

    Attributes:
        xyz_ego_m: (n, 3) positions.
        layers: (n,) colours of each layer by its name, see `viewer.layers`.
        words: Names of words.
        word_index: (n,) place of the word of each point in `words`, -1 for none; None where words were not made.
        total: How many points the sweep has.
    """

    xyz_ego_m: Floats
    layers: Mapping[str, Ints]
    words: tuple[str, ...]
    word_index: Ints | None
    total: int


@dataclass(frozen=True)
class PictureView:
    """One reduced picture as JPEG, and the edges of the boxes in it."""

    jpeg: bytes
    edges: BoxEdges


@dataclass(frozen=True)
class FrameView:
    """All that is shown of one frame; None and absent names stand for what there is not.

    Attributes:
        frame: Number of the frame.
        time_s: Time since the first frame of the drive.
        world_from_ego: (4, 4) pose in the axes of the shown world.
        sweep: The points.
        labels: The boxes, in ego axes.
        tails: Of each track (m, 3) its past centres, oldest first, in the axes of the shown world.
        pictures: By the name of the camera.
    """

    frame: int
    time_s: float
    world_from_ego: Array | None
    sweep: SweepView | None
    labels: LabelRow | None
    tails: Mapping[int, Floats]
    pictures: Mapping[str, PictureView]


class DriveScene:
    """One drive as the viewer shows it. Frames are made when they are asked for: memory does not grow with them."""

    def __init__(self, workspace: Workspace, segment: str, options: ViewOptions) -> None:
        """Open a drive.

        Args:
            workspace: The workspace of the drive.
            segment: Name of the drive.
            options: What of it is shown.

        Raises:
            UpvlError: There is no such drive, nothing is there of it, or no frame of the range.
        """
        self.tables = DriveTables(workspace, segment)
        self.options = options
        self.frames = chosen_frames(self.tables, options.frame_range)
        self._start_ns = next(iter(self.tables.times_ns.values()))

    @property
    def segment(self) -> str:
        """Name of the drive."""
        return self.tables.segment

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of the drive."""
        return () if self.tables.drive is None else self.tables.drive.cameras

    @cached_property
    def poses(self) -> dict[int, Array]:
        """(4, 4) pose of each frame by its number, moved so that the first one stands at the origin.

        The viewer keeps positions in single precision, which map coordinates do not fit.
        """
        given = self.tables.world_from_ego
        origin_m = next((pose[:3, 3] for pose in given.values()), np.zeros(3))
        moved = {frame: pose.copy() for frame, pose in given.items()}
        for pose in moved.values():
            pose[:3, 3] -= origin_m
        return moved

    @property
    def path_m(self) -> Floats:
        """(T, 3) the way of the car in the shown world."""
        return np.array([pose[:3, 3] for pose in self.poses.values()]).reshape(-1, 3)

    @property
    def rate_hz(self) -> float:
        """Frames a second; 10 where a single frame cannot tell."""
        times_ns = list(self.tables.times_ns.values())
        steps_ns = np.diff(times_ns)
        return float(1e9 / np.median(steps_ns)) if len(steps_ns) and np.median(steps_ns) > 0 else 10.0

    @property
    def layer_names(self) -> tuple[str, ...]:
        """The layers of points that there are, the most telling one first."""
        if self.tables.drive is None:
            return ()
        has = self.tables.has
        needs = {"flow": "flow", "height": "ground", "ground": "ground", "moving": "mask"}
        made = [layer for layer, stage in needs.items() if stage in has]
        return (*(["words"] if has & {"labels", "semantics"} else []), *made, "intensity")

    def frame_views(self) -> Iterator[FrameView]:
        """Yield the frames, in order; several are prepared at a time."""
        tails: dict[int, deque[Floats]] = {}
        for view in in_order(self._view, self.frames):
            yield _with_tails(view, tails)

    def _view(self, frame: int) -> FrameView:
        labels = self.tables.labels(frame)
        return FrameView(
            frame,
            (self.tables.times_ns[frame] - self._start_ns) * 1e-9,
            self.poses.get(frame),
            self._sweep(frame),
            labels,
            {},
            dict(self._pictures(frame, labels)),
        )

    def _sweep(self, frame: int) -> SweepView | None:
        points = self.tables.points(frame)
        if points is None:
            return None
        xyz_m = points.points.xyz_ego_m
        finite = np.flatnonzero(np.isfinite(xyz_m).all(axis=1))
        most = self.options.max_points
        kept = finite if most is None else finite[evenly_thinned(xyz_m[finite], most)]
        rounded = np.round(xyz_m[kept] * _STEPS_OF_A_METRE) / _STEPS_OF_A_METRE
        return SweepView(
            rounded.astype(np.float32),
            {name: values[kept] for name, values in layer_colours(points).items()},
            points.words,
            None if points.word_index is None else points.word_index[kept],
            len(xyz_m),
        )

    def _pictures(self, frame: int, labels: LabelRow | None) -> Iterator[tuple[str, PictureView]]:
        for camera in self.cameras:
            assert self.tables.drive is not None
            image = self.tables.drive.image(frame, camera.name)
            if image is not None:
                scale = reduction(camera, self.options.picture_px)
                edges = BoxEdges([], [], {}) if labels is None else box_edges(camera, labels.boxes, scale)
                yield camera.name, PictureView(jpeg(image.rgb, size_of(camera, scale)), edges)


def _with_tails(view: FrameView, tails: dict[int, deque[Floats]]) -> FrameView:
    """Return the frame with the past centres of its tracks; `tails` grows by the present ones."""
    if view.labels is None or view.world_from_ego is None:
        return view
    centers_m = apply(view.world_from_ego, view.labels.center_m)
    present: Sequence[int] = view.labels.track_id.tolist()
    for track_id in set(tails) - set(present):
        del tails[track_id]
    for track_id, center_m in zip(present, centers_m, strict=True):
        if track_id >= 0:
            tails.setdefault(track_id, deque(maxlen=TAIL_FRAMES)).append(center_m)
    shown = {track_id: np.array(tail) for track_id, tail in tails.items() if len(tail) > 1}
    return FrameView(**{**vars(view), "tails": shown})
