"""The rows of the stages that read pictures, and of what they say of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from upvl_cli.pipeline.stage import Row, column
from upvl_cli.stages import shared_columns

if TYPE_CHECKING:
    from upvl_cli.perception.labels.box_matching import FramePictures
    from upvl_cli.perception.visual.open_vocabulary import Basis
    from upvl_cli.types import Array, Boxes2d


@dataclass(frozen=True)
class PcaRow(Row):
    """The basis that features are kept in; one row for all drives. `components` holds 64 rows, one after the other."""

    mean: Array = column("float32", "mean of the features, all of length 1", per="dimension")
    components: Array = column("float32", "principal axes, those of the most variance first", per="value")
    scale: Array = column("float32", "size of a step of each rounded value", per="component")
    variance_kept: float = column("float64", "share of the variance that is kept")

    @property
    def basis(self) -> Basis:
        """The basis itself."""
        from upvl_cli.perception.visual.open_vocabulary import Basis

        return Basis(self.mean, self.components.reshape(-1, len(self.mean)), self.scale, self.variance_kept)


@dataclass(frozen=True)
class ExtractVlRow(Row):
    """Features of the points of one sweep."""

    state: Array = column("int8", "0 seen, 1 occluded, 2 no view: outside of all pictures", per="point")
    camera: Array = column(
        "int8", "place of the camera that sees it best among the drive's cameras, -1 for none", per="point"
    )
    feature: Array = column(
        "int8",
        "values of the seen points, in the order of the points, to be scaled by pca's steps",
        per="seen point",
        shape=(64,),
    )


@dataclass(frozen=True)
class Boxes2dRow(Row):
    """2D boxes in the pictures of one frame."""

    has_image: Array = column("bool", "whether the frame has a picture of the camera", per="camera")
    image_time_ns: Array = column("int64", "time of the picture, 0 where there is none", "ns", per="camera")
    camera: Array = column("int8", "place of the camera among the drive's cameras", per="box")
    xyxy_px: Array = column(
        "float32",
        "left, top, right and bottom edge; (0, 0) is the centre of the first pixel",
        "px",
        per="box",
        shape=(4,),
    )
    score: Array = column("float32", "confidence of the detector, 0 to 1", per="box")
    name: Array = column("string", "the detector's name of the kind", per="box")

    @property
    def pictures(self) -> FramePictures:
        """The pictures with the boxes of all of them."""
        from upvl_cli.perception.labels.box_matching import FramePictures

        return FramePictures(self.has_image, self.image_time_ns, self.camera, self.boxes2d)

    @property
    def boxes2d(self) -> Boxes2d:
        """The boxes of all cameras, without the camera."""
        from upvl_cli.types import Boxes2d

        return Boxes2d(self.xyxy_px, self.score, self.name)


@dataclass(frozen=True)
class LooksRow(Row):
    """What pictures of whole tracks show, for each label of one frame, to be joined with those of `nms` by track."""

    per_box: ClassVar[bool] = True

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    num_looks: Array = shared_columns.num_looks()
    look_feature: Array = shared_columns.look_feature()


@dataclass(frozen=True)
class MatchBoxes2dRow(Row):
    """2D boxes of the labels of one frame, in the order of those of `nms`."""

    per_box: ClassVar[bool] = True

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    camera: Array = column(
        "int8",
        "place of the camera that shows most of the label among the drive's cameras, -1 for none",
        per="box",
    )
    iou_2d: Array = column(
        "float32",
        "IoU, in that camera's picture, of the rectangle around the projected label with the best 2D box; 0 where none "
        "overlaps it, -1 where no picture shows the label or there is no detector",
        per="box",
    )
    name: Array = column(
        "string", "name of the 2D box that shows the label in this frame; empty for none", per="box"
    )
    score: Array = column("float32", "confidence of that 2D box, 0 for none", per="box")
    word: Array = column(
        "string",
        "name of the 2D boxes with the most votes of the track, in all frames; empty for none",
        per="box",
    )
    share: Array = column("float32", "share of the votes of the track that the word has", per="box")
    votes: Array = column("float32", "sum of the confidences of the 2D boxes of the track", per="box")


@dataclass(frozen=True)
class SemanticsRow(Row):
    """Classes of the points of one sweep, in the order of its points."""

    class_name: Array = column("string", "names of the classes", per="class")
    class_index: Array = column(
        "int8",
        "place of the class of the point in class_name, -1 where no camera saw its place or its track",
        per="point",
    )
    num_frames: Array = column(
        "int16", "frames in which a camera saw its place or its track, 0 for none", per="point"
    )
    margin: Array = column(
        "float16", "lead of the mean cosine of the class over that of the next one", per="point"
    )
