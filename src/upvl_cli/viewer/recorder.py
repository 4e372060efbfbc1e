"""Log a drive into a recording of Rerun, frame after frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.stages.rows import LabelRow
from upvl_cli.types import Array, Camera
from upvl_cli.viewer import entities
from upvl_cli.viewer.blueprint import blueprint_of
from upvl_cli.viewer.layers import LEGEND, WordNumbers
from upvl_cli.viewer.library import flush, rerun_library
from upvl_cli.viewer.pictures import reduction, size_of
from upvl_cli.viewer.scene import DriveScene, FrameView, PictureView, SweepView

FRAME_TIMELINE, TIME_TIMELINE = "frame", "time"
# The library queues without bound what its sink has not taken yet: memory would grow by 0.2 MiB a frame. The first
# frame goes out at once.
_FLUSH_FRAMES = 16
_CLASS_COLOURS: dict[str, colours.Colour] = {
    "vehicle": (90, 150, 255),
    "pedestrian": (255, 84, 104),
    "cyclist": (255, 176, 70),
    "other": (190, 140, 230),
    "unknown": (176, 184, 196),
}
_POINT_RADIUS_PX, _EDGE_RADIUS_PX = 1.3, 1.2
_CAMERA_PLANE_M = 1.5  # distance of the drawn picture plane from the camera in 3D


def record(
    recording: Any,
    scene: DriveScene,
    texts: Mapping[str, Callable[[], str]],
    tick: Callable[[], None] = lambda: None,
) -> None:
    """Log a drive: what stays, then the frames in order, then the texts, which may take long to measure.

    Args:
        recording: A `rerun.RecordingStream` with a sink.
        scene: The drive.
        texts: Markdown about the drive, by the name of its view; each is asked for once all frames are logged, and
            an empty one is left out.
        tick: Called after each frame.
    """
    recorder = DriveRecorder(recording, scene)
    recorder.log_static((*texts, "colours"))
    recorder.log_text("colours", LEGEND)
    for number, view in enumerate(scene.frame_views()):
        recorder.log_frame(view)
        if number % _FLUSH_FRAMES == 0:
            flush(recording)
        tick()
    for name, text in texts.items():
        recorder.log_text(name, text())


class DriveRecorder:
    """Writes the frames of one drive into a recording."""

    def __init__(self, recording: Any, scene: DriveScene) -> None:
        """Begin with nothing logged.

        Args:
            recording: A `rerun.RecordingStream` with a sink.
            scene: The drive.
        """
        self._rerun = rerun_library()
        self._recording = recording
        self._scene = scene
        self._words = WordNumbers()
        self._words_logged = 0

    def log_static(self, texts: tuple[str, ...]) -> None:
        """Log what does not change: the layout, the cameras, the way of the car, the names of layers.

        Args:
            texts: Names of the texts that will follow.
        """
        rr, recording, scene = self._rerun, self._recording, self._scene
        recording.send_recording_name(scene.segment)
        recording.send_blueprint(blueprint_of(scene, texts))
        recording.log(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if len(scene.path_m) > 1:
            path = rr.LineStrips3D([scene.path_m], colors=[colours.TEXT], radii=rr.Radius.ui_points(1.0))
            recording.log(entities.EGO_PATH, path, static=True)
        arrow = rr.Arrows3D(vectors=[[3.0, 0.0, 0.0]], colors=[colours.TEXT], labels=["car"], radii=[0.06])
        recording.log(entities.CAR, arrow, static=True)
        if scene.layer_names:
            radius = rr.Radius.ui_points(_POINT_RADIUS_PX)
            style = rr.Points3D.from_fields(radii=radius, show_labels=False)
            recording.log(entities.POINTS, style, static=True)
        for camera in scene.cameras:
            self._log_camera(camera)

    def _log_camera(self, camera: Camera) -> None:
        rr = self._rerun
        scale = reduction(camera, self._scene.options.picture_px)
        intrinsic = camera.intrinsic.copy()
        # The camera counts from the centre of its first pixel, the viewer from the corner of the picture.
        intrinsic[:2, 2] += 0.5
        intrinsic[:2] *= scale
        path = entities.camera_path(camera.name)
        self._recording.log(path, self._transform(camera.ego_from_camera), static=True)
        pinhole = rr.Pinhole(
            image_from_camera=intrinsic,
            resolution=size_of(camera, scale),
            image_plane_distance=_CAMERA_PLANE_M,
        )
        self._recording.log(path, pinhole, static=True)

    def _transform(self, parent_from_child: Array) -> Any:
        return self._rerun.Transform3D(translation=parent_from_child[:3, 3], mat3x3=parent_from_child[:3, :3])

    def _log_words(self) -> None:
        """Log the names of the words; again where a frame has brought new ones."""
        context = self._rerun.AnnotationContext(list(self._words.entries()))
        self._recording.log(entities.POINTS, context, static=True)
        self._words_logged = len(self._words)

    def log_frame(self, view: FrameView) -> None:
        """Log one frame at its number and its time."""
        self._recording.set_time(FRAME_TIMELINE, sequence=view.frame)
        self._recording.set_time(TIME_TIMELINE, duration=view.time_s)
        if view.world_from_ego is not None:
            self._recording.log(entities.EGO, self._transform(view.world_from_ego))
        if view.sweep is not None:
            self._log_points(view.sweep)
        if view.labels is not None:
            self._log_boxes(view.labels)
            self._log_tails(view)
        elif "labels" in self._scene.tables.has:
            for path in (entities.BOXES, entities.HEADINGS, entities.TAILS):
                self._recording.log(path, self._rerun.Clear(recursive=True))
        for camera in self._scene.cameras:
            self._log_picture(camera, view.pictures.get(camera.name), view.labels)

    def _log_points(self, sweep: SweepView) -> None:
        rr = self._rerun
        layers, numbers = dict(sweep.layers), None
        if sweep.word_index is not None:
            numbers = self._words.numbers(sweep.words, sweep.word_index)
            layers["words"] = self._words.palette[numbers]
            if len(self._words) != self._words_logged:
                self._log_words()
        components = {name: rr.components.ColorBatch(values) for name, values in layers.items()}
        self._recording.log(
            entities.POINTS,
            rr.Points3D(sweep.xyz_ego_m, class_ids=numbers),
            rr.DynamicArchetype(entities.LAYERS, components=components),
        )

    def _log_boxes(self, labels: LabelRow) -> None:
        rr = self._rerun
        half = labels.heading_rad / 2
        zeros = np.zeros_like(half)
        box_colours = class_colours(labels)
        self._recording.log(
            entities.BOXES,
            rr.Boxes3D(
                centers=labels.center_m,
                sizes=labels.size_lwh_m,
                quaternions=np.column_stack([zeros, zeros, np.sin(half), np.cos(half)]),
                colors=box_colours,
                labels=box_texts(labels),
                radii=rr.Radius.ui_points(_EDGE_RADIUS_PX),
                fill_mode=rr.components.FillMode.MajorWireframe,  # points inside stay visible
            ),
            self._box_values(labels),
        )
        ahead = np.column_stack([np.cos(labels.heading_rad), np.sin(labels.heading_rad), zeros])
        front_m = labels.center_m + ahead * labels.size_lwh_m[:, :1] / 2
        strips = np.stack([labels.center_m, front_m], axis=1)
        headings = rr.LineStrips3D(strips, colors=box_colours, radii=rr.Radius.ui_points(_EDGE_RADIUS_PX))
        self._recording.log(entities.HEADINGS, headings)

    def _box_values(self, labels: LabelRow) -> Any:
        """Return what the viewer lists of a box under the mouse; typed, so that a frame without boxes clears it."""
        import pyarrow as pa

        values = {
            "track_id": pa.array(labels.track_id, pa.int64()),
            "class_name": pa.array(labels.class_name.tolist(), pa.string()),
            "word": pa.array(labels.word.tolist(), pa.string()),
            "score": pa.array(labels.score, pa.float32()),
            "speed_mps": pa.array(np.linalg.norm(labels.velocity_mps[:, :2], axis=1), pa.float32()),
            "num_points": pa.array(labels.num_points, pa.int32()),
        }
        return self._rerun.DynamicArchetype(entities.LABEL, drop_untyped_nones=False, components=values)

    def _log_tails(self, view: FrameView) -> None:
        rr = self._rerun
        tail_colours = [colours.track_colour(track_id) for track_id in view.tails]
        strips = rr.LineStrips3D(
            list(view.tails.values()), colors=tail_colours, radii=rr.Radius.ui_points(_EDGE_RADIUS_PX)
        )
        self._recording.log(entities.TAILS, strips)

    def _log_picture(self, camera: Camera, picture: PictureView | None, labels: LabelRow | None) -> None:
        rr, path = self._rerun, entities.camera_path(camera.name)
        if picture is None:  # that of the frame before must not stay
            for part in ("image", "boxes", "names"):
                self._recording.log(f"{path}/{part}", rr.Clear(recursive=False))
            return
        image = rr.EncodedImage(media_type="image/jpeg", **{"contents": picture.jpeg})
        self._recording.log(f"{path}/image", image)
        if labels is None:
            return
        edges, box_colours = picture.edges, class_colours(labels)
        strips = rr.LineStrips2D(
            edges.strips_px, colors=box_colours[edges.box], radii=rr.Radius.ui_points(_EDGE_RADIUS_PX)
        )
        self._recording.log(f"{path}/boxes", strips)
        boxes = list(edges.anchor_px)
        names = rr.Points2D(
            np.array(list(edges.anchor_px.values())).reshape(-1, 2),
            labels=[short_text(labels, box) for box in boxes],
            colors=box_colours[boxes],
            radii=rr.Radius.ui_points(0.0),
        )
        self._recording.log(f"{path}/names", names)

    def log_text(self, name: str, text: str) -> None:
        """Log a text about the drive.

        Args:
            name: Name of its view.
            text: Markdown; where it is empty nothing is logged.
        """
        if text:
            document = self._rerun.TextDocument(text, media_type="text/markdown")
            self._recording.log(f"{entities.TEXTS}/{name}", document, static=True)


def class_colours(labels: LabelRow) -> Array:
    """Return (n, 3) uint8 colours of the boxes of a frame, by class."""
    unknown = _CLASS_COLOURS["unknown"]
    found = [_CLASS_COLOURS.get(name, unknown) for name in labels.class_name.tolist()]
    return np.array(found, dtype=np.uint8).reshape(-1, 3)


def short_text(labels: LabelRow, box: int) -> str:
    """Return the word of a box, else its class, and the number of its track."""
    return f"{labels.word[box] or labels.class_name[box]} #{labels.track_id[box]}"


def box_texts(labels: LabelRow) -> list[str]:
    """Return the texts at the boxes of a frame: word or class, track, score and speed."""
    speed_mps = np.linalg.norm(labels.velocity_mps[:, :2], axis=1)
    return [
        f"{short_text(labels, box)}  {labels.score[box]:.2f}  {speed_mps[box]:.1f} m/s"
        for box in range(len(labels.track_id))
    ]
