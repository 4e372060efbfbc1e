"""What kind of object each label is, by words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
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
    other: tuple[str, ...] = setting("words for all else: what they win is neither")

    @property
    def words(self) -> tuple[list[int], list[str]]:
        """All words, each with the number of its class."""
        lists = ((1, self.vehicle), (2, self.pedestrian), (4, self.cyclist), (0, self.other))
        return [number for number, some in lists for _ in some], [word for _, some in lists for word in some]


def run(inputs: Inputs, config: ClassifyConfig) -> Iterator[ClassifyRow]:
    """Let the points of each track vote on its word: each has the vote of its nearest word.

    In the paper all points of a box vote; here those that are not background.
    """
    import numpy as np

    from upvl_cli.perception.labels.classify import OTHER, Votes
    from upvl_cli.perception.labels.point_features import of_objects

    (fitted,) = inputs.table("pca", PcaRow)
    features, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    labels = inputs.table("nms", AmodalRow)
    kinds, names = config.words
    words = inputs.model.embed_text(names)
    votes = Votes(np.array(kinds), lambda feature: fitted.basis.cosines(feature, words))
    for row in labels:
        of = features[row.frame]
        point, feature = of_objects(of.state, of.feature, masks[row.frame].background)
        if len(point) and len(row.track_id):
            xyz = inputs.drive.points(row.frame).xyz_ego_m[point]
            votes.add(row.boxes, row.track_id, xyz, feature)
    for row in labels:
        kind, word, share = votes.of(row.track_id)
        for number, what in ((1, "vehicles"), (2, "pedestrians"), (4, "cyclists"), (OTHER, "others")):
            inputs.count(what, (kind == number).sum())
        texts = np.array([*names, ""])[word]  # a track without a vote has the number -1
        yield ClassifyRow(inputs.segment, row.frame, row.track_id, kind, texts, share)


STAGE = Stage(
    name="classify",
    run=run,
    config=ClassifyConfig,
    row=ClassifyRow,
    reads=("raw", "vlm", "pca", "extract-vl", "mask", "nms"),
    version=2,
)
