"""What class of object each label is, by words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.labels.classes import CLASS_NAMES, CYCLIST, OTHER, PEDESTRIAN, VEHICLE
from upvl_cli.perception.labels.config import LookVoteConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.picture_rows import ExtractVlRow, LooksRow, PcaRow
from upvl_cli.stages.rows import AmodalRow, ClassifyRow, MaskRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class KindsConfig(Config):
    """Finer words for the classes."""

    vehicle: tuple[str, ...] = setting("kinds of vehicles")
    pedestrian: tuple[str, ...] = setting("kinds of people on foot")
    cyclist: tuple[str, ...] = setting("kinds of people on two wheels")


@dataclass(frozen=True)
class ClassifyConfig(Config):
    """Settings of `classify`."""

    vehicle: tuple[str, ...] = setting("words for vehicles")
    pedestrian: tuple[str, ...] = setting("words for people on foot")
    cyclist: tuple[str, ...] = setting("words for people on two wheels")
    other: tuple[str, ...] = setting(
        "words for everything else; a track that they win is of none of the three classes"
    )
    kinds: KindsConfig = table("Words that only looks choose among, beside those above: finer kinds.")
    looks: LookVoteConfig = table("How looks and points choose a word together, in labels and in queries.")

    @property
    def lists(self) -> dict[str, tuple[str, ...]]:
        """The words that points vote for, by the name of their list."""
        return {
            "vehicle": self.vehicle,
            "pedestrian": self.pedestrian,
            "cyclist": self.cyclist,
            "other": self.other,
        }

    @property
    def words(self) -> tuple[list[int], list[str]]:
        """The class of each word that points vote for, and these words."""
        lists = tuple(zip((VEHICLE, PEDESTRIAN, CYCLIST, OTHER), self.lists.values(), strict=True))
        types = [number for number, words in lists for _ in words]
        return types, [word for _, words in lists for word in words]

    @property
    def kind_words(self) -> tuple[list[int], list[str]]:
        """The class of each further word that looks choose among, and these words."""
        lists = (
            (VEHICLE, self.kinds.vehicle),
            (PEDESTRIAN, self.kinds.pedestrian),
            (CYCLIST, self.kinds.cyclist),
        )
        known = set(self.words[1])
        pairs = [(number, word) for number, words in lists for word in words if word not in known]
        return [number for number, _ in pairs], [word for _, word in pairs]


def run(inputs: Inputs, config: ClassifyConfig) -> Iterator[ClassifyRow]:
    """Let the points of each track vote on its word: each has the vote of its nearest word.

    In the paper all points of a box vote; here those that are not background. Looks at the whole track give each word
    a share too; where there are both, the mean of both shares decides.
    """
    import numpy as np

    from upvl_cli.perception.labels.classify import WordVotes
    from upvl_cli.perception.labels.look_votes import look_shares
    from upvl_cli.perception.labels.point_features import foreground_points

    (fitted,) = inputs.table("pca", PcaRow)
    features, masks = inputs.table("extract-vl", ExtractVlRow), inputs.table("mask", MaskRow)
    labels = inputs.table("nms", AmodalRow)
    looks = inputs.table("looks", LooksRow)
    types = [*config.words[0], *config.kind_words[0]]
    words = [*config.words[1], *config.kind_words[1]]
    type_of_word, directions = np.array(types), inputs.model.embed_text(words)
    voters = directions[: len(config.words[1])]
    votes = WordVotes(
        type_of_word, lambda feature: fitted.basis.cosines(feature, voters), config.looks.weight
    )
    for row in labels:
        seen = features[row.frame]
        point, feature = foreground_points(seen.state, seen.feature, masks[row.frame].background)
        if len(point) and len(row.track_id):
            xyz_m = inputs.drive.points(row.frame).xyz_ego_m[point]
            votes.add_sweep(row.boxes, row.track_id, xyz_m, feature)
        look = looks[row.frame]
        shown = look.num_looks > 0
        cosines = fitted.basis.cosines(look.look_feature[shown], directions)
        votes.add_looks(look.track_id[shown], look_shares(cosines, type_of_word, config.looks.temperature))
    texts = np.array([*words, ""])  # a track without a vote has the word -1: the last one
    for row in labels:
        classes = votes.classify(row.track_id)
        for number, name in CLASS_NAMES.items():
            inputs.count(f"{name}s", (classes.type == number).sum())
        inputs.count("labels whose points and looks disagree", (~classes.agree).sum())
        yield ClassifyRow(
            inputs.segment,
            row.frame,
            row.track_id,
            classes.type,
            texts[classes.word],
            classes.share,
            looks[row.frame].num_looks,
            texts[classes.look_word],
            classes.look_share,
            classes.agree,
        )


STAGE = Stage(
    name="classify",
    run=run,
    config=ClassifyConfig,
    row=ClassifyRow,
    reads=("raw", "vlm", "pca", "extract-vl", "mask", "nms", "looks"),
    version=2,
)
