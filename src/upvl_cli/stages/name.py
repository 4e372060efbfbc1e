"""What kind of object each label is, by words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class NameParams:
    """Settings of `name`."""

    vehicle: tuple[str, ...] = param("words for vehicles")
    pedestrian: tuple[str, ...] = param("words for people on foot")
    cyclist: tuple[str, ...] = param("words for people on two wheels")
    other: tuple[str, ...] = param("words for all else: what they win is neither")

    @property
    def words(self) -> tuple[list[int], list[str]]:
        """All words, each with the number of its kind."""
        lists = ((1, self.vehicle), (2, self.pedestrian), (4, self.cyclist), (0, self.other))
        return [kind for kind, some in lists for _ in some], [word for _, some in lists for word in some]


@dataclass(frozen=True)
class NameRow(Row):
    """Kinds of the labels of one frame, to be joined with those of `nms` by track."""

    track_id: Array = column("int64", "number of the track in its segment", per="box")
    type: Array = column(
        "int8", "1 vehicle, 2 pedestrian, 4 cyclist (Waymo's numbers), 0 other or not seen", per="box"
    )
    word: Array = column("int16", "place of the word among all words of the settings, -1 not seen", per="box")
    share: Array = column("float32", "share of the votes of the track's points that the kind has", per="box")


def run(inputs: Inputs, params: NameParams) -> Iterator[NameRow]:
    """Let the points of each track vote on its word: each has the vote of its nearest word.

    In the paper all points of a box vote; here those that are not background.
    """
    import numpy as np

    from upvl_cli.algorithms.naming import OTHER, Votes
    from upvl_cli.algorithms.objects import of_objects

    (fitted,) = inputs.table("pca")
    features, masks, labels = (inputs.table(name) for name in ("extract-vl", "mask", "nms"))
    kinds, names = params.words
    words = inputs.model.embed_text(names)
    votes = Votes(np.array(kinds), lambda feature: fitted.basis.cosines(feature, words))
    for row in labels:
        of = features[row.frame]
        point, feature = of_objects(of.state, of.feature, masks[row.frame].background)
        if len(point) and len(row.seven):
            xyz = inputs.drive.points(row.frame).xyz_ego_m[point]
            votes.add(row.seven, row.track_id, xyz, feature)
    for row in labels:
        kind, word, share = votes.of(row.track_id)
        for number, what in ((1, "vehicles"), (2, "pedestrians"), (4, "cyclists"), (OTHER, "others")):
            inputs.count(what, (kind == number).sum())
        yield NameRow(inputs.segment, row.frame, row.track_id, kind, word, share)


STAGE = Stage(
    name="name",
    run=run,
    params=NameParams,
    row=NameRow,
    reads=("raw", "vlm", "pca", "extract-vl", "mask", "nms"),
    version=2,
)
