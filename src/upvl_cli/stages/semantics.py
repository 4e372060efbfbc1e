"""The class of every point, fused over the drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.errors import BadSetting
from upvl_cli.perception.semantics.config import FusionConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, PcaRow, SemanticsRow
from upvl_cli.stages.rows import AmodalRow, FlowRow, OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.semantics.fusion import SweepScores
    from upvl_cli.perception.visual.open_vocabulary import Basis
    from upvl_cli.pipeline.stage import Inputs, Rows
    from upvl_cli.types import Floats, Ints, Points

MAX_CLASSES = 127  # the column `class` is int8


@dataclass(frozen=True)
class SemanticsConfig(Config):
    """Settings of `semantics`."""

    classes: tuple[str, ...] = setting(
        "the classes of points: each a list of words between commas, of which the first names the class"
    )
    moving_mps: float = setting(
        "lowest speed of a moving point, which has the class of its track instead of that of its place",
        "m/s",
        ge=0,
        le=200,
    )
    box_margin_m: float = setting(
        "by how much the box of a track grows on each side before the moving points inside of it are taken",
        "m",
        ge=0,
        le=2,
    )
    window_s: float = setting(
        "length of the windows of time whose places and tracks are fused; those of a longer drive overlap by half",
        "s",
        ge=1,
        le=3600,
    )
    fusion: FusionConfig = table("How sightings of a place are joined.")

    @property
    def words(self) -> tuple[tuple[str, ...], ...]:
        """The words of each class, its name first.

        Raises:
            BadSetting: There are no classes or too many, a class has no word, or a name or word stands twice.
        """
        split = tuple(tuple(word.strip() for word in entry.split(",")) for entry in self.classes)
        if not 0 < len(split) <= MAX_CLASSES:
            raise BadSetting(f"semantics.toml: classes has {len(split)} entries, expected 1 to {MAX_CLASSES}")
        empty = [entry for entry, words in zip(self.classes, split, strict=True) if not all(words)]
        if empty:
            raise BadSetting(
                f"semantics.toml: classes has an empty word in {empty[0]!r}, expected words between commas: "
                '"car, sedan, taxi"'
            )
        every = [word for words in split for word in words]
        twice = sorted({word for word in every if every.count(word) > 1})
        if twice:
            raise BadSetting(
                f"semantics.toml: classes names {', '.join(map(repr, twice))} twice; keep each once"
            )
        return split


def run(inputs: Inputs, config: SemanticsConfig) -> Iterator[SemanticsRow]:
    """Give each point a class by words, averaged over the frames in which a camera saw its place or its track."""
    import numpy as np

    from upvl_cli.perception.semantics.fusion import FusedScene, SceneEvidence
    from upvl_cli.perception.windows import fits_by_window
    from upvl_cli.runtime.parallel import in_order

    names = np.array([words[0] for words in config.words])
    poses = inputs.table("odometry", OdometryRow)
    sweeps = _scored_sweeps(inputs, config)
    time_ns = [pose.time_ns for pose in poses]
    time_s = np.array([(time - time_ns[0]) * 1e-9 for time in time_ns])
    parts = fits_by_window(
        time_s,
        in_order(sweeps.scores, poses),
        config.window_s,
        lambda: SceneEvidence(len(names), config.fusion),
    )

    def classify(pose_and_scene: tuple[OdometryRow, FusedScene]) -> tuple[int, Ints, Ints, Floats]:
        """Return the number of a frame, and class, number of frames and margin of each of its points."""
        pose, scene = pose_and_scene
        fused = scene.fuse(sweeps.scores(pose))
        number, margin = fused.classify()
        return pose.frame, number, fused.num_frames, margin

    frames = iter(poses)
    served = ((next(frames), scene) for part, scene in parts for _ in part)
    for frame, number, num_frames, margin in in_order(classify, served):
        inputs.count("points with a class", (number >= 0).sum())
        inputs.count("points of which no camera saw anything", (number < 0).sum())
        yield SemanticsRow(inputs.segment, frame, names, number, num_frames, margin)


@dataclass(frozen=True)
class _ScoredSweeps:
    """The sweeps of a drive, and what is known of their points."""

    points_of: Callable[[int], Points]
    flows: Rows[FlowRow]
    features: Rows[ExtractVlRow]
    boxes: Rows[AmodalRow]
    basis: Basis
    words: Floats
    class_of_word: Ints
    config: SemanticsConfig

    def scores(self, pose: OdometryRow) -> SweepScores:
        """Return what the words say of the points of a sweep."""
        from upvl_cli.geometry.se3 import apply
        from upvl_cli.perception.background.masks import moving
        from upvl_cli.perception.semantics.fusion import SweepScores, class_scores, tracks_of_points
        from upvl_cli.perception.visual.views import SEEN

        frame, row = pose.frame, self.features[pose.frame]
        xyz_m = self.points_of(frame).xyz_ego_m.astype("float64")
        is_moving = moving(self.flows[frame].flow_mps, min_speed_mps=self.config.moving_mps)
        labels = self.boxes[frame]
        track_id = tracks_of_points(
            xyz_m, is_moving, labels.boxes, labels.track_id, margin_m=self.config.box_margin_m
        )
        cosines = self.basis.cosines(row.feature, self.words)
        return SweepScores(
            apply(pose.world_from_ego, xyz_m),
            row.state == SEEN,
            class_scores(cosines, self.class_of_word),
            is_moving,
            track_id,
        )


def _scored_sweeps(inputs: Inputs, config: SemanticsConfig) -> _ScoredSweeps:
    import numpy as np

    from upvl_cli.perception.odometry.compensation import compensated_points

    (pca,) = inputs.table("pca", PcaRow)
    words = config.words
    return _ScoredSweeps(
        compensated_points(inputs.drive, inputs.table("odometry", OdometryRow)),
        inputs.table("flow", FlowRow),
        inputs.table("extract-vl", ExtractVlRow),
        inputs.table("nms", AmodalRow),
        pca.basis,
        inputs.model.embed_text([word for class_words in words for word in class_words]),
        np.repeat(np.arange(len(words)), [len(class_words) for class_words in words]),
        config,
    )


STAGE = Stage(
    name="semantics",
    run=run,
    config=SemanticsConfig,
    row=SemanticsRow,
    reads=("raw", "vlm", "pca", "odometry", "flow", "extract-vl", "nms"),
)
