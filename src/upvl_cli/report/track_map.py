"""The map of a drive as SVG: the way of the car and the tracks, in world axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import corners_bev
from upvl_cli.report.drive_labels import DriveLabels, TrackTable
from upvl_cli.report.figures import kind_of, round_step
from upvl_cli.types import Array, Boxes, Ints

WIDTH = 1000.0  # of the drawing
MARGIN = 24.0
MIN_HEIGHT, MAX_HEIGHT = 220.0, 1200.0
MIN_SPAN_M = 20.0
TOLERANCE = 0.7  # by how much a line may differ from the way that it shows, in units of the drawing
TRACK_BYTES = 260  # of a usual track: outline, way and tooltip


@dataclass(frozen=True)
class MapTrack:
    """One track: the outline of its box, its way where it moves, its class and the text of its tooltip."""

    outline: str
    way: str
    kind: str
    title: str


@dataclass(frozen=True)
class Arrow:
    """An axis of the world: the place of its tip from its foot, and its name."""

    x: float
    y: float
    name: str


@dataclass(frozen=True)
class TrackMap:
    """The map of a drive.

    Attributes:
        width: Width of the drawing.
        height: Height of the drawing.
        ego_way: Way of the car.
        ego_marker: Triangle at its end.
        tracks: The tracks, standing ones first.
        left_out: Number of tracks that the map has no room for.
        bar_width: Width of the scale bar.
        bar_text: Length that the scale bar stands for.
        axes: Axes of the world.
        summary: What the map shows, in words.
    """

    width: float
    height: float
    ego_way: str
    ego_marker: str
    tracks: tuple[MapTrack, ...]
    left_out: int
    bar_width: float
    bar_text: str
    axes: tuple[Arrow, Arrow]
    summary: str


@dataclass(frozen=True)
class _Scale:
    """How places of the world become places of the drawing: (x right, y up), or (x up, y left) where it is turned."""

    low_m: Array
    high_m: Array
    per_metre: float
    is_turned: bool

    def places(self, xy_world_m: Array) -> Array:
        across, up = (
            (self.high_m[1] - xy_world_m[:, 1], xy_world_m[:, 0] - self.low_m[0])
            if self.is_turned
            else (xy_world_m[:, 0] - self.low_m[0], xy_world_m[:, 1] - self.low_m[1])
        )
        return np.stack(
            [MARGIN + across * self.per_metre, self.height - MARGIN - up * self.per_metre], axis=1
        )

    @property
    def height(self) -> float:
        span_m = (self.high_m - self.low_m)[0 if self.is_turned else 1]
        return max(float(span_m * self.per_metre + 2 * MARGIN), MIN_HEIGHT)


def track_map(
    labels: DriveLabels, tracks: TrackTable, world_from_ego: Array, max_bytes: float
) -> TrackMap | None:
    """Return the map of a drive; None without a frame.

    Args:
        labels: The labels of the drive.
        tracks: Its tracks.
        world_from_ego: (T, 4, 4) pose of each frame of the labels.
        max_bytes: Size that the map may have, roughly.
    """
    if not len(labels.frames):
        return None
    pose = world_from_ego[labels.place]
    center_m = np.einsum("nij,nj->ni", pose[:, :3, :3], labels.boxes.center_m) + pose[:, :3, 3]
    ego_m = world_from_ego[:, :2, 3]
    scale = _scale_of(np.concatenate([ego_m, center_m[:, :2]]))
    room = max(int(max_bytes / TRACK_BYTES), 10)
    longest = np.sort(np.argsort(-tracks.num_boxes, kind="stable")[:room])
    standing_first = longest[np.argsort(tracks.is_moving[longest], kind="stable")]
    yaw_rad = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
    boxes = Boxes(center_m, labels.boxes.size_lwh_m, labels.boxes.heading_rad + yaw_rad)
    outlines = scale.places(corners_bev(boxes).reshape(-1, 2)).reshape(-1, 4, 2)
    ways = scale.places(center_m[:, :2])
    by_track = _places_by_track(labels.boxes.track_id)
    drawn = [
        _drawn_track(tracks, number, outlines, ways, by_track[int(tracks.track_id[number])])
        for number in standing_first.tolist()
    ]
    length_m = round_step((WIDTH - 2 * MARGIN) / scale.per_metre, 5)
    moving = int(tracks.is_moving.sum())
    return TrackMap(
        width=WIDTH,
        height=scale.height,
        ego_way=_text(_simplified(scale.places(ego_m))),
        ego_marker=_text(scale.places(_marker(world_from_ego[-1], scale))),
        tracks=tuple(drawn),
        left_out=len(tracks) - len(drawn),
        bar_width=length_m * scale.per_metre,
        bar_text=f"{length_m:g} m",
        axes=(Arrow(0, -1, "x"), Arrow(-1, 0, "y")) if scale.is_turned else (Arrow(1, 0, "x"), Arrow(0, -1, "y")),
        summary=f"Map of {labels.segment}: the way of the car, {moving} tracks that move and {len(tracks) - moving} "
        "that stand.",
    )  # fmt: skip


def _scale_of(xy_world_m: Array) -> _Scale:
    low_m, high_m = xy_world_m.min(axis=0) - 3.0, xy_world_m.max(axis=0) + 3.0  # half a long vehicle
    short = np.maximum(MIN_SPAN_M - (high_m - low_m), 0) / 2
    low_m, high_m = low_m - short, high_m + short
    span_m = high_m - low_m
    is_turned = bool(span_m[1] > span_m[0])
    across_m, up_m = span_m[::-1] if is_turned else span_m
    per_metre = min((WIDTH - 2 * MARGIN) / across_m, (MAX_HEIGHT - 2 * MARGIN) / up_m)
    return _Scale(low_m, high_m, float(per_metre), is_turned)


def _places_by_track(track_id: Ints) -> dict[int, Ints]:
    """Return the places of the boxes of each track, ascending."""
    order = np.argsort(track_id, kind="stable")
    ids, first = np.unique(track_id[order], return_index=True)
    return dict(zip(ids.tolist(), np.split(order, first[1:]), strict=True)) if len(ids) else {}


def _drawn_track(tracks: TrackTable, number: int, outlines: Array, ways: Array, places: Ints) -> MapTrack:
    is_moving = bool(tracks.is_moving[number])
    name, word = str(tracks.class_name[number]), str(tracks.word[number])
    speed = f", up to {tracks.top_speed_mps[number]:.1f} m/s" if is_moving else ", parked"
    title = f"{tracks.track_id[number]}: {name}" + (f" ({word})" if word and word != name else "")
    shown = places[-1] if is_moving else places[len(places) // 2]
    return MapTrack(
        outline=_text(outlines[shown]),
        way=_text(_simplified(ways[places])) if is_moving and len(places) > 1 else "",
        kind=kind_of(name),
        title=f"{title}, {tracks.duration_s[number]:.1f} s{speed}",
    )


def _marker(world_from_ego: Array, scale: _Scale) -> Array:
    """Return (3, 2) corners of a triangle that shows where the car is and heads."""
    size_m = 9.0 / scale.per_metre
    corners_ego_m = np.array([[1.4, 0.0], [-1.0, 0.9], [-1.0, -0.9]]) * max(size_m, 1.5)
    return corners_ego_m @ world_from_ego[:2, :2].T + world_from_ego[:2, 3]


def _simplified(way: Array) -> Array:
    """Return the points of a line that it cannot do without (Ramer, Douglas and Peucker)."""
    keep = np.zeros(len(way), bool)
    keep[[0, -1]] = True
    spans = [(0, len(way) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner, chord = way[first + 1 : last] - way[first], way[last] - way[first]
        length = float(np.hypot(*chord))
        apart = (
            np.abs(inner[:, 0] * chord[1] - inner[:, 1] * chord[0]) / length
            if length > TOLERANCE
            else np.hypot(inner[:, 0], inner[:, 1])
        )
        farthest = int(apart.argmax())
        if apart[farthest] > TOLERANCE:
            middle = first + 1 + farthest
            keep[middle] = True
            spans += [(first, middle), (middle, last)]
    return way[keep]


def _text(places: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places.tolist())
