"""The rows of all tables: what stages write, and what others read. Stages meet here, and import no other stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, TypeVar

from upvl_cli.pipeline.stage import Row, column, columns_of
from upvl_cli.stages import shared_columns

if TYPE_CHECKING:
    from upvl_cli.detector.model import Detector
    from upvl_cli.perception.labels.box_matching import FramePictures
    from upvl_cli.perception.visual.open_vocabulary import Basis
    from upvl_cli.types import Array, Boxes, Boxes2d, Ints, Ragged, TrackedBoxes


@dataclass(frozen=True)
class OdometryRow(Row):
    """Time and pose of one frame, and how well the sweeps agree with it."""

    time_ns: int = column("int64", "time of the sweep, from any fixed origin", "ns")
    world_from_ego: Array = column("float64", "pose of the car", "m", shape=(4, 4))
    is_placed: bool = column(
        "bool",
        "the sweep or the data set gave the pose; else it is interpolated between those of other frames",
    )
    residual_m: float = column(
        "float64",
        "root mean square distance of upright points from the surfaces of a sweep shortly before under the poses, of "
        "those that have a partner there; NaN where nothing could be compared",
        "m",
    )
    residual_given_m: float = column(
        "float64", "the same under the poses of the data set, before refinement; NaN where it has none", "m"
    )
    inlier_share: float = column(
        "float64",
        "share of the upright points with a partner in a sweep shortly before; NaN where too few",
    )
    inlier_share_given: float = column(
        "float64", "the same under the poses of the data set, before refinement"
    )
    position_sigma_m: float = column(
        "float64",
        "standard deviation of the way since that sweep, in its worst direction, as the sweeps fix it",
        "m",
    )
    heading_sigma_rad: float = column(
        "float64", "standard deviation of the turn since then, as the sweeps fix it", "rad"
    )


@dataclass(frozen=True)
class GroundRow(Row):
    """Height of each point of a sweep, in the order of its points."""

    height_m: Array = column("float16", "height above the ground below the point", "m", per="point")
    is_ground: Array = column("bool", "part of the ground", per="point")


@dataclass(frozen=True)
class FlowRow(Row):
    """Motion of each point of a sweep, in the order of its points."""

    flow_mps: Array = column("float16", "velocity over the ground", "m/s", "ego", per="point", shape=(3,))


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
class MaskRow(Row):
    """State of each point of a sweep, in the order of its points."""

    is_moving: Array = column("bool", "at least as fast as min_speed_mps", per="point")
    background: Array = column(
        "int8",
        "1 background, 0 not, -1 unknown: it moves, or has no feature and is kept by the policy for those",
        per="point",
    )


@dataclass(frozen=True)
class BoxRow(Row):
    """Boxes of one frame; the table has one row a box."""

    per_box: ClassVar[bool] = True

    time_ns: int = column("int64", "time of the sweep, from any fixed origin", "ns")
    center_m: Array = column(
        "float64",
        "centre of the box",
        "m",
        "ego",
        per="box",
        names=("center_x_m", "center_y_m", "center_z_m"),
    )
    size_lwh_m: Array = column(
        "float64", "size of the box", "m", per="box", names=("length_m", "width_m", "height_m")
    )
    heading_rad: Array = column(
        "float64", "direction of the length, counter-clockwise from x", "rad", "ego", per="box"
    )
    velocity_mps: Array = column(
        "float64",
        "velocity over the ground",
        "m/s",
        "ego",
        per="box",
        names=("velocity_x_mps", "velocity_y_mps", "velocity_z_mps"),
    )
    num_points: Array = column("int32", "LiDAR points that the box was made from", per="box")

    @property
    def boxes(self) -> Boxes:
        """The boxes alone."""
        from upvl_cli.types import Boxes

        return Boxes(self.center_m, self.size_lwh_m, self.heading_rad)


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
class ProposalRow(BoxRow):
    """Boxes of one sweep, and which points they were made from.

    Several hypotheses say how the points part into objects; a point is in one box of each at most.
    """

    hypothesis: Array = column(
        "int8", "number of the hypothesis: the radius of the clustering that made the box", per="box"
    )
    duplicate_of: Array = column(
        "int32",
        "row of the box of an earlier hypothesis of this sweep with nearly the same points, -1 for none",
        per="box",
    )
    point_index: Ragged = column(
        "int32", "places of its points in the sweep, ascending", per="box", ragged=True
    )
    is_lifted: Array = column("bool", "a 2D box shows the object: see boxes2d", per="box")


@dataclass(frozen=True)
class TrackRow(BoxRow):
    """Tracked boxes of one frame."""

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    proposal: Array = column(
        "int32", "row of the box among the proposals of its frame, -1 where coasting", per="box"
    )
    hypothesis: Array = column(
        "int8", "number of the hypothesis that the track is of: it has no box of another", per="box"
    )


@dataclass(frozen=True)
class ScoredBoxRow(BoxRow):
    """Boxes of one frame with a score and a track."""

    score: Array = column("float64", "confidence, 0 to 1", per="box")
    track_id: Array = column("int64", "number of the track in its segment, -1 for none", per="box")

    @property
    def tracked_boxes(self) -> TrackedBoxes:
        """The boxes without the key."""
        from upvl_cli.types import TrackedBoxes

        return TrackedBoxes(
            self.center_m, self.size_lwh_m, self.heading_rad, self.velocity_mps, self.score, self.track_id
        )


@dataclass(frozen=True)
class AmodalRow(ScoredBoxRow):
    """Boxes around whole objects, and why each has its score."""

    background_share: Array = column(
        "float64", "share of background among the points of the track, in all frames", per="box"
    )
    num_frames_seen: Array = column("int32", "frames in which the track has points", per="box")
    objectness: Array = column(
        "float32", "probability that the track is a road user, by its shape, size and motion", per="box"
    )
    sides_seen: Array = column("int8", "how many of its four sides faced the sensor", per="box")
    residual_m: Array = column(
        "float32",
        "by how much the registered sweeps of the track differ, NaN where none is registered",
        "m",
        per="box",
    )


B = TypeVar("B", bound=BoxRow)


def select(row: B, index: Ints) -> B:
    """Return the row with some of its boxes."""
    names = [name for name, spec in columns_of(type(row)).items() if spec.per == "box"]
    return replace(row, **{name: getattr(row, name)[index] for name in names})


@dataclass(frozen=True)
class LooksRow(Row):
    """What pictures of whole tracks show, for each label of one frame, to be joined with those of `nms` by track."""

    per_box: ClassVar[bool] = True

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    num_looks: Array = shared_columns.num_looks()
    look_feature: Array = shared_columns.look_feature()


@dataclass(frozen=True)
class ClassifyRow(Row):
    """Classes of the labels of one frame, to be joined with those of `nms` by track."""

    per_box: ClassVar[bool] = True

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    type: Array = column(
        "int8", "1 vehicle, 2 pedestrian, 4 cyclist (Waymo's numbers), 0 other or not seen", per="box"
    )
    word: Array = column(
        "string",
        "word that the points and the looks of the track are nearest to; empty if not seen",
        per="box",
    )
    share: Array = column(
        "float32", "share of the votes of the track's points and looks that the class has", per="box"
    )
    num_looks: Array = shared_columns.num_looks()
    look_word: Array = shared_columns.look_word()
    look_share: Array = shared_columns.look_share()
    words_agree: Array = shared_columns.words_agree()


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
class LabelRow(AmodalRow):
    """The auto labels of one frame: what users take."""

    class_name: Array = column(
        "string",
        "vehicle, pedestrian, cyclist or other; unknown where no camera saw the track",
        per="box",
        names=("class",),
    )
    word: Array = column(
        "string",
        "word that the points and the looks of the track are nearest to; empty if not seen",
        per="box",
    )
    class_share: Array = column(
        "float32", "share of the votes of the track's points and looks that the class has", per="box"
    )
    is_moving: Array = column("bool", "at least as fast as moving_mps in this frame", per="box")
    num_looks: Array = shared_columns.num_looks()
    look_word: Array = shared_columns.look_word()
    look_share: Array = shared_columns.look_share()
    words_agree: Array = shared_columns.words_agree()
    iou_2d: Array = column(
        "float32",
        "IoU of the rectangle around the projected label with the best 2D box; 0 where none overlaps it, -1 where no "
        "picture shows the label or there is no detector",
        per="box",
    )
    box_word: Array = column(
        "string", "name of the 2D boxes with the most votes of the track; empty for none", per="box"
    )
    box_share: Array = column("float32", "share of the votes of the track that this name has", per="box")


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


@dataclass(frozen=True)
class ObjectSummaryRow(ScoredBoxRow):
    """Boxes of one frame, each with the mean vision-language feature of its points: what filters and rankings read."""

    num_features: Array = column("int32", "points of the box that have a feature", per="box")
    pooled: Array = column(
        "int8",
        "mean feature of the box, rounded as those of its points; zeros without points",
        per="box",
        shape=(64,),
    )
    num_looks: Array = shared_columns.num_looks()
    look_feature: Array = shared_columns.look_feature()


@dataclass(frozen=True)
class PointFeatureRow(Row):
    """The features of the points of each box of one frame: what votes read."""

    per_box: ClassVar[bool] = True

    point_feature: Ragged = shared_columns.point_feature()


@dataclass(frozen=True)
class ObjectRow(ObjectSummaryRow):
    """Boxes of one frame with the vision-language features of the points inside of them: what a query reads."""

    point_feature: Ragged = shared_columns.point_feature()


@dataclass(frozen=True)
class TrainRow(Row):
    """The detector and how it was trained; one row for all drives."""

    weights: Array = column("uint8", "the weights, as a file of safetensors", per="byte")
    detector_config: str = column(
        "string", "grid, model and sweeps of train.toml, as JSON: what the network is built from and fed with"
    )
    has_distillation_head: bool = column("bool", "whether the network predicts features of points")
    learning_rate: Array = column("float64", "learning rate of each step", per="step")
    total: Array = column("float64", "loss", per="step")
    objectness: Array = column("float64", "part of the loss: focal loss of objectness", per="step")
    box: Array = column("float64", "part of the loss: centres and sizes", per="step")
    heading: Array = column("float64", "part of the loss: headings", per="step")
    distillation: Array = column("float64", "part of the loss: features of points", per="step")
    check_step: Array = column("int64", "steps done at each check on the held-out frames", per="check")
    check_total: Array = column("float64", "loss on the held-out frames", per="check")

    @property
    def detector(self) -> Detector:
        """The network, ready to detect."""
        from upvl_cli.detector.checkpoint import unpack_config, unpack_detector

        return unpack_detector(self.weights, unpack_config(self.detector_config), self.has_distillation_head)
