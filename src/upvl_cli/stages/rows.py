"""The rows of all tables: what stages write, and what others read. Stages meet here, and import no other stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, TypeVar

from upvl_cli.pipeline.stage import Row, column, columns_of
from upvl_cli.stages import shared_columns

if TYPE_CHECKING:
    from upvl_cli.detector.model import Detector
    from upvl_cli.types import Array, Boxes, Ints, Ragged, TrackedBoxes


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
