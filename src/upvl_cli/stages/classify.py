"""What class of object each label is, by words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.perception.labels.classes import CLASS_NAMES, CYCLIST, OTHER, PEDESTRIAN, VEHICLE
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import AmodalRow, ClassifyRow, ExtractVlRow, MaskRow, PcaRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class ClassifyConfig(Config):
    """Settings of `classify`."""

    vehicle: tuple[str, ...] = setting("words for vehicles")
    pedestrian: tuple[str, ...] = setting("words for people on foot")
    cyclist: tuple[str, ...] = setting("words for people on two wheels")
    other: tuple[str, ...] = setting(
        "words for everything else; a track that they win is of none of the three classes"
    )

    @property
    def words(self) -> tuple[list[int], list[str]]:
        """The class of each word, and all words."""
        lists = (
            (VEHICLE, self.vehicle),
            (PEDESTRIAN, self.pedestrian),
            (CYCLIST, self.cyclist),
            (OTHER, self.other),
        )
        types = [number for number, words in lists for _ in words]
        return types, [word for _, words in lists for word in words]


def run(inputs: Inputs, config: ClassifyConfig) -> Iterator[ClassifyRow]:
    """Let the points of each track vote on its word: each has the vote of its nearest word.

    In the paper all points of a box vote; here those that are not background.
    """
    import numpy as np

    from upvl_cli.perception.labels.classify import WordVotes
    from upvl_cli.perception.labels.point_features import foreground_points

    (fitted,) = inputs.table("pca", PcaRow)
    features, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    labels = inputs.table("nms", AmodalRow)
    type_of_word, words = config.words
    directions = inputs.model.embed_text(words)
    votes = WordVotes(np.array(type_of_word), lambda feature: fitted.basis.cosines(feature, directions))
    for row in labels:
        seen = features[row.frame]
        point, feature = foreground_points(seen.state, seen.feature, masks[row.frame].background)
        if len(point) and len(row.track_id):
            xyz_m = inputs.drive.points(row.frame).xyz_ego_m[point]
            votes.add_sweep(row.boxes, row.track_id, xyz_m, feature)
    texts = np.array([*words, ""])  # a track without a vote has the word -1: the last one
    for row in labels:
        classes = votes.classify(row.track_id)
        for number, name in CLASS_NAMES.items():
            inputs.count(f"{name}s", (classes.type == number).sum())
        yield ClassifyRow(
            inputs.segment, row.frame, row.track_id, classes.type, texts[classes.word], classes.share
        )


STAGE = Stage(
    name="classify",
    run=run,
    config=ClassifyConfig,
    row=ClassifyRow,
    reads=("raw", "vlm", "pca", "extract-vl", "mask", "nms"),
    version=2,
)
